r"""Many small relaxations of the same candidates at once, as branch and bound asks for them.

All share the poses, so that with the entries of :math:`M_i` on and above the diagonal as row i of V, the Hessian of
every one of them is :math:`A A^T`, :math:`A = V L`, with :math:`L L^T = T(\Gamma\otimes\Theta)T^T` (see
`interior_point`; T counts what is off the diagonal twice). Newton's equations with a diagonal D are of the size of L:

.. math:: (A A^T + D)^{-1} b = D^{-1}\bigl(b - A (I + L^T V^T D^{-1} V L)^{-1} A^T D^{-1} b\bigr).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, BoolArray, transpose
from ..information import inverse_root
from .feasible import Feasible
from .objective import Objective, curvature_root

__all__ = ["BatchedRelaxation"]

MAX_ITERATIONS = 30
#: Coordinates of a pose's information, at most.
LARGEST = 16
#: The share of the way to the boundary that a step goes.
SHARE = 0.99
#: No diagonal below this share of the Hessian's: steps along flat directions stay short (as in `interior_point`).
FLAT = 1e-6
#: Products of weights and slopes below this share of the goal have nothing more to give.
ROUNDING = 1e-3


@dataclass(eq=False)
class _State:
    """Weights, slopes of their bounds, and the price of the budget: one row a problem."""

    w: Array
    low: Array
    high: Array
    price: Array

    def take(self, index: BoolArray) -> _State:
        return _State(self.w[index], self.low[index], self.high[index], self.price[index])


class BatchedRelaxation:
    """Relaxations of an objective with one piece and one scenario, "linear" or "logdet".

    Parameters
    ----------
    objective : Objective
    feasible : Feasible
        Of which the costs are used.
    """

    def __init__(self, objective: Objective, feasible: Feasible) -> None:
        info = objective.information
        self.objective, self.cost = objective, feasible.cost
        m = info.size
        rows, columns = np.triu_indices(m)
        #: Coordinates in which all candidates together have the information I.
        self.root = inverse_root(info.total(feasible.cap))[0][0]
        self.main = self.root[: objective.main].T
        blocks = self.root.T @ info.blocks[0] @ self.root
        self.flat = blocks.reshape(-1, m * m)
        self.packed = blocks[:, rows, columns]
        self.square = self.packed.T @ self.packed / len(blocks)
        basis = np.zeros((len(rows), m, m))
        basis[range(len(rows)), rows, columns] = basis[range(len(rows)), columns, rows] = 1.0
        self.basis = basis.reshape(-1, m * m)

    @staticmethod
    def serves(objective: Objective) -> bool:
        """Whether it knows the derivatives of an objective, and L is small."""
        info, criterion = objective.information, objective.criterion
        one = len(info.blocks) == 1 and criterion.pieces(np.eye(objective.main)).size == 1
        return one and criterion.curved != "" and info.size <= LARGEST

    def solve(self, fixed: Array, cap: Array, rest: Array, goal: float, enough: float) -> Array:
        r"""Weights (B, n) up to caps (B, n) that spend the rests (B,), besides fixed information (B, m, m).

        A problem ends at the relative gap `goal`, or once its bound is above `enough`. The caps of each cost more than
        its rest, and with them it sees all parameters.
        """
        fixed = self.root.T @ fixed @ self.root
        found = cap * (rest / (cap @ self.cost))[:, None]
        now, todo, least = _Derivatives(self, fixed, found), np.arange(len(cap)), np.full(len(cap), np.inf)
        slope = np.abs(now.gains).max(axis=1, keepdims=True) * (cap > 0) / 10
        at = _State(found.copy(), slope, slope, np.median(now.gains / self.cost, axis=1))
        for _ in range(MAX_ITERATIONS):
            surplus = np.maximum(now.gains - at.price[:, None] * self.cost, 0.0)
            most = at.price * rest[todo] + (cap[todo] * surplus).sum(axis=1)
            gap = most - (now.gains * at.w).sum(axis=1)
            better = gap < least[todo]
            found[todo[better]], least[todo[better]] = at.w[better], gap[better]
            products = (at.w * at.low + (cap[todo] - at.w) * at.high).sum(axis=1)
            going = (np.minimum(gap, products / ROUNDING) > goal * now.unit) & (now.values - gap < enough)
            if not going.any():
                break
            todo = todo[going]
            try:
                at = self._advanced(now.take(going), at.take(going), cap[todo], rest[todo])
                now = _Derivatives(self, fixed[todo], at.w)
            except np.linalg.LinAlgError:  # one that lost its digits: what was found stands for all
                break
        return found

    def _advanced(self, now: _Derivatives, at: _State, cap: Array, rest: Array) -> _State:
        """One step of Mehrotra's method."""
        free = cap > 0
        w, room = np.where(free, at.w, 1.0), np.where(free, cap - at.w, 1.0)
        diagonal = np.maximum(at.low / w + at.high / room, FLAT * now.curvature[:, None])
        inverse = np.where(free, 1 / np.where(free, diagonal, 1.0), 0.0)
        system = _System(self, now, inverse, rest - at.w @ self.cost)
        dual = now.gains - at.price[:, None] * self.cost + at.low - at.high
        count = 2 * free.sum(axis=1)
        mu = ((at.w * at.low) + (cap - at.w) * at.high).sum(axis=1) / count

        def step(low: Array, high: Array) -> tuple[Array, Array, Array, Array]:
            dw, price = system.solve(dual + low / w - high / room)
            return dw, (low - at.low * dw) / w, (high + at.high * dw) / room, price

        def length(dw: Array, low: Array, high: Array) -> Array:
            pairs = ((w, dw), (room, -dw), (at.low, low), (at.high, high))
            worst = np.max([np.where(free, -by / np.where(free, of, 1.0), 0.0).max(axis=1) for of, by in pairs], axis=0)
            return np.asarray(1 / np.maximum(1.0, worst / SHARE))[:, None]

        dw, low, high, _ = step(-at.low * w, -at.high * room)
        far = length(dw, low, high)
        tip = (w + far * dw) * (at.low + far * low) + (room - far * dw) * (at.high + far * high)
        aim = (mu * ((tip * free).sum(axis=1) / count / mu) ** 3)[:, None]
        dw, low, high, price = step(aim - at.low * w - dw * low, aim - at.high * room + dw * high)
        far = length(dw, low, high)
        return _State(
            at.w + far * dw * free, at.low + far * low * free, at.high + far * high * free, at.price + far[:, 0] * price
        )


