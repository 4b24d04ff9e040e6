"""Poses that cannot be a robot's: each limit has a margin, and most of the poses have to be beyond it."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.kinematics import leg_lengths
from hexopt.pools.beyond import far_beyond
from hexopt.rotations import euler_to_matrix

ROBOT = hx.robots.left_hand()


def raised(heights, angle=0.0):
    position = np.array([[0.0, 0.0, height] for height in heights])
    return position, np.stack([euler_to_matrix([angle, 0.0, 0.0], "xyz")] * len(position))


def limited(**limits):
    return replace(ROBOT, limits=hx.Limits(**limits))


@pytest.mark.parametrize(
    ("limits", "inside", "outside"),
    [
        ({"leg_length": (19.0, 21.0)}, (15.9, 25.1), (15.7, 25.3)),
        ({"position": (1.0, 1.0, 1.0)}, (-1.19, 1.19), (-1.21, 1.21)),
    ],
)
def test_lengths_may_pass_a_limit_by_a_fifth(limits, inside, outside):
    def poses(values):
        if "position" in limits:
            return raised(ROBOT.home_position[2] + np.array(values))
        heights = np.linspace(5, 30, 2501)
        lengths = leg_lengths(ROBOT, *raised(heights))[:, 0]  # of all legs, to 0.05
        return raised(np.interp(values, lengths, heights))

    robot = limited(**limits)
    assert not far_beyond(robot, *poses(inside))
    (name,) = limits
    assert far_beyond(robot, *poses(outside)).startswith(
        f"2 of 2 poses are far beyond the limits of Left Hand ({name}: 2; "
    )


@pytest.mark.parametrize("limits", [{"tilt": 0.2}, {"angles": (0.2, 0.2, 0.2)}])
def test_angles_may_pass_a_limit_by_a_fifth(limits):
    robot = limited(**limits)
    assert not far_beyond(robot, *raised([19.0], 0.239))
    assert far_beyond(robot, *raised([19.0], 0.241))


def test_a_few_outside_are_none():
    heights = [19.0, 20.0, 60.0, 70.0]
    assert not far_beyond(ROBOT, *raised(heights))
    assert far_beyond(ROBOT, *raised([*heights, 80.0])).startswith("3 of 5 poses")


def test_where_nothing_is_limited_nothing_is_beyond():
    assert not far_beyond(limited(), *raised([1e6]))
    assert not far_beyond(limited(tilt=3.0, angles=(3.0, 3.0, 3.0)), *raised([19.0], 3.1))
