"""What the commands share: robots by name or file, quantities with their unit, noise, files to write."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import typer

from ..errors import InputError, UnitError
from ..geometry import LENGTH_UNITS, Hexapod, length_factor
from ..noise import Noise, NormalNoise, UniformNoise
from ..robots import BUILT_IN, by_name

__all__ = [
    "AngleNoise",
    "AngleUnit",
    "Columns",
    "Force",
    "LengthNoise",
    "NoiseAngles",
    "NoiseKind",
    "Orientation",
    "PositionNoise",
    "angle",
    "check_outputs",
    "column_names",
    "length",
    "noise_model",
    "robot_of",
    "several",
]

_QUANTITY = re.compile(r"\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(.*?)\s*", re.ASCII)

Kind = Literal["uniform", "normal"]

PositionNoise = Annotated[
    str | None, typer.Option(metavar="LENGTH", help="Error of x, y and z of a position, e.g. 0.01cm.")
]
AngleNoise = Annotated[
    str | None, typer.Option(metavar="ANGLE", help="Error of each angle of an orientation, e.g. 0.01deg or 2e-4rad.")
]
LengthNoise = Annotated[
    str | None,
    typer.Option(metavar="READING", help="Error of a leg's reading, in a unit of its sensor, e.g. 0.01cm or 0.002rev."),
]
NoiseKind = Annotated[
    Kind, typer.Option(help="uniform: the errors are within ± the given; normal: they have it as standard deviation.")
]
NoiseAngles = Annotated[
    str,
    typer.Option(
        metavar="ANGLES",
        help="Which angles are in error: an Euler sequence such as ZXZ or xyz, or rotation_vector.",
    ),
]
Orientation = Annotated[
    str,
    typer.Option(
        metavar="HOW",
        help="How the CSV writes orientations: quaternion, matrix, rotation_vector, or an Euler sequence as in SciPy "
        "(ZXZ intrinsic, zxz extrinsic).",
    ),
]
AngleUnit = Annotated[
    Literal["deg", "rad"] | None, typer.Option(help="The unit of the angles in the CSV, where it has some.")
]
Columns = Annotated[
    list[str] | None,
    typer.Option(metavar="NAME=IN_FILE", help="Read a column by another name, e.g. orientation_w=q0; repeatable."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace files that exist.")]


def robot_of(text: str) -> Hexapod:
    """The robot in a TOML file, or a built-in one by its name."""
    if text in BUILT_IN:
        return by_name(text)
    if Path(text).suffix.lower() == ".toml" or Path(text).exists():
        return Hexapod.from_toml(text)
    raise InputError(f"robot: {text!r} is neither a TOML file nor built in; built in are {', '.join(BUILT_IN)}")


def _quantity(flag: str, text: str, example: str, signed: bool = False) -> tuple[float, str]:
    """Number and unit of a text such as ``0.5cm``."""
    match = _QUANTITY.fullmatch(text)
    if not match:
        raise InputError(f"{flag}: expected a number with its unit, e.g. {example}; got {text!r}")
    if not match[2]:
        raise UnitError(f"{flag}: {text!r} has no unit; write it behind the number, e.g. {example}")
    value = float(match[1])
    if not (-np.inf if signed else 0) <= value < np.inf or value == -np.inf:
        raise InputError(f"{flag}: expected {'a finite amount' if signed else 'an amount >= 0'}, got {text!r}")
    return value, match[2]


def length(flag: str, text: str, unit: str, *, signed: bool = False) -> float:
    """A length such as ``0.5cm``, in `unit`."""
    value, given = _quantity(flag, text, f"0.5{unit}", signed)
    try:
        return value * length_factor(given, unit)
    except UnitError as error:
        raise UnitError(f"{flag}: {str(error).removeprefix('source unit: ')}") from None


def angle(flag: str, text: str, example: str = "0.01deg") -> float:
    """An angle such as ``0.01deg``, in radians."""
    value, given = _quantity(flag, text, example)
    if given not in ("deg", "rad"):
        raise UnitError(f"{flag}: unknown unit of angle {given!r}; expected deg or rad")
    return float(np.deg2rad(value)) if given == "deg" else value


def _angle_error(flag: str, text: str) -> float:
    """An error of an angle, in radians."""
    value = angle(flag, text)
    if value > 1.0:
        raise InputError(f"{flag}: expected an error of at most 1 rad (57.3deg), got {text!r}")
    return value


def several(flag: str, text: str, count: int, example: str) -> list[str]:
    """The parts of a text such as ``17cm,20cm``."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != count or not all(parts):
        raise InputError(f"{flag}: expected {count} values with commas between, e.g. {example}; got {text!r}")
    return parts


def _reading(flag: str, text: str, robot: Hexapod) -> float:
    """An amount of a leg's reading: a length, or in the sensor's own unit."""
    if robot.reading_unit in LENGTH_UNITS:
        return length(flag, text, robot.reading_unit)
    value, given = _quantity(flag, text, f"0.01{robot.reading_unit}")
    if given != robot.reading_unit:
        raise UnitError(f"{flag}: the legs of {robot.name} read in {robot.reading_unit!r}, got {given!r}")
    return value


def noise_model(
    robot: Hexapod, kind: Kind, angles: str, position: str | None, angle: str | None, reading: str | None
) -> Noise | None:
    """The noise that the flags describe; None where they are silent."""
    amounts = (
        0.0 if position is None else length("--position-noise", position, robot.length_unit),
        0.0 if angle is None else _angle_error("--angle-noise", angle),
        0.0 if reading is None else _reading("--length-noise", reading, robot),
    )
    largest = (robot.size, np.inf, robot.size / np.abs(robot.gains).min())
    flags = (("--position-noise", position), ("--angle-noise", angle), ("--length-noise", reading))
    for (flag, text), amount, most in zip(flags, amounts, largest, strict=True):
        if amount > most:
            raise InputError(f"{flag}: expected an error smaller than {robot.name} itself, got {text!r}")
    model = UniformNoise if kind == "uniform" else NormalNoise
    try:
        noise = model(*amounts, angles)
    except InputError as error:
        raise InputError(f"--noise-angles: {error}; or rotation_vector") from None
    return None if position is None and angle is None and reading is None else noise


def column_names(pairs: list[str]) -> dict[str, str]:
    """hexopt's names of columns, with those that a file has for them."""
    columns = {}
    for pair in pairs:
        name, equals, label = pair.partition("=")
        if not (name and equals and label) or name in columns:
            raise InputError(f"--column: expected NAME=IN_FILE, each name once, e.g. position_x=X; got {pair!r}")
        columns[name] = label
    return columns


def check_outputs(outputs: Iterable[Path], inputs: Iterable[str | Path], force: bool) -> None:
    """Whether every output can be written: before a long computation, not after it."""
    taken = {Path(path).resolve() for path in inputs}
    for path in outputs:
        if path.resolve() in taken:
            raise InputError(f"{path}: is already an input or another output; give a name of its own")
        taken.add(path.resolve())
        if not path.parent.is_dir():
            raise InputError(f"{path}: the folder {path.parent} does not exist; make it first")
        if path.is_dir():
            raise InputError(f"{path}: is a folder; give the name of a file")
        if path.exists() and not force:
            raise InputError(f"{path}: exists already; give another name, or --force to replace it")
        if not os.access(path.parent, os.W_OK):
            raise InputError(f"{path}: the folder {path.parent.resolve()} cannot be written to")
