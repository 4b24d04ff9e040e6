r"""Rotations as matrices: Euler sequences, rotation vectors and quaternions, batched, with derivatives.

All matrices take platform vectors to base vectors. The derivatives are *spatial*: a small change of
the coordinates, :math:`dq`, turns the matrix by :math:`R \to \exp([\delta\omega]_\times) R` with
:math:`\delta\omega = J(q)\,dq`; each function ``*_jacobian`` returns :math:`J`.
Euler sequences are written as in SciPy: ``"ZXZ"`` intrinsic, ``"zxz"`` extrinsic; angles in radians.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .arrays import Array, as_array, matvec, norm, transpose
from .errors import InputError

__all__ = [
    "check_rotation",
    "euler_jacobian",
    "euler_to_matrix",
    "matrix_to_euler",
    "matrix_to_quaternion",
    "matrix_to_rotation_vector",
    "quaternion_jacobian",
    "quaternion_to_matrix",
    "rotation_vector_jacobian",
    "rotation_vector_to_matrix",
    "skew",
]

ORTHONORMALITY_TOLERANCE = 1e-6
_SMALL_ANGLE = 1e-4  # below it, series in the angle are exact to rounding


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
    error = np.abs(transpose(rotation) @ rotation - np.eye(3)).max(axis=(-2, -1))
    if (error > tolerance).any():
        where = np.unravel_index(int(np.argmax(error)), error.shape)
        raise InputError(
            f"{name}: the matrix{_at(where)} is not orthonormal (R'R differs from the identity by "
            f"{error[where]:.1e}, allowed {tolerance:.0e}); is it scaled, or rounded to few digits?"
        )
    x, y, z = rotation[..., 0], rotation[..., 1], rotation[..., 2]
    handedness = np.einsum("...i,...i->...", np.cross(x, y), z)
    if (handedness < 0).any():
        where = np.unravel_index(int(np.argmin(handedness)), handedness.shape)
        raise InputError(
            f"{name}: the matrix{_at(where)} is left-handed (determinant −1): a reflection, no "
            "rotation; check the order and signs of its axes"
        )
    return rotation


def _at(where: tuple[np.intp, ...]) -> str:
    return f" at index {tuple(int(i) for i in where)}" if where else ""


# --- Euler angles ---------------------------------------------------------------------------------


def _axes(sequence: str) -> tuple[tuple[int, int, int], bool]:
    """Axis numbers in intrinsic order, and whether the angles must be read backwards (extrinsic)."""
    extrinsic = isinstance(sequence, str) and sequence.islower()
    if (
        not isinstance(sequence, str)
        or len(sequence) != 3
        or not (extrinsic or sequence.isupper())
        or set(sequence.lower()) - set("xyz")
        or sequence[0] == sequence[1]
        or sequence[1] == sequence[2]
    ):
        raise InputError(
            f"Euler sequence: expected three axes such as 'ZXZ' (intrinsic) or 'zxz' (extrinsic), "
            f"no axis twice in a row; got {sequence!r}"
        )
    first, second, third = ("xyz".index(letter) for letter in sequence.lower())
    return ((third, second, first) if extrinsic else (first, second, third)), extrinsic


def _axis_rotation(axis: int, angle: Array) -> Array:
    out = np.zeros((*angle.shape, 3, 3))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    cosine, sine = np.cos(angle), np.sin(angle)
    out[..., axis, axis] = 1.0
    out[..., j, j] = out[..., k, k] = cosine
    out[..., k, j], out[..., j, k] = sine, -sine
    return out


def euler_to_matrix(angles: npt.ArrayLike, sequence: str = "ZXZ") -> Array:
    r"""Rotation matrices :math:`R = R_i(\psi) R_j(\theta) R_k(\varphi)` of an intrinsic sequence ijk.

    Parameters
    ----------
    angles : array_like, shape (..., 3)
        Angles in radians, in the order of `sequence`.
    sequence : str, default "ZXZ"
        Upper case: intrinsic (axes move with the body), lower case: extrinsic (fixed axes).

    Returns
    -------
    ndarray, shape (..., 3, 3)

    Raises
    ------
    InputError
        For an unknown sequence or angles that are not finite.

    Examples
    --------
    >>> euler_to_matrix([np.pi / 2, 0.0, 0.0], "ZXZ").round(12) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    (i, j, k), extrinsic = _axes(sequence)
    q = as_array("angles", angles, (3,))
    if extrinsic:
        q = q[..., ::-1]
    return _axis_rotation(i, q[..., 0]) @ _axis_rotation(j, q[..., 1]) @ _axis_rotation(k, q[..., 2])


