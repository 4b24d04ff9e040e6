"""Leg lengths linearised about the nominal, solved, and linearised anew (Geng and Haynes 1994)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Array, norm
from ..geometry import Leg
from ..loops import LegLength
from ..numerics.lm import STEP_TOLERANCE, LMResult
from ..numerics.lstsq import EPS, solve_svd
from ..result import Estimate
from .least_squares import check_rows
from .local_fit import check_settings, first_guess, local_estimate

__all__ = ["GengHaynes"]

#: A step has settled, too, below so many roundings of the residual times the condition number.
ROUNDING = 4.0 * EPS
#: A point so many times farther from the origin than the first guess is never come back from.
FARTHEST = 1e8


@dataclass(frozen=True)
class GengHaynes:
    r"""Undamped Gauss–Newton on leg lengths: :math:`x_{k+1} = x_k - J(x_k)^+ g(x_k)`.

    The residual is that of the inverse kinematics,
    :math:`g_i = \lVert P_i + R_i b - a\rVert - \gamma\rho_i - \delta`, linearised about the nominal, solved by
    least squares, and linearised about the solution, until a step is below 1e-9 of the parameters (by columns
    of unit length), or below the rounding of the residual.

    Parameters
    ----------
    start : Leg, optional
        Where the iteration starts; by default the data's nominal. Its other values are not used.
    max_iterations : int, default 50

    Notes
    -----
    Where it converges it finds what :class:`~hexopt.InverseKinematics` finds; but nothing keeps a step from making
    the residual worse. From a start too far off it wanders, or diverges: NOT_CONVERGED. There is
    no certificate of a global minimum (gap is NaN). The covariance is the sandwich of the noise model.

    References
    ----------
    Geng and Haynes (1994), of which Daney (1998), section 1.2, has the idea only; the stopping rule is ours.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "none", n_poses=10, nominal=robot.perturbed(0.3, rng=0), rng=1)
    >>> found = hx.estimate(hx.loops.LegLength(data), hx.GengHaynes())
    >>> bool(found.error(robot.leg(3))["base_point"] < 1e-9), int(found.iterations)
    (True, 4)
    """

    start: Leg | None = None
    max_iterations: int = 50

    accepts: ClassVar[tuple[type, ...]] = (LegLength,)
    hint: ClassVar[str] = "write estimate(loops.LegLength(data), GengHaynes())"

    def __post_init__(self) -> None:
        check_settings(self.start, self.max_iterations)

    def fit(self, target: LegLength) -> Estimate:
        """Fit every set of the batch; one that does not settle, or is not determined, fails alone."""
        first = first_guess(self, self.start, target, target.parameters, target.data.batch_shape)
        check_rows(target.linearised(first))
        found = self._relinearised(target, first)
        problem = target.linearised(np.where(found.converged[..., None], found.values, first))
        return local_estimate(problem, found.values, found.converged, found.iterations, self, target.blind_spots)

    def _relinearised(self, loop: LegLength, first: Array) -> LMResult:
        x, jacobian = np.array(first), loop.jacobian(first)[..., 0, :]
        alive = np.isfinite(jacobian).all(axis=(-2, -1))  # where a known value failed, nothing is known
        settled, iterations = np.zeros_like(alive), np.zeros(alive.shape, dtype=np.int64)
        unit = norm(np.swapaxes(jacobian, -1, -2))  # what each parameter does to the rows
        farthest = FARTHEST * norm(unit * first)
        for _ in range(self.max_iterations):
            active = alive & ~settled
            if not active.any():
                break
            residual, jacobian = loop.residual(x)[..., 0], loop.jacobian(x)[..., 0, :]
            solution = solve_svd(
                np.where(active[..., None, None], jacobian, 0.0), np.where(active[..., None], -residual, 0.0)
            )
            alive &= settled | solution.full_rank
            step = np.where((active & alive)[..., None], solution.values, 0.0)
            alive &= norm(unit * (x + step)) <= farthest
            x = np.where(alive[..., None], x + step, x)
            tolerance = np.maximum(STEP_TOLERANCE, ROUNDING * solution.condition)
            settled |= active & alive & (norm(unit * step) <= tolerance * norm(unit * x))
            iterations += active
        return LMResult(x, settled, iterations)
