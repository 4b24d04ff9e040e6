r"""Chosen poses moved inside the robot's limits, each on its clamp, while the criterion falls.

A pose is :math:`P = a + s - R\,b` with the leg vector s and the rotation R. A step :math:`(d, \omega)` turns R to
:math:`\exp([\omega]_\times) R`, and moves s as the lock lets it: not at all (LEG), along itself (DIRECTION), on its
sphere (LENGTH), or freely.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, as_count, as_generator, brief, matvec, norm
from ..errors import InputError
from ..geometry import Hexapod, Leg
from ..kinematics import inverse_kinematics, leg_vector, reachable
from ..measurements import LegMeasurements, Lock, Measurements
from ..pools.clamp import Clamp
from ..pools.exact import Accept, checked_mask
from ..rotations import rotation_vector_to_matrix
from ..simulation import check_robot
from .choosing import design_of
from .design import Design
from .objective import Objective

__all__ = ["moved", "refine_poses"]

#: The first steps: so far in leg lengths, and in radians. Smaller by SHRINK after a round that gains too little.
REACH, SHRINK, LEAST = 0.2, 0.5, 1e-4
#: A round gains enough if it takes this share off the variance.
ENOUGH = 1e-4
#: Poses that are off one clamp by more, in sizes of the robot, were made with another robot.
CLAMPED = 1e-4
#: Steps that leave the limits are halved so often before they are given up.
HALVINGS = 5


def refine_poses(
    design: Design,
    robot: Hexapod,
    *,
    accept: Accept | None = None,
    rounds: int = 100,
    neighbours: int = 32,
    rng: int | np.random.Generator,
) -> Design:
    r"""Move the chosen poses, each on its clamp and within the limits of all six legs, while the criterion falls.

    In every round each pose looks at random neighbours
    :math:`R' = \exp([\omega]_\times) R,\; P' = a + s' - R' b` and takes the best. The leg vector
    :math:`s = P + R\,b - a` moves as the lock lets it: along itself (DIRECTION), not at all (LEG), on its sphere
    (LENGTH), or freely. Steps that leave the limits are halved until they do not; the reach of all steps is halved
    where a round gains too little.

    Parameters
    ----------
    design : Design
        From :func:`select_poses`, over one set: a loop of one leg, or ``WholeRobot(pool)``.
    robot : Hexapod
        That of the candidates: its geometry is the clamp's, its limits are respected.
    accept : callable, optional
        A further condition: positions (m, 3) and rotations (m, 3, 3), which all legs reach, to a mask (m,).
    rounds : int, default 100
        At most; it ends sooner where the reach is below 1e-4.
    neighbours : int, default 32
        How many each pose looks at in a round.
    rng : int or numpy.random.Generator
        Seed or generator; there is no default.

    Returns
    -------
    Design
        Of the moved poses, with exact readings; never worse. ``indices`` are the candidates that they come from,
        ``weights`` and ``relaxed`` still those of the candidates. ``bound`` and ``efficiency`` are NaN: no design of
        *candidates* is better than the bound before, moved poses may be.

    Raises
    ------
    InputError
        For candidates of several sets or without poses, chosen poses that the robot does not reach, a robot without
        limits, and wrong settings.

    Notes
    -----
    Poses of a design that repeats them move apart. Two poses may come close to each other: where a design of few poses
    is best, it measures some of them twice.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> pool = hx.candidates(robot, 3, "direction", 300, noise, rng=0)
    >>> design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 7)
    >>> better = hx.refine_poses(design, robot, rounds=20, rng=0)
    >>> bool(better.value < design.value), bool(hx.reachable(robot, better.poses.position, better.poses.rotation).all())
    (True, True)
    """
    if not isinstance(design, Design):
        raise InputError(f"design: expected a Design from select_poses, got {brief(design)}")
    check_robot(robot)
    _check_limits(robot, accept)
    search = _Search(design, robot, accept, as_count("neighbours", neighbours), as_generator(rng))
    reach = REACH
    for _ in range(as_count("rounds", rounds)):
        if search.round(reach) < ENOUGH:
            reach *= SHRINK
        if reach < LEAST:
            break
    return _answer(design, search.poses)


def _check_limits(robot: Hexapod, accept: Accept | None) -> None:
    """Where nothing holds them, poses would run away: far-off ones see more."""
    limits = robot.limits
    turns = (limits.angles, limits.tilt, limits.base_tilt, limits.leg_tilt)
    free = ["leg lengths"] * (limits.leg_length is None) + ["angles"] * all(one is None for one in turns)
    if free and accept is None:
        raise InputError(
            f"robot: {robot.name} has no limits on {' and '.join(free)}, within which poses could move; give it "
            "limits=Limits(leg_length=…, angles=…), or a condition, accept="
        )


def moved(leg: Leg, lock: Lock, position: Array, rotation: Array, step: Array) -> tuple[Array, Array]:
    """Poses (..., 3), (..., 3, 3) after steps (..., 6), in lengths of the leg and radians, on the clamp of each."""
    vectors = leg_vector(leg.platform_point, leg.base_point, position, rotation)
    length = norm(vectors)[..., None]
    if lock is Lock.DIRECTION:
        vectors = vectors * (1 + step[..., :1])
    elif lock is not Lock.LEG:
        vectors = vectors + length * step[..., :3]
    if lock is Lock.LENGTH:
        vectors = vectors * (length / norm(vectors)[..., None])
    turned = rotation_vector_to_matrix(step[..., 3:]) @ rotation
    return leg.base_point + vectors - matvec(turned, leg.platform_point), turned


class _Search:
    """Chosen poses on their way."""

    def __init__(
        self, design: Design, robot: Hexapod, accept: Accept | None, count: int, rng: np.random.Generator
    ) -> None:
        poses = design.poses
        if not isinstance(poses, (LegMeasurements, Measurements)):
            came = "a linear problem or bare information" if poses is None else f"{len(poses)} sets"
            raise InputError(f"design: expected one of poses from one set of candidates, got one of {came}")
        self.poses, self.question, self.robot, self.accept = poses, design.question, robot, accept
        number = poses.leg if isinstance(poses, LegMeasurements) else poses.locked_leg or 1
        self.leg, self.count, self.rng = robot.leg(number), count, rng
        clamp = Clamp.of_poses(robot, number, poses.lock, poses.position, poses.rotation)
        off = float(clamp.distance(poses.position, poses.rotation).max())
        if off > CLAMPED * robot.size:
            raise InputError(
                f"design: its poses are up to {off:.3g} {robot.length_unit} off one clamp of {robot.name}; give "
                "the robot that the candidates were made with"
            )
        outside = ~self._inside(poses.position, poses.rotation)
        if outside.any():
            raise InputError(
                f"design: {int(outside.sum())} of {len(outside)} chosen poses are outside the limits of this robot, or "
                "accept refuses them; give the robot and the condition that the candidates were made with"
            )

    def _inside(self, position: Array, rotation: Array) -> BoolArray:
        inside = reachable(self.robot, position, rotation)
        if self.accept is not None:
            reached = np.flatnonzero(inside)
            inside[reached] = checked_mask(self.accept, position[reached], rotation[reached])
        return inside

    def round(self, reach: float) -> float:
        """Let every pose take its best neighbour within reach; by which share the variance falls."""
        n = self.poses.n_poses
        parents, data = self._with_neighbours(reach)
        objective = self.question.over(data).objective()
        blocks, fixed = objective.information.blocks, objective.information.fixed
        chosen = np.arange(n)
        before = value = float(objective.of_totals(fixed + blocks[:, chosen].sum(axis=1)))
        for i in range(n):
            others = fixed + blocks[:, np.delete(chosen, i)].sum(axis=1)
            near = n + np.flatnonzero(parents[n:] == i)
            values = objective.of_totals(others + np.moveaxis(blocks[:, near], 0, 1))
            if len(near) and values.min() < value:
                chosen[i], value = near[values.argmin()], float(values.min())
        self.poses = data.poses(chosen)
        return fallen(objective, before, value)

    def _with_neighbours(self, reach: float) -> tuple[npt.NDArray[np.intp], Any]:
        """The poses, and behind them neighbours that all legs reach; and which pose each of them comes from."""
        n, lock = self.poses.n_poses, self.poses.lock
        parents = np.repeat(np.arange(n), self.count)
        size = reach * self.rng.uniform(0.0, 1.0, (len(parents), 1))
        step = size * self.rng.standard_normal((len(parents), 6))
        start = self.poses.position[parents], self.poses.rotation[parents]
        position, rotation = moved(self.leg, lock, *start, step)
        outside = np.flatnonzero(~self._inside(position, rotation))
        for _ in range(HALVINGS):
            step[outside] /= 2
            position[outside], rotation[outside] = moved(
                self.leg, lock, start[0][outside], start[1][outside], step[outside]
            )
            outside = outside[~self._inside(position[outside], rotation[outside])]
        keep = np.delete(np.arange(len(parents)), outside)
        parents = np.concatenate([np.arange(n), parents[keep]])
        length = inverse_kinematics(self.robot, position[keep], rotation[keep])
        if isinstance(self.poses, LegMeasurements):
            length = length[:, self.leg.number - 1]
        data = self.poses.poses(parents).moved_to(
            np.concatenate([self.poses.position, position[keep]]),
            np.concatenate([self.poses.rotation, rotation[keep]]),
            None if self.poses.length is None else np.concatenate([self.poses.length, length]),
        )
        return parents, data


def fallen(objective: Objective, before: float, after: float) -> float:
    """By which share the variance that a criterion stands for falls between two values of it."""
    return 1 - float(objective.criterion.efficiency(after, before, objective.main))


def _answer(before: Design, poses: Any) -> Design:
    """The design of the moved poses, if they are better."""
    n, start = poses.n_poses, before.poses
    both = start.poses(np.tile(np.arange(n), 2)).moved_to(
        np.concatenate([start.position, poses.position]),
        np.concatenate([start.rotation, poses.rotation]),
        None if start.length is None else np.concatenate([start.length, poses.length]),
    )
    question = before.question.over(both)
    objective = question.objective()
    old, new = np.repeat([1, 0], n), np.repeat([0, 1], n)
    share = fallen(objective, objective.value(old), objective.value(new))
    if not share > 0:
        return replace(before, stopped=f"{before.stopped}; no pose that was moved is better")
    words = f"poses moved inside the limits, which makes {before.criterion} better by {share:.2%} of the variance"
    found = design_of(question, objective, new.astype(np.intp), None, np.nan, False, words)
    return replace(
        found, indices=before.indices, weights=before.weights, relaxed=before.relaxed, question=before.question
    )
