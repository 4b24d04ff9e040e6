"""Leg lengths of a pose, and the limits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexopt as hx
from hexopt.errors import InputError
from hexopt.kinematics import leg_lengths, leg_vectors, limit_violations

FREE = hx.Limits()


def poses(n=20, seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(-3, 3, (n, 3)) + np.array([0, 0, 19]), Rotation.from_rotvec(
        rng.uniform(-0.5, 0.5, (n, 3))
    ).as_matrix()


def test_readings_are_the_papers_equation_18(robot):
    """ρ = (‖P + R b − a‖ − δ)/γ, written out leg by leg and pose by pose."""
    position, rotation = poses()
    position = position * robot.size / 20
    readings = hx.inverse_kinematics(robot, position, rotation)
    assert readings.shape == (20, 6)
    for i in range(20):
        for k, leg in enumerate(robot.legs):
            length = np.linalg.norm(position[i] + rotation[i] @ leg.platform_point - leg.base_point)
            np.testing.assert_allclose(readings[i, k], (length - leg.offset) / leg.gain, rtol=1e-12, atol=1e-14)


def test_shapes_broadcast(left_hand):
    position, rotation = poses(6)
    assert hx.inverse_kinematics(left_hand, position[0], rotation[0]).shape == (6,)
    assert leg_vectors(left_hand, position.reshape(2, 3, 3), rotation.reshape(2, 3, 3, 3)).shape == (2, 3, 6, 3)
    np.testing.assert_array_equal(
        leg_lengths(left_hand, position[0], rotation)[3], leg_lengths(left_hand, position[0], rotation[3])
    )
    assert hx.reachable(left_hand, position[0], rotation).shape == (6,)
    assert hx.reachable(left_hand, position, rotation[0]).shape == (6,)
    assert hx.reachable(left_hand, position[0], rotation[0]).shape == ()


@pytest.mark.parametrize(
    ("position", "rotation", "message"),
    [
        ([0, 0], np.eye(3), "position: expected shape"),
        ([0, 0, np.nan], np.eye(3), "position: .*NaN"),
        ([0, 0, 19], 2 * np.eye(3), "rotation: .*orthonormal"),
        ([0, 0, 19], np.diag([1, 1, -1.0]), "rotation: .*left-handed"),
    ],
)
def test_wrong_poses(left_hand, position, rotation, message):
    for function in (hx.inverse_kinematics, hx.reachable):
        with pytest.raises(InputError, match=message):
            function(left_hand, position, rotation)


class TestLimits:
    """Each limit alone, just inside and just outside."""

    def robot(self, **limits):
        return replace(hx.robots.left_hand(), limits=hx.Limits(**limits))

    def check(self, robot, inside, outside):
        (name,) = limit_violations(robot, *inside)
        assert hx.reachable(robot, *inside)
        assert not hx.reachable(robot, *outside)
        assert limit_violations(robot, *outside)[name]

    def test_leg_length_binds_for_every_leg(self):
        home = self.robot()
        for k in range(6):
            position, rotation = [0.5, -0.3, 19.5], Rotation.from_rotvec([0.1, -0.05, 0.2]).as_matrix()
            lengths = leg_lengths(home, position, rotation)
            longest, shortest = lengths.max(), lengths.min()
            for low, high, ok in (
                (shortest * (1 - 1e-9), longest * (1 + 1e-9), True),
                (shortest * (1 + 1e-9), longest, False),
                (shortest, longest * (1 - 1e-9), False),
                (lengths[k] * (1 + 1e-9), 1e3, False),
            ):
                assert hx.reachable(self.robot(leg_length=(low, high)), position, rotation) == ok

    def test_leg_tilt_is_from_home(self):
        home = self.robot()
        position, rotation = [2.0, 1.0, 19.0], np.eye(3)
        vectors = leg_vectors(home, position, rotation)
        cosine = (vectors * home.home_vectors).sum(-1) / np.linalg.norm(vectors, axis=-1) / home.home_lengths
        largest = np.arccos(cosine.min())
        assert hx.reachable(self.robot(leg_tilt=largest + 1e-9), position, rotation)
        assert not hx.reachable(self.robot(leg_tilt=largest - 1e-9), position, rotation)

    def test_base_tilt_is_from_the_vertical(self):
        position, rotation = [2.0, 1.0, 19.0], np.eye(3)
        vectors = leg_vectors(self.robot(), position, rotation)
        largest = np.arccos((vectors[:, 2] / np.linalg.norm(vectors, axis=-1)).min())
        assert hx.reachable(self.robot(base_tilt=largest + 1e-9), position, rotation)
        assert not hx.reachable(self.robot(base_tilt=largest - 1e-9), position, rotation)

    @pytest.mark.parametrize("tilt", [1e-6, 1e-3, 0.3, 1.5, 3.0])
    def test_tilt_of_the_platform(self, tilt):
        turn = Rotation.from_euler("ZXZ", [0.3, tilt, 1.1]).as_matrix()
        p = [0, 0, 19.0]
        assert hx.reachable(self.robot(tilt=tilt * (1 + 1e-9)), p, turn)
        assert not hx.reachable(self.robot(tilt=tilt * (1 - 1e-9)), p, turn)

    def test_angles_are_half_widths_of_their_sequence_from_home(self):
        limits = {"angles": (0.1, 0.2, 0.3), "sequence": "xyz"}
        p = [0, 0, 19.0]
        for axis, half in enumerate(limits["angles"]):
            for sign in (-1, 1):
                angles = np.array([0.05, -0.1, 0.1])
                angles[axis] = sign * half * (1 - 1e-9)
                inside = Rotation.from_euler("xyz", angles).as_matrix()
                angles[axis] = sign * half * (1 + 1e-9)
                outside = Rotation.from_euler("xyz", angles).as_matrix()
                self.check(self.robot(**limits), (p, inside), (p, outside))
        turned = Rotation.from_rotvec([0, 0, 2.0]).as_matrix()
        robot = replace(self.robot(**limits), home_rotation=turned)
        assert hx.reachable(robot, p, turned @ Rotation.from_euler("xyz", [0.09, -0.19, 0.29]).as_matrix())

    def test_position_is_travel_from_home(self):
        robot = self.robot(position=(1.0, 2.0, 3.0))
        self.check(robot, ([0.99, -1.99, 21.99], np.eye(3)), ([1.01, 0, 19], np.eye(3)))
        self.check(robot, ([0, 0, 16.01], np.eye(3)), ([0, 0, 15.99], np.eye(3)))

    def test_none_binds_nothing(self):
        assert limit_violations(self.robot(), [0, 0, 1e6], np.eye(3)) == {}
        assert hx.reachable(self.robot(), [0, 0, 1e6], np.eye(3))
