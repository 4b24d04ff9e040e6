"""Which of a loop's parameters are unknown, and what the others are known to be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import InputError, UnitError
from ..geometry import LENGTH_UNITS
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements
from ..result import Estimate

__all__ = ["Known", "KnownValues", "check_estimate_unit", "chosen_unknown", "known_values", "square_root"]

#: A known value: an array, or an estimate that brings its covariance along.
Known = npt.ArrayLike | Estimate


def chosen_unknown(
    loop: str, involved: Sequence[str], unknown: str | Sequence[str], given: Mapping[str, Any]
) -> tuple[str, ...]:
    """The names to estimate, in the order of a leg's blocks; strange, foreign and doubly given names are errors."""
    names = tuple([unknown] if isinstance(unknown, str) else unknown)
    if not names or set(names) - set(involved):
        raise InputError(f"unknown: {loop} can estimate {', '.join(involved)}; got {names or 'nothing'}")
    foreign = [name for name, value in given.items() if value is not None and name not in involved]
    if foreign:
        raise InputError(f"{loop} does not contain {', '.join(foreign)}; leave it out")
    both = [name for name in names if given[name] is not None]
    if both:
        raise InputError(f"{', '.join(both)}: both given and unknown; name the unknown ones by unknown=(…)")
    return tuple(name for name in LEG_BLOCKS if name in names)


@dataclass(frozen=True)
class KnownValues:
    """The known blocks of a loop.

    Attributes
    ----------
    values : dict of str to ndarray, shape (..., size)
    roots : dict of str to ndarray
        Factors of the covariance of those that are estimates with one.
    uncarried : tuple of str
        Those that are estimates without one: their error is real, and lost.
    """

    values: dict[str, Array]
    roots: dict[str, Array]
    uncarried: tuple[str, ...]


def known_values(loop: str, names: Sequence[str], given: Mapping[str, Any], data: LegMeasurements) -> KnownValues:
    """The known blocks of a loop, from arguments or else from the nominal of the data."""
    values, roots, uncarried, nominal = {}, {}, [], data.nominal
    for name in names:
        value = given[name]
        if isinstance(value, Estimate):
            check_estimate_unit(value, name, data.length_unit)
            values[name] = value.params[name]
            if value.covariance is not None:
                roots[name] = square_root(value.covariance_of(name))
            else:
                uncarried.append(name)
        elif value is not None:
            size = LEG_BLOCKS[name]
            array = as_array(name, value, (size,) if size > 1 else ())
            values[name] = array if size > 1 else array[..., None]
        elif nominal is not None:
            values[name] = nominal.block(name)
        else:
            raise InputError(f"{name}: {loop} needs it; give {name}=…, or measurements with nominal=robot.leg(k)")
    return KnownValues(values, roots, tuple(uncarried))


def check_estimate_unit(found: Estimate, name: str, unit: str) -> None:
    """An estimated length must be in the unit of the measurements."""
    for block in found.parameters:
        if block.name == name and block.unit in LENGTH_UNITS and block.unit != unit:
            raise UnitError(f"{name}: the measurements are in {unit}, the estimate in {block.unit}")


def square_root(covariance: Array) -> Array:
    """A factor F with F F' = covariance, for positive semidefinite input; NaN where that is NaN."""
    finite = np.isfinite(covariance).all(axis=(-2, -1), keepdims=True)
    values, vectors = np.linalg.eigh(np.where(finite, covariance, 0.0))
    vectors = np.where(finite, vectors, np.nan)
    factor: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return factor
