"""Random candidate poses on one clamp that all six legs reach."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_count, as_generator, brief
from ..errors import InputError, SamplingError
from ..geometry import Hexapod, PoseRanges
from ..kinematics import limit_violations, reachable
from ..measurements import Lock, Measurements
from ..noise import Noise
from ..poses import PoseSampler, hopeless, limit_ranges, refusing
from ..simulation import check_robot
from .clamp import Clamp
from .exact import Accept, checked_mask, exact_pool, lock_and_leg

__all__ = ["candidates"]

LEAST_AT_ONCE = 1_000
MOST_AT_ONCE = 50_000  # poses a draw, so that memory stays bounded


def candidates(
    robot: Hexapod,
    leg: int | None,
    lock: Lock | str,
    n: int,
    noise: Noise | None = None,
    given: npt.ArrayLike | None = None,
    *,
    nominal: Hexapod | None = None,
    ranges: PoseRanges | None = None,
    accept: Accept | None = None,
    rng: int | np.random.Generator,
) -> Measurements:
    r"""Random poses on one clamp that all six legs reach, with exact readings: :math:`P = a + \ell n - R\,b`.

    What the lock leaves free is uniform where the pose is feasible: the Euler angles of R about home, the true length
    :math:`\ell` of the locked leg, and its direction n on a spherical cap about that of home. What it holds is the
    same in all poses. So the poses cover all that can be reached on this clamp.

    Parameters
    ----------
    robot : Hexapod
        Its ``limits`` say what can be reached.
    leg : int or None
        The locked leg, 1…6. With the lock "none" it is the leg whose length and direction are uniform, by default 1.
    lock : Lock or str
        "direction" (Type I), "leg" (II), "length" (III) or "none".
    n : int
        How many.
    noise : Noise, optional
        What estimators and the information of a pose assume; nothing is added to the readings.
    given : array_like or float, optional
        What the clamp holds: a direction (3,) of any length, the point c (3,) of the platform joint in the base
        frame, or the true length; by default that of the leg at home.
    nominal : Hexapod, optional
        What estimators may know; by default `robot`.
    ranges : PoseRanges, optional
        Where angles, lengths and directions are drawn; by default everything within ``robot.limits``, and the robot's
        own ranges where a limit does not bind.
    accept : callable, optional
        A further condition: positions (m, 3) and rotations (m, 3, 3), which all legs reach, to a mask (m,).
    rng : int or numpy.random.Generator
        Seed or generator; there is no default.

    Returns
    -------
    Measurements
        One set of n poses. ``FixedDirection(pool.leg(3))`` sees the locked leg, ``WholeRobot(pool)`` all six.

    Raises
    ------
    InputError
        For arguments out of range.
    SamplingError
        If hardly any pose on this clamp can be reached; it says what share each limit refuses.

    Examples
    --------
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=1e-4, length=0.01)
    >>> pool = hx.candidates(hx.robots.left_hand(), 3, "direction", 1000, noise, given=[0.1, -0.2, 1.0], rng=0)
    >>> pool.length.shape, str(pool.leg(3).lock)
    ((1000, 6), 'direction')
    """
    check_robot(robot)
    kind, number = lock_and_leg(lock, leg)
    if ranges is not None and not isinstance(ranges, PoseRanges):
        raise InputError(f"ranges: expected PoseRanges(…), got {brief(ranges)}")
    clamp = Clamp.at_home(robot, number, kind) if given is None else Clamp.given(robot, number, kind, given)
    sampler = PoseSampler(robot, number, kind, ranges or limit_ranges(robot), as_generator(rng))
    position, rotation = _reached(sampler, clamp, as_count("n", n), accept)
    return exact_pool(robot, clamp, position, rotation, noise, nominal)


def _reached(sampler: PoseSampler, clamp: Clamp, n: int, accept: Accept | None) -> tuple[Array, Array]:
    """The first n random poses on the clamp that all legs reach and `accept` takes."""
    position, rotation = np.empty((n, 3)), np.empty((n, 3, 3))
    filled = drawn = accepted = 0
    while filled < n:
        if hopeless(drawn, accepted, n - filled):
            raise SamplingError(_why(sampler, clamp, drawn, accepted, accept))
        rate = max(accepted / drawn, 1e-3) if drawn else 0.5
        count = int(np.clip(1.2 * (n - filled) / rate, LEAST_AT_ONCE, MOST_AT_ONCE))
        p, r = (array[0] for array in sampler.poses(1, count, clamp.held)[:2])
        good = np.flatnonzero(reachable(sampler.robot, p, r))
        if accept is not None and good.size:
            good = good[checked_mask(accept, p[good], r[good])]
        drawn, accepted = drawn + count, accepted + len(good)
        good = good[: n - filled]
        position[filled : filled + len(good)], rotation[filled : filled + len(good)] = p[good], r[good]
        filled += len(good)
    return position, rotation


def _why(sampler: PoseSampler, clamp: Clamp, drawn: int, accepted: int, accept: Accept | None) -> str:
    """Which limit kills the poses on a clamp, and what can be done."""
    p, r = (array[0] for array in sampler.poses(1, 20_000, clamp.held)[:2])
    reasons = refusing(limit_violations(sampler.robot, p, r))
    good = reachable(sampler.robot, p, r)
    if accept is not None and good.any():
        reasons += f"{'; ' if reasons else ''}of those that all legs reach, accept refuses " + (
            f"{1 - checked_mask(accept, p[good], r[good]).mean():.1%}"
        )
    other = f", or give another {clamp.kind} (given=)" if clamp.lock is not Lock.NONE else ""
    fewer = ", or ask for fewer poses" if accepted else ""
    return (
        f"only {accepted} of {drawn} random poses under {clamp}, are feasible ({reasons}); "
        f"widen the robot's limits, narrow the pose ranges (ranges=){other}{fewer}"
    )
