"""Limits that flags make stricter."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry import Hexapod
from .options import angle, length, several

__all__ = ["narrowed"]

_TILTS = {"leg_tilt": "--leg-tilt", "base_tilt": "--base-tilt", "tilt": "--tilt"}


def narrowed(robot: Hexapod, leg_length: str | None, **tilts: str | None) -> Hexapod:
    """The robot with limits that the flags make stricter."""
    limits = robot.limits
    new: dict[str, Any] = {}
    if leg_length is not None:
        flag = "--leg-length"
        example = f"17{robot.length_unit},20{robot.length_unit}"
        low, high = (length(flag, part, robot.length_unit) for part in several(flag, leg_length, 2, example))
        least, most = limits.leg_length or (0.0, np.inf)
        if not 0 < low < high:
            raise InputError(f"{flag}: expected 0 < shortest < longest, e.g. {example}; got {leg_length!r}")
        if low < least or high > most:
            raise InputError(f"{flag}: {leg_length!r} goes beyond {_own(robot)}; flags narrow limits only")
        new["leg_length"] = low, high
    for name, text in tilts.items():
        if text is None:
            continue
        value, most = angle(_TILTS[name], text, "20deg"), getattr(limits, name)
        if not 0 < value <= np.pi:
            raise InputError(f"{_TILTS[name]}: expected an angle in (0deg, 180deg], got {text!r}")
        if most is not None and value > most * (1 + 1e-12):
            raise InputError(f"{_TILTS[name]}: {text!r} goes beyond {_own(robot)}; flags narrow limits only")
        new[name] = value
    return replace(robot, limits=replace(limits, **new)) if new else robot


def _own(robot: Hexapod) -> str:
    return f"the limits of {robot.name} ({robot.limits.describe(robot.length_unit)})"
