"""Bounds on the entries of named parameters."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..geometry import Leg
from ..named import NamedArrays, chosen_blocks, named_points, per_name, rows_of, sized
from ..parameters import Parameters
from .base import BallRows, Constraint, IntervalRows, bound_array, check_order, checked_pair

__all__ = ["Box"]


@dataclass(frozen=True, eq=False, repr=False)
class Box(NamedArrays, Constraint):
    r"""Bounds: :math:`l \le x \le h` on the entries of named parameters.

    Parameters
    ----------
    bounds : dict of str to (lower, upper)
        By parameter name, each side (..., size), a number for all entries, or None for no bound.
    unit : str, optional
        The length unit of the values, checked against the problem.
    if_present : bool, default False
        Whether names that a problem does not have are left out instead of being an error.
    name : str, default "box"
        Of the multipliers in ``Estimate.duals``.

    Raises
    ------
    InputError
        If a lower bound is above its upper bound.

    Examples
    --------
    >>> import hexopt as hx
    >>> Box.around(hx.robots.left_hand().leg(3), 0.5).bounds["base_point"][0]
    array([12.26,  3.4 , -0.5 ])
    """

    bounds: Mapping[str, tuple[Array, Array]]
    unit: str | None = None
    if_present: bool = False
    name: str = "box"

    def __post_init__(self) -> None:
        pairs = {}
        for name, value in per_name("Box", "bounds", self.bounds).items():
            low, high = checked_pair("Box", name, value, "(lower, upper)")
            lower, upper = bound_array(name, low, -np.inf), bound_array(name, high, np.inf)
            check_order(f"Box of {name}", lower, upper)
            pairs[name] = (lower, upper)
        object.__setattr__(self, "bounds", pairs)

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], radius: npt.ArrayLike | Mapping[str, Any]) -> Box:
        """The two points of a leg, or of several, within `radius` in every entry (a number, or by name)."""
        points, unit = named_points(cls.__name__, leg, radius)
        return cls({name: (c - r, c + r) for name, (c, r) in points.items()}, unit=unit, if_present=True)

    def rows(self, parameters: Parameters) -> list[IntervalRows | BallRows]:
        """One part: the named entries between their bounds."""
        blocks = chosen_blocks("Box", self.bounds, parameters, if_present=self.if_present, length_unit=self.unit)
        sides = []
        for side in (0, 1):
            parts = []
            for block in blocks:
                value = self.bounds[block.name][side]
                wide = value if value.ndim == 0 and block.size > 1 else sized(block.name, value, block)
                parts.append(np.broadcast_to(wide, (*wide.shape[:-1], block.size)))
            shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
            sides.append(np.concatenate([np.broadcast_to(p, (*shape, p.shape[-1])) for p in parts], axis=-1))
        matrix = np.concatenate([rows_of(parameters, block.name) for block in blocks])
        return [IntervalRows(self.name, matrix, sides[0], sides[1], is_box=True)]

    def centre(self, parameters: Parameters) -> Array:
        """The middle of the box where both bounds are finite."""
        (part,) = self.rows(parameters)
        assert isinstance(part, IntervalRows)
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (part.lower + part.upper)
        out = np.full((*middle.shape[:-1], parameters.size), np.nan)
        out[..., np.argmax(part.matrix, axis=-1)] = np.where(np.isfinite(middle), middle, np.nan)
        return out
