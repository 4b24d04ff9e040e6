"""Linear problems posed in cvxpy: the definition that every fast route must agree with."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from ..arrays import Array, matvec, norm, transpose
from ..errors import InputError
from ..losses import Quadratic
from ..numerics.lstsq import solve_svd
from ..problem import LinearProblem
from ..result import Estimate, Status
from .least_squares import check_rows, linear_uncertainty, unseen_combinations

__all__ = ["ConvexEstimator"]

#: Clarabel's tolerances are absolute; its defaults leave answers off by up to 5e-4 σ.
CLARABEL = {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13, "tol_feas": 1e-13, "max_iter": 200}
#: What the gap must reach, relative to 1 + |objective|, to be called a success.
GAP = 1e-8
#: How far, in standard deviations of the rows, a success may be from the optimum: the gap is half its square.
DEVIATION = 1e-6


@dataclass(frozen=True)
class ConvexEstimator:
    r"""A convex programme in the whitened residuals: :math:`\min_x \sum_i \rho(W(A x - y))_i`, by cvxpy.

    Parameters
    ----------
    loss : Quadratic
    weights : "model" or None, default "model"
        "model": whitened by the noise model; None: raw rows.

    Notes
    -----
    Clarabel solves every problem of a batch in turn, in scaled variables (columns of unit length,
    right-hand side of unit size), at tolerance 1e-13, and then once more about the answer. The gap is
    recomputed from the returned point; an answer whose gap exceeds ``1e-8·(1 + |objective|)``, or allows a
    deviation of more than 1e-6 σ, is INACCURATE, whatever the solver says.

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", n_poses=5, rng=0)
    >>> found = hx.estimate(hx.loops.FixedLeg(data).linear(), hx.ConvexEstimator(weights=None))
    >>> found.params["platform_point"].round(6) + 0.0
    array([ 7.822, -1.052,  0.   ])
    """

    loss: Quadratic = field(default_factory=Quadratic)
    weights: Literal["model"] | None = "model"

    accepts: ClassVar[tuple[type, ...]] = (LinearProblem,)
    hint: ClassVar[str] = 'write estimate(loop.linear(form="direct"), ConvexEstimator())'

    def __post_init__(self) -> None:
        if self.weights not in (None, "model"):
            raise InputError(f"weights: expected None or 'model', got {self.weights!r}")
        if not isinstance(self.loss, Quadratic):
            raise InputError(f"loss: expected Quadratic(), the only one with a certificate so far; got {self.loss!r}")

    def cvxpy_problem(self, problem: LinearProblem) -> Any:
        """The programme of one problem as a ``cvxpy.Problem`` in the unscaled variable ``x``.

        Raises
        ------
        InputError
            For a batch: pass one of its problems.
        """
        if problem.batch_shape:
            raise InputError(f"cvxpy_problem takes one problem, got a batch of {problem.batch_shape}")
        import cvxpy as cp

        matrix, rhs = problem.whitened() if self.weights == "model" else (problem.matrix, problem.rhs)
        x = cp.Variable(problem.parameters.size, name="x")
        return cp.Problem(cp.Minimize(self.loss.expression(matrix @ x - rhs)))

    def fit(self, target: LinearProblem) -> Estimate:
        """Solve every problem of the batch in turn; one that fails, fails alone."""
        check_rows(target)
        root = target.whitening() if self.weights == "model" else None
        matrix, rhs = target.whitened_by(root)
        reference = solve_svd(matrix, rhs, target.worst_cancellation)
        values = np.full(reference.values.shape, np.nan)
        codes = np.full(target.batch_shape, Status.RANK_DEFICIENT, dtype=np.int8)
        for index in zip(*np.nonzero(np.atleast_1d(reference.full_rank)), strict=True):
            where = index if target.batch_shape else ()
            values[where], codes[where] = self._solve(matrix[where], rhs[where])
        residual = matvec(matrix, values) - rhs
        objective = self.loss.rho(residual).sum(axis=-1)
        gap = quadratic_gap(matrix, residual)
        # raw rows have a unit: what is small is measured by the right-hand side; whitened rows count in σ
        unit = np.einsum("...m,...m->...", rhs, rhs) / rhs.shape[-1] if root is None else np.array(1.0)
        unit = np.where(unit > 0, unit, 1.0)
        proven = gap <= np.minimum(GAP * (unit + objective), DEVIATION**2 / 2 * np.maximum(unit, objective))
        codes[(codes == Status.OPTIMAL) & ~proven] = Status.INACCURATE
        return Estimate(
            values=np.where((codes == Status.OPTIMAL)[..., None], values, np.nan),
            parameters=target.parameters,
            codes=codes,
            objective=objective,
            gap=gap,
            condition=reference.condition,
            chi2=None if root is None else 2 * objective,
            estimator=f"{target.name} by {self!r}",
            unseen=unseen_combinations(target, reference),
            **linear_uncertainty(target, reference, root, values),
        )

    def _solve(self, matrix: Array, rhs: Array) -> tuple[Array, Status]:
        """One problem, twice: about zero, and then about the first answer, where the tolerance is that of residuals."""
        centre, status = self._solve_scaled(matrix, rhs)
        if status is Status.OPTIMAL:
            change, status = self._solve_scaled(matrix, rhs - matrix @ centre)
            centre = centre + change
        return centre, status

    def _solve_scaled(self, matrix: Array, rhs: Array) -> tuple[Array, Status]:
        """One problem in scaled variables z: x = z · size / column length."""
        import cvxpy as cp

        columns = norm(transpose(matrix))
        size = float(np.abs(rhs).max()) or 1.0
        z = cp.Variable(matrix.shape[1])
        scaled = cp.Problem(cp.Minimize(self.loss.expression((matrix / columns) @ z - rhs / size)))
        try:
            scaled.solve(solver=cp.CLARABEL, **CLARABEL)
        except cp.SolverError:
            return np.full(matrix.shape[1], np.nan), Status.FAILED
        if z.value is None:
            return np.full(matrix.shape[1], np.nan), Status.FAILED
        return z.value * size / columns, Status.OPTIMAL


def quadratic_gap(matrix: Array, residual: Array) -> Array:
    """Objective minus dual bound of least squares at a residual: half its squared part in range(A)."""
    basis = np.linalg.qr(matrix).Q
    inside = matvec(transpose(basis), residual)
    gap: Array = 0.5 * np.einsum("...p,...p->...", inside, inside)
    return gap
