"""Which weights are allowed: so many poses, or poses of so much cost, none more often than its cap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array

__all__ = ["Feasible"]


@dataclass(frozen=True, eq=False)
class Feasible:
    r"""Weights :math:`0 \le w \le u`, :math:`c^T w \le N`; a design has whole numbers.

    Attributes
    ----------
    cap : ndarray, shape (n,)
        u: 1 where a pose is measured once at most.
    cost : ndarray, shape (n,)
        c > 0; 1 each, where N counts poses.
    total : float
        N.
    """

    cap: Array
    cost: Array
    total: float

    @property
    def counts_poses(self) -> bool:
        """Whether every pose costs one, so that a design has exactly N."""
        return bool((self.cost == 1).all())

    def take(self, index: np.ndarray) -> Feasible:
        """The same for some of the poses."""
        return Feasible(self.cap[index], self.cost[index], self.total)

    def best(self, gain: Array) -> Array:
        r"""The weights v that maximise :math:`g^T v` for gains g ≥ 0, (n,): by gain for cost, the last in part."""
        order = np.argsort(-gain / self.cost, kind="stable")
        spent = np.cumsum(self.cap[order] * self.cost[order])
        within = np.clip(self.total - (spent - self.cap[order] * self.cost[order]), 0.0, None) / self.cost[order]
        out = np.zeros(len(gain))
        out[order] = np.minimum(self.cap[order], within)
        return out

    def holds(self, weights: Array, slack: float = 1e-9) -> bool:
        """Whether weights are allowed, to rounding."""
        inside = (weights >= -slack).all() and (weights <= self.cap * (1 + slack) + slack).all()
        return bool(inside and self.cost @ weights <= self.total * (1 + slack))
