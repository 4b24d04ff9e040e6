r"""One set of poses, row by row: rows are held until they determine the parameters well, then filterpy goes on.

Rows have unit variance: :math:`z = H x + \nu`, :math:`\nu \sim N(0, I)`. The unknowns x are the p parameters and r
errors that all poses share; these have rows of their own, :math:`0 = f + \nu`. filterpy gets
:math:`u = T (x - x_0)`, with :math:`x_0` the solution of the rows that were held and T their column lengths.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..numerics.lstsq import LstsqSolution, solve_svd
from ..problem import LinearProblem
from ..result import Status

__all__ = ["FILTERS", "Gate", "LinearRun", "empty_run", "pose_rows", "solved"]

FILTERS = ("kalman", "information", "square_root")
#: Rows are held up to this condition number: a filter works on covariances, of which it is the square.
WELL_CONDITIONED = 2e3


@dataclass(frozen=True)
class Gate:
    """When a pose is flagged, and whether it is then left out.

    Attributes
    ----------
    limit : float
        Largest normalised innovation squared that is no reason to doubt a pose.
    reject : bool
    """

    limit: float
    reject: bool


@dataclass(frozen=True, eq=False)
class LinearRun:
    """What is known of one set after some of its poses.

    Attributes
    ----------
    matrix, rhs : ndarray, shape (m, p + r) and (m,)
        Rows that are held; raw ones while `rows` is 0, because they wait for their weights.
    filter : object, or None
        The filter of filterpy that has taken over.
    origin, scale : ndarray, shape (p + r,)
        x₀ and T.
    mean, spread : ndarray, shape (p + r,) and (p + r, p + r)
        Estimate and covariance; NaN while the rows do not determine them.
    code : Status
    chi2 : float
    rows : int
        Rows that count.
    nis : float
        Of the last pose.
    flagged : bool
        Whether that is above the limit.
    """

    matrix: Array
    rhs: Array
    filter: Any
    origin: Array
    scale: Array
    mean: Array
    spread: Array
    code: Status = Status.RANK_DEFICIENT
    chi2: float = np.nan
    rows: int = 0
    nis: float = np.nan
    flagged: bool = False

    def after(self, matrix: Array, rhs: Array, kind: str, gate: Gate) -> LinearRun:
        """What is known after the whitened rows (d, p + r) and (d,) of one more pose."""
        if self.code is Status.FAILED:
            return self
        if self.rows == 0:
            return empty_run(len(self.mean), matrix.shape[-1] - len(self.mean))._counting(matrix, rhs, kind)
        nis = self._surprise(matrix, rhs)
        flagged = nis > gate.limit  # NaN is not
        if flagged and gate.reject:
            return replace(self, nis=nis, flagged=True)
        return replace(self, nis=nis, flagged=bool(flagged))._counting(matrix, rhs, kind)

    def _counting(self, matrix: Array, rhs: Array, kind: str) -> LinearRun:
        more = replace(self, rows=self.rows + len(rhs))
        return more._held(matrix, rhs, kind) if self.filter is None else more._filtered(matrix, rhs)

    def _held(self, matrix: Array, rhs: Array, kind: str) -> LinearRun:
        """The solution of all rows; filterpy takes over where they are well conditioned."""
        d = len(rhs)
        held = replace(self, matrix=np.vstack([self.matrix, matrix]), rhs=np.append(self.rhs, rhs))
        solution = solved(held.matrix, held.rhs)
        if solution is None:
            return held
        spread = solution.inverse @ solution.inverse.T
        found = replace(
            held, mean=solution.values, spread=spread, code=Status.OPTIMAL, chi2=2 * float(solution.objective)
        )
        return found._handed_over(kind, d) if solution.condition < WELL_CONDITIONED else found

    def _surprise(self, matrix: Array, rhs: Array) -> float:
        """The innovation squared over its covariance I + H P H'; NaN while nothing is foretold."""
        if self.code is not Status.OPTIMAL:
            return np.nan
        innovation = rhs - matrix @ self.mean
        return float(innovation @ np.linalg.solve(np.eye(len(rhs)) + matrix @ self.spread @ matrix.T, innovation))

    def _handed_over(self, kind: str, d: int) -> LinearRun:
        scale = np.linalg.norm(self.matrix, axis=0)
        filter_ = _filter(kind, self.spread * scale[:, None] * scale, d)
        empty = np.empty((0, len(scale)))
        return replace(self, filter=filter_, origin=self.mean, scale=scale, matrix=empty, rhs=empty[:, 0])

    def _filtered(self, matrix: Array, rhs: Array) -> LinearRun:
        """One update by filterpy, whose answer is checked."""
        filter_ = deepcopy(self.filter)
        filter_.H = matrix / self.scale
        filter_.update((rhs - matrix @ self.origin)[:, None])
        covariance = 0.5 * (filter_.P + filter_.P.T)
        try:
            np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            return replace(self, code=Status.FAILED)
        return replace(
            self,
            filter=filter_,
            mean=self.origin + filter_.x[:, 0] / self.scale,
            spread=covariance / self.scale[:, None] / self.scale,
            chi2=self.chi2 + self.nis,
        )


def empty_run(size: int, shared: int = 0) -> LinearRun:
    """Nothing is known of the p parameters, and of shared errors that their variance is 1."""
    total = size + shared
    unknown = np.full(total, np.nan)
    spread = np.full((total, total), np.nan)
    return LinearRun(np.eye(total)[size:], np.zeros(shared), None, unknown, unknown, unknown, spread)


def solved(matrix: Array, rhs: Array) -> LstsqSolution | None:
    """The solution of rows (m, p), or None where they do not determine it."""
    if len(rhs) < matrix.shape[-1]:
        return None
    solution = solve_svd(matrix, rhs)
    return solution if solution.full_rank else None


def _filter(kind: str, covariance: Array, rows: int) -> Any:
    """A filter of filterpy about zero, for rows of unit variance."""
    from filterpy.kalman import InformationFilter, KalmanFilter, SquareRootKalmanFilter

    size = len(covariance)
    if kind == "information":
        made = InformationFilter(size, rows, compute_log_likelihood=False)
        made.P_inv = np.linalg.inv(covariance)
        return made
    made = KalmanFilter(size, rows) if kind == "kalman" else SquareRootKalmanFilter(size, rows)
    made.P = covariance
    return made


def pose_rows(problem: LinearProblem) -> tuple[Array, Array]:
    """The whitened rows of every pose, (..., n, d, p + r), and their right-hand sides, (..., n, d)."""
    root, covariance = problem.whitening(shared=False), problem.row_covariance()
    matrix, rhs = problem.whitened_by(root)
    if covariance.common is not None:
        columns = covariance.common.reshape(*covariance.common.shape[:-3], rhs.shape[-1], -1)
        columns = np.broadcast_to(root.apply(columns), (*matrix.shape[:-1], columns.shape[-1]))
        columns = np.where(np.isfinite(columns), columns, 0.0)  # of a known value that failed, whose rows are 0
        matrix = np.concatenate([matrix, columns], axis=-1)
    d = problem.rows_per_block
    n = rhs.shape[-1] // d
    return matrix.reshape(*matrix.shape[:-2], n, d, matrix.shape[-1]), rhs.reshape(*rhs.shape[:-1], n, d)
