"""Measurement sets from a CSV file."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..arrays import Array
from ..errors import InputError, LockError
from ..geometry import Hexapod, length_factor
from ..measurements import LegMeasurements, Lock, Measurements
from ..noise import Noise
from .columns import LEG, LENGTH, LENGTHS, LOCK, POSITION, SET, choose_columns
from .orientation import QUATERNION, OrientationKind
from .settings import ReaderSettings, checked
from .table import Table, brief, read_table

__all__ = ["MeasuredSet", "read_measurements", "rotations_of", "sets_of"]

FULL_TURN = {"deg": 360.0, "rad": 2 * np.pi}


def read_measurements(
    path: str | Path,
    *,
    length_unit: str,
    orientation: str = QUATERNION,
    angle_unit: Literal["deg", "rad"] | None = None,
    columns: Mapping[str, str] | None = None,
    nominal: Hexapod | None = None,
    noise: Noise | None = None,
) -> list[Measurements] | list[LegMeasurements]:
    """Read measurement sets from a CSV file: a header, and a row for each pose.

    Parameters
    ----------
    path : str or Path
    length_unit : str
        The unit of the positions in the file: m, dm, cm, mm, um, in, or "unstated".
    orientation : str, default "quaternion"
        How orientations (platform to base) are written: "quaternion", "matrix", "rotation_vector", or an
        Euler sequence as in SciPy, such as "ZXZ" (intrinsic) or "xyz" (extrinsic).
    angle_unit : {"deg", "rad"}, optional
        Needed where `orientation` has angles.
    columns : dict of str to str, optional
        The file's names by hexopt's: ``{"position_x": "X [mm]", "orientation_w": "q0"}``.
    nominal : Hexapod, optional
        Attached to the sets, whose lengths are converted to its unit. Readings are lengths, and
        converted too, if its reading unit is its length unit; otherwise they stay what the sensor says.
    noise : Noise, optional
        What is assumed of the errors, in the units that the sets have then.

    Returns
    -------
    list of Measurements or of LegMeasurements
        One a set, in the order of the file: with six readings a pose, or with the one of the measured leg,
        whose number the nominal keeps. Such a reading may be left empty over a whole set.

    Raises
    ------
    FileFormatError
        For the first fault in the file, in one line with its place and the remedy.
    InputError
        For settings that are wrong or do not fit each other.

    Notes
    -----
    The columns, in any order, by hexopt's names:

    - ``position_x``, ``_y``, ``_z``: the platform's position;
    - ``orientation_x``, ``_y``, ``_z``, ``_w``: a unit quaternion, w being the scalar; or ``orientation_11`` …
      ``orientation_33``: a matrix, by row and column; or ``orientation_x``, ``_y``, ``_z``: a rotation vector; or
      ``orientation_1``, ``_2``, ``_3``: the angles of an Euler sequence, in its order;
    - ``leg_length_1`` … ``leg_length_6``: the six readings; or ``leg_length``: that of the one measured leg;
    - ``set`` (optional): a label, the same for the poses of a set, which stand together; without it all are one set;
    - ``lock`` (optional): none, direction, leg or length;
    - ``leg`` (optional): the locked leg, 1…6, or empty; beside ``leg_length`` the measured one, which is then needed.

    Other columns are left alone. Fields are separated by commas, semicolons or tabs, decimals by points.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> sets = [hx.simulate(robot, "direction", n_poses=5, leg=k, rng=k) for k in (1, 2)]
    >>> with TemporaryDirectory() as folder:
    ...     path = hx.write_measurements(sets, f"{folder}/poses.csv")
    ...     first, second = hx.read_measurements(path, length_unit="cm", nominal=robot)
    >>> first.lock, second.locked_leg, bool((first.length == sets[0].length).all())
    (<Lock.DIRECTION: 'direction'>, 2, True)
    """
    settings = checked(
        ReaderSettings,
        length_unit=length_unit,
        orientation=orientation,
        angle_unit=angle_unit,
        columns={} if columns is None else columns,
        nominal=nominal,
        noise=noise,
    )
    table = choose_columns(read_table(Path(path)), settings.kind, settings.columns)
    return _measurements(table, settings)


def _measurements(table: Table, settings: ReaderSettings) -> list[Measurements] | list[LegMeasurements]:
    robot, noise = settings.nominal, settings.noise
    unit = settings.length_unit if robot is None else robot.length_unit
    factor = length_factor(settings.length_unit, unit)
    reading_factor = factor if robot is not None and robot.reading_unit == robot.length_unit else 1.0
    parts = list(sets_of(table))
    position = table.numbers(POSITION) * factor
    rotation = rotations_of(table, settings.kind, settings.angle_unit)
    sets = [(part, position[part.slice], rotation[part.slice]) for part in parts]
    if LENGTH not in table:
        length = table.numbers(LENGTHS) * reading_factor
        return [Measurements(p, r, length[part.slice], part.lock, part.leg, noise, robot, unit) for part, p, r in sets]
    if robot is None:
        raise InputError(f"nominal: {table.path} has the readings of single legs; give nominal=, the robot they are of")
    return [
        LegMeasurements(
            p,
            r,
            _readings(table, part.rows, reading_factor),
            part.lock,
            None if noise is None else noise.for_leg(part.number),
            robot.leg(part.number),
        )
        for part, p, r in sets
    ]


def _readings(table: Table, rows: range, factor: float) -> Array | None:
    """The readings of one leg over a set; None where all are left empty."""
    if not any(table.cell(row, LENGTH) for row in rows):
        return None
    return table.numbers([LENGTH], rows)[:, 0] * factor


def rotations_of(table: Table, kind: OrientationKind, angle_unit: str | None) -> Array:
    """Rotation matrices of all rows."""
    values = table.numbers(kind.columns)
    if angle_unit is not None:
        beyond = np.argwhere(np.abs(values) > FULL_TURN[angle_unit])
        if len(beyond):
            row, column = (int(i) for i in beyond[0])
            fault = f"an angle of {values[row, column]:g} {angle_unit} is more than a turn; is the unit wrong?"
            raise table.error(fault, row, kind.columns[column])
        values = np.deg2rad(values) if angle_unit == "deg" else values
    try:
        return kind.to_matrix(values)
    except InputError:
        row, message = _first_fault(kind, values)
        raise table.error(message, row) from None


def _first_fault(kind: OrientationKind, values: Array) -> tuple[int, str]:
    """The first row that is no rotation, and why."""
    for row, value in enumerate(values):
        try:
            kind.to_matrix(value)
        except InputError as error:
            return row, str(error)
    raise AssertionError("rows that fail together fail one by one")


# --- sets -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class MeasuredSet:
    """Neighbouring rows that were measured under one lock."""

    rows: range
    lock: Lock
    leg: int | None

    @property
    def number(self) -> int:
        """The leg, of a set that has one."""
        assert self.leg is not None
        return self.leg

    @property
    def slice(self) -> slice:
        """Its place in arrays of all rows."""
        return slice(self.rows.start, self.rows.stop)


def sets_of(table: Table) -> Iterator[MeasuredSet]:
    """The sets in the order of the file."""
    starts: dict[str, int] = {}
    previous = None
    for row in range(len(table.rows)):
        label = table.cell(row, SET)
        if not label and SET in table:
            raise table.error("the label is missing; expected that of the row's set, such as 1", row, SET)
        if label in starts and label != previous:
            fault = (
                f"the set {brief(label)}, begun in line {table.lines[starts[label]]}, had ended; the poses of a set "
                "stand together: sort the rows, or give these another label"
            )
            raise table.error(fault, row, SET)
        starts.setdefault(label, row)
        previous = label
    ends = [*starts.values(), len(table.rows)][1:]
    for start, end in zip(starts.values(), ends, strict=True):
        yield _one_set(table, range(start, end))


def _one_set(table: Table, rows: range) -> MeasuredSet:
    first = rows.start
    lock, leg = _lock(table, first), _leg(table, first)
    for name in (LOCK, LEG):
        for row in rows:
            if table.cell(row, name) != table.cell(first, name):
                fault = (
                    f"got {brief(table.cell(row, name))}, but the set began with {brief(table.cell(first, name))} in "
                    f"line {table.lines[first]}; a set has one lock and one leg: give this row another label in {SET!r}"
                )
                raise table.error(fault, row, name)
    if LENGTH in table:
        if leg is None:
            raise table.error(f"which leg was measured? Beside {LENGTH!r}, {LEG!r} has to say it, 1…6", first)
    elif lock is Lock.NONE and leg is not None:
        raise table.error(f"leg {leg} is named, but no lock; say which in {LOCK!r}, or leave {LEG!r} empty", first)
    elif lock is not Lock.NONE and leg is None:
        raise table.error(f"the lock is {str(lock)!r}, but of which leg? Say it in {LEG!r}, 1…6", first)
    return MeasuredSet(rows, lock, leg)


def _lock(table: Table, row: int) -> Lock:
    if LOCK not in table:
        return Lock.NONE
    text = table.cell(row, LOCK)
    try:
        return Lock.of(text)
    except LockError:
        raise table.error(f"got {brief(text)}, expected one of {', '.join(Lock)}", row, LOCK) from None


def _leg(table: Table, row: int) -> int | None:
    text = table.cell(row, LEG)
    if not text:
        return None
    if not re.fullmatch(r"[1-6](\.0*)?", text):  # a table program may write 3.0
        raise table.error(f"got {brief(text)}, expected a leg number from 1 to 6, or nothing", row, LEG)
    return int(text[0])
