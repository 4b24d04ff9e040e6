"""Named points within a radius."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError
from ..geometry import Leg
from ..named import NamedArrays, chosen_blocks, named_points, per_name, rows_of, sized
from ..parameters import Parameters
from .base import BallRows, Constraint, IntervalRows, bound_array, checked_pair

__all__ = ["Ball"]


@dataclass(frozen=True, eq=False, repr=False)
class Ball(NamedArrays, Constraint):
    r"""Named points within a radius of their nominal: :math:`\lVert x - c\rVert \le r`.

    Parameters
    ----------
    balls : dict of str to (centre, radius)
        By parameter name: centre (..., size), radius (...) > 0.
    unit, if_present
        As in :class:`~hexopt.Box`.
    name : str, default "ball"
        Its multipliers are ``duals["ball.base_point"]`` and so on.

    Examples
    --------
    >>> import hexopt as hx
    >>> float(Ball.around(hx.robots.left_hand().leg(3), 0.5).balls["base_point"][1])
    0.5
    """

    balls: Mapping[str, tuple[Array, Array]]
    unit: str | None = None
    if_present: bool = False
    name: str = "ball"

    def __post_init__(self) -> None:
        pairs = {}
        for name, value in per_name("Ball", "balls", self.balls).items():
            point, size = checked_pair("Ball", name, value, "(centre, radius)")
            centre, radius = bound_array(name, point, np.nan), bound_array(f"radius of {name}", size, np.nan)
            if not np.isfinite(centre).all() or not (np.isfinite(radius) & (radius > 0)).all():
                raise InputError(f"Ball of {name}: expected a finite centre and a radius > 0, got radius {size!r}")
            pairs[name] = (centre, radius)
        object.__setattr__(self, "balls", pairs)

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], radius: npt.ArrayLike | Mapping[str, Any]) -> Ball:
        """The two points of a leg, or of several, within `radius` (a number, or by name)."""
        points, unit = named_points(cls.__name__, leg, radius)
        return cls(points, unit=unit, if_present=True)

    def rows(self, parameters: Parameters) -> list[IntervalRows | BallRows]:
        """One ball a named block."""
        blocks = chosen_blocks("Ball", self.balls, parameters, if_present=self.if_present, length_unit=self.unit)
        return [
            BallRows(
                f"{self.name}.{block.name}",
                rows_of(parameters, block.name),
                sized(block.name, self.balls[block.name][0], block),
                self.balls[block.name][1],
            )
            for block in blocks
        ]

    def centre(self, parameters: Parameters) -> Array:
        """The centres."""
        parts = [part for part in self.rows(parameters) if isinstance(part, BallRows)]
        shape = np.broadcast_shapes(*(part.centre.shape[:-1] for part in parts))
        out = np.full((*shape, parameters.size), np.nan)
        for part in parts:
            out[..., np.argmax(part.matrix, axis=-1)] = part.centre
        return out
