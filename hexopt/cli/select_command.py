"""``hexopt select``: which poses to measure, as a list for the controller and a report for people."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from ..errors import InputError
from ..files import write_whole
from ..measurements import Lock
from ..readers import write_measurements
from .chosen import choose, count, report_on, summary
from .limits import narrowed
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
    robot_of,
)
from .planning import (
    Plan,
    clamp_given,
    criterion_of,
    noise_of,
    parameters_of,
    reading_of,
    scenarios,
    source_of,
)

__all__ = ["HELP", "NAME", "run"]

NAME = "select"
HELP = """Choose the poses to measure, and say how well they will calibrate the robot.

Of many candidates that all six legs can reach, those poses are chosen that make the predicted errors small, with a
bound that says how far from the best they can be. They are written as a CSV file for the controller.

\b
  hexopt select left-hand --lock direction --leg 3 --poses 7 --out leg3.csv \\
      --position-noise 0.01cm --angle-noise 0.01deg --length-noise 0.01cm \\
      --report report.html
  hexopt select left-hand --lock leg --poses 8 --out poses.csv \\
      --position-noise 0.01cm --angle-noise 0.01deg --tilt 20deg
  hexopt select jugglebot --lock none --poses 15 --out poses.csv \\
      --position-noise 0.3mm --angle-noise 0.05deg --length-noise 0.002rev

\b
  --lock       poses determine               then calibrate by
  direction    both joints of the leg        --method one-step --weighted
  leg          its platform joint            --method three-step --weighted,
  length       its base joint                  with poses for both of these
  none         all legs: both joints, and    --method free or joint
               offset, gain (--model)

The promised errors are reached by --method joint, after the lock direction with --model 36.

With --leg all, each leg in turn has its own clamp and its own set of poses; unlocked poses serve all legs at once. The
candidates of a set share one clamp: that of the leg at home, or --given, or that of the poses --measured so far.

