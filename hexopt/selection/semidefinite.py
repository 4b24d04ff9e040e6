r"""The relaxation of E, by its semidefinite programme: the largest variance :math:`\lambda_{\max}(C_s)` of scenario s.

.. math:: \frac{1}{\lambda_{\max}(C_s(w))} = \max\; t_s \quad\text{s.t.}\quad M_s(w) - t_s K K^T \succeq 0.

**The proof.** Let :math:`Z_s \succeq 0` be any, :math:`y_s = \langle Z_s, K K^T\rangle`. For every allowed v,

.. math:: \sum_s y_s t_s(v) \le \sum_s \langle Z_s, M_s(v)\rangle
          \le B = \sum_s \langle Z_s, M_{s0}\rangle + \max_u h^T u, \quad h_i = \sum_s \langle Z_s, M_{si}\rangle,

so that the worst of the :math:`1/t_s` is at least :math:`\sum_s y_s / B`, and by the Cauchy–Schwarz inequality their
average at least :math:`(\sum_s \sqrt{y_s})^2 / (S B)`. Both are convex in :math:`h^T v`; their tangents bound every v.
One eigenvector in place of Z leaves a gap wherever the largest eigenvalue is multiple, as it is at most optima.

Source: Boyd and Vandenberghe, *Convex Optimization* (2004), section 7.5.2.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..arrays import Array, transpose
from ..information import inverse_root
from .column_generation import Master, Priced, Restricted, generate
from .cones import Rows, packed, root_of, solve_cones, unpacked
from .feasible import Feasible
from .objective import Objective
from .relaxed import Relaxation

__all__ = ["relax_largest", "semidefinite_bound"]


def semidefinite_bound(objective: Objective, feasible: Feasible, root: Array) -> tuple[float, Array]:
    r"""A value of E that no allowed weights can go below, and the gains g that prove it.

    To rounding, as is the value: a share of 1e-16 times the condition number of M.

    Parameters
    ----------
    objective : Objective
        With the criterion E.
    feasible : Feasible
    root : ndarray, shape (S, m, r)
        F with :math:`Z_s = F_s F_s^T`, which is positive semidefinite whatever F is.

    Returns
    -------
    bound : float
    gains : ndarray, shape (n,)
        :math:`f(v) \ge \text{bound} + \max_u g^T u - g^T v`.
    """
    proof = _proof(objective, feasible, root)
    return proof.bound, proof.gains


def relax_largest(objective: Objective, feasible: Feasible, goal: float = 1e-7) -> Relaxation:
    """The relaxation of E over any number of candidates, to a relative gap.

    Parameters
    ----------
    objective : Objective
        With the criterion E; scenarios are averaged, or the worst counts.
    feasible : Feasible
    goal : float, default 1e-7

    Returns
    -------
    Relaxation
        Value from the weights, and bound from the multipliers; the solver's status has no part in them.

    Raises
    ------
    RankDeficientError
        If all candidates together do not see all parameters.
    """
    return generate(_Largest(objective, feasible), goal)


def _proof(objective: Objective, feasible: Feasible, root: Array, level: float = 0.0) -> Priced:
    """What Z proves; a level of h becomes one of the gains."""
    dual = root @ transpose(root)
    shares = np.einsum("skk->s", dual[:, : objective.information.main, : objective.information.main])
    seen = objective.gains(dual)
    best = feasible.best(seen)
    most = float(np.einsum("sij,sij->", dual, objective.information.fixed) + seen @ best)
    part = float(shares.sum() if objective.worst else np.sqrt(shares).sum() ** 2 / len(shares))
    mix = shares / shares.sum() if objective.worst and part > 0 else np.full(len(shares), 1 / len(shares))
    if part == 0 or most <= 0:
        return Priced(0.0, np.zeros(len(seen)), 0.0, best, mix[:, None])
    slope = part / most**2
    return Priced(part / most, slope * seen, slope * level, best, mix[:, None])


class _Prices(NamedTuple):
    """F, and the multiplier of the budget."""

    root: Array
    level: float


class _Largest(Master):
    """The semidefinite programme over a few columns."""

    def __init__(self, objective: Objective, feasible: Feasible) -> None:
        super().__init__(objective.information, feasible)
        self.objective = objective

    def value(self, weights: Array) -> float:
        """E."""
        return self.objective.value(weights)

    def price(self, prices: _Prices) -> Priced:
        """The bound of Z."""
        return _proof(self.objective, self.feasible, *prices)

    def solve(self, part: Restricted, around: Array) -> tuple[Array, Array, _Prices] | None:
        """In coordinates in which the information near some weights is the identity."""
        information, feasible = self.information, self.feasible
        size, own = information.size, len(part.columns)
        turn = inverse_root((information.total(around) + self.total) / 2)[0]
        blocks, unit = part.blocks(information, feasible)
        columns = packed(transpose(turn)[:, None] @ blocks @ turn[:, None])
        fixed = packed(transpose(turn) @ information.fixed @ turn)
        rows = part.rows(feasible, unit)
        levels, cost, balls = self._levels(turn[:, : information.main], len(unit))
        rows += balls
        for column, level, constant in zip(columns, levels, fixed, strict=True):
            rows.append(Rows("semidefinite", np.concatenate([-column.T, level.T], axis=1), constant, size))
        found = solve_cones(cost, [one.widened(len(cost)) for one in rows])
        if found is None:
            return None
        x, duals = found
        root = turn @ root_of(unpacked(np.stack(duals[-len(levels) :]), size))
        x = x[: len(unit)] * unit
        return x[:own], x[own:], _Prices(root, duals[1][0] / feasible.total)

    def _levels(self, corner: Array, before: int) -> tuple[Array, Array, list[Rows]]:
        r"""Columns (S, l, q) of the levels in :math:`K K^T`, the cost, and :math:`u_s t_s \ge 1` for an average."""
        square = transpose(corner) @ corner
        largest = np.linalg.eigvalsh(square)[:, -1]
        count = len(square)
        if self.objective.worst or count == 1:
            cost = np.zeros(before + 1)
            cost[-1] = -1.0
            return packed(square)[:, None] / largest.max(), cost, []
        scaled = packed(square) / largest[:, None]
        levels = np.zeros((count, 2 * count, scaled.shape[-1]))
        levels[np.arange(count), np.arange(count)] = scaled
        ball = np.zeros((count, 3, before + 2 * count))
        each = np.arange(count)
        ball[each, 0, before + each], ball[each, 1, before + each] = -1.0, 1.0
        ball[each, :2, before + count + each] = -1.0
        rhs = np.tile([0.0, 0.0, 2.0], count)
        cost = np.concatenate([np.zeros(before + count), largest / largest.sum()])
        return levels, cost, [Rows("ball", ball.reshape(3 * count, -1), rhs)]
