"""Euler sequences against scipy, the reference."""

import itertools
import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hexopt.errors import InputError
from hexopt.rotations import euler_jacobian, euler_to_matrix, matrix_to_euler, rotation_vector_to_matrix

INTRINSIC = ["".join(axes) for axes in itertools.product("XYZ", repeat=3) if axes[0] != axes[1] != axes[2]]
SEQUENCES = INTRINSIC + [sequence.lower() for sequence in INTRINSIC]
ANGLE = st.floats(-np.pi, np.pi)


def test_there_are_24_sequences():
    assert len(set(SEQUENCES)) == 24


@pytest.mark.parametrize("sequence", SEQUENCES)
class TestAllSequences:
    def test_matrices_are_scipys(self, sequence):
        angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (200, 3))
        expected = Rotation.from_euler(sequence, angles).as_matrix()
        np.testing.assert_allclose(euler_to_matrix(angles, sequence), expected, atol=1e-15)

    def test_angles_are_scipys(self, sequence):
        matrices = Rotation.random(500, rng=1).as_matrix()
        expected = Rotation.from_matrix(matrices).as_euler(sequence)
        difference = matrix_to_euler(matrices, sequence) - expected
        np.testing.assert_allclose(np.angle(np.exp(1j * difference)), 0, atol=2e-13)

    @pytest.mark.parametrize("distance", [0.0, 1e-12, 1e-9, 1e-6, 1e-3])
    def test_round_trip_keeps_its_digits_at_and_near_the_singular_middle_angle(self, sequence, distance):
        proper = sequence[0] == sequence[2]
        middles = [0.0, np.pi] if proper else [np.pi / 2, -np.pi / 2]
        outer = np.random.default_rng(2).uniform(-np.pi, np.pi, (100, 2))
        for middle, side in itertools.product(middles, (-1, 1)):
            angles = np.insert(outer, 1, middle + side * distance, axis=1)
            matrices = Rotation.from_euler(sequence, angles).as_matrix()
            found = matrix_to_euler(matrices, sequence)
            np.testing.assert_allclose(euler_to_matrix(found, sequence), matrices, atol=2e-15)

    def test_middle_angle_is_in_its_range(self, sequence):
        middle = matrix_to_euler(Rotation.random(500, rng=3).as_matrix(), sequence)[:, 1]
        low, high = (0, np.pi) if sequence[0] == sequence[2] else (-np.pi / 2, np.pi / 2)
        assert low <= middle.min() < low + 0.5
        assert high - 0.5 < middle.max() <= high

    def test_identity_has_zero_angles(self, sequence):
        np.testing.assert_array_equal(matrix_to_euler(np.eye(3), sequence), 0)

    def test_jacobian_is_the_central_difference(self, sequence, central_difference):
        for angles in np.random.default_rng(4).uniform(-np.pi, np.pi, (5, 3)):
            turned = central_difference(lambda q: euler_to_matrix(q, sequence), angles)
            skew = np.einsum("ijc,kj->ikc", turned, euler_to_matrix(angles, sequence))
            expected = np.stack([skew[2, 1], skew[0, 2], skew[1, 0]])
            np.testing.assert_allclose(euler_jacobian(angles, sequence), expected, atol=1e-11)

    def test_batch_equals_its_members(self, sequence):
        angles = np.random.default_rng(5).uniform(-3, 3, (4, 5, 3))
        matrices = euler_to_matrix(angles, sequence)
        assert matrices.shape == (4, 5, 3, 3)
        assert euler_jacobian(angles, sequence).shape == (4, 5, 3, 3)
        np.testing.assert_array_equal(matrices[2, 3], euler_to_matrix(angles[2, 3], sequence))
        np.testing.assert_array_equal(
            matrix_to_euler(matrices, sequence)[2, 3], matrix_to_euler(matrices[2, 3], sequence)
        )
        np.testing.assert_array_equal(euler_jacobian(angles, sequence)[2, 3], euler_jacobian(angles[2, 3], sequence))


@given(sequence=st.sampled_from(SEQUENCES), angles=st.tuples(ANGLE, ANGLE, ANGLE))
def test_any_angles_give_scipys_matrix_and_come_back_to_it(sequence, angles):
    matrix = euler_to_matrix(angles, sequence)
    np.testing.assert_allclose(matrix, Rotation.from_euler(sequence, angles).as_matrix(), atol=1e-15)
    np.testing.assert_allclose(euler_to_matrix(matrix_to_euler(matrix, sequence), sequence), matrix, atol=2e-15)


def test_scipy_agrees_on_which_angles_are_singular():
    """At the singular angle scipy warns and sets one angle to zero; the product is what must agree."""
    angles = np.array([0.3, 0.0, 0.4])
    matrix = euler_to_matrix(angles, "ZXZ")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scipy's warning of gimbal lock
        theirs = Rotation.from_matrix(matrix).as_euler("ZXZ")
    np.testing.assert_allclose(matrix_to_euler(matrix, "ZXZ")[[0, 2]].sum(), theirs[[0, 2]].sum(), atol=1e-15)


def test_extrinsic_is_intrinsic_read_backwards():
    angles = np.array([0.1, -0.7, 1.9])
    np.testing.assert_allclose(euler_to_matrix(angles, "xyz"), euler_to_matrix(angles[::-1], "ZYX"), atol=1e-16)


def test_the_paper_s_sequence_is_written_out():
    psi, theta, phi = 0.3, 0.5, -0.2
    z, x = np.array([0, 0, 1.0]), np.array([1.0, 0, 0])
    expected = (
        rotation_vector_to_matrix(psi * z) @ rotation_vector_to_matrix(theta * x) @ rotation_vector_to_matrix(phi * z)
    )
    np.testing.assert_allclose(euler_to_matrix([psi, theta, phi]), expected, atol=1e-15)


@pytest.mark.parametrize("sequence", ["ZXx", "zXZ", "ZZX", "ZXX", "AXZ", "ZX", "ZXZX", "", 3, None, ("Z", "X", "Z")])
@pytest.mark.parametrize(
    "function", [euler_to_matrix, euler_jacobian, lambda _, sequence: matrix_to_euler(np.eye(3), sequence)]
)
def test_a_wrong_sequence_is_an_error_that_shows_a_right_one(function, sequence):
    with pytest.raises(InputError, match=r"Euler sequence: .*'ZXZ'"):
        function([0.1, 0.2, 0.3], sequence)
