r"""Leg vectors, true lengths and readings of a pose, and whether a robot can reach it."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from .arrays import Array, BoolArray, as_array, matvec, norm
from .geometry import Hexapod
from .rotations import check_rotation, matrix_to_euler

__all__ = ["inverse_kinematics", "leg_lengths", "leg_vectors", "limit_violations", "reachable"]


def leg_vectors(robot: Hexapod, position: npt.ArrayLike, rotation: npt.ArrayLike) -> Array:
    r"""Leg vectors :math:`s_k = P + R\,b_k - a_k`.

    Parameters
    ----------
    robot : Hexapod
    position : array_like, shape (..., 3)
    rotation : array_like, shape (..., 3, 3)

    Returns
    -------
    ndarray, shape (..., 6, 3)

    References
    ----------
    Daney (1998), eq. (2).
    """
    p = as_array("position", position, (3,))
    r = check_rotation("rotation", rotation)
    vectors: Array = p[..., None, :] + robot.platform_points @ np.swapaxes(r, -1, -2) - robot.base_points
    return vectors


def leg_lengths(robot: Hexapod, position: npt.ArrayLike, rotation: npt.ArrayLike) -> Array:
    r"""True leg lengths :math:`\ell_k = \lVert P + R\,b_k - a_k\rVert`, shape (..., 6), length units."""
    return norm(leg_vectors(robot, position, rotation))


def inverse_kinematics(robot: Hexapod, position: npt.ArrayLike, rotation: npt.ArrayLike) -> Array:
    r"""Sensor readings :math:`\rho_k = (\lVert P + R\,b_k - a_k\rVert - \delta_k)/\gamma_k` of a pose.

    Parameters
    ----------
    robot : Hexapod
    position : array_like, shape (..., 3)
        :math:`P`, length units of the robot.
    rotation : array_like, shape (..., 3, 3)
        :math:`R`, platform to base.

    Returns
    -------
    ndarray, shape (..., 6)
        Readings, in reading units; with offset 0 and gain 1 they are the true lengths.

    Raises
    ------
    InputError
        For wrong shapes, values that are not finite, or matrices that are no rotations.

    References
    ----------
    Daney (1998), eq. (18).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> hx.inverse_kinematics(hx.robots.left_hand(), [0.0, 0.0, 19.0], np.eye(3)).round(3)
    array([4.977, 4.977, 4.996, 4.996, 4.996, 4.996])
    """
    return (leg_lengths(robot, position, rotation) - robot.offsets) / robot.gains


def limit_violations(robot: Hexapod, position: npt.ArrayLike, rotation: npt.ArrayLike) -> dict[str, BoolArray]:
    """For every limit of the robot that binds: which poses violate it, by the limit's name.

    Returns
    -------
    dict of str to ndarray of bool, shape (...)
    """
    limits = robot.limits
    vectors = leg_vectors(robot, position, rotation)
    lengths = norm(vectors)
    r = np.asarray(rotation, dtype=float)
    out: dict[str, Any] = {}  # NumPy's own types say that a mask may be a scalar
    if limits.leg_length is not None:
        low, high = limits.leg_length
        out["leg_length"] = ((lengths < low) | (lengths > high)).any(axis=-1)
    if limits.leg_tilt is not None:
        cosine = np.einsum("...ki,ki->...k", vectors, robot.home_vectors) / (lengths * robot.home_lengths)
        out["leg_tilt"] = (cosine < np.cos(limits.leg_tilt)).any(axis=-1)
    if limits.base_tilt is not None:
        out["base_tilt"] = (np.abs(vectors[..., 2]) < np.cos(limits.base_tilt) * lengths).any(axis=-1)
    if limits.tilt is not None:
        # |R e_z − e_z| = 2 sin(tilt/2) keeps its digits where the cosine of a small tilt does not
        chord = np.hypot(np.hypot(r[..., 0, 2], r[..., 1, 2]), r[..., 2, 2] - 1.0)
        out["tilt"] = chord > 2 * np.sin(limits.tilt / 2)
    if limits.angles is not None:
        angles = matrix_to_euler(robot.home_rotation.T @ r, limits.sequence)
        out["angles"] = (np.abs(angles) > np.asarray(limits.angles) + 1e-12).any(axis=-1)
    if limits.position is not None:
        travel = np.abs(np.asarray(position, dtype=float) - robot.home_position)
        out["position"] = (travel > np.asarray(limits.position)).any(axis=-1)
    return out


def reachable(robot: Hexapod, position: npt.ArrayLike, rotation: npt.ArrayLike) -> BoolArray:
    """Whether each pose respects every limit of the robot, all six legs included.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> reachable(robot, [[0.0, 0.0, 19.0], [0.0, 0.0, 40.0]], np.stack([np.eye(3)] * 2))
    array([ True, False])
    """
    inside = np.ones(np.broadcast_shapes(np.shape(position)[:-1], np.shape(rotation)[:-2]), dtype=bool)
    for violated in limit_violations(robot, position, rotation).values():
        inside &= ~violated
    return inside


def leg_vector(platform_point: Array, base_point: Array, position: Array, rotation: Array) -> Array:
    r"""One leg's vectors :math:`s_i = P_i + R_i b - a` over poses, (..., n, 3); points are (..., 3)."""
    return position + matvec(rotation, platform_point[..., None, :]) - base_point[..., None, :]
