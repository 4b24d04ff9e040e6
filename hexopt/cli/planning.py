"""What the flags of ``select`` ask for: limits, clamps, candidates, and the loop over them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError
from ..geometry import Hexapod, Limits
from ..loops import FixedDirection, FixedLeg, FixedLength, LegLength, WholeRobot
from ..loops.clamps import clamp_difference
from ..loops.implicit import Implicit
from ..measurements import LegMeasurements, Lock, Measurements
from ..noise import Noise
from ..pools import candidates
from ..pools.beyond import far_beyond
from ..pools.clamp import Clamp
from ..pools.listed import listed_pool
from ..readers import read_measurements
from ..readers.listing import PoseList, read_poses
from ..readers.settings import OrientationSettings, checked
from ..selection.criteria import Criterion
from ..selection.prediction import GOptimal
from .options import column_names, length, noise_model, several

__all__ = [
    "SCENARIOS",
    "Plan",
    "clamp_given",
    "criterion_of",
    "noise_of",
    "parameters_of",
    "reading_of",
    "scenarios",
    "source_of",
]

#: Robots that the true one may be, where the nominal may be off.
SCENARIOS = 8
#: Poses at which the criterion G wants leg lengths to be right.
TASK = 200

_LOCKED: Mapping[Lock, type[FixedDirection | FixedLeg | FixedLength]] = {
    Lock.DIRECTION: FixedDirection,
    Lock.LEG: FixedLeg,
    Lock.LENGTH: FixedLength,
}


@dataclass(frozen=True)
class Plan:
    """Which poses are to be chosen from, and what is measured with them.

    Attributes
    ----------
    robot : Hexapod
        With the limits that hold now.
    limits : Limits
        The robot's own, within which poses were measured before.
    lock : Lock
    unknown : tuple of str
        What unlocked poses are to determine.
    noise : Noise
    source : int or Path
        So many random candidates, or a CSV file of them.
    given : str or None
        The clamp, as the flag says it.
    measured : Path or None
        Poses that were measured before.
    reading : mapping
        How files are to be read.
    drop : bool
        Leave out listed poses that cannot be candidates.
    seed : int
    """

    robot: Hexapod
    limits: Limits
    lock: Lock
    unknown: tuple[str, ...]
    noise: Noise
    source: int | Path
    given: str | None = None
    measured: Path | None = None
    reading: Mapping[str, Any] = field(default_factory=dict)
    drop: bool = False
    seed: int = 0

    def loop(self, data: Measurements | LegMeasurements, leg: int | None) -> Implicit:
        """The equation of the locked leg, of one unlocked leg, or of all."""
        if leg is None:
            return WholeRobot(data, unknown=self.unknown, nominal=self.robot)
        view = data.leg(leg) if isinstance(data, Measurements) else data
        return LegLength(view, unknown=self.unknown) if self.lock is Lock.NONE else _LOCKED[self.lock](view)

    def before(self, leg: int | None) -> list[Measurements | LegMeasurements]:
        """The sets that were measured under this lock."""
        if self.measured is None:
            return []
        sets = read_measurements(self.measured, nominal=self.robot, noise=self.noise, **self.reading)
        own = [data for data in sets if data.lock is self.lock and _concerns(data, leg, self.lock)]
        if not own:
            found = ", ".join(dict.fromkeys(_words(data.lock, _locked(data)) for data in sets))
            raise InputError(
                f"--measured: {self.measured} has no set with {_words(self.lock, leg)}; it has {found}. Name the leg "
                "by --leg, or leave the file out: the clamp has changed since"
            )
        if self.lock is not Lock.NONE and len(own) > 1:
            raise InputError(
                f"--measured: {self.measured} has {len(own)} sets with {_words(self.lock, leg)}; keep the one whose "
                "clamp is set now"
            )
        for data in own:
            self._check_before(data)
        return own

    def _check_before(self, data: Measurements | LegMeasurements) -> None:
        """Whether poses can be this robot's, and on one clamp."""
        robot = replace(self.robot, limits=self.limits)
        beyond = far_beyond(robot, data.position, data.rotation)
        if beyond:
            raise InputError(f"--measured: {self.measured}: {beyond}; is it the right --length-unit, the right robot?")
        apart = clamp_difference(data, data)
        if apart:
            words = _words(self.lock, _locked(data))
            raise InputError(f"--measured: {self.measured}: expected {words}, but these poses share no clamp: {apart}")

    def clamp(self, leg: int | None, data: Measurements | LegMeasurements) -> Clamp:
        """The clamp that poses share, as the robot sees it."""
        assert leg is not None
        return Clamp.of_poses(self.robot, leg, self.lock, data.position, data.rotation)

    def pool(
        self, leg: int | None, before: list[Measurements | LegMeasurements]
    ) -> tuple[Measurements, npt.NDArray[np.intp] | None, str]:
        """The candidates on one clamp; of the user's list their lines (n,), and in words what was left out."""
        given = clamp_given(self.robot, self.lock, self.given)
        if given is None and before and self.lock is not Lock.NONE:
            given = self.clamp(leg, before[0]).value
        if isinstance(self.source, int):
            rng = np.random.default_rng([self.seed, leg or 0])  # leg 3 has the same, alone or among all
            return candidates(self.robot, leg, self.lock, self.source, self.noise, given, rng=rng), None, ""
        found = self._listed(leg)
        position, rotation = (np.concatenate([getattr(p, name) for p in found]) for name in ("position", "rotation"))
        lines = np.concatenate([part.lines for part in found])
        try:
            pool, bad, why = listed_pool(self.robot, position, rotation, leg, self.lock, self.noise, given)
        except InputError as error:
            raise InputError(f"{self.source}: {error}") from None
        if not bad.any():
            return pool, lines, ""
        if not self.drop or bad.all():
            rest = "nothing is left" if self.drop else f"the first is in line {lines[bad][0]}; --drop leaves them out"
            raise InputError(f"{self.source}: {why}; {rest}")
        return pool.poses(np.flatnonzero(~bad)), lines[~bad], f"left out: {why.partition(';')[0]}"

    def _listed(self, leg: int | None) -> list[PoseList]:
        """The poses in the user's file that are meant for this lock."""
        assert isinstance(self.source, Path)
        lists = read_poses(self.source, self.robot, **self.reading)
        if all(part.lock is None for part in lists):
            return lists
        own = [part for part in lists if part.lock is self.lock and (self.lock is Lock.NONE or part.leg == leg)]
        if not own:
            found = ", ".join(dict.fromkeys(_words(part.lock or Lock.NONE, part.leg) for part in lists))
            raise InputError(f"--candidates: {self.source} has no set with {_words(self.lock, leg)}; it has {found}")
        return own


