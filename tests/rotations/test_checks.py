"""check_rotation: the gate for rotation matrices."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexopt.errors import InputError
from hexopt.rotations import check_rotation, matrix_to_euler, matrix_to_quaternion, matrix_to_rotation_vector


def rotations():
    return Rotation.random(6, rng=0).as_matrix().reshape(2, 3, 3, 3)


def test_rotations_pass_unchanged_and_read_only():
    given = rotations()
    checked = check_rotation("R", given)
    np.testing.assert_array_equal(checked, given)
    assert not checked.flags.writeable
    assert given.flags.writeable


def test_rounding_to_seven_digits_passes():
    check_rotation("R", np.round(rotations(), 7))


def test_no_rotation_at_all_passes():
    assert check_rotation("R", np.empty((0, 3, 3))).shape == (0, 3, 3)


SHEAR = np.eye(3) + 1e-4 * np.eye(3, k=1)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: 1.001 * r, "not orthonormal"),
        (lambda r: r @ SHEAR, "not orthonormal"),
        (lambda r: SHEAR @ r, "not orthonormal"),
        (lambda r: np.round(r, 3), "not orthonormal"),
        (lambda r: 0 * r, "not orthonormal"),
        (lambda r: r * [1.0, 1.0, -1.0], "left-handed"),
        (lambda r: r[:, [1, 0, 2]], "left-handed"),
        (lambda r: -r, "left-handed"),
    ],
    ids=["scaled", "sheared", "sheared-rows", "rounded", "zero", "reflected", "swapped", "inverted"],
)
def test_a_bad_matrix_is_named_by_its_index(spoil, message):
    matrices = rotations()
    matrices[1, 2] = spoil(matrices[1, 2])
    with pytest.raises(InputError, match=rf"pose R: the matrix at index \(1, 2\) is {message}"):
        check_rotation("pose R", matrices)
    with pytest.raises(InputError, match=rf"pose R: the matrix is {message}"):
        check_rotation("pose R", matrices[1, 2])


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nan_is_an_error(value):
    matrices = rotations()
    matrices[0, 1, 2, 0] = value
    with pytest.raises(InputError, match=r"NaN or infinite.*\(0, 1, 2, 0\)"):
        check_rotation("R", matrices)


@pytest.mark.parametrize("shape", [(3,), (3, 2), (4, 4), (9,)])
def test_a_wrong_shape_is_an_error(shape):
    with pytest.raises(InputError, match=r"expected shape \(\.\.\., 3, 3\)"):
        check_rotation("R", np.ones(shape))


@pytest.mark.parametrize("function", [matrix_to_euler, matrix_to_quaternion, matrix_to_rotation_vector])
def test_every_conversion_checks(function):
    with pytest.raises(InputError, match="left-handed"):
        function(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(InputError, match="orthonormal"):
        function(1.01 * np.eye(3))
