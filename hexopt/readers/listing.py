"""Lists of poses from a CSV file, whether or not anything was read there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..arrays import Array
from ..geometry import Hexapod, length_factor
from ..measurements import Lock
from .columns import LOCK, POSITION, choose_columns
from .reading import rotations_of, sets_of
from .settings import ReaderSettings, checked
from .table import read_table

__all__ = ["PoseList", "read_poses"]


@dataclass(frozen=True, eq=False)
class PoseList:
    """Poses that stand together in a file.

    Attributes
    ----------
    position, rotation : ndarray, shape (n, 3) and (n, 3, 3)
        In the robot's length unit.
    lock : Lock or None
        None where the file does not say.
    leg : int or None
        The locked leg.
    lines : tuple of int
        Of each pose in the file.
    """

    position: Array
    rotation: Array
    lock: Lock | None
    leg: int | None
    lines: tuple[int, ...]


def read_poses(path: str | Path, robot: Hexapod, **settings: Any) -> list[PoseList]:
    """Read poses as :func:`~hexopt.read_measurements` does, from a file that needs no readings.

    Parameters
    ----------
    path : str or Path
    robot : Hexapod
        Gives the length unit of what is returned.
    **settings
        ``length_unit``, and where needed ``orientation``, ``angle_unit`` and ``columns``, as there.

    Raises
    ------
    FileFormatError, InputError
        As there.
    """
    how = checked(ReaderSettings, **{"columns": {}, "nominal": robot, "noise": None, **settings})
    table = choose_columns(read_table(Path(path)), how.kind, how.columns, readings=False)
    position = table.numbers(POSITION) * length_factor(how.length_unit, robot.length_unit)
    rotation = rotations_of(table, how.kind, how.angle_unit)
    return [
        PoseList(
            position[part.slice],
            rotation[part.slice],
            part.lock if LOCK in table else None,
            part.leg,
            tuple(table.lines[part.slice]),
        )
        for part in sets_of(table)
    ]
