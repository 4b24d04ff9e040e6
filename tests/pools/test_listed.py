"""The user's own list of poses as candidates: every pose that cannot be one is named, none is lost in silence."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexopt as hx
from hexopt.errors import InputError, LockError, SamplingError

HELD = ["direction", "leg", "length"]


@pytest.fixture
def listed(left_hand):
    """Twenty unlocked poses that all legs reach."""
    pool = hx.candidates(left_hand, None, "none", 20, rng=0)
    return np.array(pool.position), np.array(pool.rotation)


def test_exact_readings_in_the_order_of_the_list(left_hand, listed, paper_noise):
    nominal = left_hand.perturbed(0.1, rng=0)
    pool = hx.candidates_at(left_hand, *listed, noise=paper_noise, nominal=nominal)
    np.testing.assert_array_equal(pool.position, listed[0])
    np.testing.assert_array_equal(pool.rotation, listed[1])
    np.testing.assert_array_equal(pool.length, hx.inverse_kinematics(left_hand, *listed))
    assert (pool.lock, pool.locked_leg, pool.noise, pool.nominal) == ("none", None, paper_noise, nominal)


def test_the_list_is_copied(left_hand, listed):
    pool = hx.candidates_at(left_hand, *listed)
    listed[0][:] = 0.0
    assert (pool.position != 0).any()


def test_poses_from_a_file(left_hand, tmp_path):
    """Written, read again, and still on the clamp."""
    pool = hx.candidates(left_hand, 3, "direction", 12, rng=0)
    path = hx.write_measurements(pool, tmp_path / "poses.csv", orientation="ZXZ", angle_unit="deg")
    (data,) = hx.read_measurements(path, length_unit="cm", orientation="ZXZ", angle_unit="deg")
    again = hx.candidates_at(left_hand, data.position, data.rotation, 3, "direction")
    np.testing.assert_allclose(again.length, pool.length, atol=1e-9)
    assert again.leg(3).lock == "direction"


class TestLimits:
    def test_what_cannot_be_reached_is_counted(self, left_hand, listed):
        position, rotation = listed
        position[[4, 9]] = [0.0, 0.0, 40.0]
        rotation[17] = Rotation.from_euler("x", 26, degrees=True).as_matrix()
        position[17] = [0.0, 0.0, 21.0]
        message = r"^3 of 20 poses cannot be candidates \(leg_length: 2, angles: 1\); the first is pose 4, .*drop=True"
        with pytest.raises(InputError, match=message):
            hx.candidates_at(left_hand, position, rotation)
        pool = hx.candidates_at(left_hand, position, rotation, drop=True)
        np.testing.assert_array_equal(pool.position, np.delete(position, [4, 9, 17], axis=0))
        assert hx.reachable(left_hand, pool.position, pool.rotation).all()

    def test_the_users_own_condition(self, left_hand, listed):
        high = lambda position, rotation: position[:, 2] > 18.5  # noqa: E731 - a name says it
        low = int((~high(*listed)).sum())
        with pytest.raises(InputError, match=rf"\(accept: {low}\)"):
            hx.candidates_at(left_hand, *listed, accept=high)
        assert hx.candidates_at(left_hand, *listed, accept=high, drop=True).n_poses == 20 - low

    def test_nothing_left(self, left_hand, listed):
        far = listed[0] + [0.0, 0.0, 50.0]
        with pytest.raises(SamplingError, match=r"20 of 20 poses .*\(leg_length: 20\); nothing is left"):
            hx.candidates_at(left_hand, far, listed[1], drop=True)

    def test_a_covariance_a_pose_goes_with_its_pose(self, left_hand, listed):
        listed[0][3] = [0.0, 0.0, 40.0]
        covariance = np.eye(12) * (1e-4 * np.arange(1, 21)[:, None, None])
        noise = hx.NormalNoise(pose_covariance=covariance)
        pool = hx.candidates_at(left_hand, *listed, noise=noise, drop=True)
        np.testing.assert_array_equal(pool.noise.pose_covariance, np.delete(covariance, 3, axis=0))


class TestDuplicates:
    def test_they_are_found_wherever_they_stand(self, left_hand, listed):
        for array in listed:
            array[[7, 19]] = array[2]
        with pytest.raises(InputError, match=r"\(duplicate: 2\); the first is pose 7"):
            hx.candidates_at(left_hand, *listed)
        pool = hx.candidates_at(left_hand, *listed, drop=True)
        np.testing.assert_array_equal(pool.position, np.delete(listed[0], [7, 19], axis=0))

    def test_the_same_place_turned_is_another_pose(self, left_hand):
        turns = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]).as_matrix()
        assert hx.candidates_at(left_hand, np.tile([0.0, 0.0, 19.0], (2, 1)), turns).n_poses == 2

    def test_minus_zero_is_zero(self, left_hand):
        with pytest.raises(InputError, match="duplicate: 1"):
            hx.candidates_at(left_hand, [[0.0, 0.0, 19.0], [-0.0, 0.0, 19.0]], [np.eye(3)] * 2)


@pytest.mark.parametrize("lock", HELD)
class TestClamp:
    """One pose in twenty, pushed off the clamp by a known distance, is found whatever the lock."""

    def poses(self, robot, lock, by):
        pool = hx.candidates(robot, 3, lock, 20, rng=0)
        vector = pool.position[5] + pool.rotation[5] @ robot.platform_points[2] - robot.base_points[2]
        along = vector / np.linalg.norm(vector)
        push = np.cross(along, [0.0, 1.0, 0.0]) if lock != "length" else along
        position = np.array(pool.position)
        position[5] += by * push / np.linalg.norm(push)
        return position, pool.rotation

    def test_poses_that_do_not_keep_it(self, left_hand, lock):
        poses = self.poses(left_hand, lock, 0.01)
        message = (
            rf"^1 of 20 .*\(off the clamp: 1\); up to 0\.01 cm off the lock '{lock}' of leg 3, .*is pose 5, counted"
        )
        with pytest.raises(InputError, match=message):
            hx.candidates_at(left_hand, *poses, 3, lock)
        assert hx.candidates_at(left_hand, *poses, 3, lock, drop=True).n_poses == 19
        assert hx.candidates_at(left_hand, *poses, 3, lock, tolerance=0.0101).n_poses == 20
        with pytest.raises(InputError, match="off the clamp: 1"):
            hx.candidates_at(left_hand, *poses, 3, lock, tolerance=0.0099)

    def test_rounded_poses_keep_it(self, left_hand, lock):
        assert hx.candidates_at(left_hand, *self.poses(left_hand, lock, 1e-3), 3, lock).n_poses == 20

    def test_a_clamp_that_is_given(self, left_hand, lock):
        poses = self.poses(left_hand, lock, 0.0)
        vector = left_hand.home_vectors[2]
        length = np.linalg.norm(vector)
        given = {"direction": 2 * vector, "leg": left_hand.base_points[2] + vector, "length": length}
        other = {"direction": [0, 0.1, 1], "leg": [8, -1, 20], "length": length + 0.1}
        assert hx.candidates_at(left_hand, *poses, 3, lock, given=given[lock]).n_poses == 20
        with pytest.raises(InputError, match="off the clamp: 20"):
            hx.candidates_at(left_hand, *poses, 3, lock, given=other[lock])

    def test_it_needs_a_leg(self, left_hand, lock):
        with pytest.raises(LockError, match=rf"which leg \(1…6\) has the lock '{lock}'"):
            hx.candidates_at(left_hand, *self.poses(left_hand, lock, 0.0), lock=lock)


def test_a_direction_is_a_ray_and_no_line(left_hand):
    """A leg that points the other way does not keep the direction."""
    free = hx.Hexapod("free", left_hand.base_points, left_hand.platform_points, home_position=[0.0, 0.0, 19.0])
    vector = free.home_vectors[2]
    position = free.base_points[2] + np.array([[1.0], [1.1], [1.2], [-1.0]]) * vector - free.platform_points[2]
    with pytest.raises(InputError, match=r"off the clamp: 1\).*is pose 3"):
        hx.candidates_at(free, position, [np.eye(3)] * 4, 3, "direction")


def test_poses_that_share_no_direction(left_hand):
    base, platform = left_hand.base_points[2], left_hand.platform_points[2]
    away = base - platform + np.array([[0, 0, 19.0], [0, 0, -19.0]])
    with pytest.raises(InputError, match="the poses share no direction of leg 3; say which one is held: given="):
        hx.candidates_at(left_hand, away, [np.eye(3)] * 2, 3, "direction")


@pytest.mark.parametrize(
    ("position", "rotation", "settings", "message"),
    [
        (np.full((2, 3), np.nan), np.eye(3)[None], {}, "position: 6 value"),
        (
            np.zeros((2, 3)),
            np.stack([np.eye(3), 2 * np.eye(3)]),
            {},
            r"rotation: the matrix at index \(1,\) is not orth",
        ),
        (np.zeros((2, 3)), np.eye(3)[None], {}, "as many positions as rotations, .*; got 2 and 1"),
        (np.zeros((0, 3)), np.zeros((0, 3, 3)), {}, "at least one; got 0 and 0"),
        (np.zeros((4, 2, 3)), np.eye(3)[None], {}, r"position: expected shape \(n, 3\), got \(4, 2, 3\)"),
        (np.zeros((1, 3)), np.eye(3)[None], {"tolerance": -1.0}, "tolerance: expected a length >= 0, got -1"),
        (np.zeros((1, 3)), np.eye(3)[None], {"accept": lambda p, r: 1}, "accept: expected a mask of 1 booleans"),
        (np.zeros((1, 3)), np.eye(3)[None], {"accept": 3}, r"accept: expected a function of positions .*, got 3"),
        (np.zeros((1, 3)), np.eye(3)[None], {"accept": lambda p: p}, "accept: expected a function of positions"),
        (np.zeros((1, 3)), np.eye(3)[None], {"drop": "no"}, "drop: expected True or False, got 'no'"),
        (np.zeros((1, 3)), np.eye(3)[None], {"lock": "tight"}, "lock: expected one of"),
    ],
)
def test_wrong_arguments(left_hand, position, rotation, settings, message):
    with pytest.raises(InputError, match=message):
        hx.candidates_at(left_hand, position, rotation, **settings)
