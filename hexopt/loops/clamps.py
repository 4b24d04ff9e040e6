"""What a lock holds, as a nominal sees it: the direction of the locked leg, and its length."""

from __future__ import annotations

import numpy as np

from ..arrays import Array, norm
from ..kinematics import leg_vector
from ..measurements import LegMeasurements, Lock, Measurements

__all__ = ["clamp_difference"]

#: Sets whose directions differ by more (rad), or whose lengths by a larger share, are not on one clamp.
DIRECTION, LENGTH = 0.1, 0.05


def clamp_difference(one: LegMeasurements | Measurements, two: LegMeasurements | Measurements) -> str:
    """In words, how the clamps of two sets differ by more than a nominal may be off; empty where they do not.

    Sets without a nominal pass: nothing is known of their clamps.
    """
    if one.lock is not two.lock or one.legs != two.legs:
        return f"the lock {str(two.lock)!r} of leg {two.legs}, not {str(one.lock)!r} of {one.legs}"
    first, second = _held(one), _held(two)
    if first is None or second is None:
        return ""
    (n1, l1), (n2, l2) = first, second
    if one.lock in (Lock.DIRECTION, Lock.LEG):
        angle = float(np.arccos(np.clip(n1 @ n2, -1.0, 1.0)))
        if angle > DIRECTION:
            return f"directions {np.rad2deg(angle):.1f}° apart"
    if one.lock in (Lock.LEG, Lock.LENGTH) and abs(l1 - l2) > LENGTH * l1:
        return f"lengths of {l1:.4g} and {l2:.4g} {one.length_unit}"
    return ""


def _held(data: LegMeasurements | Measurements) -> tuple[Array, float] | None:
    """The mean direction and length of the locked leg."""
    if isinstance(data, Measurements):
        if data.locked_leg is None:
            return None
        data = data.leg(data.locked_leg)
    if data.lock is Lock.NONE or data.nominal is None:
        return None
    leg = data.nominal
    vectors = leg_vector(leg.platform_point, leg.base_point, data.position, data.rotation)
    mean = (vectors / norm(vectors)[..., None]).mean(axis=-2)
    return mean / norm(mean), float(norm(vectors).mean())
