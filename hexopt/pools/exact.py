"""What random and listed candidates share: the locked leg, the user's condition, exact readings."""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature

import numpy as np

from ..arrays import Array, BoolArray, brief, frozen
from ..errors import InputError, LockError
from ..geometry import Hexapod
from ..geometry.leg import check_leg_number
from ..kinematics import inverse_kinematics
from ..measurements import Lock, Measurements
from ..noise import Noise
from .clamp import Clamp

__all__ = ["Accept", "checked_mask", "exact_pool", "lock_and_leg"]

#: Positions (m, 3) and rotations (m, 3, 3) to a mask (m,).
Accept = Callable[[Array, Array], BoolArray]


def lock_and_leg(lock: Lock | str, leg: int | None) -> tuple[Lock, int]:
    """The lock, and the leg that has it or from which unlocked poses are built."""
    kind = Lock.of(lock)
    if leg is None and kind is not Lock.NONE:
        raise LockError(f"leg: which leg (1…6) has the lock {str(kind)!r}?")
    return kind, 1 if leg is None else check_leg_number(leg)


def checked_mask(accept: Accept, position: Array, rotation: Array) -> BoolArray:
    """What the user's condition says, checked."""
    try:
        signature(accept).bind(position, rotation)
    except (TypeError, ValueError):
        raise InputError(
            f"accept: expected a function of positions (m, 3) and rotations (m, 3, 3), got {brief(accept)}"
        ) from None
    mask = np.asarray(accept(position, rotation))
    if mask.dtype != bool or mask.shape != position.shape[:-1]:
        raise InputError(
            f"accept: expected a mask of {len(position)} booleans, one a pose, got {mask.dtype} of shape {mask.shape}"
        )
    return mask


def exact_pool(
    robot: Hexapod, clamp: Clamp, position: Array, rotation: Array, noise: Noise | None, nominal: Hexapod | None
) -> Measurements:
    """Poses with the readings that they have without noise."""
    return Measurements(
        frozen(position),
        frozen(rotation),
        frozen(inverse_kinematics(robot, position, rotation)),
        clamp.lock,
        None if clamp.lock is Lock.NONE else clamp.leg.number,
        noise,
        nominal or robot,
        robot.length_unit,
    )
