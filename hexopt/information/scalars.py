"""Which scalars are of interest, and the units of coordinates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, as_array, brief
from ..errors import InputError
from ..parameters import Parameters

__all__ = ["chosen_scalars", "coordinate_units", "expected_spreads"]


def chosen_scalars(parameters: Parameters, of: Sequence[str] | None) -> BoolArray:
    """Which scalars are of interest, shape (p,)."""
    names = parameters.main.names if of is None else (of,) if isinstance(of, str) else tuple(of)
    if not names:
        raise InputError("of: no parameter is of interest; name some, or leave it out")
    wanted = {name for given in names for name in _named("of", parameters, given)}
    return np.repeat([block.name in wanted for block in parameters], [block.size for block in parameters])


def expected_spreads(parameters: Parameters, spread: Mapping[str, float] | None) -> Array:
    """The expected spread of every scalar, shape (p,)."""
    if spread is not None and not isinstance(spread, Mapping):
        raise InputError(f"spread: expected a size by block name, such as {{'base_point': 0.5}}; got {brief(spread)}")
    sizes = np.array(parameters.scale)
    for given, value in (spread or {}).items():
        named = _named("spread", parameters, given)
        size = float(as_array(f"spread[{given!r}]", value, (), batch=False))
        if size <= 0:
            raise InputError(f"spread[{given!r}]: expected an expected spread > 0, got {size}")
        for name in named:
            sizes[parameters[name]] = size
    return sizes


def coordinate_units(lengths: Array, main: npt.NDArray[np.intp], spread: Array) -> Array:
    """The unit of every coordinate, from the lengths of columns, both (q,).

    Of interest, the expected spread; of the others what makes their columns as long as those of interest are in root
    mean square: a condition number is to say nothing of the units of nuisances.
    """
    mean = float(np.sqrt(np.square(lengths[main] * spread).mean()))
    units = (mean or 1.0) / np.where(lengths > 0, lengths, 1.0)
    units[main] = spread
    return units


def _named(argument: str, parameters: Parameters, given: str) -> list[str]:
    """The blocks that are meant: by their name, or by their name without the leg."""
    known = parameters.main.names
    found = [name for name in known if given in (name, name.rpartition(".")[2])]
    if not found:
        raise InputError(f"{argument}: unknown parameter {given!r}; this problem has {', '.join(known)}")
    return found
