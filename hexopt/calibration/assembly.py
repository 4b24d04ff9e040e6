"""The robot from its legs: sets sorted by leg and lock, each leg calibrated in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..errors import EstimationError, InputError, LockError, UnitError
from ..geometry import Hexapod
from ..measurements import LegMeasurements, Lock, Measurements
from ..result import Estimator
from .joint import Joint
from .methods import Method, leg_views
from .report import Calibration

__all__ = ["calibrate"]


def calibrate(
    robot: Hexapod,
    sets: Sequence[LegMeasurements | Measurements] | LegMeasurements | Measurements,
    method: Method | Joint | None = None,
    estimator: Estimator | None = None,
) -> Calibration:
    """Calibrate a robot: all that was measured at once, or each measured leg in turn.

    Parameters
    ----------
    robot : Hexapod
        The nominal: it lends what the method does not estimate (and a start to nonlinear methods).
    sets : list of LegMeasurements or Measurements
        In any order. :class:`Joint` uses all readings of any sets. The other methods need one set for each leg and
        lock; of :class:`Measurements` under a lock they use the locked leg, of unlocked ones all six. Legs without
        a set keep their nominal.
    method : Joint, OneStep, ThreeStep or FreePoses, default ``Joint()``
    estimator : Estimator, optional
        By default ``MaximumLikelihood()`` for Joint, which needs a noise model; ``LeastSquares()`` for the linear
        methods, ``InverseKinematics()`` for free poses.

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

    All readings of the same six sets, in one likelihood, see the offsets too:

    >>> noise = hx.UniformNoise(0.01, 1e-4, 0.01)
    >>> sets = [hx.simulate(robot, "direction", 7, leg=k, noise=noise, rng=k) for k in range(1, 7)]
    >>> result = hx.calibrate(robot.perturbed(0.5, offsets=0.1, rng=0), sets)
    >>> bool(abs(result.robot.offsets - robot.offsets).max() < 0.2)
    True
    """
    if not isinstance(robot, Hexapod):
        raise InputError(f"robot: expected a Hexapod, got {type(robot).__name__}")
    method = Joint() if method is None else method
    if isinstance(method, type) or not (hasattr(method, "calibrate_leg") or isinstance(method, Joint)):
        raise InputError(f"method: expected Joint(), OneStep(), ThreeStep() or FreePoses(), got {method!r}")
    given = [sets] if isinstance(sets, (LegMeasurements, Measurements)) else list(sets)
    _check_sets(robot, given)
    if isinstance(method, Joint):
        return method.calibrate_robot(robot, given, estimator)
    by_leg = _sorted_sets(robot, given, method)
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


def _check_sets(robot: Hexapod, sets: Sequence[LegMeasurements | Measurements]) -> None:
    if not sets:
        raise InputError("sets: there are no measurements")
    for data in sets:
        if not isinstance(data, (LegMeasurements, Measurements)):
            raise InputError(f"sets: expected LegMeasurements or Measurements, got {type(data).__name__}")
        if data.batch_shape:
            raise InputError(f"sets: calibrate takes single sets, got a batch of {data.batch_shape}; write data[i]")
        if data.length_unit != robot.length_unit:
            raise UnitError(f"the measurements are in {data.length_unit}, the robot in {robot.length_unit}")


def _sorted_sets(
    robot: Hexapod, sets: Sequence[LegMeasurements | Measurements], method: Method
) -> dict[int, dict[Lock, LegMeasurements]]:
    by_leg: dict[int, dict[Lock, LegMeasurements]] = {}
    for data in sets:
        if data.lock not in method.locks:
            wanted = " and ".join(repr(str(lock)) for lock in method.locks)
            raise LockError(f"{method!r} uses sets with the lock {wanted}; one has {str(data.lock)!r}")
        for number, part in leg_views(data, locked=True):
            leg_sets = by_leg.setdefault(number, {})
            if part.lock in leg_sets:
                raise InputError(f"leg {number} has two sets with the lock {str(part.lock)!r}; give one of each")
            leg_sets[part.lock] = replace(part, nominal=robot.leg(number))
    return by_leg
