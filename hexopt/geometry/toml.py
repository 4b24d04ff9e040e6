"""Robots as TOML files: every number survives the round trip, every mistake has a line of its own."""

from __future__ import annotations

import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import tomli_w

from ..errors import FileFormatError, HexoptError, InputError
from ..files import write_whole
from .limits import Limits, PoseRanges
from .robot import Hexapod

__all__ = ["read_robot", "write_robot"]

_REQUIRED = ("name", "length_unit", "base_points", "platform_points")
_OPTIONAL = ("reading_unit", "offsets", "gains", "home_position", "home_rotation")


def read_robot(path: Path) -> Hexapod:
    """A :class:`Hexapod` from `path`.

    Keys: name, length_unit, base_points and platform_points (six rows of three); optional offsets,
    gains, reading_unit, home_position, home_rotation, and tables [limits] and [ranges] with the fields
    of :class:`Limits` and :class:`PoseRanges` (angles in radians).

    Raises
    ------
    FileFormatError
        If the file cannot be read, is no TOML, misses a key, or has a wrong or unknown one.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: is not a TOML file ({error})") from None
    missing = [key for key in _REQUIRED if key not in data]
    if missing:
        raise FileFormatError(f"{path}: misses {', '.join(missing)}; a robot file needs {', '.join(_REQUIRED)}")
    unknown = set(data) - {*_REQUIRED, *_OPTIONAL, "limits", "ranges"}
    if unknown:
        raise FileFormatError(
            f"{path}: unknown key(s) {', '.join(sorted(unknown))}; "
            f"known are {', '.join((*_REQUIRED, *_OPTIONAL, 'limits', 'ranges'))}"
        )
    try:
        settings = {key: data[key] for key in (*_REQUIRED, *_OPTIONAL) if key in data}
        if "limits" in data:
            settings["limits"] = _table(Limits, data["limits"])
        if "ranges" in data:
            settings["ranges"] = _table(PoseRanges, data["ranges"])
        return Hexapod(**settings)
    except HexoptError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _table(kind: type[Limits] | type[PoseRanges], table: dict[str, Any]) -> Any:
    known = {item.name for item in fields(kind)}
    if not isinstance(table, dict) or set(table) - known:
        raise InputError(f"[{kind.__name__.lower()}]: expected a table with {', '.join(sorted(known))}")
    try:
        settings: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
        }
        return kind(**settings)
    except TypeError as error:
        raise InputError(f"[{kind.__name__.lower()}]: {error}") from None


def _plain(record: object) -> dict[str, Any]:
    """The fields of a dataclass that are not None, tuples as lists."""
    values = {item.name: getattr(record, item.name) for item in fields(record)}  # type: ignore[arg-type]
    return {
        key: list(value) if isinstance(value, tuple) else value for key, value in values.items() if value is not None
    }


def write_robot(robot: Hexapod, path: Path) -> Path:
    """Write `robot` to `path`, whole or not at all."""
    document: dict[str, Any] = {
        "name": robot.name,
        "length_unit": robot.length_unit,
        "reading_unit": robot.reading_unit,
        "base_points": robot.base_points.tolist(),
        "platform_points": robot.platform_points.tolist(),
        "offsets": robot.offsets.tolist(),
        "gains": robot.gains.tolist(),
        "home_position": robot.home_position.tolist(),
        "home_rotation": robot.home_rotation.tolist(),
        "limits": _plain(robot.limits),
        "ranges": _plain(robot.ranges),
    }
    return write_whole(path, tomli_w.dumps(document))
