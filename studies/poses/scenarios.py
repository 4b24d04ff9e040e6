"""What poses are chosen for: robots, locks, legs, and how many poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import hexopt as hx

__all__ = [
    "COUNTS", "FEWEST", "LEG", "ROBOTS", "SCENARIOS", "SETTINGS", "SIZES", "Array", "Robot", "Scenario", "ranges_of"
]  # fmt: skip

Array = npt.NDArray[Any]

LEG = 3
#: Settings, and what they are called.
SETTINGS = {
    "I": "Type I (a, b)",
    "II": "Type II (b)",
    "III": "Type III (a, b known)",
    "free": "unlocked (a, b, offset)",
    "gain": "unlocked (a, b, offset, gain)",
}
#: Where all legs are compared: 7 poses, and where 7 are the fewest, 10.
SIZES = {"I": 7, "II": 7, "III": 7, "free": 10}
#: The fewest poses that determine a leg.
FEWEST = {"I": 3, "II": 3, "III": 4, "free": 7, "gain": 8}
COUNTS = {"hand": (4, 5, 6, 7, 8, 10, 14, 20, 30), "rubin": (4, 5, 8, 10, 14, 30)}


@dataclass(frozen=True)
class Robot:
    """A robot, what its readings err by, and what is expected of its parts.

    Attributes
    ----------
    title : str
    geometry : Hexapod
    err : float
        Half-width of the uniform errors of position and reading.
    angle : float
        That of the angles, rad.
    tolerance : float
        By which its points are expected to be off; gains by a thousandth.
    """

    title: str
    geometry: hx.Hexapod
    err: float
    angle: float
    tolerance: float

    @property
    def noise(self) -> hx.UniformNoise:
        """Uniform errors, as the paper adds them."""
        return hx.UniformNoise(self.err, self.angle, self.err)


ROBOTS = {
    "hand": Robot("Left Hand", hx.robots.left_hand(), 0.01, float(np.deg2rad(0.01)), 0.1),
    "rubin": Robot("Rubin camera hexapod", hx.robots.rubin(), 1.0, 1e-6, 100.0),
}


def ranges_of(name: str) -> str:
    """Where the candidates of a robot are from, for captions."""
    robot = ROBOTS[name].geometry
    return f"{ROBOTS[name].title}, candidates uniform within {robot.limits.describe(robot.length_unit)}; clamp at home"


@dataclass(frozen=True)
class Scenario:
    """One choice of poses.

    Attributes
    ----------
    experiment : {"legs", "counts", "units", "nominal", "sequential"}
    setting : str
        Of `SETTINGS`.
    robot : str
        Of `ROBOTS`.
    leg, n_poses : int
    off : float
        By how much every coordinate of a and b is wrong in the nominal, length units.
    candidates : int
    draws : int
        Noisy copies of a chosen set; `random_draws` of each random one.
    """

    key: str
    experiment: str
    setting: str
    robot: str
    leg: int
    n_poses: int
    off: float = 0.0
    candidates: int = 1000
    draws: int = 500
    random_draws: int = 500


def _legs() -> Iterator[Scenario]:
    for robot, draws in (("hand", 500), ("rubin", 40)):
        for setting, n in SIZES.items():
            for leg in range(1, 7):
                few = 40 if setting == "free" else draws
                key = f"legs, {robot}, {setting}, leg={leg}"
                yield Scenario(key, "legs", setting, robot, leg, n, random_draws=few)


def _counts() -> Iterator[Scenario]:
    for robot in ("hand", "rubin"):
        for setting in SIZES:
            for n in COUNTS[robot]:
                if n >= FEWEST[setting]:
                    key = f"counts, {robot}, {setting}, N={n}"
                    yield Scenario(key, "counts", setting, robot, LEG, n, candidates=300, random_draws=25)


def _units() -> Iterator[Scenario]:
    for robot in ROBOTS:
        for setting, n in (("I", 7), ("III", 5), ("III", 7), ("gain", 10)):
            for leg in range(1, 7):
                key = f"units, {robot}, {setting}, N={n}, leg={leg}"
                yield Scenario(key, "units", setting, robot, leg, n, candidates=300, random_draws=25)


def _nominal() -> Iterator[Scenario]:
    for setting, n in SIZES.items():
        for off in (0.1, 0.5, 1.0):
            key = f"nominal, {setting}, off={off:g}"
            yield Scenario(key, "nominal", setting, "hand", LEG, n, off, candidates=300)
    for setting in ("I", "II", "III"):
        for off in (1.0, 3.0):
            key = f"sequential, {setting}, off={off:g}"
            yield Scenario(key, "sequential", setting, "hand", LEG, SIZES[setting], off, candidates=300)


SCENARIOS = (*_legs(), *_counts(), *_units(), *_nominal())
