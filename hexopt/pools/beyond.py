"""Whether poses can be a robot's at all: a wrong length unit or another robot shows in its limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..geometry import Hexapod, Limits
from ..kinematics import limit_violations

__all__ = ["far_beyond"]

#: By so much a limit may be passed: the nominal is off, and what was measured need not respect limits closely.
FACTOR = 1.2


def far_beyond(robot: Hexapod, position: Array, rotation: Array) -> str:
    """In words, which limits of the robot most of the poses (n, 3), (n, 3, 3) pass by more than a fifth, if any."""
    violated = limit_violations(replace(robot, limits=_wider(robot.limits)), position, rotation)
    bad = np.logical_or.reduce([np.zeros(len(position), dtype=bool), *violated.values()])
    if bad.mean() <= 0.5:
        return ""
    counts = ", ".join(f"{name}: {int(mask.sum())}" for name, mask in violated.items() if mask.any())
    limits = robot.limits.describe(robot.length_unit)
    return f"{int(bad.sum())} of {len(bad)} poses are far beyond the limits of {robot.name} ({counts}; {limits})"


def _wider(limits: Limits) -> Limits:
    new: dict[str, Any] = {}
    for name in ("leg_tilt", "base_tilt", "tilt", "angles"):
        value = getattr(limits, name)
        if value is not None:
            new[name] = np.minimum(np.multiply(value, FACTOR), np.pi)
    if limits.leg_length is not None:
        low, high = limits.leg_length
        new["leg_length"] = low / FACTOR, high * FACTOR
    if limits.position is not None:
        new["position"] = tuple(FACTOR * half for half in limits.position)
    return replace(limits, **new)
