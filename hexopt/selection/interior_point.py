r"""The relaxation over a few hundred candidates, by a primal–dual interior-point method.

In shares :math:`x_i = c_i w_i / N` of what may be spent, with a level :math:`t_g` for every group of pieces:

.. math:: \min_{x, t} \sum_g \alpha_g t_g \quad\text{s.t.}\quad f_p(x) \le t_g \;(p \in g), \quad
          0 \le x \le \kappa, \quad \mathbf 1^T x = 1;

the sum is an equation, for more information never hurts. A piece that is alone in its group needs no level. With
:math:`Q = M^{-1}`, :math:`\Gamma = Q K \varphi' K^T Q` and :math:`\Theta = 2Q` for functions that are linear in C,
:math:`2Q - \Gamma` for its log det, the derivatives are

.. math:: \frac{\partial f}{\partial x_i} = -\langle\Gamma, M_i\rangle, \qquad
          \frac{\partial^2 f}{\partial x_i\,\partial x_j} = \operatorname{tr}(\Gamma M_i \Theta M_j).

From :math:`\Gamma = U U^T`, :math:`\Theta = V V^T` the Hessian is :math:`A A^T`, row i of A the entries of
:math:`U^T M_i V`: k m columns a scenario, so that Newton's equations cost as much as that many unknowns, not n. Steps
are Mehrotra's: a predictor, then a corrector with its second-order terms.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from ..arrays import Array, transpose
from .feasible import Feasible
from .objective import Objective, curvature_root

__all__ = ["Optimum", "minimise"]

MAX_ITERATIONS = 80
#: After so many iterations without a smaller gap it is at the limit of rounding.
PATIENCE = 6
#: The sum of products at which it is done, as a share of the goal: what is left is rounding.
ROUNDING = 1e-2
#: A step is shortened, at most so many times, while it makes the gap larger than this many times.
SHORTER, WORSE = 6, 1.5
#: The share of the way to the boundary that a step goes.
SHARE = 0.995
#: Directions in which the objective bends less than this are flat.
FLAT = 1e-11
#: Room above the largest piece at the start, in units in which it is about 1.
ROOM = 0.1


@dataclass(frozen=True, eq=False)
class Optimum:
    r"""What was found.

    Attributes
    ----------
    weights : ndarray, shape (n,)
    mix : ndarray, shape (S, j)
        Multipliers of the pieces.
    price : float
        By how much another unit of the budget lowers the objective.
    gap : float
        How far apart value and bound are over these candidates, as a share of the variance.
    iterations : int
    """

    weights: Array
    mix: Array
    price: float
    gap: float
    iterations: int


@dataclass(frozen=True, eq=False)
class _Point:
    """Shares, multipliers of their bounds and of the budget; levels, and slacks and multipliers of the pieces."""

    x: Array
    low: Array
    high: Array
    price: float
    level: Array
    slack: Array
    mix: Array

    def moved(self, step: _Point, length: float) -> _Point:
        """A step on."""
        return _Point(*(getattr(self, one.name) + length * getattr(step, one.name) for one in fields(self)))

    def products(self, cap: Array) -> list[Array]:
        """What is zero at the optimum."""
        return [self.x * self.low, (cap - self.x) * self.high, self.slack * self.mix]

    def reach(self, step: _Point, cap: Array) -> float:
        """How much of a step is possible, until something that is positive is not."""
        pairs = [(self.x, step.x), (cap - self.x, -step.x), (self.low, step.low), (self.high, step.high)]
        pairs += [(self.slack, step.slack), (self.mix, step.mix)]
        return 1 / max(1.0, *(float((-by / of).max(initial=0.0)) / SHARE for of, by in pairs))


class _Posed:
    """The programme in shares x, and in units in which the objective is about 1 (log det: its mean)."""

    def __init__(self, objective: Objective, feasible: Feasible) -> None:
        info = objective.information
        self.share = feasible.total / feasible.cost
        blocks = info.blocks * self.share[:, None, None]
        self.objective = replace(objective, information=replace(info, blocks=blocks))
        self.cap = feasible.cap / self.share
        self.room = Feasible(self.cap, np.ones(len(self.cap)), 1.0)
        self.middle = self.cap / self.cap.sum()
        pieces = self.objective.local(self.middle).pieces
        self.logdet = objective.criterion.curved == "logdet"
        self.unit = float(info.main if self.logdet else pieces.max())
        self.shape = pieces.shape
        groups = 1 if objective.worst else len(pieces)
        each = pieces.size // groups
        #: Multipliers where every piece of a group counts the same, (P,).
        self.even = np.full(pieces.size, 1 / pieces.size)
        #: Which level each piece is below, (P, g): none where every piece is alone.
        self.member = np.repeat(np.eye(groups), each, axis=0) if each > 1 else np.zeros((0, 0))
        self.alpha = np.full(self.member.shape[1], 1 / groups)

    def start(self) -> _Point:
        """In the middle, with products that are about even."""
        x, own = self.middle, len(self.member)
        local = self.objective.local(x)
        gains = self.objective.gains(local.sensitivity(self.even.reshape(self.shape) / self.unit))
        price = float(gains @ x)
        mu = price / len(x)
        values = local.pieces.ravel()[:own] / self.unit
        level = np.where(self.member > 0, values[:, None], -np.inf).max(axis=0) + ROOM if own else np.zeros(0)
        slack = self.member @ level - values
        return _Point(x, mu / x, mu / (self.cap - x), price, level, slack, self.even[:own])

    def mix(self, at: _Point) -> Array:
        """Multipliers of the pieces that sum to the share of their group, (P,)."""
        if not len(self.member):
            return self.even
        return at.mix * (self.member @ (self.alpha / (at.mix @ self.member)))

    def value(self, values: Array) -> float:
        """The objective from its pieces (P,)."""
        if not len(self.member):
            return float(self.even @ values)
        return float(self.alpha @ np.where(self.member > 0, values[:, None], -np.inf).max(axis=0))


class _Derivatives:
    """Values (P,), gains (n,) of their mix, and of each where it has a level (P, n); the gap; A of the Hessian."""

    def __init__(self, posed: _Posed, at: _Point) -> None:
        info = posed.objective.information
        local = posed.objective.local(at.x)
        k, (s, n, m, _) = info.main, info.blocks.shape
        self.values = local.pieces.ravel() / posed.unit
        self.mix = posed.mix(at)
        shares = self.mix.reshape(posed.shape) / posed.unit
        self.gains = posed.objective.gains(local.sensitivity(shares))
        value = posed.value(self.values)
        self.size = 1.0 if posed.logdet else value
        short = value - float(self.mix @ self.values) + float(self.gains @ (posed.room.best(self.gains) - at.x))
        self.gap = short / self.size
        columns = local.columns
        self.each = np.zeros((0, n))
        if len(posed.member):
            pieces = columns[:, None] @ local.slopes @ transpose(columns)[:, None] / posed.unit
            self.each = (pieces.reshape(s, -1, m * m) @ transpose(info.blocks.reshape(s, n, m * m))).reshape(-1, n)
        inner, vectors = np.linalg.eigh(np.einsum("sj,sjkl->skl", shares, local.slopes))
        left = columns @ (vectors * np.sqrt(np.maximum(inner, 0.0))[:, None, :])
        right = curvature_root(local.root, local.root[:, :k], posed.logdet)
        sides = zip(info.blocks.reshape(s, n * m, m), left, right, strict=True)
        half = [(transpose((blocks @ u).reshape(n, m, k)).reshape(n * k, m) @ v) for blocks, u, v in sides]
        self.factor = np.concatenate([one.reshape(n, k * m) for one in half], axis=1)


class _Newton:
    r"""Newton's equations, :math:`(D + A A^T)\,\Delta x + B^T \Delta\nu = \ldots` with the rows B of budget and pieces.

    With :math:`D^{-1/2} A = P T`, the columns of [P; P'] orthonormal below the identity, the inverse is
    :math:`D^{-1/2}(I - P P^T)D^{-1/2}`; where A is wider than long, the small side is that of n.
    """

    def __init__(self, now: _Derivatives, at: _Point, cap: Array, member: Array) -> None:
        self.at, self.left = at, cap - at.x
        self.factor = now.factor
        self.diagonal = np.maximum(at.low / at.x + at.high / self.left, FLAT * now.size)[:, None]
        self.root = np.sqrt(self.diagonal)
        scaled = self.factor / self.root
        n, r = scaled.shape
        self.wide = r >= n
        if self.wide:
            self.basis = np.linalg.inv(np.eye(n) + scaled @ scaled.T)
        else:
            self.basis = np.linalg.qr(np.concatenate([scaled, np.eye(r)]))[0][:n]
        self.rows = np.concatenate([np.ones((1, n)), -now.each])
        self.behind = self._solve(self.rows.T)
        own, levels = len(self.rows), member.shape[1]
        self.system = np.zeros((own + levels, own + levels))
        self.system[:own, :own] = self.rows @ self.behind + np.diag(np.concatenate([[0.0], at.slack / at.mix]))
        self.system[1:own, own:] = member
        self.system[own:, 1:own] = member.T

    def _once(self, b: Array) -> Array:
        b = b / self.root
        return (self.basis @ b if self.wide else b - self.basis @ (self.basis.T @ b)) / self.root

    def _solve(self, b: Array) -> Array:
        """With one refinement."""
        x = self._once(b)
        return x + self._once(b - self.diagonal * x - self.factor @ (self.factor.T @ x))

    def step(self, balance: Array, miss: Array, aims: list[Array]) -> _Point:
        """The step for the right sides of x, of rows and levels, and of the products."""
        at, (low, high, slack) = self.at, aims
        ahead = self._solve((balance + low / at.x - high / self.left)[:, None])[:, 0]
        own = len(self.rows)
        right = -miss
        right[:own] += self.rows @ ahead
        right[1:own] += slack / at.mix
        right[own:] *= -1
        found = np.asarray(np.linalg.solve(self.system, right), dtype=np.float64)
        x, mix = ahead - self.behind @ found[:own], found[1:own]
        down: Array = (low - at.low * x) / at.x
        up: Array = (high + at.high * x) / self.left
        room: Array = (slack - at.slack * mix) / at.mix
        return _Point(x, down, up, float(found[0]), found[own:], room, mix)


def minimise(objective: Objective, feasible: Feasible, goal: float = 1e-9) -> Optimum:
    """The best weights for a budget that binds, of candidates that together see all parameters.

    Parameters
    ----------
    objective : Objective
        Of a criterion that is "linear" or "logdet".
    feasible : Feasible
        All caps together cost more than the budget.
    goal : float, default 1e-9
        Relative gap at which it stops; rounding may stop it before.
    """
    posed = _Posed(objective, feasible)
    at = posed.start()
    now = _Derivatives(posed, at)
    best, best_at, iterations, since = now, at, 0, 0
    while best.gap > goal and iterations < MAX_ITERATIONS and since < PATIENCE:
        if np.concatenate(at.products(posed.cap)).sum() <= ROUNDING * goal * now.size:
            break
        at, now = _advanced(posed, now, at)
        iterations, since = iterations + 1, since + 1
        if now.gap < best.gap:
            best, best_at, since = now, at, 0
    price = best_at.price * posed.unit / feasible.total
    return Optimum(best_at.x * posed.share, best.mix.reshape(posed.shape), price, best.gap, iterations)


def _advanced(posed: _Posed, now: _Derivatives, at: _Point) -> tuple[_Point, _Derivatives]:
    """A step of predictor and corrector, shortened as long as it makes things worse."""
    cap, member = posed.cap, posed.member
    products = at.products(cap)
    count = sum(map(len, products))
    mu = sum(float(one.sum()) for one in products) / count
    system = _Newton(now, at, cap, member)
    balance = now.gains + at.low - at.high - at.price
    lack = member @ at.level - now.values[: len(member)] - at.slack
    miss = np.concatenate([[1 - at.x.sum()], lack, posed.alpha - at.mix @ member])
    ahead = system.step(balance, miss, [-one for one in products])
    tip = at.moved(ahead, at.reach(ahead, cap))
    after = sum(float(one.sum()) for one in tip.products(cap)) / count
    aim = mu * (after / mu) ** 3
    second = [ahead.x * ahead.low, -ahead.x * ahead.high, ahead.slack * ahead.mix]
    step = system.step(balance, miss, [aim - one - two for one, two in zip(products, second, strict=True)])
    length = at.reach(step, cap)
    for _ in range(SHORTER):
        new = at.moved(step, length)
        there = _Derivatives(posed, new)
        if there.gap <= WORSE * now.gap:
            break
        length /= 3
    return new, there
