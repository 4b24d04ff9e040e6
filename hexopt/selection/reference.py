r"""The relaxations as cvxpy problems: the definitions that fast routes must agree with.

Those of E, G and κ stand in :mod:`hexopt.selection.reference_cones`; here are A and D.

Over shares :math:`x_i = c_i w_i / N \ge 0` of the budget, :math:`\sum_i x_i \le 1`, :math:`x_i \le c_i u_i / N`, with
the nuisances kept in :math:`M_s(w) = M_{s0} + \sum_i w_i M_{si}`:

.. math:: \text{A:}\quad \operatorname{mean\ or\ max}_s\; \operatorname{tr} K^T M_s(w)^{-1} K, \qquad
          \text{D:}\quad \operatorname{mean\ or\ max}_s\; -\log\det X_s \quad\text{s.t.}\quad
          M_s(w) - K X_s K^T \succeq 0,

for then :math:`X_s` is at most the Schur complement, the inverse of C.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import InputError
from .criteria import AOptimal, DOptimal, EOptimal
from .feasible import Feasible
from .indices import ConditionNumber
from .objective import Objective
from .prediction import GOptimal
from .reference_cones import Posed, condition_by_cvxpy, largest_by_cvxpy, prediction_by_cvxpy

__all__ = ["relaxed_by_cvxpy"]


def relaxed_by_cvxpy(objective: Objective, feasible: Feasible, tolerance: float = 1e-8) -> float:
    """The least value of a criterion over all allowed weights, by Clarabel.

    Parameters
    ----------
    objective : Objective
    feasible : Feasible
    tolerance : float, default 1e-8
        Clarabel's, of gap and constraints, for A and D.

    Raises
    ------
    InputError
        For a criterion other than A, D, E, G and κ.
    """
    import cvxpy as cp

    if isinstance(objective.criterion, ConditionNumber):
        return condition_by_cvxpy(objective.information, feasible)
    if isinstance(objective.criterion, (EOptimal, GOptimal)):
        by = largest_by_cvxpy if isinstance(objective.criterion, EOptimal) else prediction_by_cvxpy
        return by(objective, feasible)
    terms = {AOptimal: _variances, DOptimal: _volumes}.get(type(objective.criterion))
    if terms is None:
        raise InputError(f"criterion {objective.criterion.name}: expected A, D, E, G or κ")
    posed = Posed(objective.information, feasible)
    values, conditions, unit = terms(posed)
    goal = cp.maximum(*values) if objective.worst and len(values) > 1 else cp.sum(cp.hstack(values)) / len(values)
    problem = cp.Problem(cp.Minimize(goal), [*posed.allowed, *conditions])
    small = {"tol_gap_abs": tolerance, "tol_gap_rel": tolerance, "tol_feas": tolerance}
    return float(problem.solve(solver=cp.CLARABEL, **small) * unit)


def _variances(posed: Posed) -> tuple[list[Any], list[Any], float]:
    """tr C of every scenario, in units of what even shares give: about 1 for the solver."""
    import cvxpy as cp

    corners = [posed.corner(s) for s in range(len(posed.matrices))]
    unit = max(float((corner**2).sum()) for corner in corners)
    pairs = zip(corners, posed.matrices, strict=True)
    return [cp.matrix_frac(corner / np.sqrt(unit), matrix) for corner, matrix in pairs], [], unit


def _volumes(posed: Posed) -> tuple[list[Any], list[Any], float]:
    """log det C of every scenario, and the conditions on X, in coordinates in which even shares have C = I."""
    import cvxpy as cp

    values, conditions = [], []
    for s, matrix in enumerate(posed.matrices):
        schur = cp.Variable((posed.main, posed.main), PSD=True)
        corner, triangle = np.linalg.qr(posed.corner(s))
        conditions.append(matrix - corner @ schur @ corner.T >> 0)
        values.append(-cp.log_det(schur) + 2 * np.linalg.slogdet(triangle)[1])
    return values, conditions, 1.0
