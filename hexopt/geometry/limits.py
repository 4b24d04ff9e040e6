"""What a robot can reach, and the ranges that random poses are drawn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import as_array
from ..errors import InputError
from ..rotations import euler_to_matrix

__all__ = ["Limits", "PoseRanges"]


def _interval(name: str, value: object, *, positive: bool = True) -> tuple[float, float]:
    low, high = (float(v) for v in as_array(name, value, (2,), batch=False))  # type: ignore[arg-type]
    if low > high or (positive and low <= 0):
        raise InputError(f"{name}: expected {'0 < ' if positive else ''}low <= high, got ({low}, {high})")
    return low, high


def _angle(name: str, value: float, largest: float = np.pi) -> float:
    angle = float(as_array(name, value, (), batch=False))
    if not 0 <= angle <= largest + 1e-12:
        hint = "; angles are radians: numpy.deg2rad(…)" if angle > largest else ""
        raise InputError(f"{name}: expected an angle in [0, {largest:.4g}] rad, got {angle:.6g}{hint}")
    return angle


@dataclass(frozen=True, eq=False)
class Limits:
    r"""What a pose must respect to be reachable; a limit that is None does not bind.

    Parameters
    ----------
    leg_length : (float, float) or None
        Shortest and longest true length :math:`\ell` of every leg.
    leg_tilt : float or None
        Largest angle between a leg and its direction at home (the cone of its joints), rad.
    base_tilt : float or None
        Largest angle between a leg and the base normal z, rad.
    tilt : float or None
        Largest angle between the platform's and the base's normal, rad.
    angles : (float, float, float) or None
        Half-widths of the angles of `sequence` from the home orientation, rad.
    sequence : str, default "xyz"
    position : (float, float, float) or None
        Half-widths of the platform's travel from its home position.
    """

    leg_length: tuple[float, float] | None = None
    leg_tilt: float | None = None
    base_tilt: float | None = None
    tilt: float | None = None
    angles: tuple[float, float, float] | None = None
    sequence: str = "xyz"
    position: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        if self.leg_length is not None:
            object.__setattr__(self, "leg_length", _interval("leg_length", self.leg_length))
        for name in ("leg_tilt", "base_tilt", "tilt"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _angle(name, getattr(self, name)))
        object.__setattr__(self, "angles", _half_widths("angles", self.angles, np.pi))
        object.__setattr__(self, "position", _half_widths("position", self.position, np.inf))
        euler_to_matrix(np.zeros(3), self.sequence)

    def describe(self, length_unit: str = "") -> str:
        """One line with the limits that bind, for captions and logs."""
        words = []
        if self.leg_length is not None:
            low, high = self.leg_length
            words.append(f"leg length {low:.6g} to {high:.6g} {length_unit}".rstrip())
        for angle, what in (
            (self.leg_tilt, "leg from its direction at home"),
            (self.base_tilt, "leg from the base's normal"),
            (self.tilt, "platform from the base's normal"),
        ):
            if angle is not None:
                words.append(f"{what} up to {np.rad2deg(angle):g}°")
        if self.angles is not None:
            halves = ", ".join(f"±{np.rad2deg(angle):g}°" for angle in self.angles)
            words.append(f"Euler {self.sequence} {halves}")
        if self.position is not None:
            words.append("travel " + ", ".join(f"±{half:g}" for half in self.position) + f" {length_unit}".rstrip())
        return "; ".join(words) or "none"


def _half_widths(name: str, value: object, largest: float) -> tuple[float, float, float] | None:
    if value is None:
        return None
    x, y, z = (float(v) for v in as_array(name, value, (3,), batch=False))  # type: ignore[arg-type]
    if min(x, y, z) < 0 or max(x, y, z) > largest + 1e-12:
        raise InputError(f"{name}: expected three half-widths in [0, {largest:.4g}], got ({x}, {y}, {z})")
    return x, y, z


@dataclass(frozen=True, eq=False)
class PoseRanges:
    r"""The ranges of random poses, seen from one leg: :math:`P = a + \ell n - R\,b`.

    The orientation R is home times uniform Euler angles, the true length :math:`\ell` is uniform, and
    the direction n is uniform on a spherical cap about the leg's direction at home.

    Parameters
    ----------
    angles : (float, float, float)
        Half-widths of the Euler angles, rad.
    length : (float, float)
        Shortest and longest true length :math:`\ell`.
    cone : float
        Half-angle of the cap of directions where the direction is free (LENGTH and NONE), rad.
    lock_cone : float
        Half-angle of the cap that a locked direction is drawn from (DIRECTION and LEG), rad.
    sequence : str, default "ZXZ"
        The paper's z-x'-z''.

    Notes
    -----
    The paper does not print its ranges, and they decide its error factors: the platform error goes as
    1/(range of rotations), the base error of Type I as 1/(spread of leg length), that of Type III
    nearly as 1/(cone of directions)². Always state them beside a figure: :meth:`describe`.

    Examples
    --------
    >>> import hexopt as hx
    >>> print(hx.robots.left_hand().ranges.describe("cm"))
    Euler ZXZ ±35°, ±35°, ±35°; length 17–20.3 cm; free directions within 68°, locked within 20° of home
    """

    angles: tuple[float, float, float]
    length: tuple[float, float]
    cone: float
    lock_cone: float
    sequence: str = "ZXZ"

    def __post_init__(self) -> None:
        object.__setattr__(self, "angles", _half_widths("angles", self.angles, np.pi))
        object.__setattr__(self, "length", _interval("length", self.length))
        for name in ("cone", "lock_cone"):
            object.__setattr__(self, name, _angle(name, getattr(self, name)))
        euler_to_matrix(np.zeros(3), self.sequence)

    def describe(self, length_unit: str = "") -> str:
        """One line for captions and logs."""
        angles = ", ".join(f"±{np.rad2deg(angle):g}°" for angle in self.angles)
        low, high = self.length
        return (
            f"Euler {self.sequence} {angles}; length {low:g}–{high:g} {length_unit}".rstrip()
            + f"; free directions within {np.rad2deg(self.cone):g}°, "
            + f"locked within {np.rad2deg(self.lock_cone):g}° of home"
        )
