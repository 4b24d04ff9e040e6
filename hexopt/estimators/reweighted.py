"""Weights taken at the estimate itself: any weighted linear estimator, repeated until it settles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from ..arrays import BoolArray
from ..errors import InputError
from ..loops import Loop
from ..problem import LinearProblem
from ..result import Estimate, Estimator, Status

__all__ = ["Reweighted"]

#: Where an estimate has no covariance: what counts as one standard error, relative to the size of the block.
RELATIVE = 1e-3


@dataclass(frozen=True)
class Reweighted:
    r"""The fixed point :math:`x = \arg\min_z F(W(x)(A z - y))`, :math:`W(x) = (D S(x) D^T)^{-1/2}`.

    The covariance S of the rows depends on the parameters: for Type I on b and n. A weighted estimator takes it
    at the unweighted solution; this one then takes it at the answer, :math:`x_0`, and goes on with
    :math:`x_{k+1} = \arg\min_z F(W(x_k)(A z - y))` until that changes nothing.

    Parameters
    ----------
    estimator : Estimator
        A weighted estimator of linear problems, such as ``LeastSquares(weights="model")``: it solves every pass.
    form : {"direct", "consecutive", "centred"}, default "direct"
        The form in which a loop is taken; a linear problem has its own.
    tolerance : float, default 1e-6
        A set has settled when no value changes by more, in standard errors; where the estimator gives no
        covariance, in thousandths of the largest value in the parameter's block.
    max_iterations : int, default 50
        Passes after the first estimate; a set that has not settled by then is NOT_CONVERGED.

    Notes
    -----
    To first order in the noise the first pass is efficient already, and the fixed point is what another weighting
    would not improve; it does not depend on where the weights began. Covariance, gap and χ² are those of the last
    pass of each set; `iterations` counts the passes. A set that has settled, or failed, is left as it is, so that
    the answer does not depend on its neighbours. There is no certificate that the fixed point is the only one.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "direction", n_poses=7, noise=noise, rng=2)
    >>> settled = hx.Reweighted(hx.LeastSquares(weights="model"))
    >>> found = hx.estimate(hx.loops.FixedDirection(data), settled)
    >>> found.status, found.covariance_kind, int(found.iterations) <= 5
    (<Status.OPTIMAL: 0>, 'model', True)
    """

    estimator: Estimator
    form: str = "direct"
    tolerance: float = 1e-6
    max_iterations: int = 50

    accepts: ClassVar[tuple[type, ...]] = (Loop, LinearProblem)
    hint: ClassVar[str] = 'write estimate(loop, Reweighted(LeastSquares(weights="model")))'

    def __post_init__(self) -> None:
        inner = self.estimator
        if isinstance(inner, type) or not hasattr(inner, "accepts") or not issubclass(LinearProblem, inner.accepts):
            raise InputError(
                f'estimator: expected one of linear problems, such as LeastSquares(weights="model"); got {inner!r}'
            )
        if getattr(inner, "weights", None) != "model":
            raise InputError(
                f'estimator: {inner!r} has no weights to take anew; write {type(inner).__name__}(weights="model")'
            )
        if not 0 < self.tolerance < np.inf:
            raise InputError(f"tolerance: expected a number > 0 of standard errors, got {self.tolerance!r}")
        if not isinstance(self.max_iterations, (int, np.integer)) or self.max_iterations < 1:
            raise InputError(f"max_iterations: expected an integer >= 1, got {self.max_iterations!r}")

    def fit(self, target: Loop | LinearProblem) -> Estimate:
        """Estimate, weigh at the estimate, and so on; a set that does not settle fails alone."""
        problem = target.linear(self.form) if isinstance(target, Loop) else target
        found: Estimate = self.estimator.fit(problem)
        moving = np.asarray(found.codes) == Status.OPTIMAL
        passes = np.zeros(found.batch_shape, dtype=np.int64)
        for _ in range(self.max_iterations):
            if not moving.any():
                break
            after: Estimate = self.estimator.fit(replace(problem, at=found.values))
            passes = passes + moving
            settled = self._settled(found, after)
            found = _merged(found, after, moving)
            moving = moving & (np.asarray(found.codes) == Status.OPTIMAL) & ~settled
        codes = np.where(moving, Status.NOT_CONVERGED, found.codes).astype(np.int8)
        return replace(
            found,
            values=np.where((codes == Status.OPTIMAL)[..., None], found.values, np.nan),
            codes=codes,
            iterations=passes,
            estimator=f"{problem.name} by {self!r}",
        )

    def _settled(self, before: Estimate, after: Estimate) -> BoolArray:
        """Which problems of the batch hardly changed."""
        if after.covariance is not None:
            unit = after.standard_errors
        else:
            sizes = [
                np.broadcast_to(np.abs(block).max(axis=-1, keepdims=True), block.shape)
                for block in after.params.values()
            ]
            unit = RELATIVE * np.concatenate(sizes, axis=-1)
        change = np.abs(after.values - before.values)
        return np.asarray((change <= self.tolerance * unit).all(axis=-1))


def _merged(kept: Estimate, new: Estimate, where: BoolArray) -> Estimate:
    """`new` at the members `where`, `kept` elsewhere."""

    def merged(old: Any, fresh: Any) -> Any:
        if isinstance(fresh, Mapping):
            return {name: merged(old.get(name, value), value) for name, value in fresh.items()}
        if isinstance(fresh, np.ndarray) and fresh.shape[: where.ndim] == where.shape:
            return np.where(where.reshape(where.shape + (1,) * (fresh.ndim - where.ndim)), fresh, old)
        return fresh

    parts: dict[str, Any] = {
        item.name: merged(getattr(kept, item.name), getattr(new, item.name)) for item in fields(new)
    }
    return replace(new, **parts)