def matrix_to_euler(matrix: npt.ArrayLike, sequence: str = "ZXZ") -> Array:
    r"""Euler angles of rotation matrices; the inverse of :func:`euler_to_matrix`.

    The middle angle is in :math:`[0, \pi]` when the first and third axes agree, else in
    :math:`[-\pi/2, \pi/2]`. At the singular middle angle only a sum or difference of the other two
    is defined: the first is then 0 (or whatever rounding leaves), and the product is still exact.

    Parameters
    ----------
    matrix : array_like, shape (..., 3, 3)
    sequence : str, default "ZXZ"

    Returns
    -------
    ndarray, shape (..., 3)
        Angles in radians.
    """
    (i, j, k), extrinsic = _axes(sequence)
    r = check_rotation("matrix", matrix)
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    if proper:
        first = np.arctan2(r[..., j, i], -sign * r[..., k, i])
        middle = np.arctan2(np.hypot(r[..., j, i], r[..., k, i]), r[..., i, i])
    else:
        first = np.arctan2(-sign * r[..., j, k], r[..., k, k])
        middle = np.arctan2(sign * r[..., i, k], np.hypot(r[..., j, k], r[..., k, k]))
    # the row e_j of R_i(first)' R depends on the third angle alone, whatever the middle one is
    row = np.cos(first)[..., None] * r[..., j, :] + sign * np.sin(first)[..., None] * r[..., k, :]
    third = (
        np.arctan2(-sign * row[..., k], row[..., j])
        if proper
        else np.arctan2(sign * row[..., i], row[..., j])
    )
    angles = np.stack([first, middle, third], axis=-1)
    return angles[..., ::-1].copy() if extrinsic else angles


def euler_jacobian(angles: npt.ArrayLike, sequence: str = "ZXZ") -> Array:
    r"""Spatial Jacobian of Euler angles: :math:`\delta\omega = [e_i,\; R_i e_j,\; R_i R_j e_k]\,dq`.

    Parameters
    ----------
    angles : array_like, shape (..., 3)
        Radians.
    sequence : str, default "ZXZ"

    Returns
    -------
    ndarray, shape (..., 3, 3)
    """
    (i, j, k), extrinsic = _axes(sequence)
    q = as_array("angles", angles, (3,))
    if extrinsic:
        q = q[..., ::-1]
    first = _axis_rotation(i, q[..., 0])
    out = np.zeros((*q.shape, 3))
    out[..., i, 0] = 1.0
    out[..., :, 1] = first[..., :, j]
    out[..., :, 2] = matvec(first, _axis_rotation(j, q[..., 1])[..., :, k])
    return out[..., ::-1].copy() if extrinsic else out


# --- rotation vectors -----------------------------------------------------------------------------


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
    r"""Rodrigues: :math:`\exp([v]_\times) = I + \frac{\sin t}{t}[v]_\times
    + \frac{1-\cos t}{t^2}[v]_\times^2`, :math:`t = \lVert v\rVert` (rad).

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
    r"""Left Jacobian of SO(3): :math:`\delta\omega = (I + \frac{1-\cos t}{t^2}[v]_\times
    + \frac{t-\sin t}{t^3}[v]_\times^2)\,dv`, shape (..., 3, 3).
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


# --- quaternions ----------------------------------------------------------------------------------


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
            f"quaternion{_at(where)}: its norm is {length[where]:.6g}, expected 1 (within 1e-3); "
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
    r"""Spatial Jacobian of a unit quaternion: :math:`\delta\omega = 2\,\mathrm{vec}(dq\,\bar q)`, (..., 3, 4)."""
    q = _scalar_last(quaternion, order)
    vector, scalar = q[..., :3], q[..., 3]
    out = np.empty((*scalar.shape, 3, 4))
    out[..., :3] = 2 * (scalar[..., None, None] * np.eye(3) + skew(vector))
    out[..., 3] = -2 * vector
    return np.roll(out, 1, axis=-1) if order == "wxyz" else out
