"""Simulated measurements: random poses under a lock, exact readings, then noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .arrays import Array, BoolArray, as_count, as_generator, frozen
from .errors import InputError
from .geometry import Hexapod, Leg, PoseRanges
from .geometry.leg import check_leg_number
from .kinematics import inverse_kinematics
from .measurements import LegMeasurements, Lock, Measurements
from .noise import Noise
from .poses import limit_ranges, sample_poses

__all__ = ["check_robot", "simulate", "simulate_leg"]


def check_robot(robot: object) -> None:
    """Refuse what is no robot."""
    if not isinstance(robot, Hexapod):
        raise InputError(f"robot: expected a Hexapod, got {type(robot).__name__}")


def simulate_leg(
    robot: Hexapod,
    leg: int,
    lock: Lock | str,
    n_poses: int,
    n_sets: int | None = None,
    noise: Noise | None = None,
    ranges: PoseRanges | None = None,
    nominal: Hexapod | Leg | None = None,
    *,
    rng: int | np.random.Generator,
    all_legs: bool = False,
    accept: Callable[[Array, Array], BoolArray] | None = None,
) -> LegMeasurements:
    r"""Simulated measurements of one leg: :math:`P = a + \ell n - R\,b` with (ℓ, n, R) random, then noise.

    Parameters
    ----------
    robot : Hexapod
        The truth.
    leg : int
        1…6.
    lock : Lock or str
        "direction" (Type I), "leg" (II), "length" (III) or "none". What is locked is drawn once a set.
    n_poses : int
        Poses in a set.
    n_sets : int, optional
        The batch; by default one set with no batch dimension.
    noise : Noise, optional
        Added to the readings, and assumed by estimators; by default none.
    ranges : PoseRanges, optional
        By default the robot's own.
    nominal : Hexapod or Leg, optional
        What estimators may know: offset, gain, a start. By default the true leg; give
        ``robot.perturbed(…)`` for an honest start of nonlinear methods.
    rng : int or numpy.random.Generator
        Seed or generator; there is no default.
    all_legs : bool, default False
        Keep only poses that all six legs reach within ``robot.limits``.
    accept : callable, optional
        A further condition on (position, rotation), giving a mask.

    Returns
    -------
    LegMeasurements

    Raises
    ------
    InputError
        For arguments out of range.
    SamplingError
        If hardly any pose is accepted.

    References
    ----------
    Daney (1998), section 3.1 and 4.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(hx.robots.left_hand(), leg=3, lock="length", n_poses=7, n_sets=100, noise=noise, rng=1)
    >>> data.length.shape, str(data.lock)
    ((100, 7), 'length')
    """
    check_robot(robot)
    true_leg = robot.leg(leg)
    generator = as_generator(rng)
    shape = (1 if n_sets is None else as_count("n_sets", n_sets), as_count("n_poses", n_poses))
    position, rotation, length = sample_poses(
        robot, leg, Lock.of(lock), shape, ranges or robot.ranges, generator, all_legs=all_legs, accept=accept
    )
    reading = true_leg.reading(length)
    if noise is not None:
        position, rotation, reading = noise.apply(position, rotation, reading, generator)
    if isinstance(nominal, Hexapod):
        nominal = nominal.leg(leg)
    if isinstance(nominal, Leg) and nominal.number != true_leg.number:
        raise InputError(f"nominal: is leg {nominal.number}, but leg {true_leg.number} is simulated")
    data = LegMeasurements(
        frozen(position),
        frozen(rotation),
        frozen(reading),
        Lock.of(lock),
        noise,
        nominal or true_leg,
        robot.length_unit,
    )
    return data[0] if n_sets is None else data


def simulate(
    robot: Hexapod,
    lock: Lock | str = Lock.NONE,
    n_poses: int = 20,
    n_sets: int | None = None,
    noise: Noise | None = None,
    ranges: PoseRanges | None = None,
    nominal: Hexapod | None = None,
    *,
    leg: int | None = None,
    rng: int | np.random.Generator,
    accept: Callable[[Array, Array], BoolArray] | None = None,
) -> Measurements:
    """Simulated measurements with all six readings, at poses that all legs reach.

    Parameters
    ----------
    robot, lock, n_poses, n_sets, noise, rng, accept
        As in :func:`simulate_leg`.
    ranges : PoseRanges, optional
        By default everything within ``robot.limits``.
    nominal : Hexapod, optional
        By default the true robot.
    leg : int, optional
        The locked leg; needed unless `lock` is "none".

    Returns
    -------
    Measurements

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate(hx.robots.left_hand(), "direction", n_poses=7, leg=3, rng=0)
    >>> data.length.shape, data.leg(3).lock, data.leg(1).lock
    ((7, 6), <Lock.DIRECTION: 'direction'>, <Lock.NONE: 'none'>)
    """
    check_robot(robot)
    kind = Lock.of(lock)
    generator = as_generator(rng)
    n_built = as_count("n_sets", 1 if n_sets is None else n_sets)
    shape = (n_built, as_count("n_poses", n_poses))
    locked = None if kind is Lock.NONE and leg is None else check_leg_number(leg)
    # unlocked poses are built from one leg, drawn once a call; that all legs reach them is checked afterwards
    built_from = locked if locked is not None else int(generator.integers(1, 7))
    position, rotation, _ = sample_poses(
        robot, built_from, kind, shape, ranges or limit_ranges(robot), generator, all_legs=True, accept=accept
    )
    length = inverse_kinematics(robot, position, rotation)
    if noise is not None:
        position, rotation, length = noise.apply(position, rotation, length, generator)
    data = Measurements(
        frozen(position), frozen(rotation), frozen(length), kind, locked, noise, nominal or robot, robot.length_unit
    )
    return data[0] if n_sets is None else data
