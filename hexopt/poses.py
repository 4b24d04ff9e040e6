r"""Random poses under a lock, exact to rounding: :math:`P = a + \ell n - R\,b` from (ℓ, n, R)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from .arrays import Array, BoolArray, matvec
from .errors import SamplingError
from .geometry import Hexapod, PoseRanges
from .kinematics import limit_violations, reachable
from .measurements import Lock
from .rotations import euler_to_matrix

__all__ = ["PoseSampler", "hopeless", "limit_ranges", "refusing", "sample_poses"]

MAX_ROUNDS = 200
PATIENCE = 10  # rounds after which a set gives up the direction or length that it holds
FIRST_DRAWS = 2_000_000  # poses after which the rate of acceptance is trusted
LOWEST_RATE = 1e-3  # below it, what would need more than so many draws in all is hopeless
MOST_DRAWS = 50_000_000
LARGEST_DRAW = 2_000_000  # poses at once, so that memory stays bounded
FIRST_LOOK = 50_000  # poses that a set draws at most with a direction or length that has given none yet


def limit_ranges(robot: Hexapod) -> PoseRanges:
    """Ranges that cover everything within the robot's limits, for poses that all six legs reach."""
    limits, home = robot.limits, robot.ranges
    cone = home.cone
    if limits.leg_tilt is not None:
        cone = limits.leg_tilt
    elif limits.base_tilt is not None:
        lean = np.arccos(np.clip(np.abs(robot.home_vectors[:, 2]) / robot.home_lengths, 0.0, 1.0)).max()
        cone = min(limits.base_tilt + float(lean), np.pi)
    return PoseRanges(
        angles=limits.angles or home.angles,
        length=limits.leg_length or home.length,
        cone=cone,
        lock_cone=cone,
        sequence=limits.sequence if limits.angles else home.sequence,
    )


@dataclass(frozen=True)
class PoseSampler:
    """Draws (ℓ, n, R) within the ranges of one leg, and places the platform."""

    robot: Hexapod
    leg: int
    lock: Lock
    ranges: PoseRanges
    rng: np.random.Generator

    def directions(self, shape: tuple[int, ...], cone: float) -> Array:
        """Uniform on the cap of half-angle `cone` about the leg's direction at home."""
        height = self.rng.uniform(np.cos(cone), 1.0, shape)
        around = self.rng.uniform(0.0, 2 * np.pi, shape)
        radius = np.sqrt(np.maximum(1.0 - height * height, 0.0))
        local = np.stack([radius * np.cos(around), radius * np.sin(around), height], axis=-1)
        directions: Array = local @ _frame(self.robot.home_vectors[self.leg - 1]).T
        return directions

    def lengths(self, shape: tuple[int, ...]) -> Array:
        """Uniform between the shortest and the longest."""
        return self.rng.uniform(*self.ranges.length, shape)

    def locked(self, n_sets: int) -> tuple[Array | None, Array | None]:
        """What each set holds fixed: a direction (n_sets, 1, 3), a length (n_sets, 1)."""
        direction = length = None
        if self.lock in (Lock.DIRECTION, Lock.LEG):
            direction = self.directions((n_sets, 1), self.ranges.lock_cone)
        if self.lock in (Lock.LENGTH, Lock.LEG):
            length = self.lengths((n_sets, 1))
        return direction, length

    def poses(self, n_sets: int, n_poses: int, held: tuple[Array | None, Array | None]) -> tuple[Array, Array, Array]:
        """Positions, rotations and true lengths of n_poses a set, with what is held."""
        shape = (n_sets, n_poses)
        direction, length = held
        half = np.asarray(self.ranges.angles)
        angles = half * self.rng.uniform(-1.0, 1.0, (*shape, 3))
        rotation = _nearest_rotation(self.robot.home_rotation) @ euler_to_matrix(angles, self.ranges.sequence)
        if direction is None:
            direction = self.directions(shape, self.ranges.cone)
        if length is None:
            length = self.lengths(shape)
        length = np.broadcast_to(length, shape)
        leg = self.robot.leg(self.leg)
        position = leg.base_point + length[..., None] * direction - matvec(rotation, leg.platform_point)
        return position, rotation, length


def _nearest_rotation(matrix: Array) -> Array:
    """The rotation nearest to a matrix that is one to a few digits only, as a rounded file gives it."""
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def _frame(axis: Array) -> Array:
    """A right-handed orthonormal frame whose third axis is `axis`, as columns."""
    third = axis / np.sqrt(axis @ axis)
    helper = np.eye(3)[np.argmin(np.abs(third))]
    first = np.cross(helper, third)
    first /= np.sqrt(first @ first)
    return np.column_stack([first, np.cross(third, first), third])


def sample_poses(
    robot: Hexapod,
    leg: int,
    lock: Lock,
    shape: tuple[int, int],
    ranges: PoseRanges,
    rng: np.random.Generator,
    *,
    all_legs: bool = False,
    accept: Callable[[Array, Array], BoolArray] | None = None,
) -> tuple[Array, Array, Array]:
    """Random poses with one leg locked, in sets.

    Parameters
    ----------
    robot : Hexapod
    leg : int
        The leg that is locked, and from which the pose is built.
    lock : Lock
    shape : (int, int)
        (n_sets, n_poses); what the lock holds is drawn once a set.
    ranges : PoseRanges
    rng : numpy.random.Generator
    all_legs : bool, default False
        Keep only poses within ``robot.limits`` for all six legs.
    accept : callable, optional
        A further condition: positions and rotations to a mask.

    Returns
    -------
    position, rotation, length : ndarray
        (n_sets, n_poses, 3), (n_sets, n_poses, 3, 3) and the leg's *true* length (n_sets, n_poses).

    Raises
    ------
    SamplingError
        If hardly any pose is accepted; the message says what fraction was, and which limit refuses most.
    """
    sampler = PoseSampler(robot, leg, lock, ranges, rng)
    n_sets, n_poses = shape
    if not all_legs and accept is None:
        return sampler.poses(n_sets, n_poses, sampler.locked(n_sets))

    def inside(position: Array, rotation: Array) -> BoolArray:
        mask = reachable(robot, position, rotation) if all_legs else np.ones(position.shape[:-1], dtype=bool)
        return mask if accept is None else mask & accept(position, rotation)

    return _Rejection(sampler, inside, n_sets, n_poses).run()


