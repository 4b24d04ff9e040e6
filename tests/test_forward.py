"""Forward kinematics: inverts inverse kinematics, on the start's branch, or says that it did not."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError
from hexopt.forward import pose_derivatives, robot_blocks
from hexopt.rotations import matrix_to_rotation_vector, rotation_vector_to_matrix

STATUSES = {hx.Status.OPTIMAL, hx.Status.RANK_DEFICIENT, hx.Status.NOT_CONVERGED}


def reached(robot, n=200, seed=0):
    """Poses that the robot reaches, and their readings."""
    data = hx.simulate(robot, n_poses=n, n_sets=1, rng=seed)
    return data.position[0], data.rotation[0], data.length[0]


def similar_hexagons():
    """An architecture-singular robot: base and platform are similar regular hexagons."""
    angles = np.arange(6) * np.pi / 3
    circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1)
    return hx.Hexapod("singular", 10 * circle, 6 * circle, home_position=[0.0, 0.0, 12.0])


def side(robot, position, rotation):
    """The sign of the determinant of the six leg lines, written out."""
    arm = robot.platform_points @ rotation.T
    s = position + arm - robot.base_points
    n = s / np.linalg.norm(s, axis=1)[:, None]
    return np.sign(np.linalg.det(np.hstack([n, np.cross(arm, n) / robot.size])))


def test_round_trip(robot):
    """Every success has the readings that were asked for; where the nominal's branch is the true one, the true pose."""
    position, rotation, reading = reached(robot, 1000)
    found = hx.forward_kinematics(robot, reading)
    assert set(found.status) <= STATUSES
    back = hx.inverse_kinematics(robot, found.position[found.ok], found.rotation[found.ok])
    assert np.abs((back - reading[found.ok]) * robot.gains).max() <= 1e-12 * robot.size
    assert np.isnan(found.position[~found.ok]).all()
    assert np.isnan(found.rotation[~found.ok]).all()
    if not robot.name.startswith("LinuxCNC"):  # whose ranges go beyond its singular poses
        assert found.ok.all()
        np.testing.assert_allclose(found.position, position, rtol=0, atol=1e-9 * robot.size)
        np.testing.assert_allclose(found.rotation, rotation, rtol=0, atol=1e-9)


def test_every_success_is_on_the_side_of_the_start():
    """LinuxCNC's poses lie on both sides of singular ones: never is one found on the other side."""
    robot = hx.robots.linuxcnc()
    position, rotation, reading = reached(robot, 400)
    found = hx.forward_kinematics(robot, reading)
    home = side(robot, robot.home_position, robot.home_rotation)
    sides = np.array([side(robot, p, r) for p, r in zip(position, rotation, strict=True)])
    assert (sides != home).mean() > 0.05
    good = np.flatnonzero(found.ok)
    assert all(side(robot, found.position[i], found.rotation[i]) == home for i in good)
    again = hx.forward_kinematics(robot, reading, position, rotation)  # from the true pose, the true pose
    assert again.ok.all()
    np.testing.assert_allclose(again.position, position, atol=1e-9 * robot.size)


def test_from_a_pose_nearby(robot):
    position, rotation, reading = reached(robot, 50)
    if robot.name.startswith("LinuxCNC"):
        steady = hx.forward_kinematics(robot, reading, position, rotation).condition < 50
        position, rotation, reading = position[steady], rotation[steady], reading[steady]
    turned = rotation_vector_to_matrix([1e-3, -2e-3, 1e-3]) @ rotation
    found = hx.forward_kinematics(robot, reading, position + 1e-3 * robot.size, turned)
    np.testing.assert_allclose(found.position, position, atol=1e-9 * robot.size)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-9)


def test_rotations_are_rotations_to_rounding(left_hand):
    """Also from a start that is rounded to six digits."""
    position, rotation, reading = reached(left_hand, 20)
    found = hx.forward_kinematics(left_hand, reading, position, rotation.round(7))
    product = found.rotation @ np.swapaxes(found.rotation, -1, -2)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-14)


