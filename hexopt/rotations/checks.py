"""Is a matrix a rotation? And the cross-product matrix."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import InputError

__all__ = ["at_index", "check_rotation", "skew", "turning_columns"]

ORTHONORMALITY_TOLERANCE = 1e-6


def skew(vector: npt.ArrayLike) -> Array:
    r"""The matrix :math:`[v]_\times` with :math:`[v]_\times u = v \times u`, shape (..., 3, 3).

    Examples
    --------
    >>> skew([1.0, 2.0, 3.0]) @ [0.0, 0.0, 1.0]
    array([ 2., -1.,  0.])
    """
    v = as_array("vector", vector, (3,))
    out = np.zeros((*v.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    out[..., 1, 2], out[..., 2, 0], out[..., 0, 1] = -v[..., 0], -v[..., 1], -v[..., 2]
    return out


def check_rotation(name: str, matrix: npt.ArrayLike, *, tolerance: float = ORTHONORMALITY_TOLERANCE) -> Array:
    r"""`matrix` as checked rotations: :math:`R^T R = I` and :math:`\det R = +1`.

    Raises
    ------
    InputError
        If a matrix is scaled, sheared or left-handed beyond `tolerance` (largest entry of
        :math:`R^T R - I`); the message names the first bad one.
    """
    rotation = as_array(name, matrix, (3, 3))
    if rotation.size == 0:
        return rotation
    x, y, z = rotation[..., 0], rotation[..., 1], rotation[..., 2]
    error = np.asarray(np.abs(_dot(x, x) - 1.0))
    for left, right, product in ((y, y, 1.0), (z, z, 1.0), (x, y, 0.0), (x, z, 0.0), (y, z, 0.0)):
        np.maximum(error, np.abs(_dot(left, right) - product), out=error)
    if (error > tolerance).any():
        where = np.unravel_index(int(np.argmax(error)), error.shape)
        raise InputError(
            f"{name}: the matrix{at_index(where)} is not orthonormal (R'R differs from the identity by "
            f"{error[where]:.1e}, allowed {tolerance:.0e}); is it scaled, or rounded to few digits?"
        )
    handedness = (  # (x × y)·z, the determinant; numpy.cross is slow
        (x[..., 1] * y[..., 2] - x[..., 2] * y[..., 1]) * z[..., 0]
        + (x[..., 2] * y[..., 0] - x[..., 0] * y[..., 2]) * z[..., 1]
        + (x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]) * z[..., 2]
    )
    if (handedness < 0).any():
        where = np.unravel_index(int(np.argmin(handedness)), handedness.shape)
        raise InputError(
            f"{name}: the matrix{at_index(where)} is left-handed (determinant −1): a reflection, no "
            "rotation; check the order and signs of its axes"
        )
    return rotation


def turning_columns(arm: Array) -> Array:
    r"""How a turned vector moves, :math:`\partial(R b)/\partial\omega = -[R b]_\times`, (..., 3, 3), unchecked.

    `arm` is :math:`R b`, (..., 3).
    """
    out = np.zeros((*arm.shape, 3))
    out[..., 1, 2], out[..., 2, 0], out[..., 0, 1] = arm[..., 0], arm[..., 1], arm[..., 2]
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = -arm[..., 0], -arm[..., 1], -arm[..., 2]
    return out


def _dot(left: Array, right: Array) -> Array:
    # asarray: a single matrix gives a scalar, and the caller writes into the result
    return np.asarray(np.einsum("...i,...i->...", left, right))


def at_index(where: tuple[np.intp, ...]) -> str:
    """Words for an index in an error message; nothing for a single matrix."""
    return f" at index {tuple(int(i) for i in where)}" if where else ""
