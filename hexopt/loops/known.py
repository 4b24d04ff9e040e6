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
from ..parameters import Parameters
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
    roots : dict of str to ndarray, shape (..., size, r)
        Factors of the covariance of those that are estimates with one: blocks of one estimate have rows of one
        factor, so that :math:`F_a F_b^T` is what a and b share.
    sources : dict of str to Estimate
        The estimates behind the roots.
    uncarried : tuple of str
        Those that are estimates without one: their error is real, and lost.
    """

    values: dict[str, Array]
    roots: dict[str, Array]
    sources: dict[str, Estimate]
    uncarried: tuple[str, ...]


def known_values(loop: str, names: Sequence[str], given: Mapping[str, Any], data: LegMeasurements) -> KnownValues:
    """The known blocks of a loop, from arguments or else from the nominal of the data."""
    values, uncarried, nominal = {}, [], data.nominal
    sources: dict[str, Estimate] = {}
    for name in names:
        value = given[name]
        if isinstance(value, Estimate):
            if name not in value.parameters:
                have = ", ".join(value.parameters.names)
                raise InputError(f"{name}: the given estimate has no such block, it has {have}")
            check_estimate_unit(value, name, data.length_unit)
            values[name] = value.params[name]
            if value.covariance is not None:
                sources[name] = value
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
    factors = {id(source): _block_roots(source) for source in sources.values()}
    roots = {name: factors[id(source)][name] for name, source in sources.items()}
    return KnownValues(values, roots, sources, tuple(uncarried))


def _block_roots(found: Estimate) -> dict[str, Array]:
    """The rows, by block, of one factor of the covariance of all of an estimate's leg blocks."""
    blocks = Parameters(tuple(block for block in found.parameters if block.name in LEG_BLOCKS))
    root = square_root(found.covariance_of(*blocks.names))
    return {name: root[..., blocks[name], :] for name in blocks.names}


def check_estimate_unit(found: Estimate, name: str, unit: str) -> None:
    """An estimated length must be in the unit of the measurements."""
    for block in found.parameters:
        if block.name == name and block.unit in LENGTH_UNITS and block.unit != unit:
            raise UnitError(f"{name}: the measurements are in {unit}, the estimate in {block.unit}")


def square_root(covariance: Array) -> Array:
    """A factor F with F F' = covariance, for positive semidefinite input of any units; NaN where that is NaN."""
    finite = np.isfinite(covariance).all(axis=(-2, -1), keepdims=True)
    known = np.where(finite, covariance, 0.0)
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", known), 0.0))
    scale = np.where(scale > 0, scale, 1.0)  # entries of unit size: small units lose no digits beside large ones
    values, vectors = np.linalg.eigh(known / scale[..., :, None] / scale[..., None, :])
    vectors = np.where(finite, scale[..., :, None] * vectors, np.nan)
    factor: Array = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return factor
