"""Measurements: checked shapes, batches, views."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, LockError
from hexopt.noise import NormalNoise, Outliers
from hexopt.rotations import euler_to_matrix


def parts(sets=(4,), n=5, seed=0):
    rng = np.random.default_rng(seed)
    return {
        "position": rng.standard_normal((*sets, n, 3)),
        "rotation": euler_to_matrix(rng.uniform(-1, 1, (*sets, n, 3))),
        "length": rng.uniform(1, 2, (*sets, n)),
    }


def leg_set(lock="direction", **changes):
    return hx.LegMeasurements(**{**parts(), "lock": lock, **changes})


def robot_set(**changes):
    values = parts()
    values["length"] = np.random.default_rng(1).uniform(1, 2, (4, 5, 6))
    return hx.Measurements(**{**values, **changes})


class TestLegMeasurements:
    def test_shapes(self):
        data = leg_set()
        assert (data.batch_shape, data.n_poses, data.lock) == ((4,), 5, hx.Lock.DIRECTION)
        assert leg_set(**parts(sets=())).batch_shape == ()
        assert leg_set(**parts(sets=(2, 3))).batch_shape == (2, 3)

    def test_sets_of_a_batch(self):
        data, whole = leg_set(), parts()
        for index in (2, -1, slice(1, 3), [0, 3], np.array([True, False, True, False])):
            np.testing.assert_array_equal(data[index].position, whole["position"][index])
            np.testing.assert_array_equal(data[index].rotation, whole["rotation"][index])
            np.testing.assert_array_equal(data[index].length, whole["length"][index])
        with pytest.raises(InputError, match="one set, not a batch"):
            data[0][0]
        with pytest.raises(IndexError):
            data[4]

    @pytest.mark.parametrize(
        "index", [[0, 2], slice(1, 4), [4, 3, 2, 1, 0], np.array([True, True, False, True, False]), 3]
    )
    def test_poses_of_every_set(self, index):
        data, whole = leg_set(), parts()
        some = data.poses(index)
        where = [index] if isinstance(index, int) else index
        np.testing.assert_array_equal(some.position, whole["position"][:, where])
        np.testing.assert_array_equal(some.rotation, whole["rotation"][:, where])
        np.testing.assert_array_equal(some.length, whole["length"][:, where])

    def test_without_readings(self):
        data = leg_set(length=None)
        assert data[1].length is None
        assert data.poses([0, 1]).length is None
        with pytest.raises(InputError, match="needs the leg's readings"):
            data.readings()

    def test_the_nominal_knows_the_leg_and_the_unit(self, left_hand):
        data = leg_set(nominal=left_hand.leg(4))
        assert (data.leg, data.length_unit) == (4, "cm")
        assert leg_set(nominal=hx.robots.rubin().leg(1)).length_unit == "um"
        with pytest.raises(InputError, match="which leg"):
            assert leg_set().leg

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"position": np.zeros((4, 5))}, "position: expected shape"),
            ({"position": np.zeros(3)}, "position: expected shape"),
            ({"position": np.zeros((4, 6, 3))}, "position and rotation disagree"),
            ({"rotation": np.zeros((4, 5, 3))}, "rotation: expected shape"),
            ({"rotation": 1.01 * parts()["rotation"]}, "rotation: .*not orthonormal"),
            ({"rotation": -parts()["rotation"]}, "rotation: .*left-handed"),
            ({"length": np.zeros((4, 6))}, "position and length disagree"),
            ({"length": np.zeros(5)}, "position and length disagree"),
            ({"length": np.full((4, 5), np.nan)}, "length: 20 value.*NaN"),
            ({"noise": 0.1}, "noise: expected a noise model"),
            ({"nominal": hx.robots.left_hand()}, r"nominal: expected a Leg \(robot\.leg\(k\)\), got Hexapod"),
            ({"length_unit": "furlong"}, "length_unit: unknown"),
        ],
    )
    def test_wrong_values_are_one_line(self, changes, message):
        with pytest.raises(InputError, match=message) as caught:
            leg_set(**changes)
        assert "\n" not in str(caught.value)

    @pytest.mark.parametrize("name", ["position", "rotation", "length"])
    def test_nan_names_the_pose(self, name):
        values = parts()
        values[name][2, 3] = np.nan
        with pytest.raises(InputError, match=rf"{name}: .*NaN.*\(2, 3"):
            leg_set(**values)

    @pytest.mark.parametrize("lock", ["Direction", "", None, 3, ["leg"]])
    def test_an_unknown_lock_lists_the_known_ones(self, lock):
        with pytest.raises(LockError, match="expected one of none, direction, leg, length"):
            leg_set(lock=lock)


class TestMeasurements:
    def test_the_locked_leg_sees_the_lock_and_no_other_leg_does(self, left_hand):
        data = robot_set(lock="length", locked_leg=3, nominal=left_hand)
        for k in range(1, 7):
            view = data.leg(k)
            assert view.lock is (hx.Lock.LENGTH if k == 3 else hx.Lock.NONE)
            assert view.leg == k
            np.testing.assert_array_equal(view.length, data.length[..., k - 1])
            np.testing.assert_array_equal(view.position, data.position)
            np.testing.assert_array_equal(view.nominal.base_point, left_hand.base_points[k - 1])

    def test_unlocked(self):
        assert {robot_set().leg(k).lock for k in range(1, 7)} == {hx.Lock.NONE}

    def test_noise_is_seen_by_leg(self):
        covariance = np.diag(np.arange(1.0, 13.0))
        view = robot_set(noise=NormalNoise(pose_covariance=covariance)).leg(5)
        np.testing.assert_array_equal(np.diag(view.noise.pose_covariance), [1, 2, 3, 4, 5, 6, 11])

    def test_sets_and_poses(self):
        data = robot_set()
        np.testing.assert_array_equal(data[1].length, data.length[1])
        np.testing.assert_array_equal(data.poses([4, 0]).length, data.length[:, [4, 0]])
        np.testing.assert_array_equal(data.poses([4, 0]).rotation, data.rotation[:, [4, 0]])
        np.testing.assert_array_equal(data[1:3].poses(2).position, data.position[1:3, [2]])

    @pytest.mark.parametrize(
        ("changes", "error", "message"),
        [
            ({"lock": "leg"}, LockError, "locked_leg: which leg"),
            ({"locked_leg": 3}, LockError, "locked_leg: 3 is named, but the lock is 'none'"),
            ({"lock": "leg", "locked_leg": 7}, InputError, "expected a number from 1 to 6"),
            ({"length": np.zeros((4, 5))}, InputError, r"length: expected shape \(\.\.\., n, 6\)"),
            ({"length": np.zeros((4, 6, 6))}, InputError, "position and length disagree"),
            ({"nominal": hx.robots.left_hand().leg(1)}, InputError, "nominal: expected a Hexapod, got Leg"),
        ],
    )
    def test_wrong_values(self, changes, error, message):
        with pytest.raises(error, match=message):
            robot_set(**changes)

    def test_an_unknown_leg_is_an_error(self):
        with pytest.raises(InputError, match="from 1 to 6"):
            robot_set().leg(0)


class TestNoiseGoesWithItsPoses:
    EACH = np.arange(1.0, 6.0)[:, None, None] * np.eye(7)

    @pytest.mark.parametrize("wrap", [lambda noise: noise, lambda noise: Outliers(noise, 0.1, (1, 2))])
    def test_a_covariance_a_pose(self, wrap):
        data = leg_set(noise=wrap(NormalNoise(pose_covariance=self.EACH)))
        for some, levels in (
            (data.poses([4, 1]), [5, 2]),
            (data.poses([4, 3, 2, 1, 0]), [5, 4, 3, 2, 1]),
            (data[1:3].poses(slice(0, 2)), [1, 2]),
            (data[2], [1, 2, 3, 4, 5]),
        ):
            found = some.noise.covariance(some.position, some.rotation)
            assert found.shape == (*some.rotation.shape[:-2], 7, 7)
            np.testing.assert_array_equal(found[..., 0, 0], np.broadcast_to(levels, some.rotation.shape[:-2]))

    def test_a_covariance_a_set_and_pose(self):
        each = np.arange(1.0, 21.0).reshape(4, 5, 1, 1) * np.eye(12)
        data = robot_set(noise=NormalNoise(pose_covariance=each))
        some = data[[3, 0]].poses([2, 0])
        np.testing.assert_array_equal(
            some.noise.covariance(some.position, some.rotation, 6)[..., 0, 0], [[18, 16], [3, 1]]
        )
        np.testing.assert_array_equal(data.leg(2)[1].noise.pose_covariance[:, 6, 6], [6, 7, 8, 9, 10])

    def test_noise_that_is_the_same_everywhere_stays(self):
        noise = hx.UniformNoise(0.1)
        assert leg_set(noise=noise).poses([0]).noise is noise
        noise = NormalNoise(pose_covariance=np.eye(7))
        assert leg_set(noise=noise)[0].noise is noise


def test_what_was_measured_does_not_change_with_the_callers_arrays():
    values = parts()
    before = {name: array.copy() for name, array in values.items()}
    data = leg_set(**values)
    for array in values.values():
        array[...] = 0.0
    for name, array in before.items():
        np.testing.assert_array_equal(getattr(data, name), array)


def test_arrays_are_read_only_and_the_input_is_not():
    values = parts()
    data = leg_set(**values)
    for name, mine in values.items():
        with pytest.raises(ValueError, match="read-only"):
            getattr(data, name)[0] = 0.0
        assert mine.flags.writeable
