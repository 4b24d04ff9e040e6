"""What is run: sets of one leg under every lock, whole robots, and sets that are used together."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

import hexopt as hx

__all__ = ["AMOUNTS", "CHAIN", "CONES", "ERR", "LEG", "OFF", "SCENARIOS", "SETTINGS", "Array", "Scenario"]

Array = npt.NDArray[Any]

LEG = 3
#: The paper's input error: half-width of uniform errors, in cm, degrees and cm.
ERR = 0.01
#: How far every coordinate of a nominal is off, cm, unless the scenario says otherwise.
OFF = 0.1
#: The same where convergence is the matter.
AMOUNTS = (0.1, 0.5, 1.0, 2.0, 5.0)
#: What is measured, by its title: the unknowns differ, and so do the methods.
SETTINGS = {
    "I": "Type I: a, b",
    "II": "Type II: b",
    "III": "Type III: a, b known",
    "III ab": "Type III: a, b",
    "2 × I": "two Type I sets: a, b",
    "free": "unlocked: a, b, offset",
}
#: Numbers of poses; of "2 × I" in each set.
COUNTS = {
    "I": (5, 7, 20, 50),
    "II": (5, 7, 20, 50),
    "III": (5, 7, 20, 50),
    "III ab": (7, 10, 20, 50),
    "2 × I": (4, 7, 20),
    "free": (10, 20, 50),
}
#: Errors by name: distribution and level.
NOISES = {"normal": ("normal", ERR), "uniform": ("uniform", ERR), "uniform, 10 times": ("uniform", 10 * ERR)}
#: Where convergence is tried: setting and poses (three more than the unknowns need, in all).
BASINS = {"free": 10, "III ab": 10, "2 × I": 5}
#: Half-angles of the cap of directions for Innocenti's factor, degrees.
CONES = (45, 65, 90)
#: Poses of the LEG set and of the LENGTH set.
CHAIN = ((7, 7), (7, 20), (7, 50))
#: Locked directions within so many degrees of home; None: as far as the robot's own limits allow.
JOINT = (None, 20, 40)


@dataclass(frozen=True)
class Scenario:
    """One point of the study.

    Attributes
    ----------
    experiment : str
        "methods", "trials", "bias", "ranges" and "basin" are of one leg; "joint", "one set", "home", "chain" and
        "running" say themselves what they do.
    setting : str
        Of one leg, as in `SETTINGS`.
    n_poses : int
        In each set.
    errors : {"normal", "uniform"}
        Of the same variance at the same level.
    level : float
        Half-width of the uniform errors, cm, degrees and cm.
    encoder : float
        Errors of the readings, by that level.
    off : float
        How far every coordinate of the nominal is off, cm.
    cone : float, optional
        Half-angle of the cap of directions, degrees; by default the robot's.
    second : int
        Poses of the second set, where it has another number.
    part : int
        Tells equal scenarios apart whose sets are pooled.
    """

    key: str
    experiment: str
    setting: str
    n_poses: int
    errors: str = "normal"
    level: float = ERR
    encoder: float = 1.0
    off: float = OFF
    cone: float | None = None
    second: int = 0
    part: int = 0

    @property
    def noise(self) -> hx.UniformNoise | hx.NormalNoise:
        """What is added, and what estimators assume."""
        size = self.level if self.errors == "uniform" else self.level / 3**0.5
        kind = hx.UniformNoise if self.errors == "uniform" else hx.NormalNoise
        return kind(size, float(np.deg2rad(size)), self.encoder * size)

    @property
    def robot(self) -> hx.Hexapod:
        """The true robot, with the ranges (and the limits) of this scenario."""
        robot = hx.robots.left_hand()
        if self.cone is None:
            return robot
        angle = float(np.deg2rad(self.cone))
        if self.experiment == "joint":
            ranges = replace(robot.ranges, lock_cone=angle)
            return replace(robot, limits=hx.Limits(), ranges=ranges)
        return replace(robot, ranges=replace(robot.ranges, cone=angle))


def _grid() -> Iterator[Scenario]:
    """All methods, by what is measured, noise and number of poses."""
    for noise, (errors, level) in NOISES.items():
        for setting, counts in COUNTS.items():
            for n in counts:
                yield Scenario(f"methods, {noise}, {setting}, N={n}", "methods", setting, n, errors, level)


def _parts(count: int, scenario: Scenario) -> Iterator[Scenario]:
    for part in range(count):
        yield replace(scenario, key=f"{scenario.key}, part {part}", part=part)


def _one_leg() -> Iterator[Scenario]:
    """Many sets for the bound, bias under large errors, the ranges behind a factor, and bad starts."""
    for setting in ("I", "II", "III"):
        for n in (7, 20, 50):
            yield from _parts(25, Scenario(f"trials, {setting}, N={n}", "trials", setting, n))
    for level in (ERR, 10 * ERR, 50 * ERR):
        key = f"bias, err={level:g}"
        yield from _parts(8, Scenario(key, "bias", "I", 50, errors="uniform", level=level))
    for cone in CONES:
        key = f"ranges, cone={cone}"
        yield from _parts(5, Scenario(key, "ranges", "III ab", 7, errors="uniform", cone=cone))
    for setting, n in BASINS.items():
        for off in AMOUNTS:
            yield Scenario(f"basin, {setting}, off={off:g}", "basin", setting, n, off=off)


def _together() -> Iterator[Scenario]:
    """Sets and legs that are used together, and poses one by one."""
    for cone in JOINT:
        where = "limits" if cone is None else f"cone={cone}"
        yield Scenario(f"joint, {where}", "joint", "I", 7, cone=cone)
    for n in (7, 8, 20):
        yield Scenario(f"one set, N={n}", "one set", "I", n)
    yield from _parts(3, Scenario("home", "home", "free", 30, encoder=0.1))
    for first, second in CHAIN:
        yield from _parts(5, Scenario(f"chain, N={first}+{second}", "chain", "II", first, second=second))
    for setting in ("I", "free"):
        for off in (0.1, 0.5):
            yield Scenario(f"running, {setting}, prior={off:g}", "running", setting, 20, off=off)


SCENARIOS = (*_grid(), *_one_leg(), *_together())
