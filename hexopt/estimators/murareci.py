"""Legs of locked direction: the angles of the U-joint agree between poses (Murareci 1997)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Array, BoolArray, matvec, norm, transpose
from ..errors import InputError
from ..geometry import Leg
from ..loops import FixedDirection, Sets
from ..loops.joined_noise import JoinedNoise
from ..numerics.charts import across
from ..problem import ConstantRowNoise, LinearProblem, RowCovariance
from ..result import Estimate
from .least_squares import check_rows
from .local_fit import AgainstFirst, check_settings, first_guess, local_estimate, minimise

__all__ = ["Murareci"]

#: Legs so many times longer than at the start have run away to where all angles agree.
FARTHEST = 1e4


@dataclass(frozen=True)
class Murareci:
    r"""Equal joint angles: :math:`\min_{a,b}\tfrac12\sum_k\sum_{i>1}\lVert q_{ki} - q_{k1}\rVert^2`.

    Over the sets k, each with a locked direction, and their poses i. :math:`q_{ki} = (\alpha, \beta)` are the angles
    of the U-joint at the base that the direction of :math:`s = P_i + R_i b - a` asks for. The first axis :math:`e_1`
    stands in the base, the second one turns with it, and both are zero along :math:`e_3`, the mean direction of the
    set at the start: with :math:`s = x e_1 + y e_2 + z e_3`,

    .. math:: \alpha = \mathrm{atan2}(-y, z), \qquad \beta = \mathrm{atan2}(x, \sqrt{y^2 + z^2}).

    So they are singular only a quarter turn away from the start. No reading is used, and no offset is needed. Every
    pose counts against the first one of its set, unweighted: the answer depends on which that is, and, to second
    order in the error of the start, on the axes.

    Parameters
    ----------
    start : Leg, optional
        Where the iteration starts; by default the nominal of the first set. Its other values are not used.
    max_iterations : int, default 200

    Notes
    -----
    One locked direction cannot see a along itself, as all B then lie on one line through A: a single set is
    RANK_DEFICIENT. Two directions, three poses each, see everything. But all angles also agree where a is infinitely
    far, errors and all. A bad start runs away to there, and so do nearly parallel directions with errors:
    NOT_CONVERGED. Levenberg–Marquardt on the whole batch, no certificate (gap is NaN). The covariance is the sandwich
    of the noise model.

    References
    ----------
    Murareci (1997), as Daney (1998), section 1.2, describes it: "minimize the changes in the U-ball angles". Which
    changes, and which axes, are ours.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> nominal = robot.perturbed(0.3, rng=0)
    >>> one, two = (hx.simulate_leg(robot, 3, "direction", n_poses=6, nominal=nominal, rng=k) for k in (0, 1))
    >>> loop = hx.loops.Sets(hx.loops.FixedDirection(one), hx.loops.FixedDirection(two))
    >>> found = hx.estimate(loop, hx.Murareci())
    >>> bool(max(found.error(robot.leg(3)).values()) < 1e-9)
    True
    """

    start: Leg | None = None
    max_iterations: int = 200

    accepts: ClassVar[tuple[type, ...]] = (FixedDirection, Sets)
    hint: ClassVar[str] = (
        "write estimate(loops.Sets(loops.FixedDirection(one), loops.FixedDirection(two)), Murareci()), "
        "for sets of two directions"
    )

    def __post_init__(self) -> None:
        check_settings(self.start, self.max_iterations)

    def fit(self, target: FixedDirection | Sets) -> Estimate:
        """Fit every problem of the batch; one that does not converge, or is not determined, fails alone."""
        sets = Sets(target) if isinstance(target, FixedDirection) else target
        main = sets.parameters.main
        for loop in sets.loops:
            if not isinstance(loop, FixedDirection):
                raise InputError(
                    f"Murareci takes sets under the lock 'direction', got {type(loop).__name__}: {self.hint}"
                )
            if set(loop.unknown) != {"platform_point", "base_point"}:
                raise InputError(
                    f"Murareci finds both points and uses no reading, a set has the unknown {', '.join(loop.unknown)}: "
                    "leave out unknown=, and give offset= and gain= as known, whatever they are"
                )
        first = first_guess(self, self.start, sets.loops[0], main, sets.batch_shape)
        if min(loop.data.n_poses for loop in sets.loops) < 2:
            raise InputError("Murareci compares the poses of a set: give every set two poses or more")
        angles = _Angles(sets, [_axes(vectors) for vectors in _vectors(sets, first)])
        check_rows(angles.linearised(first))
        found = minimise(lambda x: angles.changes(x)[:2], first, self.max_iterations)
        stayed = found.converged & (_longest(sets, found.values) <= FARTHEST * _longest(sets, first))
        stayed &= angles.exist(found.values)
        problem = angles.linearised(np.where(stayed[..., None], found.values, first))
        return local_estimate(problem, found.values, stayed, found.iterations, self, _blind_spots(sets))


def _blind_spots(sets: Sets) -> tuple[str, ...]:
    """What one direction hides; noise in the measurements makes the matrix look as if it did not."""
    return ("base_point along the leg's locked direction",) if len(sets.loops) == 1 else ()


def _vectors(sets: Sets, x: Array) -> list[Array]:
    """The leg vectors s of every set, (..., n, 3) each, at values (..., 6) of b and a."""
    b, a = x[..., None, :3], x[..., None, 3:]
    return [loop.data.position + matvec(loop.data.rotation, b) - a for loop in sets.loops]


def _longest(sets: Sets, x: Array) -> Array:
    """The longest leg vector of all poses, shape (...)."""
    return np.max([norm(vectors).max(axis=-1) for vectors in _vectors(sets, x)], axis=0)


def _direction(vectors: Array) -> Array:
    """The mean direction of a set, (..., 3)."""
    total = _unit(vectors).sum(axis=-2)
    return np.where(norm(total)[..., None] > 0, _unit(total), (0.0, 0.0, 1.0))


def _unit(vectors: Array) -> Array:
    """Vectors of length 1, or 0."""
    length = norm(vectors)[..., None]
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)


def _axes(vectors: Array) -> Array:
    """The axes of the joint about the mean direction of a set, as rows, (..., 1, 3, 3)."""
    third = _direction(vectors)
    return np.concatenate([transpose(across(third)), third[..., None, :]], axis=-2)[..., None, :, :]


def _angles(vectors: Array, axes: Array) -> tuple[Array, Array]:
    """Both angles, (..., n, 2), and their derivatives by the leg vectors, (..., n, 2, 3); 0 where there are none."""
    x, y, z = np.moveaxis(matvec(axes, vectors), -1, 0)
    q = np.hypot(y, z)
    r2, zero = x * x + q * q, np.zeros_like(x)
    by_alpha = np.stack([zero, -z, y], axis=-1), q * q
    by_beta = np.stack([q * q, -x * y, -x * z], axis=-1), q * r2
    derivatives = [
        np.divide(up, by[..., None], out=np.zeros_like(up), where=by[..., None] > 0) for up, by in (by_alpha, by_beta)
    ]
    return np.stack([np.arctan2(-y, z), np.arctan2(x, q)], axis=-1), np.stack(derivatives, axis=-2) @ axes


@dataclass(frozen=True)
class _Angles:
    """The angles of all sets, about the axes of each."""

    sets: Sets
    axes: list[Array]

    @property
    def form(self) -> AgainstFirst:
        return AgainstFirst(tuple(loop.data.n_poses for loop in self.sets.loops))

    def exist(self, x: Array) -> BoolArray:
        """Whether no leg vector lies on the first axis, where there are no angles, shape (...)."""
        found = [
            (np.abs(matvec(axes, vectors)[..., 1:]) > 0).any(axis=-1).all(axis=-1)
            for vectors, axes in zip(_vectors(self.sets, x), self.axes, strict=True)
        ]
        return np.all(found, axis=0)

    def direct(self, x: Array) -> tuple[Array, Array, Array]:
        """Angles (..., n, 2) in all poses, their derivatives by s (..., n, 2, 3) and by x (..., n, 2, 6)."""
        found = [_angles(vectors, axes) for vectors, axes in zip(_vectors(self.sets, x), self.axes, strict=True)]
        rotations = [
            np.broadcast_to(loop.data.rotation, (*x.shape[:-1], *loop.data.rotation.shape[-3:]))
            for loop in self.sets.loops
        ]
        by_s = np.concatenate([derivative for _, derivative in found], axis=-3)
        by_b = by_s @ np.concatenate(rotations, axis=-3)
        return np.concatenate([angles for angles, _ in found], axis=-2), by_s, np.concatenate([by_b, -by_s], axis=-1)

    def changes(self, x: Array) -> tuple[Array, Array, Array]:
        """Residual (..., m), matrix (..., m, 6), and what the differences lost of its columns (..., 6)."""
        angles, _, direct = self.direct(x)
        return self.form.differences(angles, direct)

    def linearised(self, x: Array) -> LinearProblem:
        """The rows to first order about x, in the unknown change of x."""
        residual, matrix, lost = self.changes(x)
        return LinearProblem(
            matrix,
            -residual,
            self.sets.parameters.main,
            rows_per_block=2,
            form=self.form,
            noise=None if self.sets.loops[0].data.noise is None else ConstantRowNoise(self._covariance(x)),
            cancellation=lost,
            minimum_poses=3 + len(self.sets.loops),
            name=f"Sets of {len(self.sets.loops)} FixedDirection",
        )

    def _covariance(self, x: Array) -> RowCovariance:
        """Of the angles; what moves a leg vector along itself, such as its reading, moves no angle."""
        values = np.zeros((*x.shape[:-1], self.sets.parameters.size))
        values[..., : x.shape[-1]] = x
        places = [place for _, place in self.sets.parts]
        for loop, place, vectors in zip(self.sets.loops, places, _vectors(self.sets, x), strict=True):
            values[..., place[loop.parameters["direction"]]] = _direction(vectors)
        rows = JoinedNoise(self.sets.loops, tuple(places)).covariance(values)
        _, by_s, _ = self.direct(x)
        common = None if rows.common is None else by_s @ rows.common
        return RowCovariance(by_s @ rows.blocks @ transpose(by_s), common)
