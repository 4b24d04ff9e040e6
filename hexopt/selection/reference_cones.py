"""The relaxations of E, κ and G as cvxpy problems: the definitions that fast routes must agree with."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..information import PoseInformation, inverse_root
from .feasible import Feasible
from .objective import Objective
from .prediction import GOptimal

__all__ = ["Posed", "condition_by_cvxpy", "largest_by_cvxpy", "prediction_by_cvxpy"]


def largest_by_cvxpy(objective: Objective, feasible: Feasible) -> float:
    r"""The least :math:`\lambda_{\max}(C)`, its average or its worst: :math:`M_s(w) - t_s K K^T \succeq 0`."""
    import cvxpy as cp

    posed = Posed(objective.information, feasible)
    unit = objective.value(posed.even)
    levels = cp.Variable(1 if objective.worst else len(posed.matrices))
    conditions = list(posed.allowed)
    for s, matrix in enumerate(posed.matrices):
        corner = posed.corner(s)
        conditions.append(matrix - levels[0 if objective.worst else s] / unit * (corner @ corner.T) >> 0)
    problem = cp.Problem(cp.Minimize(cp.sum(cp.inv_pos(levels)) / levels.size), conditions)
    return float(problem.solve(solver=cp.CLARABEL) * unit)


def prediction_by_cvxpy(objective: Objective, feasible: Feasible) -> float:
    r"""The least :math:`\max_j g_j^T C g_j`, its average or its worst, for the rows of :class:`GOptimal`."""
    import cvxpy as cp

    if not isinstance(objective.criterion, GOptimal) or objective.criterion.rows is None:
        raise InputError("criterion: expected GOptimal(task).on(loop, at, information)")
    posed = Posed(objective.information, feasible)
    unit = objective.value(posed.even)
    rows = np.broadcast_to(objective.criterion.rows, (len(posed.matrices), *objective.criterion.rows.shape[1:]))
    worst = []
    for s, matrix in enumerate(posed.matrices):
        pieces = [cp.matrix_frac(column / np.sqrt(unit), matrix) for column in (posed.corner(s) @ rows[s].T).T]
        worst.append(cp.maximum(*pieces))
    goal = cp.maximum(*worst) if objective.worst else cp.sum(worst) / len(worst)
    return float(cp.Problem(cp.Minimize(goal), posed.allowed).solve(solver=cp.CLARABEL) * unit)


def condition_by_cvxpy(information: PoseInformation, feasible: Feasible) -> float:
    r"""The least condition number of the whitened rows: :math:`\min t,\; I \preceq M \preceq t I`, scale free."""
    import cvxpy as cp

    share = feasible.total / feasible.cost
    v, scale, level = cp.Variable(len(share)), cp.Variable(), cp.Variable()
    eye = np.eye(information.size)
    # v and σ in units in which the even weights have a largest eigenvalue of 1
    unit = np.linalg.eigvalsh(information.total(share / len(share))[0])[-1]
    flat = (information.blocks[0] * share[:, None, None] / unit).reshape(len(share), -1)
    matrix = cp.reshape(flat.T @ v, eye.shape, order="C") + scale * information.fixed[0] / unit
    matrix = (matrix + matrix.T) / 2
    spent = cp.sum(v)
    conditions = [v >= 0, v <= scale * (feasible.cap / share), matrix >> eye, level * eye >> matrix]
    conditions.append(spent == scale if feasible.counts_poses else spent <= scale)
    problem = cp.Problem(cp.Minimize(level), conditions)
    return float(np.sqrt(problem.solve(solver=cp.CLARABEL)))


class Posed:
    """Information matrices of shares of the budget, in coordinates in which that of even shares is the identity."""

    def __init__(self, information: PoseInformation, feasible: Feasible) -> None:
        import cvxpy as cp

        share = feasible.total / feasible.cost
        self.main = information.main
        self.even = share / len(share)
        self.roots = inverse_root(information.total(self.even))[0]
        x = cp.Variable(len(share), name="shares")
        self.allowed: list[Any] = [x >= 0, x <= feasible.cap / share, cp.sum(x) <= 1]
        self.matrices = []
        for blocks, fixed, root in zip(information.blocks, information.fixed, self.roots, strict=True):
            flat = (root.T @ (blocks * share[:, None, None]) @ root).reshape(len(share), -1)
            matrix = cp.reshape(flat.T @ x, root.shape, order="C") + root.T @ fixed @ root
            self.matrices.append((matrix + matrix.T) / 2)

    def corner(self, scenario: int) -> Array:
        """K in these coordinates."""
        return self.roots[scenario, : self.main].T
