"""``hexopt simulate``: measurements that a robot might give, in a CSV file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..errors import InputError
from ..geometry import Hexapod
from ..measurements import Lock
from ..readers import write_measurements
from ..readers.settings import OrientationSettings, checked
from ..simulation import simulate
from .options import (
    AngleNoise,
    AngleUnit,
    Force,
    LengthNoise,
    NoiseAngles,
    NoiseKind,
    Orientation,
    PositionNoise,
    check_outputs,
    length,
    noise_model,
    robot_of,
)

__all__ = ["HELP", "NAME", "run"]

NAME = "simulate"
HELP = """Simulate measurements of a robot, and write them to a CSV file.

Poses are random and within reach of all six legs. A leg may be locked while a set of poses is measured: its direction
(Type I of Daney 1998), direction and length (leg, Type II), or its length (Type III); by default each leg in turn, with
a set for each.

\b
  hexopt simulate --robot left-hand --lock direction --poses 7 --out run.csv
  hexopt simulate --robot my.toml --lock none --poses 40 --out run.csv
  hexopt simulate --robot left-hand --lock leg --lock length --poses 9 \\
      --position-noise 0.01cm --angle-noise 0.01deg --length-noise 0.01cm \\
      --nominal-error 0.5cm --seed 1 --out run.csv

For --out run.csv this writes run.csv, with lengths in the robot's unit, and the true robot as run.truth.toml; with
--nominal-error, a robot that is off as run.nominal.toml, to start a calibration from.
"""


Robot = Annotated[str, typer.Option(metavar="ROBOT", help="The true robot: a TOML file, or a built-in name.")]
Out = Annotated[Path, typer.Option(metavar="FILE.csv", help="Where the measurements go.")]
Locks = Annotated[
    list[Lock],
    typer.Option(metavar="none|direction|leg|length", help="What is locked; give it twice for sets of two kinds."),
]
LockedLeg = Annotated[str | None, typer.Option(metavar="1…6|all", help="The locked leg, or (by default) each in turn.")]
NominalError = Annotated[
    str | None, typer.Option(metavar="LENGTH", help="How far each joint coordinate of the nominal is off, at most.")
]
OffsetError = Annotated[str | None, typer.Option(metavar="LENGTH", help="The same for the nominal's leg offsets.")]


def run(
    robot: Robot,
    out: Out,
    lock: Locks,
    leg: LockedLeg = None,
    poses: Annotated[int, typer.Option(min=1, metavar="N", help="Poses in a set.")] = 20,
    sets: Annotated[int, typer.Option(min=1, metavar="N", help="Sets for each lock and leg; calibrate takes one.")] = 1,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="The same seed gives the same files.")] = 0,
    position_noise: PositionNoise = None,
    angle_noise: AngleNoise = None,
    length_noise: LengthNoise = None,
    noise_kind: NoiseKind = "uniform",
    noise_angles: NoiseAngles = "ZXZ",
    nominal_error: NominalError = None,
    offset_error: OffsetError = None,
    orientation: Orientation = "quaternion",
    angle_unit: AngleUnit = None,
    force: Force = False,
) -> None:
    """Simulate and write."""
    truth = robot_of(robot)
    noise = noise_model(truth, noise_kind, noise_angles, position_noise, angle_noise, length_noise)
    robots = {_beside(out, "truth"): truth}
    if nominal_error is not None or offset_error is not None:
        robots[_beside(out, "nominal")] = _nominal(truth, nominal_error, offset_error, seed)
    checked(OrientationSettings, orientation=orientation, angle_unit=angle_unit)
    check_outputs([out, *robots], [robot], force)
    legs = [(kind, number) for kind in dict.fromkeys(lock) for number in _legs(kind, leg)]
    rng = np.random.default_rng(seed)
    data = [simulate(truth, kind, poses, sets, noise, leg=number, rng=rng) for kind, number in legs]
    write_measurements(data, out, orientation=orientation, angle_unit=angle_unit)
    for path, part in robots.items():
        part.to_toml(path)
    size = f"{_count(len(legs) * sets, 'set')} of {_count(poses, 'pose')}"
    print(f"wrote {out}: {size}, lengths in {truth.length_unit}, seed {seed}")
    print("\n".join(f"wrote {path}: {part.name}" for path, part in robots.items()))


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _beside(out: Path, what: str) -> Path:
    """The robot file that belongs to a CSV: run.csv, run.truth.toml."""
    if out.suffix.lower() != ".csv":
        raise InputError(f"--out: expected a name that ends in .csv, got {str(out)!r}")
    return out.with_suffix(f".{what}.toml")


def _nominal(truth: Hexapod, joints: str | None, offsets: str | None, seed: int) -> Hexapod:
    """The truth with errors, from a random stream of its own: the measurements stay the same."""
    unit = truth.length_unit
    return truth.perturbed(
        0.0 if joints is None else length("--nominal-error", joints, unit),
        offsets=0.0 if offsets is None else length("--offset-error", offsets, unit),
        rng=np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,))),
    )


def _legs(lock: Lock, leg: str | None) -> list[int] | list[None]:
    """The legs to lock in turn; [None] for unlocked poses."""
    if lock is Lock.NONE:
        if leg is not None:
            raise InputError(f"--leg: {leg!r} is named, but --lock none locks no leg; leave it out")
        return [None]
    if leg is None or leg == "all":
        return list(range(1, 7))
    if leg not in tuple("123456"):
        raise InputError(f"--leg: expected a number from 1 to 6, or all; got {leg!r}")
    return [int(leg)]
