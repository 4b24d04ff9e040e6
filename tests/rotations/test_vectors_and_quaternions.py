"""Rotation vectors and quaternions against scipy, the reference."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hexopt.errors import InputError
from hexopt.rotations import (
    matrix_to_quaternion,
    matrix_to_rotation_vector,
    quaternion_jacobian,
    quaternion_to_matrix,
    rotation_vector_jacobian,
    rotation_vector_to_matrix,
    skew,
)

ANGLES = [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 1e-3, 0.1, 1.0, 2.0, 3.0]
NEAR_PI = [np.pi - 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi - 1e-12, np.pi]
COORDINATE = st.floats(-1, 1)


def axes(n=40):
    axis = np.random.default_rng(0).standard_normal((n, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return np.vstack([axis, np.eye(3), -np.eye(3), [[0, 0.6, 0.8], [0.6, 0, -0.8], [-0.6, 0.8, 0]]])


@pytest.mark.parametrize("angle", ANGLES + NEAR_PI)
def test_matrix_of_a_vector_is_scipys(angle):
    expected = Rotation.from_rotvec(angle * axes()).as_matrix()
    np.testing.assert_allclose(rotation_vector_to_matrix(angle * axes()), expected, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_vector_comes_back_with_its_relative_digits(angle):
    vectors = angle * axes()
    found = matrix_to_rotation_vector(rotation_vector_to_matrix(vectors))
    np.testing.assert_allclose(found, vectors, atol=4e-15 * max(angle, 1e-2), rtol=0)


@pytest.mark.parametrize("angle", NEAR_PI)
def test_vector_near_pi_comes_back_up_to_its_sign(angle):
    """The sign of an axis is lost where 2(π − angle) is rounding; the rotation is not."""
    matrices = Rotation.from_rotvec(angle * axes()).as_matrix()
    found = matrix_to_rotation_vector(matrices)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), angle, atol=1e-14)
    np.testing.assert_allclose(rotation_vector_to_matrix(found), matrices, atol=4e-15)
    if angle < np.pi - 1e-10:
        np.testing.assert_allclose(found, angle * axes(), atol=1e-14)


def test_tiny_rotations_keep_their_relative_digits():
    """A matrix holds a small vector to 1e-16 absolutely through its antisymmetric part: no more is lost."""
    vectors = 1e-10 * axes()
    np.testing.assert_allclose(
        matrix_to_rotation_vector(rotation_vector_to_matrix(vectors)), vectors, rtol=1e-14, atol=1e-25
    )


@given(st.tuples(COORDINATE, COORDINATE, COORDINATE), st.floats(0, np.pi))
def test_any_vector(axis, angle):
    length = np.linalg.norm(axis)
    assume(length > 1e-3)
    vector = np.array(axis) / length * angle
    matrix = rotation_vector_to_matrix(vector)
    np.testing.assert_allclose(matrix, Rotation.from_rotvec(vector).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(rotation_vector_to_matrix(matrix_to_rotation_vector(matrix)), matrix, atol=3e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1e-2, 1.0, 3.0])
def test_vector_jacobian_is_the_central_difference(angle, central_difference):
    for axis in axes(3):
        vector = angle * axis
        turned = central_difference(rotation_vector_to_matrix, vector)
        cross = np.einsum("ijc,kj->ikc", turned, rotation_vector_to_matrix(vector))
        expected = np.stack([cross[2, 1], cross[0, 2], cross[1, 0]])
        np.testing.assert_allclose(rotation_vector_jacobian(vector), expected, atol=1e-11)


@pytest.mark.parametrize("order", ["xyzw", "wxyz"])
class TestQuaternions:
    def test_matrices_are_scipys(self, order):
        rotations = Rotation.random(300, rng=1)
        quaternions = rotations.as_quat(scalar_first=order == "wxyz")
        np.testing.assert_allclose(quaternion_to_matrix(quaternions, order), rotations.as_matrix(), atol=1e-15)

    def test_quaternions_are_scipys_up_to_sign(self, order):
        rotations = Rotation.random(300, rng=2)
        found = matrix_to_quaternion(rotations.as_matrix(), order)
        expected = rotations.as_quat(scalar_first=order == "wxyz")
        sign = np.sign((found * expected).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(sign * found, expected, atol=1e-15)

    @pytest.mark.parametrize("angle", [0.0, 1e-8, np.pi - 1e-8, np.pi])
    def test_every_pivot_round_trips(self, order, angle):
        matrices = Rotation.from_rotvec(angle * axes()).as_matrix()
        found = matrix_to_quaternion(matrices, order)
        np.testing.assert_allclose(quaternion_to_matrix(found, order), matrices, atol=2e-15)

    def test_jacobian_is_the_central_difference_along_the_sphere(self, order, central_difference):
        rng = np.random.default_rng(3)
        for _ in range(5):
            q = rng.standard_normal(4)
            q /= np.linalg.norm(q)
            tangent = np.linalg.svd(q[None])[2][1:].T  # changes that keep the norm
            turned = central_difference(
                lambda t, q=q, tangent=tangent: quaternion_to_matrix(
                    (q + tangent @ t) / np.linalg.norm(q + tangent @ t), order
                ),
                np.zeros(3),
            )
            cross = np.einsum("ijc,kj->ikc", turned, quaternion_to_matrix(q, order))
            expected = np.stack([cross[2, 1], cross[0, 2], cross[1, 0]])
            np.testing.assert_allclose(quaternion_jacobian(q, order) @ tangent, expected, atol=1e-10)

    def test_rounded_quaternions_are_normalised(self, order):
        q = np.round(Rotation.random(50, rng=4).as_quat(), 4)
        matrices = quaternion_to_matrix(q, order)
        np.testing.assert_allclose(
            matrices @ np.swapaxes(matrices, -1, -2), np.eye(3) * np.ones((50, 1, 1)), atol=1e-15
        )

    @pytest.mark.parametrize("scale", [0.0, 0.998, 1.002, 2.0])
    def test_a_norm_far_from_one_is_an_error(self, order, scale):
        with pytest.raises(InputError, match=r"quaternion.*index \(1,\).*norm"):
            quaternion_to_matrix([[0, 0, 0, 1.0], [0, 0, 0, scale]], order)


def test_the_two_orders_differ():
    q = [0.5, 0.1, -0.3, np.sqrt(1 - 0.35)]
    assert np.abs(quaternion_to_matrix(q, "xyzw") - quaternion_to_matrix(q, "wxyz")).max() > 0.1
    np.testing.assert_array_equal(quaternion_to_matrix(np.roll(q, 1), "wxyz"), quaternion_to_matrix(q, "xyzw"))


@pytest.mark.parametrize("order", ["xyz", "WXYZ", "zyxw", None])
def test_an_unknown_order_is_an_error(order):
    for function, argument in (
        (quaternion_to_matrix, [0, 0, 0, 1.0]),
        (matrix_to_quaternion, np.eye(3)),
        (quaternion_jacobian, [0, 0, 0, 1.0]),
    ):
        with pytest.raises(InputError, match="quaternion order"):
            function(argument, order)


def test_skew_is_the_cross_product():
    u, v = np.random.default_rng(5).standard_normal((2, 10, 3))
    np.testing.assert_allclose(np.einsum("nij,nj->ni", skew(u), v), np.cross(u, v), atol=1e-15)
