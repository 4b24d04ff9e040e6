"""The rows of a set, whitened or not, and the places of parameters, shared errors and members of batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array

__all__ = ["Members", "Place", "Rows", "SharedPlaces", "WhitenedRows", "picked", "shared_places"]

#: Places of a set's parameters among those of a model.
Place = npt.NDArray[np.intp]


#: Members of a batch: as many index arrays as it has dimensions.
Members = tuple[npt.NDArray[np.intp], ...]


def picked(array: Any, core: int, batch: tuple[int, ...], which: Members) -> Any:
    """The members of an array whose last `core` dimensions are no batch, and whose others broadcast to it."""
    whole = np.asarray(array)
    return np.broadcast_to(whole, (*batch, *whole.shape[whole.ndim - core :]))[which]


@dataclass(frozen=True)
class Rows:
    """Rows of one set.

    Attributes
    ----------
    misclosure : ndarray, shape (..., n, d)
    jacobian : ndarray, shape (..., n, d, p)
        By the parameters of the set.
    common : ndarray, shape (..., n, d, r)
        By standard errors of what the poses of the set share; r may be 0.
    sources : tuple of (object, int)
        Where these come from, and how many columns each has: an estimate, which several sets may share, or None.
    """

    misclosure: Array
    jacobian: Array
    common: Array
    sources: tuple[tuple[Any, int], ...]


@dataclass(frozen=True)
class WhitenedRows(Rows):
    """Rows of unit variance of one set.

    Attributes
    ----------
    root : ndarray, shape (..., n, d, d)
        The left factor that whitened them.
    error : ndarray, shape (..., n, e)
        The errors of the measurements that make the equations hold.
    """

    root: Array
    error: Array


@dataclass(frozen=True)
class SharedPlaces:
    """Where the shared errors of every set stand among all; what several sets take from one estimate is one error.

    Attributes
    ----------
    of_sets : tuple of ndarray of int
    count : int
    """

    of_sets: tuple[Place, ...]
    count: int


def shared_places(rows: Sequence[Rows]) -> SharedPlaces:
    """The places of shared errors from their sources."""
    known: dict[int, Place] = {}
    of_sets, count = [], 0
    for part in rows:
        places = [np.zeros(0, dtype=np.intp)]
        for source, width in part.sources:
            place = known.get(id(source)) if source is not None else None
            if place is None:
                place = np.arange(count, count + width)
                count += width
            if source is not None:
                known[id(source)] = place
            places.append(place)
        of_sets.append(np.concatenate(places))
    return SharedPlaces(tuple(of_sets), count)
