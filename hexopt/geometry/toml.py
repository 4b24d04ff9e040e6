"""Robots as TOML files: every number survives the round trip, every mistake has a line of its own."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from ..errors import FileFormatError, HexoptError, InputError
from ..files import write_whole
from .limits import Limits, PoseRanges

__all__ = ["read_fields", "write_fields"]

_REQUIRED = ("name", "length_unit", "base_points", "platform_points")
_OPTIONAL = ("reading_unit", "offsets", "gains", "home_position", "home_rotation")


def read_fields(path: Path) -> dict[str, Any]:
    """The fields of a robot from `path`.

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
            settings["limits"] = _table("limits", Limits, data["limits"])
        if "ranges" in data:
            settings["ranges"] = _table("ranges", PoseRanges, data["ranges"])
    except HexoptError as error:
        raise FileFormatError(f"{path}: {error}") from None
    return settings


def _table(name: str, kind: type[Limits] | type[PoseRanges], table: dict[str, Any]) -> Any:
    known = {item.name for item in fields(kind)}
    if not isinstance(table, dict) or set(table) - known:
        raise InputError(f"[{name}]: expected a table with {', '.join(sorted(known))}")
    try:
        settings: dict[str, Any] = {
            key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
        }
        return kind(**settings)
    except TypeError as error:
        raise InputError(f"[{name}]: {error}") from None


def write_fields(path: Path, values: Mapping[str, Any]) -> Path:
    """Write the fields of a robot to `path`, whole or not at all."""
    document = {name: _plain(values[name]) for name in (*_REQUIRED, *_OPTIONAL, "limits", "ranges")}
    return write_whole(path, tomli_w.dumps(document))


def _plain(value: Any) -> Any:
    """Arrays and tuples as lists; a record as a table of the fields that are not None."""
    if is_dataclass(value):
        items = {item.name: getattr(value, item.name) for item in fields(value)}
        return {name: _plain(item) for name, item in items.items() if item is not None}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value
