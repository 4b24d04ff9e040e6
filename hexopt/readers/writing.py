"""Measurement sets to a CSV file."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import InputError, UnitError
from ..files import write_whole
from ..measurements import LegMeasurements, Lock, Measurements
from .columns import LEG, LENGTH, LENGTHS, LOCK, POSITION, SET
from .orientation import QUATERNION
from .settings import OrientationSettings, checked

__all__ = ["write_measurements"]

Data = Measurements | LegMeasurements


def write_measurements(
    measurements: Data | Sequence[Data],
    path: str | Path,
    *,
    orientation: str = QUATERNION,
    angle_unit: Literal["deg", "rad"] | None = None,
) -> Path:
    """Write measurement sets to a CSV file, whole or not at all; :func:`read_measurements` lists its columns.

    Parameters
    ----------
    measurements : Measurements, LegMeasurements, or a list of one of them
        In one length unit, which the file does not name: keep it for the reader. A batch gives one set a member.
    path : str or Path
        Replaced if it exists.
    orientation, angle_unit : str
        As in :func:`read_measurements`. Positions and readings survive the round trip to the bit, and so
        do orientations as "matrix"; in the other ways they survive to rounding.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is nothing to write, the sets are of both kinds, or the path cannot be written to.
    UnitError
        If the sets have different length units.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), leg=3, lock="leg", n_poses=5, rng=0)
    >>> with TemporaryDirectory() as folder:
    ...     path = hx.write_measurements(data, f"{folder}/poses.csv", orientation="ZXZ", angle_unit="deg")
    ...     print(path.read_text().splitlines()[0])
    set,leg,lock,leg_length,position_x,position_y,position_z,orientation_1,orientation_2,orientation_3
    """
    settings = checked(OrientationSettings, orientation=orientation, angle_unit=angle_unit)
    sets = [part for data in _listed(measurements) for part in _members(data)]
    if not sum(data.n_poses for data in sets):
        raise InputError("measurements: there are no poses to write")
    lengths = LENGTHS if isinstance(sets[0], Measurements) else (LENGTH,)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([SET, LEG, LOCK, *lengths, *POSITION, *settings.kind.columns])
    for label, data in enumerate(sets, start=1):
        angles = settings.kind.from_matrix(data.rotation)
        turned = np.rad2deg(angles) if settings.angle_unit == "deg" else angles
        first = [label, _leg(data), str(data.lock)]
        values = np.concatenate([data.position, turned], axis=-1).tolist()
        writer.writerows([*first, *reading, *rest] for reading, rest in zip(_readings(data), values, strict=True))
    return write_whole(path, text.getvalue())


def _listed(measurements: Data | Sequence[Data]) -> list[Data]:
    sets = [measurements] if isinstance(measurements, (Measurements, LegMeasurements)) else list(measurements)
    for data in sets:
        if not isinstance(data, (Measurements, LegMeasurements)):
            raise InputError(f"measurements: expected Measurements or LegMeasurements, got {type(data).__name__}")
    if len({type(data) for data in sets}) > 1:
        raise InputError("measurements: a file has six readings a pose or one, not both; write two files")
    units = sorted({data.length_unit for data in sets})
    if len(units) > 1:
        raise UnitError(f"measurements: the sets are in {' and '.join(units)}; a file has one length unit")
    return sets


def _members(data: Data) -> Iterator[Data]:
    """The single sets of a batch."""
    if not data.batch_shape:
        yield data
    else:
        for index in np.ndindex(data.batch_shape):
            yield data[index]


def _leg(data: Data) -> int | None:
    if isinstance(data, LegMeasurements):
        return data.leg
    return None if data.lock is Lock.NONE else data.locked_leg


def _readings(data: Data) -> Sequence[Sequence[float | None]]:
    if data.length is None:
        return [[None]] * data.n_poses
    readings: list[list[float]] = data.length.reshape(data.n_poses, -1).tolist()
    return readings
