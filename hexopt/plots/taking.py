"""The poses behind an argument: measurements or a design, in the robot's unit, and which of them are chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, brief
from ..errors import InputError
from ..geometry import Hexapod
from ..geometry.leg import check_leg_number
from ..geometry.units import length_factor
from ..measurements import LegMeasurements, Lock, Measurements
from ..selection.design import Design
from ..simulation import check_robot

__all__ = ["Shown", "shown"]


@dataclass(frozen=True)
class Shown:
    """Poses (n, 3), (n, 3, 3), the locked leg of each, which are chosen, and what the poses are called."""

    position: Array
    rotation: Array
    legs: tuple[int | None, ...]
    chosen: npt.NDArray[np.intp]
    names: tuple[str, ...]

    @property
    def leg(self) -> int | None:
        """The leg that is locked in all of them."""
        return self.legs[0] if len(set(self.legs)) == 1 else None


def shown(robot: Hexapod, poses: object, chosen: Any, leg: int | None) -> Shown:
    """What is to be drawn, checked."""
    check_robot(robot)
    if isinstance(poses, Design) and poses.poses is None:
        raise InputError("poses: this design was made of bare information and has no poses; give the candidates too")
    sets = poses.poses if isinstance(poses, Design) else poses
    sets = sets if isinstance(poses, Design) and isinstance(sets, tuple) else (sets,)
    for data in sets:
        if not isinstance(data, (LegMeasurements, Measurements)):
            raise InputError(f"poses: expected LegMeasurements, Measurements or a Design, got {brief(poses)}")
        if data.batch_shape:
            raise InputError(f"poses: expected one set, got a batch of {data.batch_shape}; take one, such as data[0]")
    held = None if leg is None else check_leg_number(leg)
    legs = [_locked(data) if held is None else held for data in sets for _ in range(data.n_poses)]
    return Shown(
        np.concatenate([data.position * length_factor(data.length_unit, robot.length_unit) for data in sets]),
        np.concatenate([data.rotation for data in sets]),
        tuple(legs),
        _chosen(chosen, len(legs)),
        tuple(f"candidate {i}" for i in poses.indices) if isinstance(poses, Design) else ("",) * len(legs),
    )


def _chosen(chosen: Any, n_poses: int) -> npt.NDArray[np.intp]:
    if chosen is None:
        index = np.arange(n_poses)
    else:
        index = np.asarray(chosen.indices if isinstance(chosen, Design) else chosen)
    if index.ndim != 1 or not index.size or index.dtype.kind not in "iu":
        raise InputError(f"chosen: expected a design or indices of poses, counted from 0; got {brief(chosen)}")
    if index.min() < 0 or index.max() >= n_poses:
        raise InputError(f"chosen: there are {n_poses} poses, 0…{n_poses - 1}; got {index.min()}…{index.max()}")
    return index.astype(np.intp)


def _locked(data: LegMeasurements | Measurements) -> int | None:
    """The leg that the clamp holds, where the measurements say it."""
    if isinstance(data, Measurements):
        return data.locked_leg
    return data.leg if data.lock is not Lock.NONE and data.nominal is not None else None
