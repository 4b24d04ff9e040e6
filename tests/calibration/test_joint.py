"""Everything measured in one likelihood, and what that says of the platform's pose."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError
from hexopt.rotations import matrix_to_rotation_vector

NOISE = hx.NormalNoise(0.01, 1e-4, 0.01, coordinates="rotation_vector")


def direction_sets(robot, n=8, noise=NOISE, rng=0):
    return [hx.simulate(robot, "direction", n, leg=k, noise=noise, rng=10 * rng + k) for k in range(1, 7)]


class TestCalibration:
    def test_it_is_the_default(self, left_hand):
        sets, nominal = direction_sets(left_hand), left_hand.perturbed(0.3, offsets=0.2, rng=0)
        result = hx.calibrate(nominal, sets)
        assert result.method == "Joint(model=42)"
        assert repr(hx.calibrate(nominal, sets, hx.Joint()).robot) == repr(result.robot)
        loop = hx.loops.WholeRobot(*sets, nominal=nominal)
        found = hx.estimate(loop, hx.MaximumLikelihood())
        for k, part in result.legs.items():
            np.testing.assert_allclose(part.leg.base_point, found.params[f"leg{k}.base_point"])
            assert part.covariance.shape == (7, 7)
            np.testing.assert_allclose(part.covariance[3:6, 3:6], found.covariance_of(f"leg{k}.base_point"))
        assert "covariance: model" in result.summary()
        assert len(result.to_frame()) == 42

    @pytest.mark.parametrize("model", [36, 42, 48])
    def test_without_noise_every_robot_is_found(self, robot, model):
        scale = robot.size / 20
        small = hx.NormalNoise(1e-3 * scale, 1e-5, 1e-3 * scale / abs(robot.gains).max())
        nominal = robot.perturbed(0.2 * scale, offsets=0.2 * scale if model > 36 else 0.0, rng=0)
        if model == 48:
            nominal = replace(nominal, gains=nominal.gains * 1.001)
        sets = [
            hx.simulate(robot, n_poses=20, rng=1),
            *(hx.simulate(robot, "direction", 5, leg=k, rng=k) for k in (2, 5)),
        ]
        result = hx.calibrate(nominal, [replace(data, noise=small) for data in sets], hx.Joint(model))
        worst = 1e-6 if robot.name.startswith("Rubin") else 1e-9
        assert np.abs(result.robot.base_points - robot.base_points).max() < worst * robot.size
        assert np.abs(result.robot.platform_points - robot.platform_points).max() < worst * robot.size
        assert np.abs(result.robot.offsets - robot.offsets).max() < worst * robot.size

    def test_legs_without_readings_keep_their_nominal(self, left_hand):
        nominal = left_hand.perturbed(0.2, rng=0)
        sets = [hx.simulate_leg(left_hand, 2, lock, 12, noise=NOISE, rng=k) for k, lock in enumerate(("leg", "length"))]
        result = hx.calibrate(nominal, sets)
        assert list(result.legs) == [2]
        assert result.robot.leg(1) == nominal.leg(1)
        assert np.abs(result.robot.leg(2).base_point - left_hand.leg(2).base_point).max() < 0.2

    def test_what_cannot_be_seen_or_weighed(self, left_hand):
        sets = [hx.simulate_leg(left_hand, 2, "direction", 12, noise=NOISE, rng=1)]
        with pytest.raises(RankDeficientError, match=r"leg2\.offset"):
            hx.calibrate(left_hand, sets)
        assert list(hx.calibrate(left_hand, sets, hx.Joint(36)).legs) == [2]
        with pytest.raises(InputError, match="no noise model"):
            hx.calibrate(left_hand, [replace(sets[0], noise=None)], hx.Joint(36))
        with pytest.raises(InputError, match="expected 36, 42 or 48"):
            hx.Joint(40)
        with pytest.raises(InputError, match="a pose in common"):
            hx.calibrate(left_hand, [sets[0], sets[0]], hx.Joint(36))


class TestPoseCovariance:
    def test_against_finite_differences(self, left_hand):
        """The derivative of forward kinematics by every parameter, at a pose that is not home."""
        position, rotation = np.array([0.4, -0.3, 20.0]), hx.rotations.rotation_vector_to_matrix([0.1, -0.05, 0.2])
        parameters = hx.loops.WholeRobot(hx.simulate(left_hand, n_poses=9, rng=0)).parameters
        length = hx.inverse_kinematics(left_hand, position, rotation)
        columns, step = [], 1e-6
        for leg in left_hand.legs:
            for name in ("platform_point", "base_point", "offset"):
                for i in range(leg.block(name).size):
                    change = np.zeros(leg.block(name).size)
                    change[i] = step
                    value = leg.block(name) + change
                    moved = left_hand.with_legs(
                        {leg.number: leg.replaced(**{name: value if value.size > 1 else value[0]})}
                    )
                    pose = hx.forward_kinematics(moved, length, position, rotation)
                    turn = matrix_to_rotation_vector(pose.rotation @ rotation.T)
                    columns.append(np.concatenate([pose.position - position, turn]) / step)
        jacobian = np.array(columns).T
        root = np.random.default_rng(0).normal(size=(42, 42))
        covariance = root @ root.T
        found = hx.pose_covariance(left_hand, parameters, covariance, position, rotation)
        np.testing.assert_allclose(
            found, jacobian @ covariance @ jacobian.T, rtol=1e-4, atol=1e-4 * np.abs(found).max()
        )

    def test_intervals_hold_the_true_pose(self, left_hand):
        """Normalised errors of the platform's position at home, over calibrations of 12 unlocked poses."""
        n_sets = 250
        noise = hx.NormalNoise(0.01, 2e-4, 0.001, coordinates="rotation_vector")
        loop = hx.loops.WholeRobot(hx.simulate(left_hand, n_poses=12, n_sets=n_sets, noise=noise, rng=1))
        found = hx.estimate(loop, hx.MaximumLikelihood())
        home = hx.inverse_kinematics(left_hand, left_hand.home_position, left_hand.home_rotation)
        squares = []
        for i in range(n_sets):
            one = found[i]
            legs = {
                k: left_hand.leg(k).replaced(
                    platform_point=one.params[f"leg{k}.platform_point"],
                    base_point=one.params[f"leg{k}.base_point"],
                    offset=one.params[f"leg{k}.offset"][0],
                )
                for k in range(1, 7)
            }
            robot = left_hand.with_legs(legs)
            error = hx.forward_kinematics(robot, home).position - left_hand.home_position
            covariance = hx.pose_covariance(robot, one.parameters, one.covariance)[:3, :3]
            squares.append(error @ np.linalg.solve(covariance, error) / 3)
        assert abs(np.mean(squares) - 1) < 4 * np.sqrt(2 / (3 * n_sets))

    def test_wrong_calls(self, left_hand):
        sets = [hx.simulate_leg(left_hand, k, "direction", 6, rng=k) for k in range(1, 7)]
        with pytest.raises(InputError, match=r"leg by leg.*Joint\(\)"):
            hx.calibrate(left_hand, sets, hx.OneStep()).pose_covariance()
        parameters = hx.loops.WholeRobot(hx.simulate(left_hand, n_poses=9, rng=0)).parameters
        with pytest.raises(InputError, match="covariance: expected shape"):
            hx.pose_covariance(left_hand, parameters, np.eye(41))
        with pytest.raises(InputError, match="rotation"):
            hx.pose_covariance(left_hand, parameters, np.eye(42), [0, 0, 19.0], 2 * np.eye(3))
