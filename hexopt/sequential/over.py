"""A loop equation over other poses, and what both filters ask of a pose and of their settings."""

from __future__ import annotations

from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np

from ..errors import InputError, LockError, UnitError
from ..loops import Loop
from ..measurements import LegMeasurements

__all__ = ["check_gate", "check_noise", "check_state", "merged", "next_pose"]


def check_state(state: object, kind: type) -> None:
    """A filter steps from a state of its own kind."""
    if not isinstance(state, kind):
        raise InputError(f"state: expected a {kind.__name__}, from start() or scan(); got {type(state).__name__}")


def next_pose(loop: Loop, pose: LegMeasurements) -> Loop:
    """`loop` over one pose that has arrived.

    Raises
    ------
    InputError
        If it is not one pose of as many sets, with a noise model.
    LockError, UnitError
        If it is of another kind than the poses that the loop was made for.
    """
    if not isinstance(pose, LegMeasurements):
        raise InputError(f"pose: expected LegMeasurements of one pose, got {type(pose).__name__}")
    if pose.n_poses != 1:
        raise InputError(f"pose: expected one pose, got {pose.n_poses}; write data.poses([i]), or fit(loop) for all")
    if pose.batch_shape != loop.data.batch_shape:
        raise InputError(f"pose: the filter runs over {loop.data.batch_shape} sets, the pose has {pose.batch_shape}")
    if pose.lock is not loop.data.lock:
        raise LockError(f"pose: the filter runs under the lock {str(loop.data.lock)!r}, not {str(pose.lock)!r}")
    if pose.length_unit != loop.data.length_unit:
        raise UnitError(f"pose: the filter runs in {loop.data.length_unit}, the pose is in {pose.length_unit}")
    if pose.nominal is not None:
        loop._check_leg(pose.nominal)
    check_noise(type(loop).__name__, pose.noise)
    return loop.over(pose)


def merged(before: Loop | None, pose: Loop) -> Loop:
    """The poses of two loops of one equation as those of one loop."""
    if before is None:
        return pose
    one, two = before.data, pose.data
    length = None if one.length is None else np.concatenate([one.length, two.readings()], axis=-1)
    data = replace(
        one,
        position=np.concatenate([one.position, two.position], axis=-2),
        rotation=np.concatenate([one.rotation, two.rotation], axis=-3),
        length=length,
    )
    both = before.over(data)
    covariances = [before.error_covariance, pose.error_covariance]  # every pose keeps its own noise
    vars(both)["error_covariance"] = np.concatenate(covariances, axis=-3)
    return both


def check_noise(name: str, noise: Any) -> None:
    """A filter weighs poses by their noise, which must be known."""
    if noise is None:
        raise InputError(f"{name}: a filter needs a noise model; give the measurements noise=UniformNoise(…), say")


def check_gate(level: float, reject: bool) -> None:
    """The settings that both filters have."""
    if not (isinstance(level, Real) and 0 < level < 1):
        raise InputError(f"level: expected a probability between 0 and 1, such as 0.999; got {level!r}")
    if not isinstance(reject, bool):
        raise InputError(f"reject: expected True or False, got {reject!r}; the threshold is level=")
