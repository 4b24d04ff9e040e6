"""Nonlinear least squares on leg lengths: the inverse-kinematics calibration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..geometry import Leg
from ..loops import LegLength
from ..measurements import Lock
from ..numerics.lm import levenberg_marquardt
from ..numerics.lstsq import solve_svd
from ..problem import Whitening
from ..result import Estimate, Status
from .least_squares import check_rows, linear_uncertainty, unseen_combinations

__all__ = ["InverseKinematics"]


@dataclass(frozen=True)
class InverseKinematics:
    r"""Leg lengths fitted to poses: :math:`\min\sum_i w_i(\lVert P_i + R_i b - a\rVert - \gamma\rho_i - \delta)^2/2`.

    Parameters
    ----------
    start : Leg, optional
        Where the iteration starts; by default the data's nominal. Its other values are not used.
    weights : None or "model", default None
        "model": :math:`w_i = 1/(n^T(\sigma_P^2 I + \sigma_E^2 JJ^T)n + \gamma^2\sigma_\rho^2)` from the noise
        model, at the unweighted solution.
    max_iterations : int, default 200

    Notes
    -----
    Needs an initial guess, unlike the linear loops. Levenberg–Marquardt on the whole batch; no
    certificate of a global minimum (gap is NaN). The unknowns are those of the loop:
    ``LegLength(data, unknown=(…))``; Model 36 has b and a, 42 the offset, 48 the gain too. Poses
    rotated about one axis only, or a leg's own DIRECTION or LEG set alone, do not determine them.

    References
    ----------
    Masory, Wang and Zhuang (1993); Daney (1998), section 1.2.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "none", n_poses=10, nominal=robot.perturbed(0.3, rng=0), rng=1)
    >>> found = hx.estimate(hx.loops.LegLength(data), hx.InverseKinematics())
    >>> bool(found.error(robot.leg(3))["base_point"] < 1e-9)
    True
    """

    start: Leg | None = None
    weights: Literal["model"] | None = None
    max_iterations: int = 200

    accepts: ClassVar[tuple[type, ...]] = (LegLength,)
    hint: ClassVar[str] = "write estimate(loops.LegLength(data), InverseKinematics())"

    def __post_init__(self) -> None:
        if self.start is not None and not isinstance(self.start, Leg):
            raise InputError(f"start: expected a Leg, got {type(self.start).__name__}")
        if self.weights not in (None, "model"):
            raise InputError(f"weights: expected None or 'model', got {self.weights!r}")
        if self.max_iterations < 1:
            raise InputError(f"max_iterations: expected at least 1, got {self.max_iterations}")

    def fit(self, target: LegLength) -> Estimate:
        """Fit every set of the batch; one that does not converge, or is not determined, fails alone."""
        start = self.start or target.data.nominal
        if start is None:
            raise InputError("InverseKinematics needs an initial guess: give start=Leg(…) or data with a nominal")
        first = np.broadcast_to(target.values(start), (*target.data.batch_shape, target.parameters.size))
        check_rows(target.linearised(first))
        values, converged, iterations = self._minimise(target, first, None)
        root = None
        if self.weights == "model":
            settled = target.linearised(np.where(converged[..., None], values, first))
            root = settled.whitening()
            values, converged, more = self._minimise(target, values, root)
            iterations = iterations + more
        return self._estimate(target, values, converged, iterations, root)

    def _minimise(self, loop: LegLength, start: Array, root: Whitening | None) -> tuple[Array, Any, Any]:
        batch, size = start.shape[:-1], start.shape[-1]

        def evaluate(flat: Array) -> tuple[Array, Array]:
            x = flat.reshape(*batch, size)
            residual, jacobian = loop.residual(x), loop.jacobian(x)[..., 0, :]  # one row a pose
            if root is not None:
                residual, jacobian = root.apply(residual), root.apply(jacobian)
            rows = residual.shape[-2]
            return residual.reshape(-1, rows), jacobian.reshape(-1, rows, size)

        result = levenberg_marquardt(evaluate, start.reshape(-1, size), max_iterations=self.max_iterations)
        return (
            result.values.reshape(*batch, size),
            result.converged.reshape(batch),
            result.iterations.reshape(batch),
        )

    def _estimate(self, loop: LegLength, values: Array, converged: Any, iterations: Any, root: Any) -> Estimate:
        problem = loop.linearised(values)
        matrix, rhs = problem.whitened_by(root)
        local = solve_svd(matrix, rhs)
        codes = np.where(converged, Status.OPTIMAL, Status.NOT_CONVERGED)
        seen = local.full_rank & (not _is_blind(loop))
        codes = np.where(seen, codes, Status.RANK_DEFICIENT).astype(np.int8)
        objective = 0.5 * np.einsum("...m,...m->...", rhs, rhs)
        return Estimate(
            values=np.where((codes == Status.OPTIMAL)[..., None], values, np.nan),
            parameters=loop.parameters,
            codes=codes,
            objective=objective,
            gap=np.full(codes.shape, np.nan),
            condition=local.condition,
            chi2=None if root is None else 2 * objective,
            iterations=iterations,
            estimator=f"{problem.name} by {self!r}",
            unseen=unseen_combinations(problem, local) or (_BLIND if _is_blind(loop) else ()),
            **linear_uncertainty(problem, local, root, values),
        )


#: What a locked direction hides; noise in the measurements makes the matrix look as if it did not.
_BLIND = ("base_point across the leg's locked direction",)


def _is_blind(loop: LegLength) -> bool:
    """Whether the leg's own lock keeps its direction, so that its lengths say nothing of a across it."""
    return "base_point" in loop.unknown and loop.data.lock in (Lock.DIRECTION, Lock.LEG)
