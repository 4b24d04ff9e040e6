"""Total least squares: errors in the matrix as well as in the right-hand side."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from ..arrays import Array, BoolArray, matvec, transpose
from ..errors import InputError
from ..numerics.lstsq import LstsqSolution, solve_svd
from ..problem import LinearProblem
from ..result import Estimate, Status
from .least_squares import check_rows, linear_uncertainty, unseen_combinations

__all__ = ["TotalLeastSquares"]

#: Where 1 − σ²/σ'² is no more than this (σ' the least singular value of the noisy columns), no solution can be told.
SMALLEST_SHARE = 1e-8


@dataclass(frozen=True)
class TotalLeastSquares:
    r"""Total least squares: :math:`\min\tfrac12\lVert[E\;f]\rVert_F^2` with :math:`(A + E)x = y + f`.

    Columns without error, :math:`A = [A_1\; A_2]` with :math:`E_1 = 0`, are kept as they are (mixed least squares –
    total least squares). Let :math:`\sigma` be the least singular value of :math:`[A_2\; y]` projected off the range of
    :math:`A_1`, and D the diagonal of ones for the columns of :math:`A_2`. Then the optimum is :math:`\sigma^2/2`, at

    .. math:: x = (A^TA - \sigma^2 D)^{-1}A^Ty = (I - \sigma^2 (A^TA)^{-1} D)^{-1} A^+ y.

    The second form starts at the least-squares solution of the column-scaled matrix, and keeps its accuracy.

    Parameters
    ----------
    exact : sequence of str, optional
        Blocks of parameters whose columns have no error. By default those that hold the same numbers in all poses,
        or zeros: −I of the base point and of the fixed point, the ones of the sphere. The right-hand side is
        always taken to have errors.

    Notes
    -----
    All errors in E and f count alike: of turns and of lengths, of nine entries of a rotation as if each were free.
    So the answer depends on the length unit and on the scale of the columns and rows, and the right weights come only
    with :class:`~hexopt.MaximumLikelihood`. On the loops it is as good or as bad as its assumption; it is here to be
    compared with.

    There is no solution where :math:`\sigma` reaches the least singular value of the projected :math:`A_2`: the
    status is FAILED. The covariance is, to first order, the sandwich
    :math:`K S K^T`, :math:`K = (A^TA - \sigma^2D)^{-1}A^T`, of the noise model; without one it comes from the
    residuals. The gap is the objective at the returned x, :math:`\tfrac12\lVert Ax - y\rVert^2/(1 + x^TDx)`, minus
    :math:`\sigma^2/2`, which bounds it from below.

    References
    ----------
    Golub and Van Loan (1980); Van Huffel and Vandewalle (1991), section 3.5, for exact columns.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "leg", n_poses=6, rng=0)
    >>> found = hx.estimate(hx.loops.FixedLeg(data).linear(), hx.TotalLeastSquares())
    >>> bool(found.error(robot.leg(3))["platform_point"] < 1e-9)
    True
    """

    exact: Sequence[str] | None = None

    accepts: ClassVar[tuple[type, ...]] = (LinearProblem,)
    hint: ClassVar[str] = 'write estimate(loop.linear(form="direct"), TotalLeastSquares())'

    def __post_init__(self) -> None:
        if self.exact is None:
            return
        many = isinstance(self.exact, Collection) and not isinstance(self.exact, str)
        if not many or not all(isinstance(name, str) for name in self.exact):
            raise InputError(f"exact: expected names of blocks such as ('base_point',), got {self.exact!r}")
        object.__setattr__(self, "exact", tuple(self.exact))

    def fit(self, target: LinearProblem) -> Estimate:
        """Solve every problem of the batch; one without a solution, or not determined, fails alone."""
        check_rows(target)
        noisy = self._noisy(target)
        plain = solve_svd(target.matrix, target.rhs, target.worst_cancellation)
        least = _least_singular_value(target, noisy, plain.full_rank) ** 2
        solution, exists = _corrected(target, plain, noisy, least)
        codes = np.where(exists, Status.OPTIMAL, Status.FAILED)
        codes = np.where(plain.full_rank, codes, Status.RANK_DEFICIENT).astype(np.int8)
        good = codes == Status.OPTIMAL
        solution = replace(
            solution,
            values=np.where(good[..., None], solution.values, np.nan),
            inverse=np.where(good[..., None, None], solution.inverse, np.nan),
        )
        weight = 1 + np.einsum("...p,p->...", solution.values**2, noisy)
        objective = solution.objective / weight
        return Estimate(
            values=solution.values,
            parameters=target.parameters,
            codes=codes,
            objective=objective,
            gap=objective - 0.5 * least,
            condition=plain.condition,
            estimator=f"{target.name} by {self!r}",
            unseen=unseen_combinations(target, plain),
            **linear_uncertainty(target, solution, None, solution.values),
        )

    def _noisy(self, problem: LinearProblem) -> Array:
        """The diagonal of D: 1 for columns with errors, 0 for exact ones, shape (p,)."""
        noisy = np.ones(problem.parameters.size)
        names = _constant(problem) if self.exact is None else self.exact
        for name in names:
            noisy[problem.parameters[name]] = 0.0
        return noisy


def _constant(problem: LinearProblem) -> list[str]:
    """The blocks whose columns are the same in every pose, but for zeros: no measured number is in them."""
    m, size = problem.matrix.shape[-2:]
    each = problem.rows_per_block
    rows = problem.matrix.reshape(*problem.batch_shape, m // each, each, size)
    found = []
    for name in problem.parameters.names:
        columns = rows[..., problem.parameters[name]]
        largest = np.where(columns.max(axis=-3) > 0, columns.max(axis=-3), columns.min(axis=-3))[..., None, :, :]
        there = columns.any(axis=(-2, -1), keepdims=True)
        if ((columns == largest) | ~there).all():
            found.append(name)
    return found


def _least_singular_value(problem: LinearProblem, noisy: Array, usable: BoolArray) -> Array:
    """σ: of the noisy columns and the right-hand side, off the range of the exact columns, shape (...)."""
    columns = np.concatenate([problem.matrix[..., noisy > 0], problem.rhs[..., None]], axis=-1)
    if problem.matrix.shape[-2] < problem.matrix.shape[-1] + 1:
        return np.zeros(problem.batch_shape)  # as many rows as unknowns: they hold as they are
    exact = problem.matrix[..., noisy == 0]
    if exact.shape[-1]:
        basis = np.linalg.qr(np.where(usable[..., None, None], exact, 0.0))[0]
        columns = columns - basis @ (transpose(basis) @ columns)
    return np.linalg.svd(columns, compute_uv=False)[..., -1]


def _corrected(
    problem: LinearProblem, plain: LstsqSolution, noisy: Array, least: Array
) -> tuple[LstsqSolution, BoolArray]:
    r"""The least-squares solution times :math:`(I - \sigma^2 (A^TA)^{-1}D)^{-1}`, and where that exists."""
    inverse = np.where(plain.full_rank[..., None, None], plain.inverse, 0.0)
    gram = inverse @ transpose(inverse)
    share = 1 - least * np.linalg.eigvalsh(noisy[:, None] * gram * noisy)[..., -1]
    exists = plain.full_rank & (share > SMALLEST_SHARE)
    unit = np.eye(len(noisy))
    factor = np.linalg.inv(np.where(exists[..., None, None], unit - least[..., None, None] * gram * noisy, unit))
    values = matvec(factor, plain.values)
    residual = problem.residual(values)
    objective = 0.5 * np.einsum("...m,...m->...", residual, residual)
    return replace(plain, values=values, inverse=factor @ plain.inverse, objective=objective, residual=residual), exists
