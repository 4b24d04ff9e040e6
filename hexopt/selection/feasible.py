"""Which weights are allowed: so many poses, or poses of so much cost, none more often than its cap."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

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
        order, part = self._leading(-gain / self.cost), self.cap * self.cost
        within = np.clip(self.total - (np.cumsum(part[order]) - part[order]), 0.0, None) / self.cost[order]
        out = np.zeros(len(gain))
        out[order] = np.minimum(self.cap[order], within)
        return out

    def _leading(self, rate: Array) -> npt.NDArray[np.intp]:
        """The candidates of the lowest rates, in ascending order: as many as the budget can need."""
        part = self.cap * self.cost
        used = part > 0
        least = part.min(where=used, initial=np.inf)
        enough = int(min(self.total / least + np.count_nonzero(~used) + 1, len(rate)))
        few = np.argpartition(rate, enough - 1)[:enough] if enough < len(rate) else np.arange(len(rate))
        return few[np.argsort(rate[few], kind="stable")]

    def holds(self, weights: npt.NDArray[Any], slack: float = 1e-9) -> bool:
        """Whether weights are allowed, to rounding."""
        inside = (weights >= -slack).all() and (weights <= self.cap * (1 + slack) + slack).all()
        return bool(inside and self.cost @ weights <= self.total * (1 + slack))