class _Derivatives:
    """Values, gains and L of problems at weights (B, n)."""

    def __init__(self, problem: BatchedRelaxation, fixed: Array, weights: Array) -> None:
        objective = problem.objective
        k, m = objective.main, objective.information.size
        total = fixed + (weights @ problem.flat).reshape(-1, m, m)
        root = transpose(np.linalg.inv(np.linalg.cholesky(total)))
        main = problem.main.T @ root
        columns, covariance = root @ transpose(main), main @ transpose(main)
        self.values = objective.criterion.pieces(covariance)[:, 0]
        logdet = objective.criterion.curved == "logdet"
        self.unit = np.full(len(fixed), float(k)) if logdet else np.abs(self.values)
        left = columns @ np.linalg.cholesky(objective.criterion.slopes(covariance)[:, 0])
        right = curvature_root(root, main, logdet)
        self.gains = (left @ transpose(left)).reshape(-1, m * m) @ problem.flat.T
        both = np.einsum("bij,bkl->bikjl", left, right).reshape(-1, m * m, k * m)
        self.factor = problem.basis @ both
        self.curvature = ((problem.square @ self.factor) * self.factor).sum(axis=(1, 2))

    def take(self, index: BoolArray) -> _Derivatives:
        """Some of the problems."""
        for name, value in vars(self).items():
            setattr(self, name, value[index])
        return self


class _System:
    """Newton's equations of all problems, with the budget's."""

    def __init__(self, problem: BatchedRelaxation, now: _Derivatives, inverse: Array, miss: Array) -> None:
        self.packed, self.cost, self.inverse, self.miss = problem.packed, problem.cost, inverse, miss
        self.diagonal = 1 / np.where(inverse > 0, inverse, np.inf)
        self.factor = now.factor
        gram = transpose(now.factor) @ ((self.packed.T * inverse[:, None, :]) @ self.packed) @ now.factor
        self.inner = np.linalg.inv(np.eye(gram.shape[-1]) + gram)
        self.behind = self._refined(np.broadcast_to(problem.cost, inverse.shape))

    def _refined(self, right: Array) -> Array:
        """The solution, with one step of refinement: D spans many orders of magnitude."""
        found = self._apply(right)
        back = self.diagonal * found + self._up(self._down(found))
        return found + self._apply(right - back)

    def _apply(self, right: Array) -> Array:
        scaled = self.inverse * right
        return scaled - self.inverse * self._up((self.inner @ self._down(scaled)[..., None])[..., 0])

    def _down(self, right: Array) -> Array:
        return (transpose(self.factor) @ (right @ self.packed)[..., None])[..., 0]

    def _up(self, inner: Array) -> Array:
        return (self.factor @ inner[..., None])[..., 0] @ self.packed.T

    def solve(self, right: Array) -> tuple[Array, Array]:
        """The step of the weights and of the price."""
        ahead = self._refined(right)
        price = (ahead @ self.cost - self.miss) / (self.behind @ self.cost)
        return ahead - price[:, None] * self.behind, price
