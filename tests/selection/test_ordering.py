"""The order of measuring: a short way, the same each time."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.kinematics import leg_lengths

ROBOT = hx.robots.left_hand()


def way(order, data):
    lengths = leg_lengths(ROBOT, data.position, data.rotation)[order]
    steps = np.diff(np.vstack([ROBOT.home_lengths, lengths]), axis=0)
    return np.linalg.norm(steps, axis=1)


def test_each_pose_is_there_once_and_the_way_is_shorter_than_a_random_one():
    data = hx.candidates(ROBOT, 3, "direction", 60, rng=0)
    order = hx.measuring_order(ROBOT, data)
    assert sorted(order) == list(range(60))
    rng = np.random.default_rng(0)
    assert way(order, data).sum() < min(way(rng.permutation(60), data).sum() for _ in range(100))


def test_it_starts_at_home():
    data = hx.candidates(ROBOT, None, "none", 30, rng=1)
    lengths = leg_lengths(ROBOT, data.position, data.rotation)
    nearest = np.linalg.norm(lengths - ROBOT.home_lengths, axis=1).argmin()
    assert hx.measuring_order(ROBOT, data)[0] == nearest


def test_a_repeated_pose_is_measured_again_at_once_and_ties_go_by_the_list():
    data = hx.candidates(ROBOT, 3, "leg", 4, rng=0).poses([0, 1, 2, 3, 0, 1])
    order = list(hx.measuring_order(ROBOT, data))
    for first, again in ((0, 4), (1, 5)):
        assert order.index(again) == order.index(first) + 1


def test_the_unit_of_the_poses_does_not_matter():
    data = hx.candidates(ROBOT, 3, "length", 20, rng=0)
    metres = hx.Measurements(data.position / 100, data.rotation, data.length, "length", 3, length_unit="m")
    np.testing.assert_array_equal(hx.measuring_order(ROBOT, metres), hx.measuring_order(ROBOT, data))


def test_a_design_is_as_good_as_its_poses():
    pool = hx.candidates(ROBOT, 3, "direction", 40, hx.UniformNoise(0.01, 1e-4, 0.01), rng=0)
    design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 7)
    np.testing.assert_array_equal(hx.measuring_order(ROBOT, design), hx.measuring_order(ROBOT, design.poses))


@pytest.mark.parametrize(
    ("robot", "poses", "message"),
    [
        (None, None, "robot: expected a Hexapod, got NoneType"),
        (ROBOT, None, "poses: expected Measurements, LegMeasurements or a Design over one set, got None"),
        (ROBOT, [1, 2], r"over one set, got \[1, 2\]"),
    ],
)
def test_what_has_no_poses(robot, poses, message):
    with pytest.raises(hx.InputError, match=message):
        hx.measuring_order(robot, poses)


def test_a_batch_is_refused():
    data = hx.simulate_leg(ROBOT, 3, "direction", 5, 2, rng=0)
    with pytest.raises(hx.InputError, match=r"poses: expected one set, got a batch of \(2,\)"):
        hx.measuring_order(ROBOT, data)
