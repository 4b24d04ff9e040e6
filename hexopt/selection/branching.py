r"""The best design of all, proven: branch and bound, with reduced costs that fix most poses at once.

A node holds all designs between two, :math:`l \le w \le h`. From any weights w of its relaxation, with gains g, the
certificate bounds what they can reach; and with a price :math:`\lambda` of the budget, the bound of those with
:math:`w_i = t` is higher by :math:`(t - l_i)(\lambda c_i - g_i)` for a pose that does not pay, and by
:math:`(h_i - t)(g_i - \lambda c_i)` for one that does: any :math:`\lambda` between the ratio g/c of the last pose that
the budget buys and that of the next one is such a price. Counts with which the bound reaches the best design known are
left out. What remains is split at a weight that is not whole, nodes with the lowest bounds first.

Source: Land and Doig (1960); Welch, "Branch-and-bound search for experimental designs based on D optimality and other
criteria", *Technometrics* 24 (1982).
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, count
from math import comb
from time import perf_counter

import numpy as np

from ..arrays import Array, frozen, transpose
from ..information import inverse_root
from .batched_relaxation import BatchedRelaxation
from .certificate import lower_bound
from .exchange import Counts, exchange
from .feasible import Feasible
from .objective import Objective
from .relaxation import Relaxation, relax
from .rounding import rounded

__all__ = ["Proof", "prove"]

#: Designs that are better by less than this, relative to the value, count as equal.
SLACK = 1e-9
#: Relative gap of a node's relaxation.
GOAL = 1e-5
#: Nodes that are relaxed at once.
BATCH = 32
#: A node with so few designs is enumerated.
FEW = 300


@dataclass(frozen=True, eq=False)
class Proof:
    """A design, and what is proven of it.

    Attributes
    ----------
    counts : ndarray of int, shape (n,)
        The best design found.
    value, bound : float
        Its objective, and what no design can go below.
    proven : bool
        Whether no design is better, by more than rounding.
    nodes : int
        Relaxations solved.
    stopped : str
        What ended the search.
    """

    counts: Counts
    value: float
    bound: float
    proven: bool
    nodes: int
    stopped: str


def prove(
    objective: Objective,
    feasible: Feasible,
    counts: Counts,
    relaxation: Relaxation,
    seconds: float = 60.0,
    nodes: int = 1_000_000,
) -> Proof:
    """Look for a better design than `counts` until there is provably none, or the time or the nodes are used up.

    Parameters
    ----------
    objective : Objective
        Convex.
    feasible : Feasible
    counts : ndarray of int, shape (n,)
        A good design, such as `exchange` finds.
    relaxation : Relaxation
        Over all candidates.
    seconds : float, default 60
        Asked after every few nodes.
    nodes : int, default 1 000 000
    """
    end = perf_counter() + seconds
    weights = np.asarray(relaxation.weights)
    high = np.floor(np.minimum(feasible.cap + 1e-9, feasible.total * (1 + 1e-12) / feasible.cost)).astype(np.intp)
    whole = _Tree(objective, feasible, counts, objective.value(counts))
    whole.compare(rounded(feasible, weights))
    root = whole.narrowed(_Node(-np.inf, np.zeros_like(high), high), weights, relaxation.mix)
    if root is None:
        return whole.proof("")
    free = np.flatnonzero(root.high > root.low)
    info = replace(objective.information.take(free), fixed=objective.information.total(root.low))
    tree = _Tree(replace(objective, information=info), whole.room(root).take(free), None, whole.value, whole.floor)
    tree.push(_Node(root.bound, np.zeros_like(free), (root.high - root.low)[free]))
    stopped = ""
    while not stopped and tree.open and not tree.closed(tree.open[0][0]):
        if perf_counter() >= end:
            stopped = f"not proven within {seconds:g} s"
        elif tree.solved >= nodes:
            stopped = f"not proven with {nodes} nodes"
        else:
            tree.visit(tree.popped())
    proof = tree.proof(stopped)
    if tree.best is None:
        best = counts if whole.best is None else whole.best
    else:
        best = root.low + np.bincount(free, tree.best, len(high)).astype(np.intp)
    value = objective.value(best)
    return replace(proof, counts=frozen(best), value=value, bound=min(proof.bound, value))


@dataclass(frozen=True, eq=False)
class _Node:
    """A bound of all designs between two."""

    bound: float
    low: Counts
    high: Counts


@dataclass(eq=False)
class _Tree:
    """The best design and its value (from elsewhere where there is no design), what was left out, and open nodes."""

    objective: Objective
    feasible: Feasible
    best: Counts | None
    value: float
    floor: float = np.inf
    solved: int = 0
    open: list[tuple[float, int, _Node]] = field(default_factory=list)
    order: Iterator[int] = field(default_factory=count)

    @cached_property
    def batched(self) -> BatchedRelaxation | None:
        """What relaxes many nodes at once."""
        return BatchedRelaxation(self.objective, self.feasible) if BatchedRelaxation.serves(self.objective) else None

    @property
    def target(self) -> float:
        """Designs whose bound is at least this are no better than the best."""
        return self.value - SLACK * abs(self.value)

    def closed(self, bound: float) -> bool:
        """Whether no design with this bound is better."""
        return bool(bound >= self.target)

    def proof(self, stopped: str) -> Proof:
        """What is proven by now."""
        bound = float(min([self.value, self.floor] + [entry[0] for entry in self.open]))
        proven = self.closed(bound)
        if proven:
            stopped = "proven: no design is better"
        best = np.zeros(0, dtype=np.intp) if self.best is None else self.best
        return Proof(frozen(best), self.value, bound, proven, self.solved, stopped)

    def push(self, node: _Node) -> None:
        """Leave a node open."""
        heapq.heappush(self.open, (node.bound, next(self.order), node))

    def popped(self) -> list[_Node]:
        """The nodes with the lowest bounds, as many as are relaxed at once."""
        many = BATCH if self.batched is not None else 1
        return [heapq.heappop(self.open)[2] for _ in range(min(many, len(self.open)))]

    def visit(self, nodes: list[_Node]) -> None:
        """Enumerate, or relax, round, narrow and branch."""
        nodes = [node for node in nodes if not self.settled(node)]
        if nodes:
            most = np.stack([self.objective.information.total(node.high) for node in nodes])
            seen = inverse_root(most)[1]
            nodes = [node for node, each in zip(nodes, seen, strict=True) if each.all()]
        if not nodes:
            return
        self.solved += len(nodes)
        relaxed = self.relaxed(nodes)
        self.compare(*(rounded(self.feasible, weights) for weights, _ in relaxed))
        for node, (weights, mix) in zip(nodes, relaxed, strict=True):
            left = self.narrowed(node, weights, mix)
            if left is not None:
                self.branch(left, weights)

    def room(self, node: _Node) -> Feasible:
        """What may be added to the lower design of a node."""
        rest = self.feasible.total - float(self.feasible.cost @ node.low)
        return Feasible((node.high - node.low).astype(float), self.feasible.cost, rest)

    def settled(self, node: _Node) -> bool:
        """Whether a node needs no relaxation: it is closed, or has one design that is best, or few."""
        if self.closed(node.bound):
            self.floor = min(self.floor, node.bound)
            return True
        room = self.room(node)
        free = np.flatnonzero(room.cap)
        if room.total < room.cost[free].min(initial=np.inf) * (1 - 1e-12):
            self.compare(node.low)
        elif room.cost @ room.cap <= room.total * (1 + 1e-12):
            self.compare(node.high)
        elif room.counts_poses and room.cap.max() == 1 and comb(len(free), round(room.total)) <= FEW:
            self.enumerate(node, free, round(room.total))
        else:
            return False
        return True

    def enumerate(self, node: _Node, free: Counts, number: int) -> None:
        """All designs of a node."""
        chosen = free[np.array(list(combinations(range(len(free)), number)), dtype=np.intp)]
        info = self.objective.information
        added = info.blocks[:, chosen].sum(axis=2)
        values = self.objective.of_totals(info.total(node.low) + np.moveaxis(added, 0, 1))
        counts = node.low.copy()
        counts[chosen[values.argmin()]] += 1
        self.compare(counts)

    def relaxed(self, nodes: list[_Node]) -> list[tuple[Array, Array | None]]:
        """Weights of the nodes' relaxations, and multipliers of the pieces."""
        rooms = [self.room(node) for node in nodes]
        totals = [self.objective.information.total(node.low) for node in nodes]
        if self.batched is not None:
            fixed, caps = np.concatenate(totals), np.stack([room.cap for room in rooms])
            found = self.batched.solve(fixed, caps, np.array([room.total for room in rooms]), GOAL, self.target)
            return [(node.low + weights, None) for node, weights in zip(nodes, found, strict=True)]
        out: list[tuple[Array, Array | None]] = []
        for node, room, total in zip(nodes, rooms, totals, strict=True):
            free = np.flatnonzero(room.cap)
            info = replace(self.objective.information.take(free), fixed=total)
            inner = relax(replace(self.objective, information=info), room.take(free), GOAL)
            weights = node.low.astype(float)
            weights[free] += inner.weights
            out.append((weights, inner.mix))
        return out

    def narrowed(self, node: _Node, weights: Array, mix: Array | None) -> _Node | None:
        """The node with the bound that weights prove, and only counts that can be in a better design; None if none can.

        This is what the proof stands on; the weights may be any that the node allows.
        """
        room = self.room(node)
        bound, gains = lower_bound(self.objective, room, weights, mix)
        bound = max(node.bound, bound - float(gains @ node.low))
        if self.closed(bound):
            self.floor = min(self.floor, bound)
            return None
        best, ratio, distance = room.best(gains), gains / room.cost, self.target - bound
        dear = ratio[best > 0].min(initial=np.inf)
        cheap = ratio[best < room.cap].max(initial=0.0)
        with np.errstate(divide="ignore"):
            up = np.floor(distance / np.maximum(dear * room.cost - gains, 0.0))
            down = np.floor(distance / np.maximum(gains - cheap * room.cost, 0.0))
        high = node.low + np.minimum(up, room.cap).astype(np.intp)
        low = node.high - np.minimum(down, room.cap).astype(np.intp)
        if (high < node.high).any() or (low > node.low).any():
            self.floor = min(self.floor, self.target)
        return _Node(bound, low, high)

    def branch(self, node: _Node, weights: Array) -> None:
        r"""Split a node at a weight that is not whole, times :math:`\langle Q, M_i\rangle/\langle QKK^TQ, M_i\rangle`.

        Poses that are alike share a weight, and to leave out one of them proves little. The factor, which is like for
        them, makes the next splits go on among them, instead of to and fro.
        """
        part = np.minimum(weights - np.floor(weights), np.ceil(weights) - weights)
        local, blocks = self.objective.local(weights), self.objective.information.blocks
        inner = np.stack([local.root @ transpose(local.root), local.columns @ transpose(local.columns)])
        flat = inner.reshape(2, len(blocks), 1, -1) @ blocks.reshape(*blocks.shape[:2], -1).swapaxes(1, 2)
        leverage, effect = flat[:, :, 0].sum(axis=1)
        score = (part + 1e-9) * leverage / np.maximum(effect, 1e-12 * effect.max())
        score = np.where(node.high > node.low, score, -1.0)
        pose = int(score.argmax())
        if score[pose] < 0:
            self.compare(node.low)
            return
        at = int(np.clip(np.floor(weights[pose]), node.low[pose], node.high[pose] - 1))
        high, low = node.high.copy(), node.low.copy()
        high[pose], low[pose] = at, at + 1
        self.push(_Node(node.bound, node.low, high))
        if self.feasible.cost @ low <= self.feasible.total * (1 + 1e-12):
            self.push(_Node(node.bound, low, node.high))

    def compare(self, *designs: Counts) -> None:
        """Keep the best of some designs, if it is better than the best known, after exchanges."""
        values = self.objective.of_totals(np.stack([self.objective.information.total(counts) for counts in designs]))
        best = designs[int(values.argmin())]
        if values.min() < self.value and self.feasible.holds(best):
            self.best, self.value = exchange(self.objective, self.feasible, best)
