r"""The design of the least condition number, as the exact convex programme.

:math:`\kappa^2 = \lambda_{\max}(M(w))/\lambda_{\min}(M(w))` of the *full* information, nuisances included, is
quasi-convex. In weights v = σw, with the scale σ ≥ 0 free, its least value is that of the convex programme

.. math:: \min\; t \quad\text{s.t.}\quad I \preceq \sigma M_0 + \sum_i v_i M_i \preceq t I, \quad
          0 \le v \le \sigma u, \quad c^T v = \sigma N.

The budget is an equation where it counts poses, since a design has all N; with costs, :math:`c^T v \le \sigma N`. Were
it so for poses, weights could be small, and no cap would bind.

**The proof.** For any X, Y ⪰ 0 and any allowed w, :math:`\lambda_{\max}(M) \ge \langle X, M\rangle/\operatorname{tr} X`
and :math:`\lambda_{\min}(M) \le \langle Y, M\rangle/\operatorname{tr} Y`, so that

.. math:: \kappa^2(w) \ge \frac{\operatorname{tr} Y}{\operatorname{tr} X}
          \min_u \frac{\langle X, M(u)\rangle}{\langle Y, M(u)\rangle},

a ratio of linear functions, of which Dinkelbach's iteration finds the least in a few sorted sums.

**Why it is not the default.** κ says nothing of the size of errors: twice the information in every direction leaves it
as it was, and a direction that is seen even better makes it worse. It changes with the units of the parameters. In a
badly scaled case its designs were up to 2.3 times worse than random ones. The condition number *of the Schur
complement*, after the nuisance is eliminated, is not even quasi-convex, and has no such programme: half of each of two
designs with κ² of 1.25 and 2 can have 11.5.

Sources: Boyd and Vandenberghe, *Convex Optimization* (2004), exercise 4.43, for the programme; Charnes and Cooper
(1962) for the scale; Dinkelbach (1967).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..information import PoseInformation, inverse_root
from .column_generation import Master, Priced, Restricted, generate
from .cones import Rows, packed, root_of, solve_cones, unpacked
from .feasible import Feasible
from .relaxed import Relaxation

__all__ = ["condition_bound", "relax_condition"]

#: Steps of Dinkelbach's iteration, which is finite: a handful as a rule.
STEPS = 100
#: Ratios that differ by less are the same.
ROUNDING = 1e-14


def relax_condition(information: PoseInformation, feasible: Feasible, goal: float = 1e-6) -> Relaxation:
    r"""The weights of the least condition number κ of the whitened rows, with a proof.

    Parameters
    ----------
    information : PoseInformation
        Of one scenario: the worst κ of several is not one programme.
    feasible : Feasible
    goal : float, default 1e-6
        Relative gap of κ², as of a variance.

    Returns
    -------
    Relaxation
        Its gains are those of the proof's numerator and denominator; κ is not convex, so they bound no other weights.

    Raises
    ------
    InputError
        For several scenarios, or fewer candidates than are to be measured.
    RankDeficientError
        If all candidates together do not see all unknowns.
    """
    if len(information.blocks) != 1:
        raise InputError(f"the condition number is designed for one scenario, got {len(information.blocks)}")
    if float(feasible.cost @ feasible.cap) < feasible.total * (1 - 1e-12) and feasible.counts_poses:
        raise InputError(f"{feasible.total:g} poses to be measured, but the candidates make {feasible.cap.sum():g}")
    return generate(_Conditioned(information, feasible), goal)


def condition_bound(information: PoseInformation, feasible: Feasible, large: Array, small: Array) -> float:
    r"""A condition number that no allowed weights can go below.

    To rounding, as is every κ: a share of 1e-16 times κ².

    Parameters
    ----------
    information : PoseInformation
        Of one scenario.
    feasible : Feasible
    large, small : ndarray, shape (m, r)
        F and G with :math:`X = F F^T`, :math:`Y = G G^T`.
    """
    even = feasible.best(np.zeros(information.n_poses))
    return _proof(information, feasible, _Prices(large, small, 0.0), even).bound


class _Prices(NamedTuple):
    """F of X, G of Y, and the multiplier of the budget."""

    large: Array
    small: Array
    level: float


def _proof(information: PoseInformation, feasible: Feasible, prices: _Prices, start: Array) -> Priced:
    """The bound of X and Y, by Dinkelbach's iteration from some weights."""
    duals = np.stack([prices.large @ prices.large.T, prices.small @ prices.small.T])
    parts = information.blocks[0].reshape(information.n_poses, -1) @ duals.reshape(2, -1).T
    fixed = np.einsum("xij,ij->x", duals, information.fixed[0])
    weights, ratio = start, 0.0
    for _ in range(STEPS):
        upper, lower = fixed + weights @ parts
        if not lower > 0:
            break
        now = float(upper / lower)
        best = _best(feasible, parts @ (-1.0, now))
        upper, lower = fixed + best @ parts
        if upper >= now * lower * (1 - ROUNDING):
            ratio = now
            break
        weights = best
    large, small = np.einsum("xii->x", duals)
    bound = float(np.sqrt(ratio * small / large)) if large > 0 else 0.0
    return Priced(max(1.0, bound), parts[:, 1] - parts[:, 0], prices.level, weights, np.ones((1, 1)))