Poses stand in the order of a short way: from home to the nearest, then always on to the nearest that is left, by the
change of the six leg lengths. The readings in the file are what the sensors of this robot would say there; overwrite
them with what you measure, and the file is ready for hexopt calibrate.
"""

Robot = Annotated[str, typer.Argument(metavar="ROBOT", help="The nominal: a TOML file or a built-in name.")]
LockOption = Annotated[
    Lock, typer.Option(metavar="none|direction|leg|length", help="How the leg is held while a set is measured.")
]
Poses = Annotated[int, typer.Option(min=1, metavar="N", help="How many poses to choose, for each leg that is locked.")]
Out = Annotated[Path, typer.Option(metavar="FILE.csv", help="Where the chosen poses go.")]
Leg = Annotated[str, typer.Option(metavar="1…6|all", help="The leg to calibrate, or all.")]
CriterionName = Annotated[
    Literal["A", "D", "E", "G", "kappa", "O1", "O2", "O3", "O4", "O5"],
    typer.Option(
        help="What to make small: A, the sum of variances; D, the volume of the confidence region; E, the largest "
        "variance of any combination; G, the worst error of a leg length in the workspace; the others for comparison."
    ),
]
Model = Annotated[Literal["36", "42", "48"] | None, typer.Option(help="Parameters of unlocked poses; by default 42.")]
Candidates = Annotated[
    str, typer.Option(metavar="N|FILE.csv", help="So many random candidates, or your own list of poses.")
]
Drop = Annotated[
    bool, typer.Option("--drop", help="Leave out listed poses that cannot be candidates, and say how many and why.")
]
Given = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z|LENGTH",
        help="What the clamp holds: a direction such as 0.1,-0.2,1; for the lock leg the place of the platform joint, "
        "12cm,3cm,20cm; for the lock length the true length.",
    ),
]
Measured = Annotated[
    Path | None, typer.Option(metavar="FILE.csv", help="Poses measured on this clamp so far: choose the N next ones.")
]
LegLimit = Annotated[str | None, typer.Option(metavar="LOW,HIGH", help="Stricter limits of all legs: 17cm,20cm.")]
Tilt = Annotated[str | None, typer.Option(metavar="ANGLE", help="Stricter limit of the platform's tilt.")]
LegTilt = Annotated[str | None, typer.Option(metavar="ANGLE", help="The same of a leg from its direction at home.")]
BaseTilt = Annotated[str | None, typer.Option(metavar="ANGLE", help="The same of a leg from the base's normal.")]
NominalError = Annotated[
    str | None,
    typer.Option(
        metavar="LENGTH", help="How far joint coordinates may be off: poses are chosen that are good for 8 such robots."
    ),
]
Worst = Annotated[bool, typer.Option("--worst", help="Good for the worst of these robots, not on average.")]
Repeat = Annotated[bool, typer.Option("--repeat", help="A pose may be measured more than once.")]
Prove = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Search so long for the best poses of all, and prove it (for each set)."),
]
Refine = Annotated[bool, typer.Option("--refine", help="Then move the chosen poses inside the limits.")]
Report = Annotated[Path | None, typer.Option(metavar="FILE.html", help="A report with tables and pictures.")]
Seed = Annotated[int, typer.Option(min=0, metavar="N", help="The same seed gives the same files.")]
LengthUnit = Annotated[str | None, typer.Option(metavar="UNIT", help="The unit of the lengths in the CSV files read.")]


def run(
    robot: Robot,
    lock: LockOption,
    poses: Poses,
    out: Out,
    leg: Leg = "all",
    criterion: CriterionName = "A",
    model: Model = None,
    position_noise: PositionNoise = None,
    angle_noise: AngleNoise = None,
    length_noise: LengthNoise = None,
    noise_kind: NoiseKind = "uniform",
    noise_angles: NoiseAngles = "ZXZ",
    candidates: Candidates = "1000",
    drop: Drop = False,
    given: Given = None,
    measured: Measured = None,
    leg_length: LegLimit = None,
    tilt: Tilt = None,
    leg_tilt: LegTilt = None,
    base_tilt: BaseTilt = None,
    nominal_error: NominalError = None,
    worst: Worst = False,
    repeat: Repeat = False,
    prove: Prove = None,
    refine: Refine = False,
    report: Report = None,
    seed: Seed = 0,
    length_unit: LengthUnit = None,
    orientation: Orientation = "quaternion",
    angle_unit: AngleUnit = None,
    column: Columns = None,
    force: Force = False,
) -> None:
    """Choose, write, report."""
    own = robot_of(robot)
    nominal = narrowed(own, leg_length, leg_tilt=leg_tilt, base_tilt=base_tilt, tilt=tilt)
    legs = _legs(leg, lock)
    noise = noise_of(nominal, lock, (noise_kind, noise_angles, position_noise, angle_noise, length_noise))
    unknown, source = parameters_of(lock, model), source_of(candidates)
    if given is not None and len(legs) > 1:
        raise InputError("--given: a clamp is that of one leg; name it by --leg")
    clamp_given(nominal, lock, given)
    if given is not None and measured is not None:
        raise InputError("--given: the clamp is that of the poses --measured; leave one of the two out")
    read = [path for path in (source, measured) if isinstance(path, Path)]
    reading = reading_of(read, length_unit, orientation, angle_unit, column)
    if drop and not isinstance(source, Path):
        raise InputError("--drop: random candidates are all within the limits; leave it out")
    if worst and nominal_error is None:
        raise InputError("--worst: of which robots? Give --nominal-error, how far the nominal may be off")
    _check_names(out, report)
    check_outputs([path for path in (out, report) if path is not None], [robot, *read], force)
    plan = Plan(nominal, own.limits, lock, unknown, noise, source, given, measured, reading, drop, seed)
    ask = {
        "criterion": criterion_of(criterion, nominal, seed),
        "at": scenarios(nominal, nominal_error, seed),
        "worst": worst,
        "repeat": repeat,
        "prove": prove,
    }
    chosen = [choose(plan, number, poses, ask, refine, several=len(legs) > 1) for number in legs]
    page = None if report is None else report_on(plan, chosen, nominal_error, worst, repeat)
    print(summary(plan, chosen, criterion))
    data = [one.measurements(nominal) for one in chosen]
    write_measurements(data, out, orientation=orientation, angle_unit=angle_unit)
    size = f"{count(len(data), 'set')} of {count(poses, 'pose')}"
    print(f"wrote {out}: {size}, lengths in {nominal.length_unit}, seed {seed}")
    if report is not None and page is not None:
        print(f"wrote {write_whole(report, page)}")


def _legs(leg: str, lock: Lock) -> list[int] | list[None]:
    """The legs to choose poses for in turn; [None] for all at once."""
    if leg == "all":
        return [None] if lock is Lock.NONE else list(range(1, 7))
    if leg not in tuple("123456"):
        raise InputError(f"--leg: expected a number from 1 to 6, or all; got {leg!r}")
    return [int(leg)]


def _check_names(out: Path, report: Path | None) -> None:
    for flag, path, suffix in (("--out", out, ".csv"), ("--report", report, ".html")):
        if path is not None and path.suffix.lower() != suffix:
            raise InputError(f"{flag}: expected a name that ends in {suffix}, got {str(path)!r}")
