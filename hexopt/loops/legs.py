"""Parameters of several legs: "leg1.platform_point", "leg1.base_point", …, leg by leg, and stacked arrays of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError, UnitError
from ..geometry import Hexapod, Leg
from ..geometry.leg import LEG_BLOCKS
from ..parameters import Block, Parameters
from ..result import Estimate
from .known import check_estimate_unit

__all__ = ["leg_blocks", "leg_columns", "leg_parameters", "leg_values"]


def leg_parameters(unknown: Sequence[str], legs: Sequence[int], unit: str) -> Parameters:
    """The unknown blocks of some legs, leg by leg, each leg's in the order of ``LEG_BLOCKS``.

    Examples
    --------
    >>> leg_parameters(("offset", "platform_point"), (1, 4), "cm").names
    ('leg1.platform_point', 'leg1.offset', 'leg4.platform_point', 'leg4.offset')
    """
    names = [name for name in LEG_BLOCKS if name in unknown]
    units = {name: f"{unit}/reading" if name == "gain" else unit for name in names}
    return Parameters(tuple(Block(f"leg{k}.{name}", LEG_BLOCKS[name], units[name]) for k in legs for name in names))


def leg_values(x: npt.ArrayLike | Hexapod | Leg | Estimate, parameters: Parameters, unit: str) -> Array:
    """The main values (..., p) of legs: of a robot, of an estimate with those names, of the only leg, or as given.

    Raises
    ------
    UnitError
        If the robot, leg or estimate is in another length unit.
    InputError
        If `x` does not have all the values.
    """
    main = parameters.main
    if isinstance(x, (Hexapod, Leg)):
        if x.length_unit != unit:
            raise UnitError(f"the measurements are in {unit}, the {type(x).__name__.lower()} in {x.length_unit}")
        parts = [_block_of(x, name) for name in main.names]
    elif isinstance(x, Estimate):
        missing = [name for name in main.names if name not in x.parameters]
        if missing:
            raise InputError(f"values: {', '.join(missing)} missing; the estimate has {', '.join(x.parameters.names)}")
        for name in main.names:
            check_estimate_unit(x, name, unit)
        parts = [x.params[name] for name in main.names]
    else:
        vector = np.asarray(x, dtype=float)
        if vector.shape[-1:] != (main.size,):
            raise InputError(f"values: expected {main.size} ({', '.join(main.names)}), got shape {vector.shape}")
        return vector
    shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
    return np.concatenate([np.broadcast_to(part, (*shape, part.shape[-1])) for part in parts], axis=-1)


def _block_of(x: Hexapod | Leg, name: str) -> Array:
    """The block "leg3.offset", say, of a robot, or of its leg 3."""
    prefix, _, block = name.rpartition(".")
    number = int(prefix.removeprefix("leg"))
    leg = x.leg(number) if isinstance(x, Hexapod) else x
    if leg.number != number:
        raise InputError(f"values: {name} is wanted, and leg {leg.number} is given; give the robot")
    return leg.block(block)


def leg_blocks(
    values: Array, parameters: Parameters, known: Hexapod | Mapping[int, Leg] | None, legs: Sequence[int]
) -> dict[str, Array]:
    """All blocks of L legs: the points (..., L, 3), offset and gain (..., L); unknown ones from `values`.

    Raises
    ------
    InputError
        If a block is neither unknown nor known.
    """
    parts, blocks = parameters.split(values), {}
    for name, size in LEG_BLOCKS.items():
        if f"leg{legs[0]}.{name}" in parameters:
            each = [parts[f"leg{k}.{name}"] for k in legs]
        elif known is not None:
            each = [(known.leg(k) if isinstance(known, Hexapod) else known[k]).block(name) for k in legs]
        else:
            raise InputError(f"{name}: neither unknown nor known; give measurements with a nominal robot")
        stacked: Array = np.stack(each, axis=-2)
        blocks[name] = stacked if size > 1 else stacked[..., 0]
    return blocks


def leg_columns(columns: Mapping[str, Array], parameters: Parameters, legs: Sequence[int]) -> Array:
    """A Jacobian (..., p) from derivatives by stacked blocks, each (..., L, size); other columns are 0."""
    wanted = [name for name in columns if f"leg{legs[0]}.{name}" in parameters]
    out = np.zeros((*np.broadcast_shapes(*(columns[name].shape[:-2] for name in wanted)), parameters.size))
    for name in wanted:
        for row, k in enumerate(legs):
            out[..., parameters[f"leg{k}.{name}"]] = columns[name][..., row, :]
    return out
