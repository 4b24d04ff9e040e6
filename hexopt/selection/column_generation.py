r"""Column generation: a convex programme over many candidates, by programmes over few of them.

At an optimum few candidates have a weight strictly between 0 and the cap. A restricted programme has some as its
*columns*, and mixes a few whole designs for all the others; its multipliers price every candidate. Those that pay
become columns, what would be best at these prices becomes a whole design, and only the bound that the prices prove
ends it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, frozen
from ..errors import RankDeficientError
from ..information import PoseInformation, inverse_root
from .cones import Rows
from .feasible import Feasible
from .relaxed import Relaxation

__all__ = ["Master", "Priced", "Restricted", "generate"]

Index = npt.NDArray[np.intp]
#: Columns at first, that come in a round, and that are too many; whole designs; rounds, and those without a column.
SAMPLE, NEW, MANY, WHOLE, ROUNDS, IDLE = 300, 100, 500, 8, 60, 4
#: Shares below this are none.
SHARE = 1e-9
#: Multiples of the golden section are spread evenly over the candidates, whatever their order.
GOLDEN = (np.sqrt(5) - 1) / 2


@dataclass(frozen=True, eq=False)
class Restricted:
    """Columns (f,) with their caps, and whole designs (r, n), without the columns, of which the shares sum to ≤ 1."""

    columns: Index
    cap: Array
    whole: Array

    def blocks(self, information: PoseInformation, feasible: Feasible) -> tuple[Array, Array]:
        """Information (S, f + r, m, m) of every variable, in a unit each, (f + r,)."""
        own, size = len(self.columns), information.size
        unit = np.concatenate([feasible.total / feasible.cost[self.columns] / size, np.ones(len(self.whole))])
        out = np.empty((len(information.blocks), len(unit), size, size))
        out[:, :own] = information.blocks[:, self.columns] * unit[:own, None, None]
        for i, design in enumerate(self.whole):
            out[:, own + i] = information.total(design) - information.fixed
        return out, unit

    def rows(self, feasible: Feasible, unit: Array) -> list[Rows]:
        """What the variables may be: not negative, within the budget, the caps that bind, and the sum of shares."""
        own, count = len(self.columns), len(unit)
        cost = feasible.cost[self.columns]
        capped = np.flatnonzero(self.cap * cost < feasible.total * (1 - 1e-9))
        limits = np.zeros((len(capped) + 1, count))
        limits[np.arange(len(capped)), capped] = 1.0
        limits[-1, own:] = 1.0
        budget = np.concatenate([cost, self.whole @ feasible.cost]) * unit / feasible.total
        return [
            Rows("orthant", -np.eye(count), np.zeros(count)),
            Rows("orthant", budget[None], np.ones(1)),
            Rows("orthant", limits, np.append(self.cap[capped] / unit[capped], 1.0)),
        ]

    def weights(self, own: Array, shares: Array, allowed: Feasible) -> Array:
        """All weights, allowed to the last digit."""
        shares = np.clip(shares, 0.0, 1.0)
        weights = (shares / max(1.0, shares.sum())) @ self.whole
        weights[self.columns] = own
        weights = np.clip(weights, 0.0, allowed.cap)
        weights *= min(1.0, allowed.total / max(float(allowed.cost @ weights), 1e-300))
        short = allowed.total - float(allowed.cost @ weights)
        if short > 0 and allowed.counts_poses:  # of what rounding and tolerances left
            room = np.where(weights > 0, allowed.cap - weights, 0.0)
            weights += room * min(1.0, short / max(float(room.sum()), 1e-300))
        return weights


@dataclass(frozen=True, eq=False)
class Priced:
    """The bound that prices prove, what a pose gains by them (n,), at which gain a cost pays, the best weights.

    Last the multipliers (S, 1) of the scenarios.
    """

    bound: float
    gains: Array
    level: float
    best: Array
    mix: Array


class Master(ABC):
    """A programme over allowed weights: how it is restricted, and how prices prove a bound."""

    #: Below this no value can be.
    least: float = 0.0
    #: What the value is to this power, a variance.
    power: int = 1

    def __init__(self, information: PoseInformation, feasible: Feasible) -> None:
        self.information = information
        self.feasible = replace(feasible, cap=np.minimum(feasible.cap, feasible.total / feasible.cost))
        whole = float(self.feasible.cost @ self.feasible.cap)
        self.even = self.feasible.cap * min(1.0, feasible.total / whole)
        self.total = information.total(self.even)
        for total, seen in zip(self.total, inverse_root(self.total)[1], strict=True):
            if not seen:
                unseen = information.unseen(total)
                raise RankDeficientError(f"all candidates together do not see {'; '.join(unseen)}", unseen)

    @abstractmethod
    def solve(self, part: Restricted, around: Array) -> tuple[Array, Array, Any] | None:
        """Weights of the columns, shares of the whole designs, and prices; well scaled near the weights `around`."""

    @abstractmethod
    def price(self, prices: Any) -> Priced:
        """What any prices prove."""

    @abstractmethod
    def value(self, weights: Array) -> float:
        """The objective, from the weights."""


class _Search:
    """The best weights and the best proof so far, each for itself."""

    def __init__(self, master: Master, goal: float) -> None:
        self.master, self.goal = master, goal
        self.weights, self.value = master.even, master.value(master.even)
        self.proof = Priced(master.least, np.zeros(len(master.even)), 0.0, master.even, np.ones((1, 1)))

    def relative(self) -> float:
        """The gap, as a share of the variance."""
        return 1 - (self.proof.bound / self.value) ** self.master.power

    def add(self, weights: Array, priced: Priced) -> bool:
        """Whether they close the gap."""
        value = self.master.value(weights)
        if value < self.value:
            self.weights, self.value = weights, value
        if priced.bound > self.proof.bound:
            self.proof = priced
        return self.relative() <= self.goal

    def result(self, iterations: int, stopped: str) -> Relaxation:
        """What was found."""
        proof, weights = self.proof, frozen(self.weights)
        relative = self.relative()
        return Relaxation(
            weights, self.value, proof.bound, proof.gains, proof.mix, relative, self.goal, iterations, stopped
        )


def generate(master: Master, goal: float) -> Relaxation:
    """Solve to a relative gap, or as far as it goes."""
    search = _Search(master, goal)
    columns, whole = _first(master)
    weights, idle = master.even, 0
    for count in range(1, ROUNDS + 1):
        outside = whole.copy()
        outside[:, columns] = 0.0
        part = Restricted(columns, master.feasible.cap[columns], outside)
        found = master.solve(part, weights)
        if found is None:
            return search.result(count, "no proof to the goal: the solver failed on a restricted programme")
        own, shares, prices = found
        weights, priced = part.weights(own, shares, master.feasible), master.price(prices)
        if search.add(weights, priced):
            return search.result(count, "proven to the goal")
        columns, new = _columns(columns, weights, priced, master.feasible)
        idle = 0 if new else idle + 1
        if idle >= IDLE:
            return search.result(count, "no proof to the goal: no other pose pays, to the accuracy of the solver")
        kept = [design for share, design in zip(shares, whole, strict=True) if share > SHARE]
        whole = np.stack([weights, priced.best, *kept][:WHOLE])
    return search.result(ROUNDS, "no proof to the goal: too many rounds of column generation")


def _first(master: Master) -> tuple[Index, Array]:
    """Columns and whole designs to begin with: by the prices of a sample that stands for all."""
    feasible = master.feasible
    usable, none = np.flatnonzero(feasible.cap > 0), np.zeros((0, len(feasible.cap)))
    if len(usable) <= 2 * SAMPLE:
        return usable, none
    sample = usable[np.unique((np.arange(1, SAMPLE + 1) * GOLDEN % 1 * len(usable)).astype(int))]
    room = np.minimum(feasible.cap * len(usable) / len(sample), feasible.total / feasible.cost)
    found = master.solve(Restricted(sample, room[sample], none), master.even)
    if found is None:
        return sample, master.even[None]
    priced = master.price(found[2])
    near = np.abs(priced.gains / feasible.cost - priced.level)[usable]
    return np.union1d(sample, usable[np.argpartition(near, SAMPLE)[:SAMPLE]]), priced.best[None]


def _columns(columns: Index, weights: Array, priced: Priced, feasible: Feasible) -> tuple[Index, int]:
    """The columns of the next round, and how many of them are new."""
    excess = priced.gains / feasible.cost - priced.level
    full = np.divide(weights, feasible.cap, out=np.zeros(len(weights)), where=feasible.cap > 0)
    slack = np.where(excess > 0, excess * (1 - full), -excess * full)
    slack[columns] = 0.0
    slack[feasible.cap == 0] = 0.0
    new = np.argpartition(-slack, NEW)[:NEW] if len(slack) > NEW else np.arange(len(slack))
    new = new[slack[new] > 0]
    if len(columns) > MANY:
        inside = (full[columns] > SHARE) & (full[columns] < 1 - SHARE)
        near = np.abs(excess[columns])
        columns = columns[inside | (near <= np.partition(near, NEW)[NEW])]
    return np.union1d(columns, new), len(new)
