"""Seven poses of one leg length: all twenty solutions, and the physical one among them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..arrays import Array, BoolArray, norm
from ..errors import InputError
from ..geometry import Leg
from ..loops import FixedLength
from ..numerics.burmester import POSES, BurmesterSolutions, burmester_solutions
from ..numerics.lstsq import solve_svd
from ..problem import LinearProblem
from ..result import Estimate, Status
from .least_squares import combinations, linear_uncertainty

__all__ = ["Innocenti"]

_UNKNOWN = ("platform_point", "base_point")
#: The nominal chooses where the second nearest solution is more than so many times as far from it.
_CLEAR = 2.0


@dataclass(frozen=True)
class Innocenti:
    r"""The spatial Burmester problem: :math:`\lVert P_i + R_i b - a\rVert` the same in seven poses, solved for b and a.

    Of the 20 complex solutions the physical one is taken to be the nearest to the nominal,
    :math:`\min_k \lVert b_k - b_0\rVert^2 + \lVert a_k - a_0\rVert^2`, imaginary parts counted.

    Parameters
    ----------
    nominal : Leg, optional
        :math:`(b_0, a_0)`; by default the data's nominal. Its other values are not used.

    Notes
    -----
    Takes ``FixedLength(data, unknown=("platform_point", "base_point"))`` with exactly seven poses. No reading is used,
    and no start: the nominal only chooses. :meth:`solutions` has all 20, without a nominal.

    As many equations as unknowns: no residual, no degree of freedom; the covariance is that of the noise model through
    the inverse Jacobian. It is of first order, while the errors have heavy tails: noise may bring two real solutions
    together, after which they are complex.

    The status is INFEASIBLE where the nearest solution is complex: the physical one is lost, or none is real. It is
    INACCURATE where another solution is less than twice as far from the nominal as the nearest, so that either may
    be meant (never where the nominal is nearer to the truth than a third of what lies between the two), and
    where two solutions are one to rounding. It is RANK_DEFICIENT where there are not 20 solutions but infinitely
    many, as for repeated poses or rotations about one axis.

    References
    ----------
    Innocenti (1995); Daney (1998), section 5.1, with which it is compared there.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "length", n_poses=7, n_sets=5, nominal=robot.perturbed(0.5, rng=0), rng=1)
    >>> loop = hx.loops.FixedLength(data, unknown=("platform_point", "base_point"))
    >>> found = hx.estimate(loop, hx.Innocenti())
    >>> bool((found.error(robot.leg(3))["base_point"] < 1e-9).all())
    True
    >>> hx.Innocenti().solutions(loop).real.sum(axis=-1).tolist()
    [8, 10, 10, 4, 4]
    """

    nominal: Leg | None = None

    accepts: ClassVar[tuple[type, ...]] = (FixedLength,)
    hint: ClassVar[str] = (
        'write estimate(loops.FixedLength(data, unknown=("platform_point", "base_point")), Innocenti())'
    )

    def __post_init__(self) -> None:
        if self.nominal is not None and not isinstance(self.nominal, Leg):
            raise InputError(f"nominal: expected a Leg, got {type(self.nominal).__name__}")

    def solutions(self, target: FixedLength) -> BurmesterSolutions:
        """All 20 solutions of every set, real and complex, in the order in which the method finds them.

        Raises
        ------
        InputError
            If the loop has other unknowns than both points, or not exactly seven poses.
        """
        if not isinstance(target, FixedLength) or target.unknown != _UNKNOWN:
            raise InputError(f"Innocenti estimates both points of a leg of fixed length: {self.hint}")
        count = target.data.n_poses
        if count < POSES:
            raise InputError(f"Innocenti needs exactly {POSES} poses, got {count}: measure {POSES - count} more")
        if count > POSES:
            raise InputError(
                f"Innocenti needs exactly {POSES} poses, got {count}: choose {POSES}, e.g. data.poses(range({POSES})), "
                "or take an estimator that fits all poses"
            )
        return burmester_solutions(target.data.position, target.data.rotation)

    def fit(self, target: FixedLength) -> Estimate:
        """Solve every set of the batch and choose; a degenerate set, or one without real solution, fails alone."""
        found = self.solutions(target)
        nominal = self.nominal or target.data.nominal
        if nominal is None:
            raise InputError(
                "Innocenti needs to know which of 20 solutions is meant: give Innocenti(nominal=Leg(…)) or data with "
                "a nominal, or look at all of them by Innocenti().solutions(loop)"
            )
        start = np.broadcast_to(target.values(nominal), (*target.data.batch_shape, target.parameters.size))
        points, real, clear = _nearest(found, start[..., :6])
        codes = np.where(clear, Status.OPTIMAL, Status.INACCURATE)
        codes = np.where(real, codes, Status.INFEASIBLE)
        codes = np.where(found.complete, codes, Status.INACCURATE)
        codes = np.where(found.regular, codes, Status.RANK_DEFICIENT)
        good = codes == Status.OPTIMAL
        # a member without an answer is looked at where the nominal is, which may tell what it does not see
        values = np.where(good[..., None], target.values(np.where(good[..., None], points, start[..., :6])), start)
        return self._estimate(target.linearised(values), values, codes)

    def _estimate(self, problem: LinearProblem, values: Array, codes: np.ndarray) -> Estimate:
        local = solve_svd(problem.matrix, problem.rhs)
        good = codes == Status.OPTIMAL
        codes = np.where(good & ~local.full_rank, Status.RANK_DEFICIENT, codes).astype(np.int8)
        good = codes == Status.OPTIMAL
        local = replace(local, inverse=np.where(good[..., None, None], local.inverse, np.nan))
        blind = codes == Status.RANK_DEFICIENT
        first = np.unravel_index(int(np.argmax(blind)), blind.shape) if blind.any() else None
        return Estimate(
            values=np.where(good[..., None], values, np.nan),
            parameters=problem.parameters,
            codes=codes,
            objective=np.where(good, 0.5 * np.einsum("...m,...m->...", problem.rhs, problem.rhs), np.nan),
            gap=np.full(codes.shape, np.nan),
            condition=np.where(blind, np.inf, local.condition),
            estimator=f"{problem.name} by {self!r}",
            unseen=() if first is None else combinations(problem, first, at_least=1),
            **linear_uncertainty(problem, local, None, values),
        )


def _nearest(found: BurmesterSolutions, nominal: Array) -> tuple[Array, BoolArray, BoolArray]:
    """Of each set the solution (..., 6) nearest to the nominal; whether it is real; whether no other is as near."""
    points = np.concatenate([found.platform_points, found.base_points], axis=-1)
    distance = np.nan_to_num(norm(np.abs(points - nominal[..., None, :])), nan=np.inf)
    order = np.argsort(distance, axis=-1)[..., :2]
    nearest = np.take_along_axis(points, order[..., :1, None], axis=-2)[..., 0, :]
    first, second = np.moveaxis(np.take_along_axis(distance, order, axis=-1), -1, 0)
    real = np.take_along_axis(found.real, order[..., :1], axis=-1)[..., 0]
    return nearest.real, real, np.asarray(second > _CLEAR * first)
