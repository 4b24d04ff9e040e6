"""Damped Newton steps from a start to a pose, for many poses at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, frozen, matvec, norm, transpose
from ..numerics.lstsq import EPS
from ..result import Status
from .equations import LegEquations, condition_of, inverses

__all__ = ["MAX_ITERATIONS", "PoseSolution", "solve_poses"]

#: The largest misclosure of a solution, relative to the largest of the robot's coordinates and lengths.
TOLERANCE = 1e-12
#: From this condition number on, two solutions may have met within the rounding of the readings.
SINGULAR = 1.0 / np.sqrt(EPS)
LARGEST_STEP = 1.0  # in radii of the platform
SMALLEST_SHARE = 1e-6  # of a Newton step; what cannot take even that is stuck
MAX_ITERATIONS = 50


@dataclass(frozen=True, eq=False)
class PoseSolution:
    """Poses of the platform, one or a batch, and whether they can be trusted.

    Attributes
    ----------
    position : ndarray, shape (..., 3)
        NaN where the status is no success.
    rotation : ndarray, shape (..., 3, 3)
        NaN where the status is no success.
    codes : ndarray of int, shape (...)
        :class:`Status` of every pose: OPTIMAL; RANK_DEFICIENT where the legs do not hold the platform, at the start
        or in the end; NOT_CONVERGED where no solution was found on the start's side of all singular poses.
    residual : ndarray, shape (...)
        Largest misclosure of a leg in the end, length units.
    condition : ndarray, shape (...)
        Condition number of the Jacobian in the end, within a factor of 6, turns times the platform's radius.
    iterations : ndarray of int, shape (...)
    """

    position: Array
    rotation: Array
    codes: npt.NDArray[np.int8]
    residual: Array
    condition: Array
    iterations: npt.NDArray[np.int64]

    @property
    def status(self) -> Any:
        """A :class:`Status` for one pose, an object array of them for a batch."""
        if not self.codes.ndim:
            return Status(int(self.codes))
        return np.array([Status(int(code)) for code in self.codes.flat], dtype=object).reshape(self.codes.shape)

    @property
    def ok(self) -> Any:
        """Whether the status is a success: a bool, or an array of them."""
        good: BoolArray = np.asarray(self.codes) == Status.OPTIMAL
        return good if self.codes.ndim else bool(good)


def solve_poses(
    blocks: Mapping[str, Array],
    reading: Array,
    position: Array,
    rotation: Array,
    *,
    max_iterations: int = MAX_ITERATIONS,
) -> PoseSolution:
    """As :func:`forward_kinematics`, unchecked, for legs as stacked arrays that may differ between poses.

    Parameters
    ----------
    blocks : dict of str to ndarray
        "platform_point" and "base_point" (..., 6, 3), "offset" and "gain" (..., 6).
    reading, position, rotation : ndarray, shape (..., 6), (..., 3) and (..., 3, 3)
        The readings, and where to start. All leading dimensions are broadcast.
    """
    batch = np.broadcast_shapes(
        *(blocks[name].shape[:-2] for name in ("platform_point", "base_point")),
        *(blocks[name].shape[:-1] for name in ("offset", "gain")),
        *(reading.shape[:-1], position.shape[:-1], rotation.shape[:-2]),
    )
    equations = LegEquations.of(blocks, reading, batch)
    p = np.array(np.broadcast_to(position, (*batch, 3))).reshape(-1, 3)
    r = _orthonormal(np.broadcast_to(rotation, (*batch, 3, 3)).reshape(-1, 3, 3))
    first = condition_of(equations(p, r)[1])
    iterations = _newton(equations, p, r, max_iterations)
    misclosure, jacobian = equations(p, r)
    condition = condition_of(jacobian)
    closed = norm(misclosure) <= TOLERANCE * equations.size
    codes = np.where(closed, Status.OPTIMAL, Status.NOT_CONVERGED)
    codes[(first >= SINGULAR) | (closed & (condition >= SINGULAR))] = Status.RANK_DEFICIENT
    p[codes != Status.OPTIMAL], r[codes != Status.OPTIMAL] = np.nan, np.nan
    return PoseSolution(
        frozen(p.reshape(*batch, 3)),
        frozen(r.reshape(*batch, 3, 3)),
        codes.astype(np.int8).reshape(batch),
        np.abs(misclosure).max(axis=-1).reshape(batch),
        condition.reshape(batch),
        iterations.reshape(batch),
    )


def _newton(equations: LegEquations, position: Array, rotation: Array, max_iterations: int) -> npt.NDArray[np.int64]:
    """Move flat poses, in place, to where the misclosure is rounding, as far as they get; the iterations of each."""
    misclosure, jacobian = equations(position, rotation)
    size = norm(misclosure)
    inverse, determinant = inverses(jacobian)
    side = np.sign(determinant)
    share, tolerance = np.ones(len(size)), TOLERANCE * equations.size
    iterations = np.zeros(len(size), dtype=np.int64)
    active = np.isfinite(inverse).all(axis=(-2, -1)) & np.isfinite(size)
    for _ in range(max_iterations):
        (index,) = np.nonzero(active)
        if not index.size:
            break
        here = equations[index]
        full = -matvec(inverse[index], misclosure[index])
        longest = LARGEST_STEP * here.radius
        step = full * np.minimum(share[index], longest / np.maximum(norm(full), longest))[:, None]
        p, r = here.moved(position[index], rotation[index], step)
        new, new_jacobian = here(p, r)
        new_inverse, determinant = inverses(new_jacobian)
        good = (norm(new) < size[index]) & (np.sign(determinant) == side[index])
        active[index] = size[index] > tolerance[index]  # a step beyond the tolerance brings it to rounding
        kept = index[good]
        position[kept], rotation[kept], misclosure[kept] = p[good], r[good], new[good]
        inverse[kept], size[kept] = new_inverse[good], norm(new[good])
        share[index] = np.where(good, np.minimum(2.0 * share[index], 1.0), 0.25 * share[index])
        active[index] &= share[index] > SMALLEST_SHARE
        iterations[index] += 1
    return iterations


def _orthonormal(rotation: Array) -> Array:
    """Rotations to rounding from some that are orthonormal to 1e-6: two steps of Newton's for the polar factor."""
    for _ in range(2):
        rotation = rotation @ (1.5 * np.eye(3) - 0.5 * transpose(rotation) @ rotation)
    return rotation
