"""Values that carry arrays by parameter name: what priors and constraints are made of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import Array, as_array, brief
from .errors import InputError, UnitError
from .geometry import LENGTH_UNITS, Leg
from .parameters import Block, Parameters

__all__ = ["NamedArrays", "chosen_blocks", "named_points", "per_name", "rows_of", "sized"]

#: The two points of a leg, which `around` speaks of.
POINTS = ("platform_point", "base_point")


class NamedArrays:
    """Equality and repr of frozen dataclasses that hold arrays in dictionaries."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and _same(vars(self), vars(other))

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        parts = (f"{name}={_text(value)}" for name, value in vars(self).items() if not name.startswith("_"))
        return f"{type(self).__name__}({', '.join(parts)})"


def _same(one: Any, two: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(two, Mapping):
        return list(one) == list(two) and all(_same(one[key], two[key]) for key in one)
    if isinstance(one, tuple) and isinstance(two, tuple):
        return len(one) == len(two) and all(_same(a, b) for a, b in zip(one, two, strict=True))
    if isinstance(one, np.ndarray) or isinstance(two, np.ndarray):
        return bool(np.array_equal(one, two))
    return bool(one == two)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_text(part)}" for key, part in value.items()) + "}"
    if isinstance(value, tuple):
        return "(" + ", ".join(_text(part) for part in value) + ")"
    if isinstance(value, np.ndarray):
        text = repr(value.tolist()).replace("inf", "float('inf')")
        return text if value.size <= 64 else f"<array of shape {value.shape}>"
    return repr(value)


def per_name(kind: str, argument: str, values: object) -> Mapping[str, Any]:
    """`values` as a mapping from parameter names, or an error that shows how to write it."""
    if not isinstance(values, Mapping) or not values or not all(isinstance(name, str) for name in values):
        raise InputError(
            f"{kind}: {argument} is given by parameter name, such as {{'base_point': …}}; got {brief(values)}"
        )
    return values


def sized(name: str, value: Array, block: Block) -> Array:
    """A block's values, (..., size), of an array that may leave out the last dimension of a scalar."""
    if block.size == 1 and value.shape[-1:] != (1,):
        return value[..., None]
    if value.shape[-1:] != (block.size,):
        raise InputError(f"{name}: expected {block.size} values ({', '.join(block.labels)}), got shape {value.shape}")
    return value


def rows_of(parameters: Parameters, name: str) -> Array:
    """The rows of the identity that pick a block, (size, p); an unknown name is an error."""
    return np.eye(parameters.size)[parameters[name]]


def named_points(
    kind: str, legs: Leg | Iterable[Leg], radius: npt.ArrayLike | Mapping[str, Any]
) -> tuple[dict[str, tuple[Array, Array]], str]:
    """(centre, radius) of the points of a leg, or of several legs as "leg3.base_point", and their length unit."""
    if isinstance(legs, Leg):
        named, unit = {name: legs.block(name) for name in POINTS}, legs.length_unit
    else:
        several = list(legs) if isinstance(legs, Iterable) else []
        if not several or not all(isinstance(leg, Leg) for leg in several):
            raise InputError(f"{kind}.around: expected a Leg, or a list of legs, got {brief(legs)}")
        unit = several[0].length_unit
        named = {f"leg{leg.number}.{name}": leg.block(name) for leg in several for name in POINTS}
    if isinstance(radius, Mapping):
        chosen = {}
        for name, size in radius.items():
            if name not in named:
                raise InputError(f"{kind}.around: unknown point {name!r}; there are {', '.join(named)}")
            chosen[name] = (named[name], as_array(name, size))
        return chosen, unit
    size = as_array("radius", radius)
    return {name: (centre, size) for name, centre in named.items()}, unit


def chosen_blocks(
    kind: str, names: Iterable[str], parameters: Parameters, *, if_present: bool, length_unit: str | None
) -> list[Block]:
    """The blocks of a problem that are named, with checked units.

    Where names count only if present, those that the problem does not have are left out, but not all of them.
    """
    blocks = {block.name: block for block in parameters}
    unknown = [name for name in names if name not in blocks]
    found = [blocks[name] for name in names if name in blocks]
    if unknown and not (if_present and found):
        raise InputError(f"{kind}: unknown parameter {unknown[0]!r}; this problem has {', '.join(parameters.names)}")
    for block in found:
        if length_unit and block.unit in LENGTH_UNITS and block.unit != length_unit:
            raise UnitError(f"{kind} of {block.name} is in {length_unit}, the problem in {block.unit}")
    return found