def _best(feasible: Feasible, gains: Array) -> Array:
    """The weights of the largest sum of gains of either sign."""
    if feasible.counts_poses:
        return feasible.best(gains)
    return np.where(gains > 0, feasible.best(np.maximum(gains, 0.0)), 0.0)


class _Conditioned(Master):
    """The programme over a few columns: variables v, σ and t."""

    least = 1.0
    power = 2

    def value(self, weights: Array) -> float:
        """κ."""
        total = self.information.total(weights)
        root, seen = inverse_root(total)
        return float(np.linalg.norm(root[0], 2) * np.sqrt(np.linalg.eigvalsh(total[0])[-1])) if seen[0] else np.inf

    def price(self, prices: _Prices) -> Priced:
        """The bound of X and Y."""
        return _proof(self.information, self.feasible, prices, self.even)

    def solve(self, part: Restricted, around: Array) -> tuple[Array, Array, _Prices] | None:
        """The lower bound in coordinates in which some M near is the identity, the upper in units of κ² there."""
        information, feasible, own = self.information, self.feasible, len(part.columns)
        size, near = information.size, (information.total(around) + self.total) / 2
        turn = inverse_root(near)[0][0]
        unity = turn.T @ turn
        small = 1 / np.linalg.eigvalsh(unity)[-1]
        large = small * self.value(around) ** 2
        blocks, unit = part.blocks(information, feasible)
        both = np.concatenate([blocks[0], information.fixed])
        under, over = packed(turn.T @ both @ turn).T, packed(both / large).T
        none, eye = np.zeros((len(under), 1)), packed(np.eye(size))
        rows = [_homogeneous(one) for one in part.rows(feasible, unit)]
        if feasible.counts_poses:
            rows[1] = replace(rows[1], kind="zero")
        rows.append(Rows("orthant", -np.eye(1, len(unit) + 1, len(unit)), np.zeros(1)))
        rows.append(Rows("semidefinite", np.concatenate([-under, none], axis=1), -small * packed(unity), size))
        rows.append(Rows("semidefinite", np.concatenate([over, -eye[:, None]], axis=1), none[:, 0], size))
        cost = np.zeros(len(unit) + 2)
        cost[-1] = 1.0
        found = solve_cones(cost, [one.widened(len(cost)) for one in rows])
        if found is None or not found[0][-2] > 0:
            return None
        x, duals = found
        x = x[:-2] * unit / x[-2]
        lower, upper = (root_of(unpacked(dual, size)) for dual in duals[-2:])
        return x[:own], x[own:], _Prices(upper / np.sqrt(large), turn @ lower, float(duals[1][0] / feasible.total))


def _homogeneous(rows: Rows) -> Rows:
    """Rows of weights as those of weights times σ, the last variable."""
    return replace(rows, matrix=np.concatenate([rows.matrix, -rows.rhs[:, None]], axis=1), rhs=np.zeros(len(rows.rhs)))
