"""The noise of joined loop equations: each set's own, and what several sets share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..problem import RowCovariance, RowNoise
from ..result import Estimate
from .base import Loop

__all__ = ["JoinedNoise", "Place"]

#: Where the parameters of a part stand among the joined ones.
Place = npt.NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class JoinedNoise:
    """The noise of joined rows: every part's own, and its common errors in columns of their own.

    Parameters
    ----------
    noises : tuple of RowNoise
        Of the parts.
    places : tuple of ndarray of int
        Where the parameters of each part stand among the joined ones.
    """

    noises: tuple[RowNoise, ...]
    places: tuple[Place, ...]

    def covariance(self, values: Array) -> RowCovariance:
        """The covariance of all direct rows at the joined `values` (..., p)."""
        own, shared = self.covariance_parts(values)
        return RowCovariance(own, np.concatenate([columns for _, columns in shared], axis=-1) if shared else None)

    def covariance_parts(self, values: Array) -> tuple[Array, list[tuple[Estimate | None, Array]]]:
        """The blocks of all poses, and what poses share by its source; one estimate keeps its columns for all parts."""
        found = [_row_parts(noise, values[..., place]) for noise, place in zip(self.noises, self.places, strict=True)]
        every = [array for own, shared in found for array in (own, *(columns for _, columns in shared))]
        batch = np.broadcast_shapes(*(array.shape[:-3] for array in every))
        blocks = np.concatenate([np.broadcast_to(own, (*batch, *own.shape[-3:])) for own, _ in found], axis=-3)
        groups: list[tuple[Estimate | None, Array]] = []
        start = 0
        for own, shared in found:
            rows = slice(start, start + own.shape[-3])
            start = rows.stop
            for source, columns in shared:
                wide = next((array for key, array in groups if key is not None and key is source), None)
                if wide is None:
                    wide = np.zeros((*batch, *blocks.shape[-3:-1], columns.shape[-1]))
                    groups.append((source, wide))
                wide[..., rows, :, :] = columns
        return blocks, groups


def _row_parts(noise: RowNoise, values: Array) -> tuple[Array, list[tuple[Estimate | None, Array]]]:
    """Blocks and common columns with their sources, which loops know; elsewhere they are a set's own."""
    if isinstance(noise, (Loop, JoinedNoise)):
        return noise.covariance_parts(values)
    rows = noise.covariance(values)
    return rows.blocks, [] if rows.common is None else [(None, rows.common)]
