"""Rotation vectors: axis times angle, in radians."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, norm
from .checks import skew
from .quaternions import matrix_to_quaternion

__all__ = ["matrix_to_rotation_vector", "rotation_vector_jacobian", "rotation_vector_to_matrix"]

_SMALL_ANGLE = 1e-4  # below it, series in the angle are exact to rounding


def _rodrigues(angle: Array) -> tuple[Array, Array, Array]:
    """sin t / t, (1 − cos t) / t², (t − sin t) / t³, by series near zero."""
    small = angle < _SMALL_ANGLE
    t = np.where(small, 1.0, angle)
    square = angle * angle
    half = np.sin(0.5 * t) / t
    return (
        np.where(small, 1.0 - square / 6.0, np.sin(t) / t),
        np.where(small, 0.5 - square / 24.0, 2.0 * half * half),
        np.where(small, 1.0 / 6.0 - square / 120.0, (t - np.sin(t)) / t**3),
    )


def rotation_vector_to_matrix(vector: npt.ArrayLike) -> Array:
    r"""Rodrigues: :math:`\exp([v]_\times)`.

    With :math:`t = \lVert v\rVert`, this is
    :math:`I + \frac{\sin t}{t}[v]_\times + \frac{1-\cos t}{t^2}[v]_\times^2`.

    Parameters
    ----------
    vector : array_like, shape (..., 3)
        Axis times angle, radians.

    Returns
    -------
    ndarray, shape (..., 3, 3)

    Examples
    --------
    >>> rotation_vector_to_matrix([0.0, 0.0, np.pi / 2]).round(12) @ [1.0, 0.0, 0.0]
    array([0., 1., 0.])
    """
    v = as_array("vector", vector, (3,))
    sine, cosine, _ = _rodrigues(norm(v))
    cross = skew(v)
    return np.eye(3) + sine[..., None, None] * cross + cosine[..., None, None] * (cross @ cross)


def rotation_vector_jacobian(vector: npt.ArrayLike) -> Array:
    r"""Left Jacobian of SO(3), :math:`\delta\omega = J\,dv`, shape (..., 3, 3).

    :math:`J = I + \frac{1-\cos t}{t^2}[v]_\times + \frac{t-\sin t}{t^3}[v]_\times^2`.
    """
    v = as_array("vector", vector, (3,))
    _, cosine, cubic = _rodrigues(norm(v))
    cross = skew(v)
    return np.eye(3) + cosine[..., None, None] * cross + cubic[..., None, None] * (cross @ cross)


def matrix_to_rotation_vector(matrix: npt.ArrayLike) -> Array:
    r"""Axis times angle (rad, angle in :math:`[0, \pi]`) of rotation matrices, shape (..., 3)."""
    q = matrix_to_quaternion(matrix)
    q = np.where(q[..., 3:] < 0, -q, q)
    imaginary = q[..., :3]
    sine = norm(imaginary)
    angle = 2.0 * np.arctan2(sine, q[..., 3])
    factor = np.where(sine < _SMALL_ANGLE, 2.0 + sine * sine / 3.0, angle / np.where(sine == 0, 1.0, sine))
    vector: Array = factor[..., None] * imaginary
    return vector
