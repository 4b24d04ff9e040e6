"""What a lock holds, as a nominal sees it: the direction of the locked leg, and its length."""

from __future__ import annotations

import numpy as np

from ..arrays import Array, norm
from ..kinematics import leg_vector
from ..measurements import LegMeasurements, Lock, Measurements

__all__ = ["clamp_difference"]

#: Poses whose directions differ by more (rad), or whose lengths by a larger share, are not on one clamp, even as a
#: nominal sees it that is off by a twentieth of the leg's length.
DIRECTION, LENGTH = 0.2, 0.1


def clamp_difference(one: LegMeasurements | Measurements, two: LegMeasurements | Measurements) -> str:
    """In words, how a set is off the clamp of another by more than a nominal may be; empty if it is not.

    Sets without a nominal pass: nothing is known of their clamps.
    """
    if one.lock is not two.lock or one.legs != two.legs:
        return f"the lock {str(two.lock)!r} of leg {two.legs}, not {str(one.lock)!r} of {one.legs}"
    clamp, held = _vectors(one), _vectors(two)
    if clamp is None or held is None:
        return ""
    if one.lock in (Lock.DIRECTION, Lock.LEG):
        mean = (clamp / norm(clamp)[:, None]).mean(axis=0)
        cosine = held @ mean / (norm(held) * norm(mean))
        angle = float(np.arccos(np.clip(cosine.min(), -1.0, 1.0)))
        if angle > DIRECTION:
            return f"directions {np.rad2deg(angle):.1f}° apart"
    if one.lock in (Lock.LEG, Lock.LENGTH):
        length, lengths = float(norm(clamp).mean()), norm(held)
        worst = float(lengths[np.abs(lengths - length).argmax()])
        if abs(worst - length) > LENGTH * length:
            return f"lengths of {length:.4g} and {worst:.4g} {one.length_unit}"
    return ""


def _vectors(data: LegMeasurements | Measurements) -> Array | None:
    """The vectors (n, 3) of the locked leg."""
    if isinstance(data, Measurements):
        if data.locked_leg is None:
            return None
        data = data.leg(data.locked_leg)
    if data.lock is Lock.NONE or data.nominal is None:
        return None
    return leg_vector(data.nominal.platform_point, data.nominal.base_point, data.position, data.rotation)
