"""The peers: loops that a user would write with SciPy's Rotation and numpy.linalg.lstsq (Type I)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

import hexopt as hx

__all__ = ["plain_loop"]


def plain_loop(
    leg: hx.Leg,
    home: np.ndarray,
    ranges: hx.PoseRanges,
    n_poses: int,
    n_sets: int,
    err: float,
    rng: np.random.Generator,
    *,
    by_pose: bool,
) -> np.ndarray:
    """Errors of (a, b) of `n_sets` sets, one set after the other, as section 4 of the paper spells it out.

    `by_pose` turns one pose after the other into a matrix; otherwise SciPy gets all poses of a set at once.
    """

    def matrices(angles: np.ndarray) -> np.ndarray:
        if by_pose:
            return np.array([Rotation.from_euler(ranges.sequence, angle).as_matrix() for angle in angles])
        return Rotation.from_euler(ranges.sequence, angles).as_matrix()

    a, b = leg.base_point, leg.platform_point
    tilt = Rotation.align_vectors([home], [[0, 0, 1]])[0]  # once, not in the loop: as fast as a plain loop gets
    errors = []
    for _ in range(n_sets):
        height, around = rng.uniform(np.cos(ranges.lock_cone), 1.0), rng.uniform(0.0, 2 * np.pi)
        radius = np.sqrt(1.0 - height**2)
        n = tilt.apply([radius * np.cos(around), radius * np.sin(around), height])
        angles = rng.uniform(-1.0, 1.0, (n_poses, 3)) * ranges.angles
        length = rng.uniform(ranges.length[0], ranges.length[1], n_poses)
        rotation = matrices(angles)
        position = a + length[:, None] * n - rotation @ b

        position = position + rng.uniform(-err, err, position.shape)
        noisy_angles = angles + np.deg2rad(rng.uniform(-err, err, angles.shape))
        rotation = matrices(noisy_angles)
        length = length + rng.uniform(-err, err, n_poses)

        matrix, rhs = [], []
        for i in range(n_poses - 1):
            left = length[i] * rotation[i + 1] - length[i + 1] * rotation[i]
            matrix.append(np.hstack([left, (length[i + 1] - length[i]) * np.eye(3)]))
            rhs.append(length[i + 1] * position[i] - length[i] * position[i + 1])
        x = np.linalg.lstsq(np.vstack(matrix), np.concatenate(rhs))[0]
        errors.append([np.linalg.norm(x[3:] - a), np.linalg.norm(x[:3] - b)])
    return np.array(errors)
