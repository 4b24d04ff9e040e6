"""Built-in robots, their numbers retyped from public sources."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .arrays import Array
from .errors import InputError
from .geometry import Hexapod, Limits, PoseRanges

__all__ = ["BUILT_IN", "by_name", "jugglebot", "left_hand", "linuxcnc", "rubin"]


def left_hand() -> Hexapod:
    """INRIA's "Left Hand" (cm): the robot of the paper.

    The default ranges are ours: the paper prints none, and these bring four of its five error factors
    within 15 % at once. The limits (for work on all six legs) are ours too.

    References
    ----------
    Daney (1998), section 4: joints and the offset of 15.25 cm.
    """
    d = np.deg2rad
    return Hexapod(
        name="Left Hand",
        base_points=_at_height([(-9.7, 9.1), (9.7, 9.1), (12.76, 3.9), (3, -13), (-3, -13), (-12.76, 3.9)]),
        platform_points=_at_height(
            [(-3, 7.3), (3, 7.3), (7.822, -1.052), (4.822, -6.248), (-4.822, -6.248), (-7.822, -1.052)]
        ),
        offsets=np.full(6, 15.25),
        length_unit="cm",
        home_position=np.array([0.0, 0.0, 19.0]),
        limits=Limits(leg_length=(17.25, 25.25), base_tilt=d(45), angles=(d(25), d(25), d(25)), sequence="xyz"),
        ranges=PoseRanges(angles=(d(35), d(35), d(35)), length=(17.0, 20.3), cone=d(68), lock_cone=d(20)),
    )


def rubin() -> Hexapod:
    """Rubin Observatory's camera hexapod (µm): large, stiff, with tiny rotations.

    Readings are strut displacements from home, so the offsets are the home lengths.
    """
    d = np.deg2rad
    base = _at_height(
        [
            (227600, 653800),
            (-227600, 653800),
            (-680000, -129700),
            (-452300, -524000),
            (452300, -524000),
            (680000, -129700),
        ],
        -525000.0,
    )
    platform = _at_height(
        [
            (472800, 512200),
            (-472800, 512200),
            (-680000, 153300),
            (-207200, -665500),
            (207200, -665500),
            (680000, 153300),
        ],
        -121400.0,
    )
    home = np.sqrt(((platform - base) ** 2).sum(axis=1))
    low, high = float(home.min()) - 14100.0, float(home.max()) + 14100.0
    return Hexapod(
        name="Rubin camera hexapod",
        base_points=base,
        platform_points=platform,
        offsets=home,
        length_unit="um",
        limits=Limits(
            leg_length=(low, high),
            tilt=d(0.36),
            angles=(d(0.36), d(0.36), d(0.10)),
            position=(11400, 11400, 13100),
        ),
        ranges=PoseRanges(
            angles=(d(0.25), d(0.25), d(0.10)),
            length=(low, high),
            cone=d(1.5),
            lock_cone=d(1.0),
            sequence="xyz",
        ),
    )


def linuxcnc() -> Hexapod:
    """LinuxCNC's genhexkins default (unit unstated): base joints coincide in pairs; home height 20 is ours."""
    return Hexapod(
        name="LinuxCNC genhexkins",
        base_points=_at_height(
            [(-22.95, 13.25), (22.95, 13.25), (22.95, 13.25), (0, -26.5), (0, -26.5), (-22.95, 13.25)]
        ),
        platform_points=_at_height(
            [(-1, 11.5), (1, 11.5), (10.459, -4.884), (9.459, -6.616), (-9.459, -6.616), (-10.459, -4.884)]
        ),
        length_unit="unstated",
        home_position=np.array([0.0, 0.0, 20.0]),
    )


def jugglebot() -> Hexapod:
    """Jugglebot, design values (mm): joints in pairs on two circles; readings in motor revolutions.

    The offset is the retracted leg length, the gain the spool's nominal 71 mm a revolution; the limits
    are ours.
    """
    base = _on_circle(410.0, [200, 220, 320, 340, 80, 100])
    half = 8.6024446 / 2
    platform = _on_circle(219.075, [150 + half, 270 - half, 270 + half, 30 - half, 30 + half, 150 - half])
    home = np.array([0.0, 0.0, 565.0])
    retracted = np.sqrt(((home + platform - base) ** 2).sum(axis=1))
    d = np.deg2rad
    return Hexapod(
        name="Jugglebot",
        base_points=base,
        platform_points=platform,
        offsets=retracted,
        gains=np.full(6, 71.0),
        length_unit="mm",
        reading_unit="rev",
        home_position=home,
        limits=Limits(leg_length=(600.0, 900.0), angles=(d(20), d(20), d(20)), base_tilt=d(45)),
        ranges=PoseRanges(angles=(d(20), d(20), d(20)), length=(640.0, 880.0), cone=d(30), lock_cone=d(10)),
    )


def _at_height(points: list[tuple[float, float]], height: float = 0.0) -> Array:
    return np.column_stack([np.array(points, dtype=float), np.full(len(points), height)])


def _on_circle(radius: float, degrees: list[float]) -> Array:
    angle = np.deg2rad(degrees)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(len(degrees))])


#: The built-in robots by the names that the command line uses.
BUILT_IN: dict[str, Callable[[], Hexapod]] = {
    "left-hand": left_hand,
    "rubin": rubin,
    "linuxcnc": linuxcnc,
    "jugglebot": jugglebot,
}


def by_name(name: str) -> Hexapod:
    """A built-in robot by name; an unknown name is an error that lists the known ones."""
    if name not in BUILT_IN:
        raise InputError(f"unknown robot {name!r}; built in are {', '.join(BUILT_IN)}")
    return BUILT_IN[name]()
