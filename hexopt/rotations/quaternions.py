"""Unit quaternions, scalar last or first."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import InputError
from .checks import at_index, check_rotation, skew

__all__ = ["matrix_to_quaternion", "quaternion_jacobian", "quaternion_to_matrix"]


def _scalar_last(quaternion: npt.ArrayLike, order: str) -> Array:
    q = as_array("quaternion", quaternion, (4,))
    if order == "xyzw":
        return q
    if order == "wxyz":
        return np.roll(q, -1, axis=-1)
    raise InputError(f"quaternion order: expected 'xyzw' (scalar last) or 'wxyz', got {order!r}")


def quaternion_to_matrix(quaternion: npt.ArrayLike, order: str = "xyzw") -> Array:
    r"""Rotation matrices of unit quaternions.

    Parameters
    ----------
    quaternion : array_like, shape (..., 4)
        Normalised here; a norm that differs from 1 by more than 1e-3 is an error.
    order : {"xyzw", "wxyz"}
        Scalar last (default) or first.

    Returns
    -------
    ndarray, shape (..., 3, 3)

    Raises
    ------
    InputError
        If a quaternion is far from unit length, or the order is unknown.

    Examples
    --------
    >>> quaternion_to_matrix([0.0, 0.0, 0.0, 1.0])
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    q = _scalar_last(quaternion, order)
    length = np.sqrt(np.einsum("...i,...i->...", q, q))
    if (np.abs(length - 1.0) > 1e-3).any():
        where = np.unravel_index(int(np.argmax(np.abs(length - 1.0))), length.shape)
        raise InputError(
            f"quaternion{at_index(where)}: its norm is {length[where]:.6g}, expected 1 (within 1e-3); "
            "is a column missing or the order wrong?"
        )
    x, y, z, w = np.moveaxis(q / length[..., None], -1, 0)
    out = np.empty((*length.shape, 3, 3))
    out[..., 0, 0], out[..., 0, 1], out[..., 0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - z * w),
        2 * (x * z + y * w),
    )
    out[..., 1, 0], out[..., 1, 1], out[..., 1, 2] = (
        2 * (x * y + z * w),
        1 - 2 * (x * x + z * z),
        2 * (y * z - x * w),
    )
    out[..., 2, 0], out[..., 2, 1], out[..., 2, 2] = (
        2 * (x * z - y * w),
        2 * (y * z + x * w),
        1 - 2 * (x * x + y * y),
    )
    return out


def matrix_to_quaternion(matrix: npt.ArrayLike, order: str = "xyzw") -> Array:
    """Unit quaternions of rotation matrices (Shepperd's choice of pivot; sign is not fixed), (..., 4)."""
    r = check_rotation("matrix", matrix)
    xx, yy, zz = r[..., 0, 0], r[..., 1, 1], r[..., 2, 2]
    trace = xx + yy + zz
    # the four columns are 4 q_k q: the longest of them is well away from zero
    columns = np.empty((*trace.shape, 4, 4))
    columns[..., 0, 0], columns[..., 1, 1], columns[..., 2, 2] = (
        1 + 2 * xx - trace,
        1 + 2 * yy - trace,
        1 + 2 * zz - trace,
    )
    columns[..., 3, 3] = 1 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        columns[..., i, j] = columns[..., j, i] = r[..., i, j] + r[..., j, i]
        columns[..., k, 3] = columns[..., 3, k] = r[..., j, i] - r[..., i, j]
    pivot = np.argmax(np.diagonal(columns, axis1=-2, axis2=-1), axis=-1)
    q = np.take_along_axis(columns, pivot[..., None, None], axis=-1)[..., 0]
    q = q / np.sqrt(np.einsum("...i,...i->...", q, q))[..., None]
    if order == "wxyz":
        return np.roll(q, 1, axis=-1)
    return _scalar_last(q, order)


def quaternion_jacobian(quaternion: npt.ArrayLike, order: str = "xyzw") -> Array:
    r"""Spatial Jacobian of unit quaternions: :math:`\delta\omega = 2\,\mathrm{vec}(dq\,\bar q)`, (..., 3, 4)."""
    q = _scalar_last(quaternion, order)
    vector, scalar = q[..., :3], q[..., 3]
    out = np.empty((*scalar.shape, 3, 4))
    out[..., :3] = 2 * (scalar[..., None, None] * np.eye(3) + skew(vector))
    out[..., 3] = -2 * vector
    return np.roll(out, 1, axis=-1) if order == "wxyz" else out
