"""A programme posed in cvxpy: the definition that every other route must agree with."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...arrays import Array
from ...numerics.programme import Programme, Solution

__all__ = ["CLARABEL", "Formulation", "pose", "solve_cvxpy"]

#: Clarabel's tolerances are absolute; its defaults leave answers off by up to 5e-4 σ.
CLARABEL = {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13, "tol_feas": 1e-13, "max_iter": 200}


@dataclass(frozen=True, eq=False)
class Formulation:
    """A cvxpy problem, its variable, and the constraints by part: their duals are those of the programme."""

    problem: Any
    x: Any
    rows: list[Any]  # z == A x − y of each term, if asked for
    intervals: list[Any]  # (lower, upper) of each interval, None where there is none
    balls: list[Any]


def pose(programme: Programme, member: int, *, with_rows: bool = False) -> Formulation:
    """One member of the batch as a cvxpy problem in the variable ``x``, and on request in its residuals too."""
    import cvxpy as cp

    one = programme.take(member)
    x = cp.Variable(programme.size, name="x")
    objective, rows = 0, []
    for number, term in enumerate(one.terms):
        z = term.matrix @ x - term.rhs
        if with_rows:
            z = cp.Variable(len(term.rhs), name=f"z{number}")
            rows.append(z == term.matrix @ x - term.rhs)
        loss: Any = term.loss
        objective = objective + loss.expression(cp.reshape(z, (len(term.rhs) // term.size, term.size), order="C"))
    constraints = list(rows)
    constraints += [part for part in _between(x, one.lower, one.upper) if part is not None]
    intervals = [_between(part.matrix @ x, part.lower, part.upper) for part in one.intervals]
    constraints += [part for pair in intervals for part in pair if part is not None]
    balls = [cp.norm(part.matrix @ x - part.centre, 2) <= float(part.radius) for part in one.balls]
    return Formulation(cp.Problem(cp.Minimize(objective), constraints + balls), x, rows, intervals, balls)


def _between(side: Any, lower: Array, upper: Array) -> tuple[Any, Any]:
    """The finite bounds of an expression as two constraints, or None."""
    low, high = np.flatnonzero(np.isfinite(lower)), np.flatnonzero(np.isfinite(upper))
    return (
        side[low] >= lower[low] if len(low) else None,
        side[high] <= upper[high] if len(high) else None,
    )


def solve_cvxpy(programme: Programme) -> Solution:
    """Every member in turn by cvxpy and Clarabel: about zero, and then about the first answer; scaled variables."""
    count, size = programme.lower.shape
    values = np.full((count, size), np.nan)
    converged, infeasible = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    iterations = np.zeros(count, dtype=np.int64)
    rows = [np.zeros(term.rhs.shape) for term in programme.terms]
    intervals = [np.zeros(part.lower.shape) for part in programme.intervals]
    balls = [np.zeros(part.centre.shape) for part in programme.balls]
    for i in range(count):
        centre = np.zeros(size)
        for _ in range(2):
            part = programme.take(slice(i, i + 1)).about(centre[None])
            posed, status = _solved(part)
            iterations[i] += 1
            infeasible[i] = status == "infeasible"
            if posed is None or posed.x.value is None:
                break
            centre = centre + posed.x.value
            converged[i] = True
            values[i] = np.clip(centre, programme.lower[i], programme.upper[i])
            for target, source in zip(rows, posed.rows, strict=True):
                target[i] = -source.dual_value
            for target, pair, one in zip(intervals, posed.intervals, part.intervals, strict=True):
                target[i] = _signed(pair, one.lower[0], one.upper[0])
            for target, source, ball in zip(balls, posed.balls, part.balls, strict=True):
                side = ball.matrix[0] @ posed.x.value - ball.centre[0]
                target[i] = float(source.dual_value) * side / max(float(np.linalg.norm(side)), 1e-300)
    return Solution(values, converged, iterations, tuple(rows), tuple(intervals), tuple(balls), infeasible)


def _solved(programme: Programme) -> tuple[Formulation | None, str]:
    import cvxpy as cp

    posed = pose(programme, 0, with_rows=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "may be inaccurate" is for the certificate to say
        try:
            posed.problem.solve(solver=cp.CLARABEL, **CLARABEL)
        except cp.SolverError:
            return None, "failed"
    return posed, posed.problem.status


def _signed(pair: tuple[Any, Any], lower: Array, upper: Array) -> Array:
    """Multipliers of both sides in one: positive at the upper bound."""
    out = np.zeros(lower.shape)
    if pair[0] is not None:
        out[np.isfinite(lower)] -= pair[0].dual_value
    if pair[1] is not None:
        out[np.isfinite(upper)] += pair[1].dual_value
    return out
