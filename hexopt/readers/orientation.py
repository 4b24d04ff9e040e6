"""Ways to write an orientation: their columns, and the way to and from matrices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..rotations import (
    check_rotation,
    euler_to_matrix,
    matrix_to_euler,
    matrix_to_quaternion,
    matrix_to_rotation_vector,
    quaternion_to_matrix,
    rotation_vector_to_matrix,
)

__all__ = ["QUATERNION", "OrientationKind", "orientation_kind"]

QUATERNION = "quaternion"


@dataclass(frozen=True)
class OrientationKind:
    """How an orientation stands in a file.

    Attributes
    ----------
    columns : tuple of str
    has_angles : bool
        Whether the values are angles, which need a unit.
    to_matrix, from_matrix : callable
        (..., len(columns)), with angles in radians, to (..., 3, 3) and back.
    """

    columns: tuple[str, ...]
    has_angles: bool
    to_matrix: Callable[[Array], Array]
    from_matrix: Callable[[Array], Array]


def _from_rows(values: Array) -> Array:
    return check_rotation("orientation", values.reshape(*values.shape[:-1], 3, 3))


def _to_rows(rotation: Array) -> Array:
    return rotation.reshape(*rotation.shape[:-2], 9)


def _names(suffixes: str) -> tuple[str, ...]:
    return tuple(f"orientation_{suffix}" for suffix in suffixes.split())


_KINDS = {
    QUATERNION: OrientationKind(_names("x y z w"), False, quaternion_to_matrix, matrix_to_quaternion),
    "matrix": OrientationKind(_names("11 12 13 21 22 23 31 32 33"), False, _from_rows, _to_rows),
    "rotation_vector": OrientationKind(_names("x y z"), True, rotation_vector_to_matrix, matrix_to_rotation_vector),
}


def orientation_kind(name: object) -> OrientationKind:
    """The kind called "quaternion", "matrix", "rotation_vector", or by an Euler sequence such as "ZXZ".

    Examples
    --------
    >>> orientation_kind("ZXZ").columns
    ('orientation_1', 'orientation_2', 'orientation_3')
    """
    if isinstance(name, str) and name in _KINDS:
        return _KINDS[name]
    try:
        euler_to_matrix(np.zeros(3), name)  # type: ignore[arg-type]  # a wrong type is the error below
    except InputError:
        raise InputError(
            f"orientation: expected {', '.join(_KINDS)}, or an Euler sequence such as ZXZ (intrinsic) or zxz "
            f"(extrinsic); got {name!r}"
        ) from None
    sequence = str(name)
    return OrientationKind(
        _names("1 2 3"), True, partial(euler_to_matrix, sequence=sequence), partial(matrix_to_euler, sequence=sequence)
    )