def parameters_of(lock: Lock, model: str | None) -> tuple[str, ...]:
    """What unlocked poses are to determine: Model 36, 42 or 48."""
    if lock is not Lock.NONE and model is not None:
        raise InputError(f"--model: --lock {lock} decides what it sees; leave --model out")
    blocks = ("platform_point", "base_point", "offset", "gain")
    return blocks[: {"36": 2, "42": 3, "48": 4}[model or "42"]]


def clamp_given(robot: Hexapod, lock: Lock, text: str | None) -> Array | float | None:
    """What the clamp holds: a direction, the point of the platform joint, or the true length."""
    if text is None:
        return None
    unit = robot.length_unit
    if lock is Lock.NONE:
        raise InputError(f"--given: {text!r} is named, but --lock none holds nothing; leave it out")
    if lock is Lock.LENGTH:
        return length("--given", text, unit)
    if lock is Lock.LEG:
        parts = several("--given", text, 3, f"12{unit},3{unit},20{unit}")
        return np.array([length("--given", part, unit, signed=True) for part in parts])
    parts = several("--given", text, 3, "0.1,-0.2,1")
    try:
        return np.array([float(part) for part in parts])
    except ValueError:
        raise InputError(
            f"--given: expected a direction x,y,z as plain numbers, e.g. 0.1,-0.2,1; got {text!r}"
        ) from None


def _locked(data: Measurements | LegMeasurements) -> int | None:
    return data.locked_leg if isinstance(data, Measurements) else data.leg


def _concerns(data: Measurements | LegMeasurements, leg: int | None, lock: Lock) -> bool:
    """Whether a set brings something for the leg."""
    if lock is Lock.NONE:
        return leg is None or leg in data.legs
    return _locked(data) == leg


def _words(lock: Lock, leg: int | None) -> str:
    return "unlocked poses" if lock is Lock.NONE else f"the lock {lock} of leg {leg}"


def criterion_of(name: str, robot: Hexapod, seed: int) -> str | Criterion:
    """The criterion by its name; of G the task is all that the robot reaches."""
    if name != "G":
        return name
    stream = np.random.SeedSequence(seed, spawn_key=(2,))
    return GOptimal(candidates(robot, None, Lock.NONE, TASK, rng=np.random.default_rng(stream)))


def noise_of(robot: Hexapod, lock: Lock, flags: tuple[Any, ...]) -> Noise:
    """The noise of the instruments, without which poses bring no information."""
    noise = noise_model(robot, *flags)
    read = lock in (Lock.NONE, Lock.DIRECTION)
    needed = {"position": True, "angle": True, "length": read}
    if noise is None or not all(getattr(noise, name) > 0 for name, need in needed.items() if need):
        unit, reading = robot.length_unit, robot.reading_unit
        example = f"--position-noise 0.01{unit} --angle-noise 0.01deg" + f" --length-noise 0.01{reading}" * read
        raise InputError(f"which poses are good depends on the noise of the instruments: give it, > 0, e.g. {example}")
    return noise


def source_of(text: str) -> int | Path:
    """So many random candidates, or a file of them."""
    if text.isascii() and text.isdigit():
        if int(text) == 0:
            raise InputError("--candidates: expected at least 1")
        return int(text)
    if Path(text).suffix.lower() != ".csv" and not Path(text).is_file():
        raise InputError(f"--candidates: expected a number such as 1000, or a CSV file; got {text!r}")
    return Path(text)


def reading_of(
    files: list[Path], unit: str | None, orientation: str, angle_unit: Any, column: list[str] | None
) -> dict[str, Any]:
    """How files are read; a file needs its length unit."""
    columns = column_names(column or [])
    checked(OrientationSettings, orientation=orientation, angle_unit=angle_unit)
    if files and unit is None:
        raise InputError(f"--length-unit: in which unit are the lengths in {files[0]}? Give --length-unit, e.g. mm")
    if not files and (unit is not None or columns):
        flag = "--length-unit" if unit is not None else "--column"
        raise InputError(f"{flag}: no file is read (--candidates FILE.csv, --measured); leave it out")
    return {"length_unit": unit, "orientation": orientation, "angle_unit": angle_unit, "columns": columns}


def scenarios(robot: Hexapod, error: str | None, seed: int) -> list[Hexapod] | None:
    """Robots as the true one may be; None for the nominal alone."""
    if error is None:
        return None
    amount = length("--nominal-error", error, robot.length_unit)
    streams = np.random.SeedSequence(seed, spawn_key=(1,)).spawn(SCENARIOS)
    return [robot.perturbed(amount, rng=np.random.default_rng(stream)) for stream in streams]
