"""A hexapod: checks, views, new robots."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, UnitError


def test_legs_are_the_rows(robot):
    assert [leg.number for leg in robot.legs] == [1, 2, 3, 4, 5, 6]
    for leg in robot.legs:
        k = leg.number - 1
        np.testing.assert_array_equal(leg.base_point, robot.base_points[k])
        np.testing.assert_array_equal(leg.platform_point, robot.platform_points[k])
        assert (leg.offset, leg.gain, leg.length_unit) == (robot.offsets[k], robot.gains[k], robot.length_unit)


def test_home_is_a_pose_like_any_other(robot):
    lengths = [
        np.linalg.norm(robot.home_position + robot.home_rotation @ leg.platform_point - leg.base_point)
        for leg in robot.legs
    ]
    np.testing.assert_allclose(robot.home_lengths, lengths, rtol=1e-15)


@pytest.mark.parametrize("number", [0, 7, "3", None])
def test_an_unknown_leg_is_an_error(left_hand, number):
    with pytest.raises(InputError, match="expected a number from 1 to 6"):
        left_hand.leg(number)


class TestPerturbed:
    def test_errors_are_uniform_within_the_amount(self, left_hand):
        moved = [left_hand.perturbed(0.2, rng=seed) for seed in range(100)]
        errors = np.array(
            [[m.base_points - left_hand.base_points, m.platform_points - left_hand.platform_points] for m in moved]
        )
        assert np.abs(errors).max() <= 0.2
        assert np.abs(errors).max() > 0.199
        np.testing.assert_allclose(errors.std(), 0.2 / np.sqrt(3), rtol=0.03)

    def test_offset_and_gain_are_kept_unless_asked(self, left_hand):
        np.testing.assert_array_equal(left_hand.perturbed(0.2, rng=0).offsets, left_hand.offsets)
        moved = left_hand.perturbed(0.2, offsets=0.1, rng=0)
        assert 0 < np.abs(moved.offsets - left_hand.offsets).max() <= 0.1
        np.testing.assert_array_equal(moved.gains, left_hand.gains)

    def test_the_seed_decides(self, left_hand):
        one, two, other = (left_hand.perturbed(0.2, rng=seed) for seed in (1, 1, 2))
        np.testing.assert_array_equal(one.base_points, two.base_points)
        assert (one.base_points != other.base_points).all()

    def test_nothing_hidden(self, left_hand):
        with pytest.raises(InputError, match="rng"):
            left_hand.perturbed(0.2, rng=None)
        with pytest.raises(TypeError):
            left_hand.perturbed(0.2)

    @pytest.mark.parametrize("amount", [-1.0, np.nan, "1", [1, 2]])
    def test_a_wrong_amount_is_an_error(self, left_hand, amount):
        with pytest.raises(InputError, match="amount"):
            left_hand.perturbed(amount, rng=0)


class TestWithLegs:
    def test_only_the_named_legs_change(self, left_hand):
        new = left_hand.leg(4).replaced(base_point=[1, 2, 3], offset=5.0)
        for legs in ([new], {4: new}):
            changed = left_hand.with_legs(legs, name="mended")
            np.testing.assert_array_equal(changed.base_points[3], [1, 2, 3])
            assert changed.offsets[3] == 5.0
            assert changed.name == "mended"
            others = [0, 1, 2, 4, 5]
            np.testing.assert_array_equal(changed.base_points[others], left_hand.base_points[others])
            np.testing.assert_array_equal(changed.offsets[others], left_hand.offsets[others])
        np.testing.assert_array_equal(left_hand.base_points[3], [3, -13, 0])

    def test_another_unit_is_an_error(self, left_hand):
        with pytest.raises(InputError, match="leg 4 is in mm, the robot in cm"):
            left_hand.with_legs([replace(left_hand.leg(4), length_unit="mm")])

    def test_a_batch_is_an_error(self, left_hand):
        with pytest.raises(InputError, match=r"leg 4.*batch"):
            left_hand.with_legs([left_hand.leg(4).replaced(offset=np.zeros(5))])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base_points": np.ones((5, 3))}, "base_points: a hexapod has 6 legs, got 5"),
        ({"platform_points": np.ones((7, 3))}, "platform_points: a hexapod has 6 legs, got 7"),
        ({"offsets": [1, 2, 3, 4, 5]}, "offsets: a hexapod has 6 legs, got 5"),
        ({"base_points": [[1, 2, 3]] * 5 + [[1, 2]]}, "base_points: expected numbers"),
        ({"base_points": np.ones((6, 2))}, r"base_points: expected shape \(6, 3\), got \(6, 2\)"),
        ({"offsets": 15.25}, "offsets: expected shape"),
        ({"base_points": [["1", "2", "3"]] * 6}, "base_points: expected numbers"),
        ({"gains": [1, 1, 1, 0, 1, 1]}, "gains: expected values other than 0"),
        ({"gains": np.zeros(6)}, "gains: expected values other than 0"),
        ({"name": ""}, "name"),
        ({"name": 3}, "name"),
        ({"length_unit": "furlong"}, "length_unit: unknown length unit"),
        ({"reading_unit": 3}, "reading_unit: expected a text"),
        ({"home_position": [0, 0]}, "home_position"),
        ({"home_rotation": 2 * np.eye(3)}, "home_rotation: .*not orthonormal"),
        ({"home_rotation": np.diag([1, 1, -1.0])}, "home_rotation: .*left-handed"),
        ({"limits": 3}, "limits: expected Limits"),
        ({"limits": None}, "limits: expected Limits"),
        ({"ranges": {"angles": 3}}, "ranges: expected PoseRanges"),
        (
            {"base_points": np.zeros((6, 3)), "platform_points": np.zeros((6, 3)), "home_position": np.zeros(3)},
            "coincide",
        ),
    ],
)
def test_a_wrong_robot_is_one_line(left_hand, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        replace(left_hand, **changes)
    assert "\n" not in str(caught.value)


def test_an_unknown_unit_is_a_unit_error(left_hand):
    with pytest.raises(UnitError):
        replace(left_hand, length_unit="parsec")


def test_ranges_follow_the_limits_unless_given():
    free = hx.robots.linuxcnc()
    mean = free.home_lengths.mean()
    np.testing.assert_allclose(free.ranges.length, (0.9 * mean, 1.1 * mean))
    limited = replace(free, limits=hx.Limits(leg_length=(20, 30), angles=(0.1, 0.2, 0.3), leg_tilt=0.2), ranges=None)
    assert limited.ranges.length == (20, 30)
    assert limited.ranges.angles == (0.1, 0.2, 0.3)
    assert limited.ranges.sequence == "xyz"
    assert (limited.ranges.cone, limited.ranges.lock_cone) == (0.2, 0.2)
