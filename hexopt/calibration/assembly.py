"""The robot from its legs: sets sorted by leg and lock, each leg calibrated in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..errors import EstimationError, InputError, LockError, UnitError
from ..geometry import Hexapod
from ..measurements import LegMeasurements, Lock, Measurements
from ..result import Estimator
from .methods import Method
from .report import Calibration

__all__ = ["calibrate"]


def calibrate(
    robot: Hexapod,
    sets: Sequence[LegMeasurements | Measurements] | LegMeasurements | Measurements,
    method: Method,
    estimator: Estimator | None = None,
) -> Calibration:
    """Calibrate a robot, each measured leg in turn.

    Parameters
    ----------
    robot : Hexapod
        The nominal: it lends what the method does not estimate (and a start to nonlinear methods).
    sets : list of LegMeasurements or Measurements
        One set for each leg and lock that the method needs, in any order; of :class:`Measurements` under a
        lock the locked leg is used, of unlocked ones all six. Legs without a set keep their nominal.
    method : OneStep, ThreeStep or FreePoses
    estimator : Estimator, optional
        By default ``LeastSquares()`` for the linear methods, ``InverseKinematics()`` for free poses.

    Returns
    -------
    Calibration

    Raises
    ------
    LockError
        If a set has a lock that the method does not use, or a leg misses one that it needs.
    InputError
        For an empty list, batches, two sets for the same leg and lock, or other units than the robot's.
    RankDeficientError
        If the poses of a leg do not determine its parameters.

    References
    ----------
    Daney (1998), section 3: "the same operation has to be processed 6 times, for each leg of the robot".

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> sets = [hx.simulate_leg(robot, k, "direction", n_poses=5, rng=k) for k in range(1, 7)]
    >>> result = hx.calibrate(robot.perturbed(0.5, rng=0), sets, hx.OneStep())
    >>> bool(abs(result.robot.base_points - robot.base_points).max() < 1e-9)
    True
    """
    if not isinstance(robot, Hexapod):
        raise InputError(f"robot: expected a Hexapod, got {type(robot).__name__}")
    if isinstance(method, type) or not hasattr(method, "calibrate_leg"):
        raise InputError(f"method: expected OneStep(), ThreeStep() or FreePoses(), got {method!r}")
    by_leg = _sorted_sets(robot, [sets] if isinstance(sets, (LegMeasurements, Measurements)) else list(sets), method)
    legs = {}
    for number in sorted(by_leg):
        missing = [str(lock) for lock in method.locks if lock not in by_leg[number]]
        if missing:
            raise LockError(f"leg {number}: {method!r} also needs a set with the lock {' and '.join(missing)}")
        try:
            legs[number] = method.calibrate_leg(by_leg[number], estimator)
        except EstimationError as error:
            error.args = (f"leg {number}: {error.args[0]}", *error.args[1:])
            raise
    calibrated = robot.with_legs({number: part.leg for number, part in legs.items()})
    return Calibration(calibrated, robot, legs, repr(method))


def _sorted_sets(
    robot: Hexapod, sets: Sequence[LegMeasurements | Measurements], method: Method
) -> dict[int, dict[Lock, LegMeasurements]]:
    if not sets:
        raise InputError("sets: there are no measurements")
    by_leg: dict[int, dict[Lock, LegMeasurements]] = {}
    for data in sets:
        if not isinstance(data, (LegMeasurements, Measurements)):
            raise InputError(f"sets: expected LegMeasurements or Measurements, got {type(data).__name__}")
        if data.batch_shape:
            raise InputError(f"sets: calibrate takes single sets, got a batch of {data.batch_shape}; write data[i]")
        if data.length_unit != robot.length_unit:
            raise UnitError(f"the measurements are in {data.length_unit}, the robot in {robot.length_unit}")
        if data.lock not in method.locks:
            wanted = " and ".join(repr(str(lock)) for lock in method.locks)
            raise LockError(f"{method!r} uses sets with the lock {wanted}; one has {str(data.lock)!r}")
        for number, part in leg_views(data):
            leg_sets = by_leg.setdefault(number, {})
            if part.lock in leg_sets:
                raise InputError(f"leg {number} has two sets with the lock {str(part.lock)!r}; give one of each")
            leg_sets[part.lock] = replace(part, nominal=robot.leg(number))
    return by_leg


def leg_views(data: LegMeasurements | Measurements) -> list[tuple[int, LegMeasurements]]:
    """The legs that a set is used for, by number: the locked one, or all six where none is."""
    if isinstance(data, LegMeasurements):
        return [(data.leg, data)]
    numbers = range(1, 7) if data.locked_leg is None else [data.locked_leg]
    return [(number, data.leg(number)) for number in numbers]
