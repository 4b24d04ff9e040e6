"""One design in a report, and whether several can stand on one page."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from ..arrays import brief
from ..errors import InputError, UnitError
from ..geometry import Hexapod
from ..kinematics import inverse_kinematics
from ..measurements import LegMeasurements, Lock, Measurements
from ..noise import Noise, NormalNoise, UniformNoise
from ..pools.beyond import far_beyond
from ..pools.clamp import Clamp
from ..selection.design import Design
from ..selection.objective import Objective
from ..selection.ordering import measuring_order

__all__ = ["Choice", "check_alike", "noise_words", "rounded_down", "unit_shown"]


class Choice:
    """A design with its poses in the order of measuring."""

    def __init__(self, robot: Hexapod, design: Design) -> None:
        if not isinstance(design, Design):
            raise InputError(f"designs: expected what select_poses returns, got {brief(design)}")
        if not isinstance(design.poses, (Measurements, LegMeasurements)):
            raise InputError("designs: expected choices among the poses of one set, such as from hx.candidates(…)")
        self.design = design
        self.objective: Objective = design.question.objective()
        if design.poses.length_unit != robot.length_unit:
            raise UnitError(
                f"designs: their poses are in {design.poses.length_unit}, {robot.name} is in {robot.length_unit}; give "
                "the robot that they were chosen for"
            )
        beyond = far_beyond(robot, design.poses.position, design.poses.rotation)
        if beyond:
            raise InputError(f"designs: {beyond}; give the robot that they were chosen for")
        self.order = measuring_order(robot, design.poses)
        self.candidates: Measurements | LegMeasurements = design.question.sets()[0]
        poses = design.poses.poses(self.order)
        self.lock: Lock = poses.lock
        self.leg = poses.locked_leg if isinstance(poses, Measurements) else poses.leg
        length = inverse_kinematics(robot, poses.position, poses.rotation)
        held = None if self.lock is Lock.NONE else self.leg
        #: Leg and parameter of every label.
        self.places = [_place(label, self.leg) for label in design.labels]
        self.legs = list(dict.fromkeys(leg for leg, _ in self.places))
        self.data = Measurements(poses.position, poses.rotation, length, self.lock, held, length_unit=robot.length_unit)

    def told(self, robot: Hexapod) -> str:
        """The clamp, what is proven, and what ended the search."""
        words = []
        if self.leg is not None and self.lock is not Lock.NONE:
            held = Clamp.of_poses(robot, self.leg, self.lock, self.data.position, self.data.rotation)
            words.append(f"Leg {self.leg} is held at the {held.describe()} in all of these poses.")
        if np.isfinite(self.design.efficiency):
            share = rounded_down(self.design.efficiency)
            sure = f"{share} of the best choice of these candidates, as a ratio of variances"
            words.append("The best choice of these candidates, proven." if self.design.proven else f"At least {sure}.")
        words.append(f"Search: {self.design.stopped}.")
        return " ".join(words)

    @property
    def title(self) -> str:
        """What a section on it is called."""
        return "All legs" if len(self.legs) > 1 else f"Leg {self.legs[0]}"


def _place(label: str, leg: int | None) -> tuple[str, str]:
    match = re.fullmatch(r"leg(\d)\.(.+)", label)
    return (match[1], match[2]) if match else (str(leg), label)


def check_alike(robot: Hexapod, choices: Sequence[Choice]) -> None:
    """What the page says once holds for all, and each leg has one row."""
    for what, said in (
        ("one lock", [str(one.lock) for one in choices]),
        ("one criterion", [one.design.criterion for one in choices]),
        ("one noise", [noise_words(one.candidates.noise, robot) for one in choices]),
    ):
        if len(set(said)) > 1:
            raise InputError(
                f"designs: expected {what}, got {' and '.join(dict.fromkeys(said))}; make a report of each"
            )
    legs = [leg for one in choices for leg in one.legs]
    if len(set(legs)) < len(legs):
        twice = next(leg for leg in legs if legs.count(leg) > 1)
        raise InputError(f"designs: expected each leg once, got leg {twice} in two of them; make a report of each")


def noise_words(noise: Noise | None, robot: Hexapod) -> str:
    """The noise that is assumed, with units."""
    if not isinstance(noise, (UniformNoise, NormalNoise)):
        return "as given"
    length, reading = unit_shown(robot.length_unit), unit_shown(robot.reading_unit)
    kind = "uniform, within ±" if isinstance(noise, UniformNoise) else "normal, of standard deviation"
    if isinstance(noise, NormalNoise) and noise.pose_covariance is not None:
        return "normal, of a given covariance"
    return (
        f"{kind} {noise.position:g} {length} in x, y and z, {np.rad2deg(noise.angle):g}° in each angle "
        f"({noise.coordinates}), {noise.length:g} {reading} in a reading"
    )


def rounded_down(share: float) -> str:
    """In per cent, rounded down, so that it stays a bound."""
    return f"{np.floor(1000 * share) / 10:.1f} %"


def unit_shown(unit: str) -> str:
    """A unit as people write it."""
    return "" if unit == "unstated" else unit.replace("um", "µm")
