"""``hexopt calibrate``: a robot and its measurements become a calibrated robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from ..calibration import FreePoses, Joint, Method, OneStep, ThreeStep, calibrate
from ..errors import InputError, LockError
from ..estimators.inverse_kinematics import InverseKinematics
from ..estimators.least_squares import LeastSquares
from ..estimators.maximum_likelihood import MaximumLikelihood
from ..files import write_whole
from ..measurements import LegMeasurements, Lock, Measurements
from ..noise import Noise
from ..readers import read_measurements
from ..result import Estimator
from .comparison import comparison
from .options import (
    AngleNoise,
    AngleUnit,
    Columns,
    Force,
    LengthNoise,
    NoiseAngles,
    NoiseKind,
    Orientation,
    PositionNoise,
    check_outputs,
    column_names,
    noise_model,
    robot_of,
)

__all__ = ["HELP", "NAME", "run"]

NAME = "calibrate"
HELP = """Calibrate a robot from measured poses and leg readings.

ROBOT is the nominal. DATA are CSV files with a row a pose: position_x…z, orientation_x…w (or as --orientation says),
leg_length_1…6 and, where legs were locked, set (a label), leg (the locked one) and lock.

\b
  hexopt calibrate nominal.toml poses.csv --method free --model 48 \\
      --length-unit mm --out found.toml
  hexopt calibrate nominal.toml run.csv --method one-step --length-unit cm \\
      --position-noise 0.01cm --angle-noise 0.01deg --length-noise 0.01cm
  hexopt calibrate nominal.toml run.csv --method three-step --length-unit cm \\
      --orientation ZXZ --angle-unit deg --column position_x=X

\b
  --method     needs, for each leg to calibrate   finds
  one-step     a set locked in direction          both joints (model 36)
  three-step   a set with the leg locked, and     both joints, offset (42)
               one with its length locked
  free         a set of unlocked poses            both joints (36), offset
                                                  (42) and gain (48)
  joint        any sets; all legs and readings    the same, by maximum
               at once, and the noise flags       likelihood

Legs without a set keep their nominal. Standard errors come from the noise flags, else from the residuals, where these
can tell. Readings are in the CSV's length unit where the robot's reading_unit is its length_unit; otherwise they are
what the sensor says.
"""

Data = list[Measurements | LegMeasurements]
MethodName = Literal["one-step", "three-step", "free", "joint"]

Robot = Annotated[str, typer.Argument(metavar="ROBOT", help="The nominal: a TOML file or a built-in name.")]
Files = Annotated[list[Path], typer.Argument(metavar="DATA", help="CSV files of measurements.")]
LengthUnit = Annotated[
    str, typer.Option(metavar="UNIT", help="The unit of the lengths in the CSV: m, dm, cm, mm, um, in.")
]
Model = Annotated[
    Literal["36", "42", "48"] | None,
    typer.Option(help="How many parameters, for --method free and joint; by default 42."),
]
Form = Annotated[
    Literal["consecutive", "direct", "centred"] | None,
    typer.Option(help="How the linear equations are formed; by default consecutive, as in the paper."),
]
Weighted = Annotated[bool, typer.Option("--weighted", help="Weigh the equations by the noise that the flags state.")]
Out = Annotated[Path | None, typer.Option(metavar="FILE.toml", help="Where the calibrated robot goes.")]
Report = Annotated[Path | None, typer.Option(metavar="FILE", help="Where the printed summary goes too.")]


def run(
    robot: Robot,
    data: Files,
    method: Annotated[MethodName, typer.Option(help="What to solve; see above.")],
    length_unit: LengthUnit,
    model: Model = None,
    form: Form = None,
    weighted: Weighted = False,
    orientation: Orientation = "quaternion",
    angle_unit: AngleUnit = None,
    column: Columns = None,
    position_noise: PositionNoise = None,
    angle_noise: AngleNoise = None,
    length_noise: LengthNoise = None,
    noise_kind: NoiseKind = "uniform",
    noise_angles: NoiseAngles = "ZXZ",
    out: Out = None,
    report: Report = None,
    force: Force = False,
) -> None:
    """Read, calibrate, write."""
    nominal = robot_of(robot)
    noise = noise_model(nominal, noise_kind, noise_angles, position_noise, angle_noise, length_noise)
    steps, estimator = _method(method, model, form), _estimator(method, weighted, noise)
    check_outputs([path for path in (out, report) if path is not None], [robot, *data], force)
    settings: dict[str, Any] = {"length_unit": length_unit, "orientation": orientation, "angle_unit": angle_unit}
    settings |= {"columns": column_names(column or []), "nominal": nominal, "noise": noise}
    sets = [part for path in data for part in read_measurements(path, **settings)]
    _check_locks(sets, steps, method)
    found = calibrate(nominal, sets, steps, estimator)
    text = f"{found.summary()}\n{comparison(found, sets)}"
    print(text)
    if report is not None:
        print(f"wrote {write_whole(report, text + chr(10))}")
    print(f"wrote {found.robot.to_toml(out)}" if out else "nothing written: --out FILE.toml keeps the calibrated robot")


def _method(name: str, model: str | None, form: str | None) -> Method | Joint:
    """The method that the flags describe; a flag that it has no use for is an error."""
    if name in ("free", "joint"):
        if form is not None:
            raise InputError(f"--form: --method {name} has no linear equations; leave it out")
        return (FreePoses if name == "free" else Joint)(int(model or 42))  # type: ignore[arg-type]  # one of the three
    fixed = "36" if name == "one-step" else "42"
    if model not in (None, fixed):
        raise InputError(f"--model: --method {name} has the {fixed} parameters of its model, got {model}; leave it out")
    if name == "three-step":
        return ThreeStep(form or "consecutive")  # type: ignore[arg-type]  # one of the three
    if form == "centred":
        raise InputError("--form: --method one-step has consecutive and direct, got centred")
    return OneStep(form or "consecutive")  # type: ignore[arg-type]  # one of the two


def _estimator(method: str, weighted: bool, noise: Noise | None) -> Estimator:
    if method == "joint":
        if weighted:
            raise InputError("--weighted: --method joint always weighs by the noise; leave it out")
        if noise is None or not all(vars(noise).get(name, 1) for name in ("position", "angle", "length")):
            raise InputError(
                "--method joint weighs by the noise: give --position-noise, --angle-noise and --length-noise, all > 0"
            )
        return MaximumLikelihood()
    if weighted and noise is None:
        raise InputError("--weighted: by which noise? Give --position-noise, --angle-noise and --length-noise")
    weights: Literal["model"] | None = "model" if weighted else None
    return InverseKinematics(weights=weights) if method == "free" else LeastSquares(weights=weights)


def _check_locks(sets: Data, method: Method | Joint, name: str) -> None:
    """The method must have a use for every set."""
    found = list(dict.fromkeys(data.lock for data in sets))
    if isinstance(method, Joint) or set(found) <= set(method.locks):
        return
    fitting = {"one-step": OneStep.locks, "three-step": ThreeStep.locks, "free": FreePoses.locks}
    others = [other for other, locks in fitting.items() if set(found) <= set(locks)]
    advice = f"use --method {others[0]}" if others else "give each method files of its own, or use --method joint"
    raise LockError(
        f"--method {name} takes sets with the lock {_words(method.locks)}, the data has {_words(found)}; {advice}"
    )


def _words(locks: list[Lock] | tuple[Lock, ...]) -> str:
    return " and ".join(str(lock) for lock in locks)