def test_a_batch_equals_its_members(left_hand):
    _, _, reading = reached(left_hand, 6)
    reading = np.array(reading)
    reading[2] += 1e3  # fails alone
    together = hx.forward_kinematics(left_hand, reading.reshape(2, 3, 6))
    assert together.position.shape == (2, 3, 3)
    assert together.status.shape == together.ok.shape == (2, 3)
    for i in range(6):
        alone = hx.forward_kinematics(left_hand, reading[i], throw=False)
        where = divmod(i, 3)
        assert alone.status is together.status[where]
        assert alone.ok == (i != 2)
        np.testing.assert_array_equal(alone.position, together.position[where])
        np.testing.assert_array_equal(alone.iterations, together.iterations[where])


def test_starts_are_broadcast_over_readings(left_hand):
    _, _, reading = reached(left_hand, 1)
    starts = left_hand.home_position + np.linspace(-1, 1, 5)[:, None] * [1.0, 1.0, 0.0]
    found = hx.forward_kinematics(left_hand, reading[0], starts, left_hand.home_rotation)
    assert found.position.shape == (5, 3)
    np.testing.assert_allclose(found.position, np.broadcast_to(found.position[0], (5, 3)), atol=1e-12)


class TestFailures:
    @pytest.mark.parametrize("length", [1.0, 200.0])
    def test_one_length_out_of_reach(self, left_hand, length):
        reading = np.array(hx.inverse_kinematics(left_hand, left_hand.home_position, left_hand.home_rotation))
        reading[2] = length - 15.25
        found = hx.forward_kinematics(left_hand, reading, throw=False)
        assert found.status is hx.Status.NOT_CONVERGED
        assert found.residual > 1e-3
        with pytest.raises(
            EstimationError, match=r"NOT_CONVERGED; these readings may be out of reach, or start nearer"
        ):
            hx.forward_kinematics(left_hand, reading)

    def test_negative_lengths(self, left_hand):
        assert hx.forward_kinematics(left_hand, np.full((1, 6), -40.0)).status[0] is hx.Status.NOT_CONVERGED

    def test_random_readings_are_solved_or_not_but_never_wrong(self, left_hand):
        rng = np.random.default_rng(0)
        reading = rng.uniform(-5, 25, (2000, 6))
        found = hx.forward_kinematics(left_hand, reading)
        assert 0.02 < found.ok.mean() < 0.9
        back = hx.inverse_kinematics(left_hand, found.position[found.ok], found.rotation[found.ok])
        np.testing.assert_allclose(back, reading[found.ok], atol=1e-10)
        assert np.isnan(found.position[~found.ok]).all()

    @pytest.mark.parametrize("moved", [[0.0, 0.0, 0.0], [0.5, 0.2, 1.0]])
    def test_an_architecture_singular_robot(self, moved):
        robot = similar_hexagons()
        reading = hx.inverse_kinematics(robot, robot.home_position + moved, np.eye(3))
        found = hx.forward_kinematics(robot, reading, throw=False)
        assert found.status is hx.Status.RANK_DEFICIENT
        assert np.isnan(found.position).all()
        with pytest.raises(RankDeficientError, match="do not hold the platform; free to first order") as caught:
            hx.forward_kinematics(robot, reading)
        assert caught.value.combinations
        assert "\n" not in str(caught.value)

    def test_a_singular_pose_names_its_free_motion(self):
        """All joints of the platform in one point: it turns freely."""
        angles = np.arange(6) * np.pi / 3
        base = 10 * np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1)
        robot = hx.Hexapod("point", base, np.zeros((6, 3)), home_position=[0.0, 0.0, 8.0])
        with pytest.raises(RankDeficientError) as caught:
            hx.forward_kinematics(robot, hx.inverse_kinematics(robot, [0.0, 0.0, 8.0], np.eye(3)))
        assert set(caught.value.combinations) >= {"turn.x", "turn.y", "turn.z"}

    def test_too_few_iterations(self, left_hand):
        _, _, reading = reached(left_hand, 5)
        found = hx.forward_kinematics(left_hand, reading, max_iterations=1)
        assert {*found.status} == {hx.Status.NOT_CONVERGED}

    def test_throw(self, left_hand):
        _, _, reading = reached(left_hand, 3)
        bad = np.array(reading)
        bad[1] += 1e3
        assert hx.forward_kinematics(left_hand, bad).ok.tolist() == [True, False, True]
        with pytest.raises(EstimationError, match="in 1 of 3 poses"):
            hx.forward_kinematics(left_hand, bad, throw=True)
        assert hx.forward_kinematics(left_hand, reading, throw=True).ok.all()


