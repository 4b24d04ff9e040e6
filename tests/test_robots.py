"""Built-in robots against METHODS, section 8, the paper's section 4, and the real hexapod's own file."""

import tomllib

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError
from hexopt.robots import BUILT_IN, by_name


def test_left_hand_is_the_papers():
    robot = hx.robots.left_hand()
    a = [[-9.7, 9.1], [9.7, 9.1], [12.76, 3.9], [3, -13], [-3, -13], [-12.76, 3.9]]
    b = [[-3, 7.3], [3, 7.3], [7.822, -1.052], [4.822, -6.248], [-4.822, -6.248], [-7.822, -1.052]]
    np.testing.assert_array_equal(robot.base_points, np.insert(a, 2, 0.0, axis=1))
    np.testing.assert_array_equal(robot.platform_points, np.insert(b, 2, 0.0, axis=1))
    np.testing.assert_array_equal(robot.offsets, 15.25)
    assert robot.length_unit == "cm"
    d = np.deg2rad
    assert robot.ranges.length == (17.0, 20.3)
    assert robot.ranges.angles == (d(35), d(35), d(35))
    assert (robot.ranges.cone, robot.ranges.lock_cone) == (d(68), d(20))
    assert robot.ranges.sequence == "ZXZ"
    assert robot.limits.leg_length == (17.25, 25.25)
    assert robot.limits.angles == (d(25), d(25), d(25))
    np.testing.assert_array_equal(robot.home_position, [0, 0, 19])


def test_rubin_is_as_published():
    robot = hx.robots.rubin()
    a = [
        (227600, 653800),
        (-227600, 653800),
        (-680000, -129700),
        (-452300, -524000),
        (452300, -524000),
        (680000, -129700),
    ]
    b = [
        (472800, 512200),
        (-472800, 512200),
        (-680000, 153300),
        (-207200, -665500),
        (207200, -665500),
        (680000, 153300),
    ]
    np.testing.assert_array_equal(robot.base_points, np.insert(np.array(a, float), 2, -525000.0, axis=1))
    np.testing.assert_array_equal(robot.platform_points, np.insert(np.array(b, float), 2, -121400.0, axis=1))
    assert robot.length_unit == "um"
    np.testing.assert_allclose(hx.inverse_kinematics(robot, np.zeros(3), np.eye(3)), 0, atol=1e-9)


def test_linuxcnc_is_as_published():
    robot = hx.robots.linuxcnc()
    a = [(-22.95, 13.25), (22.95, 13.25), (22.95, 13.25), (0, -26.5), (0, -26.5), (-22.95, 13.25)]
    b = [(-1, 11.5), (1, 11.5), (10.459, -4.884), (9.459, -6.616), (-9.459, -6.616), (-10.459, -4.884)]
    np.testing.assert_array_equal(robot.base_points, np.insert(a, 2, 0.0, axis=1))
    np.testing.assert_array_equal(robot.platform_points, np.insert(b, 2, 0.0, axis=1))
    assert robot.length_unit == "unstated"


def test_jugglebot_follows_its_rule():
    robot = hx.robots.jugglebot()
    np.testing.assert_allclose(np.linalg.norm(robot.base_points, axis=1), 410.0, rtol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(robot.platform_points, axis=1), 219.075, rtol=1e-15)
    assert robot.length_unit == "mm"
    assert robot.reading_unit == "rev"
    angle = np.rad2deg(np.arctan2(robot.platform_points[0, 1], robot.platform_points[0, 0]))
    np.testing.assert_allclose(angle, 154.3012223, atol=1e-9)
    np.testing.assert_allclose(robot.home_lengths, robot.offsets, rtol=1e-15)


def test_jugglebot_is_its_builders_design(real_data):
    design = tomllib.loads((real_data / "nominal.toml").read_text())
    robot = hx.robots.jugglebot()
    np.testing.assert_allclose(robot.base_points, design["base_points"], atol=6e-7)
    np.testing.assert_allclose(robot.platform_points, design["platform_points"], atol=6e-7)
    np.testing.assert_allclose(robot.offsets, design["offsets"], atol=6e-5)
    assert (robot.length_unit, robot.reading_unit) == (design["length_unit"], design["reading_unit"])
    assert hx.Hexapod.from_toml(real_data / "nominal.toml").name == design["name"]


# The ratio of singular values that METHODS prints, of the Jacobian at home with rotations scaled by the size of
# the platform, tells a singular robot or a mistyped joint.
@pytest.mark.parametrize(("name", "ratio"), [("left-hand", 0.20), ("rubin", 0.45), ("linuxcnc", 0.62)])
def test_no_built_in_robot_is_singular_at_home(name, ratio):
    robot = by_name(name)
    unit = robot.home_vectors / robot.home_lengths[:, None]
    arm = robot.platform_points @ robot.home_rotation.T
    arm = arm - [0, 0, arm[:, 2].mean()]
    scale = np.sqrt((arm**2).sum(axis=1).mean())
    jacobian = np.hstack([unit, np.cross(arm, unit) / scale])
    values = np.linalg.svd(jacobian, compute_uv=False)
    assert abs(values[-1] / values[0] - ratio) < 0.12


def test_home_is_within_the_limits(robot):
    assert hx.reachable(robot, robot.home_position, robot.home_rotation)


def test_names():
    assert set(BUILT_IN) == {"left-hand", "rubin", "linuxcnc", "jugglebot"}
    with pytest.raises(InputError, match="unknown robot 'lefthand'; built in are left-hand, rubin"):
        by_name("lefthand")
