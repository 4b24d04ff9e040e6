"""Euler sequences, written as in SciPy: upper case intrinsic, lower case extrinsic."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, matvec
from ..errors import InputError
from .checks import check_rotation

__all__ = ["euler_angles", "euler_jacobian", "euler_to_matrix", "matrix_to_euler"]


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


def _parity(i: int, j: int) -> float:
    """+1 where the axes i, j and the third follow each other in cyclic order."""
    return 1.0 if (j - i) % 3 == 1 else -1.0


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
    sign = _parity(i, j)
    q = np.ascontiguousarray(np.moveaxis(q, -1, 0))  # one array an angle: the products below are then fast
    c1, c2, c3 = np.cos(q)
    s1, s2, s3 = sign * np.sin(q)  # an odd order of axes mirrors every angle
    out = np.empty((*q.shape[1:], 3, 3))
    if i == k:
        k = 3 - i - j
        out[..., i, i], out[..., i, j], out[..., i, k] = c2, s2 * s3, s2 * c3
        out[..., j, i], out[..., k, i] = s1 * s2, -c1 * s2
        out[..., j, j], out[..., j, k] = c1 * c3 - s1 * c2 * s3, -c1 * s3 - s1 * c2 * c3
        out[..., k, j], out[..., k, k] = s1 * c3 + c1 * c2 * s3, c1 * c2 * c3 - s1 * s3
    else:
        out[..., i, i], out[..., i, j], out[..., i, k] = c2 * c3, -c2 * s3, s2
        out[..., j, i], out[..., j, j], out[..., j, k] = c1 * s3 + s1 * s2 * c3, c1 * c3 - s1 * s2 * s3, -s1 * c2
        out[..., k, i], out[..., k, j], out[..., k, k] = s1 * s3 - c1 * s2 * c3, s1 * c3 + c1 * s2 * s3, c1 * c2
    return out


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
    return euler_angles(check_rotation("matrix", matrix), sequence)


def euler_angles(r: Array, sequence: str) -> Array:
    """:func:`matrix_to_euler` of matrices that are rotations already."""
    (i, j, k), extrinsic = _axes(sequence)
    proper = i == k
    if proper:
        k = 3 - i - j
    sign = _parity(i, j)
    if proper:
        first = np.arctan2(r[..., j, i], -sign * r[..., k, i] + 0.0)  # + 0.0: no −0, whose angle is π
        middle = np.arctan2(np.hypot(r[..., j, i], r[..., k, i]), r[..., i, i])
    else:
        first = np.arctan2(-sign * r[..., j, k], r[..., k, k])
        middle = np.arctan2(sign * r[..., i, k], np.hypot(r[..., j, k], r[..., k, k]))
    # the row e_j of R_i(first)' R depends on the third angle alone, whatever the middle one is
    row = np.cos(first)[..., None] * r[..., j, :] + sign * np.sin(first)[..., None] * r[..., k, :]
    third = np.arctan2(-sign * row[..., k], row[..., j]) if proper else np.arctan2(sign * row[..., i], row[..., j])
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
