r"""Fedorov's exchange: swap a pose of the design for a better one, until no swap lowers the objective.

With :math:`M_i = F_i^T F_i` of rank r, :math:`Q = M^{-1}` and :math:`T = (I + F_j Q F_j^T)^{-1}`, the covariance after
the swap i → j is (Woodbury, the new pose first, so that nothing is singular unless the new design is)

.. math:: C' = C - B_j^T T B_j + E^T H^{-1} E, \quad B = F Q K, \quad
          H = I - F_i Q F_i^T + F_i Q F_j^T T F_j Q F_i^T, \quad E = B_i - F_i Q F_j^T T B_j.

The objective being convex, :math:`f(M - M_i + M_j) \ge f(M) + g_i - g_j` for its gains g: the other poses need no look.

Source: Fedorov, *Theory of Optimal Experiments* (1972), section 3.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, transpose
from ..errors import RankDeficientError
from .feasible import Feasible
from .objective import Objective

__all__ = ["Counts", "best_of", "exchange", "factors"]

Counts = npt.NDArray[np.intp]
#: Eigenvalues of H below this: so much information goes with the pose that the update loses digits.
DOUBTFUL = 1e-6
#: A move has to lower the objective by this much, relative to its size: less is rounding.
GAIN = 1e-12
#: Poses looked at in one go, those of the largest gains first; a better one among them is taken.
CHUNK = 64


def factors(blocks: Array) -> Array:
    r""":math:`F_i` with :math:`M_i = F_i^T F_i`, for (..., m, m) shape (..., r, m): Cholesky with pivots, row by row.

    r is the largest rank among the blocks; those of lower rank have rows of zeros.
    """
    left = blocks.copy()
    floor = 1e-13 * np.einsum("...ii->...", blocks)
    rows: list[Array] = []
    while len(rows) < blocks.shape[-1]:
        diagonal = np.einsum("...ii->...i", left)
        pivot = diagonal.argmax(axis=-1)[..., None]
        size = np.take_along_axis(diagonal, pivot, -1)
        used = size > floor[..., None]
        if not used.any():
            break
        row = np.take_along_axis(left, pivot[..., None], -2)[..., 0, :] / np.sqrt(np.where(used, size, 1.0))
        rows.append(np.where(used, row, 0.0))
        left -= rows[-1][..., :, None] * rows[-1][..., None, :]
    return np.stack(rows, axis=-2) if rows else np.zeros((*blocks.shape[:-2], 0, blocks.shape[-1]))


def exchange(
    objective: Objective, feasible: Feasible, start: Counts, max_sweeps: int = 100, rows: Array | None = None
) -> tuple[Counts, float]:
    """A design that no swap of one pose for another makes better, from a design that sees all parameters.

    Where poses have costs, swaps stay within the budget; what it leaves is filled, and a pose may also give way to
    several.

    Parameters
    ----------
    objective : Objective
    feasible : Feasible
    start : ndarray of int, shape (n,)
        How often each pose is measured.
    max_sweeps : int, default 100
        Over all poses of the design.
    rows : ndarray, shape (S, n, r, m), optional
        `factors` of the poses, if they are at hand.

    Returns
    -------
    counts : ndarray of int, shape (n,)
    value : float

    Raises
    ------
    RankDeficientError
        If the start does not see all parameters.
    """
    if not np.isfinite(objective.value(start)):
        raise RankDeficientError("the poses to start from do not see all parameters; take one of `starts_of`")
    search = _Search(objective, feasible, start, factors(objective.information.blocks) if rows is None else rows)
    for _ in range(max_sweeps):
        before = search.value
        if not feasible.counts_poses:
            search.fill()
        used = np.flatnonzero(search.counts)
        for pose in used[np.argsort(search.gains[used], kind="stable")]:
            search.swap(int(pose))
        if search.value >= before and (feasible.counts_poses or not search.refill()):
            break
    return search.counts, search.value


def best_of(
    objective: Objective, feasible: Feasible, starts: Sequence[Counts], rows: Array | None = None
) -> tuple[Counts, float]:
    """The best design that `exchange` reaches from several starts, and its value; `rows` as there."""
    rows = factors(objective.information.blocks) if rows is None else rows
    return min((exchange(objective, feasible, start, rows=rows) for start in starts), key=lambda design: design[1])


class _Search:
    """A design on its way, with what its neighbours' values need."""

    def __init__(self, objective: Objective, feasible: Feasible, counts: Counts, rows: Array) -> None:
        self.objective, self.feasible, self.rows = objective, feasible, rows
        self.limit = np.floor(feasible.cap + 1e-9).astype(np.intp)
        self.move(counts)

    def move(self, counts: Counts) -> None:
        """Stand at another design."""
        self.counts, self.value = counts, self.objective.value(counts)
        self.total = self.objective.information.total(counts)
        local = self.objective.local(counts)
        self.inverse = local.root @ transpose(local.root)
        self.gains = self.objective.gains(local.sensitivity(self.objective.mix(local.pieces)))
        self.left = self.feasible.total * (1 + 1e-12) - float(self.feasible.cost @ counts)

    def swap(self, pose: int) -> bool:
        """Take a better pose instead of this one, if there is one."""
        if not self.counts[pose]:
            return False
        cost = self.feasible.cost
        fits = (self.counts < self.limit) & (cost <= self.left + cost[pose])
        fits[pose] = False
        best, value = self.better(fits, pose)
        return value < self.value and self.accept([best], [pose])

    def accept(self, new: list[int], old: list[int]) -> bool:
        """Move there, if the value from scratch is lower too."""
        counts = self.counts.copy()
        counts[new] += 1
        counts[old] -= 1
        if self.objective.value(counts) >= self.value - GAIN * abs(self.value):
            return False
        self.move(counts)
        return True

    def fill(self) -> None:
        """Add poses while one fits: by how much the objective falls for its cost."""
        while True:
            fits = (self.counts < self.limit) & (self.feasible.cost <= self.left)
            if not fits.any():
                return
            index = np.flatnonzero(fits)
            drop = (self.value - self.values(index, None)) / self.feasible.cost[index]
            if not self.accept([int(index[drop.argmax()])], []):
                return

    def refill(self) -> bool:
        """Drop a pose and fill the budget again, where that is better."""
        here = self.counts, self.value
        for pose in np.flatnonzero(here[0]):
            counts = here[0].copy()
            counts[pose] -= 1
            if np.isfinite(self.objective.value(counts)):
                self.move(counts)
                self.fill()
                if self.value < here[1] - GAIN * abs(here[1]):
                    return True
        self.move(here[0])
        return False

    def better(self, fits: BoolArray, pose: int) -> tuple[int, float]:
        """A good pose of those that fit instead of this one, and its value; infinite if none can be better."""
        convex = self.objective.criterion.convex
        index = np.flatnonzero(fits & (self.gains > self.gains[pose])) if convex else np.flatnonzero(fits)
        index = index[np.argsort(-self.gains[index], kind="stable")]
        for first in range(0, len(index), CHUNK):
            part = index[first : first + CHUNK]
            values = self.values(part, pose)
            if values.min() < self.value:
                return int(part[values.argmin()]), float(values.min())
        return -1, np.inf

    def values(self, new: npt.NDArray[np.intp], pose: int | None) -> Array:
        """The objective of the design with each of the new poses, without the old one, shape (len(new),)."""
        k, rows = self.objective.main, self.rows[:, new]
        old = self.rows[:, :0, 0] if pose is None else self.rows[:, pose]
        seen, lost = rows @ self.inverse[:, None], old @ self.inverse
        eye = np.eye(rows.shape[-2])
        across = seen @ transpose(old)[:, None]
        solved = np.linalg.solve(eye + seen @ transpose(rows), np.concatenate([seen[..., :k], across], axis=-1))
        change = transpose(seen[..., :k]) @ solved[..., :k]
        rest = lost[:, None, :, :k] - transpose(across) @ solved[..., :k]
        kept = (np.eye(old.shape[-2]) - lost @ transpose(old))[:, None] + transpose(across) @ solved[..., k:]
        sure: BoolArray = np.linalg.det(kept) > DOUBTFUL  # all eigenvalues are at most 1
        sure[~sure] = np.linalg.eigvalsh(kept[~sure])[..., 0] > DOUBTFUL if kept.shape[-1] else True
        kept = np.where(sure[..., None, None], kept, np.eye(old.shape[-2]))
        covariance = self.inverse[:, None, :k, :k] - change + transpose(rest) @ np.linalg.solve(kept, rest)
        values = self.objective.of_covariances(np.moveaxis(covariance, 0, 1))
        doubtful = ~sure.all(axis=0)
        if doubtful.any():
            blocks = self.objective.information.blocks
            without = self.total - (0 if pose is None else blocks[:, pose])
            values[doubtful] = self.objective.of_totals(without + np.moveaxis(blocks[:, new[doubtful]], 0, 1))
        return values
