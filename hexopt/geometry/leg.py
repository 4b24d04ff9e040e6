"""One leg: two joint centres, an offset and a gain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import InputError
from .units import check_length_unit

__all__ = ["Leg", "check_leg_number"]

#: The parameters of a leg, in the order of Daney (1998): b, a, Δρ; then our gain.
LEG_BLOCKS = {"platform_point": 3, "base_point": 3, "offset": 1, "gain": 1}


def check_leg_number(number: object) -> int:
    """`number` as a leg number 1…6, or an :class:`InputError`."""
    if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or not 1 <= number <= 6:
        raise InputError(f"leg: expected a number from 1 to 6 (legs are numbered as in the paper), got {number!r}")
    return int(number)


@dataclass(frozen=True, eq=False)
class Leg:
    r"""Geometry of one leg: true length :math:`\ell = \gamma\rho + \delta = \lVert P + R\,b - a\rVert`.

    Parameters
    ----------
    number : int
        1…6, numbered as in the paper.
    platform_point : array_like, shape (..., 3)
        :math:`b`, the joint centre on the platform, in the platform frame.
    base_point : array_like, shape (..., 3)
        :math:`a`, the joint centre on the base, in the base frame.
    offset : array_like, shape (...), default 0
        :math:`\delta`, in length units.
    gain : array_like, shape (...), default 1
        :math:`\gamma`, length units per unit of the sensor reading :math:`\rho`.
    length_unit : str, default "cm"

    Raises
    ------
    InputError
        For wrong shapes, values that are not finite, a leg number outside 1…6, or a gain of 0.

    References
    ----------
    Daney (1998), section 2: the 7 parameters of an ideal leg (Model 42); the gain is ours (Model 48).

    Examples
    --------
    >>> import hexopt as hx
    >>> hx.robots.left_hand().leg(3).base_point
    array([12.76,  3.9 ,  0.  ])
    """

    number: int
    platform_point: Array
    base_point: Array
    offset: Array = 0.0  # type: ignore[assignment]  # turned into an array below
    gain: Array = 1.0  # type: ignore[assignment]  # turned into an array below
    length_unit: str = "cm"

    def __post_init__(self) -> None:
        object.__setattr__(self, "number", check_leg_number(self.number))
        for name, size in LEG_BLOCKS.items():
            value = as_array(name, getattr(self, name), (size,) if size > 1 else (), own=True)
            object.__setattr__(self, name, value)
        if (self.gain == 0).any():
            raise InputError("gain: expected values other than 0 (negative where a reading falls as the leg grows)")
        object.__setattr__(self, "length_unit", check_length_unit("length_unit", self.length_unit))

    def _key(self) -> tuple[object, ...]:
        blocks = (getattr(self, name) for name in LEG_BLOCKS)
        return (self.number, self.length_unit, *((block.shape, (block + 0.0).tobytes()) for block in blocks))

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if isinstance(other, Leg) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def block(self, name: str) -> Array:
        """The values of one named parameter block, always with a last dimension: (..., 3) or (..., 1)."""
        value: Array = getattr(self, name)
        return value if LEG_BLOCKS[name] > 1 else value[..., None]

    def true_length(self, reading: npt.ArrayLike) -> Array:
        r""":math:`\ell = \gamma\rho + \delta`, broadcast over poses (the last dimension of `reading`)."""
        length: Array = self.gain[..., None] * np.asarray(reading) + self.offset[..., None]
        return length

    def reading(self, true_length: npt.ArrayLike) -> Array:
        r"""The sensor reading :math:`\rho = (\ell - \delta)/\gamma` of a true length."""
        reading: Array = (np.asarray(true_length) - self.offset[..., None]) / self.gain[..., None]
        return reading

    def replaced(self, **blocks: npt.ArrayLike) -> Leg:
        """A leg with some blocks replaced by name; an unknown name is an error."""
        unknown = set(blocks) - set(LEG_BLOCKS)
        if unknown:
            raise InputError(f"a leg has {', '.join(LEG_BLOCKS)}; got {', '.join(sorted(unknown))}")
        return replace(self, **blocks)  # type: ignore[arg-type]  # checked in __post_init__
