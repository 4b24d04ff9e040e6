"""Maximum likelihood on implicit loop equations: the Gauss–Helmert model, for a batch of problems at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..arrays import Array, BoolArray, transpose
from ..errors import InputError
from ..geometry import Hexapod, Leg
from ..loops.implicit import Implicit, check_errors, degrees_of_freedom
from ..loops.rows import WhitenedRows, shared_places
from ..numerics.charts import Chart
from ..numerics.lstsq import solve
from ..result import Estimate, Status
from .least_squares import unseen_combinations
from .likelihood import Likelihood, Stationary
from .unit_norm import UnitNormLeastSquares

__all__ = ["MaximumLikelihood"]


@dataclass(frozen=True)
class MaximumLikelihood:
    r"""The likeliest values: :math:`\min_{x, e}\tfrac12\sum_i e_i^T\Sigma_i^{-1}e_i`, :math:`g_i(x, m_i + e_i) = 0`.

    Every measurement is moved, by what its noise model finds likely, until the loop equations hold exactly
    (Gauss–Helmert model, errors in variables). For normal errors it reaches the Cramér–Rao bound of :meth:`crlb`
    to first order, and has none of the bias that noise in the matrix gives to least squares.

    Parameters
    ----------
    start : Leg or Hexapod, optional
        Where the iteration starts. By default the least-squares solution where the loop is linear in its unknowns
        (of Type I the global one on the unit sphere), so that no guess is needed; else the data's nominal.
    unit_norm : bool, default True
        Whether the direction of Type I keeps its unit length; most of the gain over weighted least squares.
    max_iterations : int, default 100
        Of each of the methods that are tried in turn.

    Notes
    -----
    With :math:`G_i = \partial g_i/\partial x` and :math:`B_i = \partial g_i/\partial m_i`, both at the moved
    measurements, the errors are :math:`e_i = -\Sigma_i B_i^T S_i^{-1} w_i`, where :math:`S_i = B_i\Sigma_i B_i^T` and
    :math:`w_i = g_i - B_i e_i`. The parameters follow from :math:`S_i^{-1/2} w_i` with the Jacobian
    :math:`S_i^{-1/2} G_i`: by Gauss–Newton from where unweighted least squares ended, by
    Levenberg–Marquardt where that fails. What all poses
    share (a common error, the error of known estimates) is estimated along, to first order. The covariance,
    :math:`(\sum G_i^T S_i^{-1} G_i)^{-1}` at the answer, is singular along unit vectors. There is no certificate of a
    global minimum (gap is NaN): :class:`UnitNormLeastSquares` has one, for given weights.

    References
    ----------
    Wampler, Hollerbach and Arai (1995), the implicit loop method; Daney (1998), eq. (3), (8) and (13).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(robot, leg=3, lock="direction", n_poses=20, n_sets=200, noise=noise, rng=1)
    >>> loop = hx.loops.FixedDirection(data)
    >>> paper = hx.estimate(loop.linear("consecutive"), hx.LeastSquares())
    >>> ours = hx.estimate(loop, hx.MaximumLikelihood())
    >>> ratio = paper.error(robot.leg(3))["base_point"].mean() / ours.error(robot.leg(3))["base_point"].mean()
    >>> bool(ratio > 1.4)
    True
    """

    start: Leg | Hexapod | None = None
    unit_norm: bool = True
    max_iterations: int = 100

    accepts: ClassVar[tuple[type, ...]] = (Implicit,)
    hint: ClassVar[str] = "write estimate(loop, MaximumLikelihood()), on the loop itself"

    def __post_init__(self) -> None:
        if self.start is not None and not isinstance(self.start, (Leg, Hexapod)):
            raise InputError(f"start: expected a Leg or a Hexapod, got {type(self.start).__name__}")
        if not isinstance(self.unit_norm, (bool, np.bool_)):
            raise InputError(f"unit_norm: expected True or False, got {self.unit_norm!r}")
        whole = isinstance(self.max_iterations, (int, np.integer)) and not isinstance(self.max_iterations, bool)
        if not whole or self.max_iterations < 1:
            raise InputError(f"max_iterations: expected an integer >= 1, got {self.max_iterations!r}")

    def fit(self, target: Implicit) -> Estimate:
        """Fit every problem of the batch; one that does not converge, or is not determined, fails alone."""
        start, unseen = _start(target, self.start, target.chart(self.unit_norm))
        rows = [part.whitened(start[..., place]) for part, place in target.parts]
        check_errors(target, start, rows)
        shared = shared_places(rows)
        problem = Likelihood(target, target.chart(self.unit_norm, shared.count), shared)
        freedom = degrees_of_freedom(target, rows, problem.chart)
        near = rows if self.start is None and target.is_linear else None
        end = problem.maximum(start, self.max_iterations, near)
        return replace(
            _estimate(problem, end, np.asarray(np.isfinite(start).all(axis=-1) & ~target.failed), unseen),
            degrees_of_freedom=freedom,
            estimator=f"{type(target).__name__} by {self!r}",
        )


def _estimate(problem: Likelihood, end: Stationary, started: BoolArray, unseen: tuple[str, ...]) -> Estimate:
    """What was found, and how sure it is by the information at the answer."""
    target, size = problem.target, problem.target.parameters.size
    basis = problem.chart.basis(np.where(end.finite[..., None], end.unknowns, 0.0))[..., :size, :]
    seen = end.local.full_rank | ~end.finite
    if not seen.all():
        worst = np.unravel_index(int(np.argmin(seen)), seen.shape)
        unseen = unseen or target.combinations(end.jacobian[worst], basis[worst])
    codes = np.where(end.settled, Status.OPTIMAL, Status.NOT_CONVERGED)
    codes = np.where(started & seen & (not target.blind_spots), codes, Status.RANK_DEFICIENT).astype(np.int8)
    gain = np.where((codes == Status.OPTIMAL)[..., None, None], basis @ end.local.inverse, np.nan)
    objective = 0.5 * np.einsum("...m,...m->...", end.misclosure, end.misclosure)
    return Estimate(
        values=np.where((codes == Status.OPTIMAL)[..., None], end.unknowns[..., :size], np.nan),
        parameters=target.parameters,
        codes=codes,
        covariance=None if target.uncarried else gain @ transpose(gain),
        covariance_kind=target.uncarried or "model",
        objective=objective,
        gap=np.full(codes.shape, np.nan),
        condition=end.local.condition,
        degrees_of_freedom=0,
        chi2=2 * objective,
        influence=_influence(gain, end.rows[0]) if len(end.rows) == 1 else None,
        iterations=end.iterations,
        unseen=target.blind_spots or unseen or (target.parameters.names if target.failed.any() else ()),
    )


def _start(target: Implicit, given: Leg | Hexapod | None, chart: Chart) -> tuple[Array, tuple[str, ...]]:
    """Where to start, NaN where a linear start is not determined; and then, what its rows do not see."""
    values, unseen = _start_values(target, given, chart)
    return chart.normalised(np.broadcast_to(values, (*target.batch_shape, chart.size))), unseen


def _start_values(target: Implicit, given: Leg | Hexapod | None, chart: Chart) -> tuple[Array, tuple[str, ...]]:
    if given is not None:
        return target.values(given), ()
    if not target.is_linear or target.blind_spots:
        return target.start(), ()
    problem = target.linear()
    if len(chart.units) == 1:
        found = UnitNormLeastSquares(target.unit_vectors[0], covariance=False).fit(problem)
        if found.ok if found.values.ndim == 1 else found.ok.all():
            return found.values, ()
    solution = solve(problem.matrix, problem.rhs, inverse=False)
    values = np.where(solution.full_rank[..., None], solution.values, np.nan)
    return values, unseen_combinations(problem, solution)


def _influence(gain: Array, rows: WhitenedRows) -> Array:
    """−∂values/∂(direct rows), shape (..., p, n, d), of a gain on the whitened rows of one set."""
    n, d = rows.misclosure.shape[-2:]
    blocks = gain[..., : n * d].reshape(*gain.shape[:-1], n, d)
    return np.einsum("...pnd,...nde->...pne", blocks, rows.root)