class TestWrongCalls:
    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"length": [1.0, 2.0]}, "length: expected shape"),
            ({"length": [np.nan] * 6}, "length: 6 value"),
            ({"position": [1.0, 2.0]}, "position: expected shape"),
            ({"rotation": 2 * np.eye(3)}, "rotation: the matrix is not orthonormal"),
            ({"max_iterations": 0}, "max_iterations: expected at least 1"),
            ({"robot": 3}, "robot: expected a Hexapod"),
            ({"length": np.zeros((2, 6)), "position": np.zeros((3, 3))}, "length, position and rotation disagree"),
        ],
    )
    def test_wrong_arguments(self, left_hand, arguments, message):
        with pytest.raises(InputError, match=message):
            hx.forward_kinematics(**{"robot": left_hand, "length": np.zeros(6), **arguments})


class TestDerivatives:
    """Against central differences of forward kinematics itself."""

    def motion(self, robot, reading, pose):
        """(P, rotation vector from `pose`) of a robot's readings."""
        found = hx.forward_kinematics(robot, reading, *pose)
        return np.concatenate([found.position, matrix_to_rotation_vector(found.rotation @ pose[1].T)])

    @pytest.mark.parametrize("name", ["left_hand", "jugglebot"])
    def test_by_readings_and_geometry(self, name, central_difference):
        robot = getattr(hx.robots, name)()
        position, rotation, reading = (part[0] for part in reached(robot, 1, seed=3))
        pose = (position, rotation)
        by = pose_derivatives(robot_blocks(robot), position, rotation)
        fields = {"platform_point": "platform_points", "base_point": "base_points"}
        fields |= {"offset": "offsets", "gain": "gains"}
        expected = {"reading": central_difference(lambda x: self.motion(robot, x, pose), reading, 1e-4)}
        for block, field in fields.items():
            settings = vars(robot)

            def moved(x, field=field, settings=settings):
                return self.motion(hx.Hexapod(**{**settings, field: x.reshape(settings[field].shape)}), reading, pose)

            start = getattr(robot, field)
            expected[block] = central_difference(moved, start.ravel(), 1e-4 * max(1.0, np.abs(start).max()))
        for block, derivative in expected.items():
            got = by[block].reshape(6, -1)
            np.testing.assert_allclose(got, derivative, atol=1e-7 * np.abs(derivative).max())

    def test_a_batch(self, left_hand):
        position, rotation, _ = reached(left_hand, 4)
        by = pose_derivatives(robot_blocks(left_hand), position, rotation)
        for i in range(4):
            alone = pose_derivatives(robot_blocks(left_hand), position[i], rotation[i])
            for name, value in alone.items():
                np.testing.assert_allclose(by[name][i], value, rtol=1e-13, atol=1e-15)

    def test_a_singular_pose_has_none(self):
        robot = hx.Hexapod("point", np.eye(6, 3) * 5, np.zeros((6, 3)), home_position=[0.0, 0.0, 8.0])
        by = pose_derivatives(robot_blocks(robot), robot.home_position, robot.home_rotation)
        assert np.isnan(by["reading"]).all()