def hopeless(drawn: int, accepted: int, missing: int) -> bool:
    """Whether the poses that are still missing would need too many draws, at the rate of acceptance so far."""
    if drawn < FIRST_DRAWS or accepted > LOWEST_RATE * drawn:
        return False
    return missing * drawn > MOST_DRAWS * accepted


def refusing(violations: Mapping[str, BoolArray]) -> str:
    """Which limit refuses what share of the poses, in words, the strictest first."""
    shares = {name: float(bad.mean()) for name, bad in violations.items()}
    return ", ".join(f"{name} refuses {share:.1%}" for name, share in sorted(shares.items(), key=lambda x: -x[1]))


class _Rejection:
    """Fills every set with accepted poses.

    What a set holds is drawn together with its first pose, and drawn anew where it leaves hardly any
    pose: held values are as frequent as they are useful. Where a large set finds none, many are tried, one pose each.
    """

    def __init__(
        self, sampler: PoseSampler, inside: Callable[[Array, Array], BoolArray], n_sets: int, n_poses: int
    ) -> None:
        self.sampler, self.inside, self.n_poses = sampler, inside, n_poses
        self.position = np.empty((n_sets, n_poses, 3))
        self.rotation = np.empty((n_sets, n_poses, 3, 3))
        self.length = np.empty((n_sets, n_poses))
        self.filled = np.zeros(n_sets, dtype=int)
        direction, length = sampler.locked(n_sets)
        self.held = [direction, length]
        self.drawn = self.accepted = 0

    def run(self) -> tuple[Array, Array, Array]:
        for turn in range(MAX_ROUNDS + 1):
            todo = np.flatnonzero(self.filled < self.n_poses)
            if not todo.size:
                return self.position, self.rotation, self.length
            missing = int((self.n_poses - self.filled[todo]).sum())
            if turn == MAX_ROUNDS or hopeless(self.drawn, self.accepted, missing):
                break
            if self.sampler.lock is not Lock.NONE and turn % PATIENCE == PATIENCE - 1:
                self.filled[todo] = 0
            self._round(todo)
        raise SamplingError(self._message())

    def _round(self, todo: np.ndarray) -> None:
        """One vectorised draw for the sets that still miss poses."""
        rate = max(self.accepted / self.drawn, 1e-3) if self.drawn else 0.5
        missing = int((self.n_poses - self.filled[todo]).max())
        count = int(np.clip(np.ceil(1.2 * missing / rate), 4, max(4, LARGEST_DRAW // todo.size)))
        empty = todo[self.filled[todo] == 0]
        if count > FIRST_LOOK and empty.size and self.sampler.lock is not Lock.NONE:
            count = FIRST_LOOK
            self._redraw_held(empty, tries=max(FIRST_LOOK // empty.size, 1))
        else:
            self._redraw_held(empty)
        held = tuple(None if part is None else part[todo] for part in self.held)
        position, rotation, length = self.sampler.poses(todo.size, count, held)  # type: ignore[arg-type]  # a pair
        good = self._counted(position, rotation)
        place = self.filled[todo][:, None] + np.cumsum(good, axis=1) - 1
        good &= place < self.n_poses
        row, column = np.nonzero(good)
        target = todo[row], place[row, column]
        self.position[target], self.rotation[target] = position[row, column], rotation[row, column]
        self.length[target] = length[row, column]
        self.filled[todo] += good.sum(axis=1)

    def _counted(self, position: Array, rotation: Array) -> BoolArray:
        """Which poses are accepted."""
        good = self.inside(position, rotation)
        self.drawn += good.size
        self.accepted += int(good.sum())
        return good

    def _redraw_held(self, empty: np.ndarray, tries: int = 1) -> None:
        """A new direction or length for sets that have no pose yet; of several the first with an accepted pose."""
        drawn = self.sampler.locked(empty.size * tries)
        which = np.arange(empty.size) * tries
        if tries > 1:
            position, rotation, _ = self.sampler.poses(which.size * tries, 1, drawn)
            which += np.argmax(self._counted(position, rotation).reshape(-1, tries), axis=1)
        for part, new in zip(self.held, drawn, strict=True):
            if part is not None and new is not None:
                part[empty] = new[which]

    def _message(self) -> str:
        position, rotation, _ = self.sampler.poses(2000, 1, self.sampler.locked(2000))
        worst = refusing(limit_violations(self.sampler.robot, position, rotation))
        return (
            f"only {self.accepted} of {self.drawn} random poses ({self.accepted / self.drawn:.2g}) under the lock "
            f"{str(self.sampler.lock)!r} of leg {self.sampler.leg} were accepted"
            + (f" ({worst})" if worst else "")
            + "; widen the robot's limits, or narrow the pose ranges"
        )
