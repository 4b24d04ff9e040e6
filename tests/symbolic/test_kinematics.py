"""CasADi's forward kinematics: round trips, NumPy's answer, and failures that are admitted."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError

symbolic = hx.symbolic


def test_round_trips(robot):
    data = hx.simulate(robot, n_poses=5, rng=0)
    turn = hx.rotations.rotation_vector_to_matrix([1e-3, -1e-3, 1e-3])
    for i in range(5):
        start = data.position[i] + 0.003 * robot.size, turn @ data.rotation[i]
        found = symbolic.forward_kinematics(robot, data.length[i], *start)
        assert found.success
        np.testing.assert_allclose(found.position, data.position[i], rtol=0, atol=1e-11 * robot.size)
        np.testing.assert_allclose(found.rotation, data.rotation[i], rtol=0, atol=1e-11)
        readings = symbolic.inverse_kinematics(robot, found.position, found.rotation)
        assert np.abs(readings - data.length[i]).max() * np.abs(robot.gains).max() <= 1e-12 * robot.size
        assert found.closure <= 1e-12 * robot.size


def test_from_home_it_finds_a_pose_of_these_readings(robot):
    """Which of them is home's: on a robot whose joints coincide it may be another than was measured."""
    data = hx.simulate(robot, n_poses=5, rng=0)
    for i in range(5):
        found = symbolic.forward_kinematics(robot, data.length[i])
        assert found.success
        readings = hx.inverse_kinematics(robot, found.position, found.rotation)
        assert np.abs(readings - data.length[i]).max() * np.abs(robot.gains).max() <= 1e-12 * robot.size


def test_it_is_what_numpy_finds(left_hand):
    """From the same start, on readings that fit no simulated pose exactly."""
    data = hx.simulate(left_hand, n_poses=10, noise=hx.UniformNoise(0.05, 0.01, 0.3), rng=1)
    poses = hx.forward_kinematics(left_hand, data.length, data.position, data.rotation)
    for i in range(10):
        found = symbolic.forward_kinematics(left_hand, data.length[i], data.position[i], data.rotation[i])
        assert found.success
        np.testing.assert_allclose(found.position, poses.position[i], rtol=0, atol=1e-10)
        np.testing.assert_allclose(found.rotation, poses.rotation[i], rtol=0, atol=1e-11)


@pytest.mark.parametrize("length", [np.full(6, -1e3), [5.0, 5.0, 5.0, 5.0, 5.0, 90.0]])
def test_readings_of_no_pose_are_a_failure(length, left_hand, capfd):
    found = symbolic.forward_kinematics(left_hand, length)
    assert not found.success
    assert np.isnan(found.position).all()
    assert np.isnan(found.rotation).all()
    assert not found.closure <= 1e-12 * left_hand.size
    assert capfd.readouterr() == ("", "")


def test_too_few_iterations_are_a_failure(left_hand):
    length = hx.inverse_kinematics(left_hand, [3.0, 1.0, 21.0], np.eye(3))
    assert not symbolic.forward_kinematics(left_hand, length, max_iterations=1).success
    assert symbolic.forward_kinematics(left_hand, length).success


def test_a_singular_robot_is_a_failure(capfd):
    """Similar base and platform: the readings do not hold the platform, Newton's matrix is singular at home."""
    angles = np.deg2rad([0, 60, 120, 180, 240, 300])
    ring = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)
    singular = hx.Hexapod("similar", 10 * ring, 5 * ring, length_unit="cm", home_position=np.array([0.0, 0.0, 10.0]))
    turned = hx.rotations.rotation_vector_to_matrix([0.0, 0.0, 0.1])
    found = symbolic.forward_kinematics(singular, hx.inverse_kinematics(singular, [0.3, 0.0, 11.0], turned))
    assert not found.success
    assert np.isnan(found.position).all()
    assert capfd.readouterr() == ("", "")


def test_wrong_arguments(left_hand):
    with pytest.raises(InputError, match=r"length: expected shape \(6\)"):
        symbolic.forward_kinematics(left_hand, np.zeros((2, 6)))
    with pytest.raises(InputError, match="rotation: the matrix is not orthonormal"):
        symbolic.forward_kinematics(left_hand, np.zeros(6), np.zeros(3), 2 * np.eye(3))
    with pytest.raises(InputError, match="rotation"):
        symbolic.inverse_kinematics(left_hand, np.zeros(3), 2 * np.eye(3))
    with pytest.raises(InputError, match="max_iterations: expected a whole number >= 1, got -1"):
        symbolic.forward_kinematics(left_hand, np.ones(6), max_iterations=-1)


def test_no_poses_have_no_readings(left_hand):
    assert symbolic.inverse_kinematics(left_hand, np.zeros((0, 3)), np.eye(3)).shape == (0, 6)
