"""Simulated measurements: locks exact to rounding, ranges respected, reachable for all legs, reproducible."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import hexopt as hx
from hexopt.errors import InputError, LockError, SamplingError, UnitError
from hexopt.kinematics import leg_vectors
from hexopt.rotations import matrix_to_euler

EPS = np.finfo(float).eps
LOCKS = list(hx.Lock)


def geometry(robot, leg, data):
    """Return the joint B in the base frame, the leg's true length and its direction, recomputed from the poses."""
    truth = robot.leg(leg)
    point = data.position + np.einsum("...ij,j->...i", data.rotation, truth.platform_point)
    vector = point - truth.base_point
    length = np.linalg.norm(vector, axis=-1)
    return point, length, vector / length[..., None]


@pytest.mark.parametrize("leg", range(1, 7))
@pytest.mark.parametrize("all_legs", [False, True])
class TestLocks:
    """What is locked is constant in a set to rounding, and differs between sets; what is free is not."""

    def poses(self, robot, leg, lock, all_legs):
        ranges = robot.ranges
        if all_legs:
            # within the limits of all six legs
            ranges = replace(ranges, length=robot.limits.leg_length or ranges.length)
        return hx.simulate_leg(robot, leg, lock, 6, 8, ranges=ranges, rng=leg, all_legs=all_legs)

    def spread(self, values):
        return np.abs(values - values[:, :1]).max(axis=1)

    def test_direction(self, robot, leg, all_legs):
        data = self.poses(robot, leg, "direction", all_legs)
        _, length, direction = geometry(robot, leg, data)
        tolerance = 8 * EPS * robot.size / length.min()
        assert self.spread(direction).max() < tolerance
        assert (np.ptp(length, axis=1) > 1e-3 * length.mean()).all()
        assert np.ptp(direction[:, 0], axis=0).max() > 1e-3

    def test_leg(self, robot, leg, all_legs):
        data = self.poses(robot, leg, "leg", all_legs)
        point, length, direction = geometry(robot, leg, data)
        assert self.spread(point).max() < 8 * EPS * robot.size
        assert np.ptp(length, axis=1).max() < 8 * EPS * robot.size
        assert self.spread(direction).max() < 8 * EPS * robot.size / length.min()
        np.testing.assert_array_equal(data.length, np.broadcast_to(data.length[:, :1], (8, 6)))
        assert np.ptp(length[:, 0]) > 1e-3 * length.mean()

    def test_length(self, robot, leg, all_legs):
        data = self.poses(robot, leg, "length", all_legs)
        _, length, direction = geometry(robot, leg, data)
        assert np.ptp(length, axis=1).max() < 8 * EPS * robot.size
        np.testing.assert_array_equal(data.length, np.broadcast_to(data.length[:, :1], (8, 6)))
        assert (self.spread(direction).max(axis=-1) > 1e-3).all()

    def test_none(self, robot, leg, all_legs):
        data = self.poses(robot, leg, "none", all_legs)
        _, length, direction = geometry(robot, leg, data)
        assert (np.ptp(length, axis=1) > 1e-3 * length.mean()).all()
        assert (self.spread(direction).max(axis=-1) > 1e-3).all()

    def test_readings_are_exact(self, robot, leg, all_legs):
        for lock in LOCKS:
            data = self.poses(robot, leg, lock, all_legs)
            _, length, _ = geometry(robot, leg, data)
            np.testing.assert_allclose(
                robot.leg(leg).true_length(data.length), length, rtol=0, atol=8 * EPS * robot.size
            )
            if all_legs:
                assert hx.reachable(robot, data.position, data.rotation).all()


@pytest.mark.parametrize("lock", LOCKS)
class TestRanges:
    N = 4000

    def sample(self, robot, lock, ranges=None):
        poses = 4
        return hx.simulate_leg(robot, 3, lock, poses, self.N // poses, ranges=ranges, rng=1)

    def test_ranges_are_respected_and_filled(self, robot, lock):
        ranges = robot.ranges
        data = self.sample(robot, lock)
        _, length, direction = geometry(robot, 3, data)
        low, high = ranges.length
        slack = 8 * EPS * robot.size
        assert low - slack <= length.min() < low + 0.02 * (high - low)
        assert high - 0.02 * (high - low) < length.max() <= high + slack
        home = robot.home_vectors[2] / robot.home_lengths[2]
        angle = 2 * np.arcsin(np.minimum(0.5 * np.linalg.norm(direction - home, axis=-1), 1.0))
        cone = ranges.lock_cone if lock in ("direction", "leg") else ranges.cone
        assert 0.98 * cone < angle.max() <= cone * (1 + 1e-9)
        turn = np.swapaxes(robot.home_rotation[None, None], -1, -2) @ data.rotation
        half = np.array(ranges.angles)
        angles = matrix_to_euler(turn, ranges.sequence)
        if ranges.sequence == "ZXZ":  # (ψ, θ, φ) and (ψ ± π, −θ, φ ± π) are one rotation: take the one in range
            other = np.stack([angles[..., 0] + np.pi, -angles[..., 1], angles[..., 2] + np.pi], axis=-1)
            other = np.angle(np.exp(1j * other))
            inside = (np.abs(angles) <= half + 1e-9).all(axis=-1, keepdims=True)
            angles = np.where(inside, angles, other)
        assert (np.abs(angles) <= half + 1e-9).all()
        assert (np.abs(angles).max(axis=(0, 1)) > 0.98 * half).all()

    def test_distributions_are_uniform(self, left_hand, lock):
        """Kolmogorov–Smirnov at fixed seeds: lengths, directions (in height and around), Euler angles."""
        data = self.sample(left_hand, lock)
        _, length, direction = geometry(left_hand, 3, data)
        ranges = left_hand.ranges
        held_length, held_direction = lock in ("length", "leg"), lock in ("direction", "leg")
        length = length[:, 0] if held_length else length.ravel()
        direction = direction[:, 0] if held_direction else direction.reshape(-1, 3)
        cone = ranges.lock_cone if held_direction else ranges.cone
        home = left_hand.home_vectors[2] / left_hand.home_lengths[2]
        height = direction @ home
        side = np.cross(home, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        around = np.arctan2(direction @ np.cross(home, side), direction @ side)
        low, high = ranges.length
        third = data.rotation[..., 2, 2].ravel()  # cos θ, with θ uniform in ±35°
        for values, law in (
            (length, stats.uniform(low, high - low)),
            (height, stats.uniform(np.cos(cone), 1 - np.cos(cone))),
            (around, stats.uniform(-np.pi, 2 * np.pi)),
            (np.arccos(np.clip(third, -1, 1)), stats.uniform(0, ranges.angles[1])),
        ):
            assert stats.kstest(values, law.cdf).pvalue > 0.01

    def test_other_ranges(self, left_hand, lock):
        ranges = hx.PoseRanges(angles=(0.0, 0.1, 0.2), length=(30.0, 30.0), cone=0.0, lock_cone=0.0, sequence="xyz")
        _, length, direction = geometry(left_hand, 3, self.sample(left_hand, lock, ranges))
        np.testing.assert_allclose(length, 30.0, rtol=1e-14)
        home = left_hand.home_vectors[2] / left_hand.home_lengths[2]
        np.testing.assert_allclose(direction, np.broadcast_to(home, direction.shape), atol=1e-14)


class TestSixLegs:
    @pytest.mark.parametrize("lock", LOCKS)
    def test_all_readings_at_poses_that_all_legs_reach(self, robot, lock):
        locked = None if lock == "none" else 2
        data = hx.simulate(robot, lock, n_poses=5, n_sets=6, leg=locked, rng=0)
        assert data.length.shape == (6, 5, 6)
        assert hx.reachable(robot, data.position, data.rotation).all()
        np.testing.assert_array_equal(data.length, hx.inverse_kinematics(robot, data.position, data.rotation))
        assert data.locked_leg == locked
        if lock == "direction":
            direction = leg_vectors(robot, data.position, data.rotation)[..., 1, :]
            direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
            assert np.abs(direction - direction[:, :1]).max() < 1e-14 * robot.size / robot.home_lengths[1] * 8
        if lock == "length":
            assert np.ptp(robot.leg(2).true_length(data.length[..., 1]), axis=1).max() < 8 * EPS * robot.size

    def test_a_lock_needs_a_leg(self, left_hand):
        with pytest.raises(InputError, match="expected a number from 1 to 6"):
            hx.simulate(left_hand, "leg", n_poses=3, rng=0)
        with pytest.raises(LockError, match="locked_leg: 3 is named"):
            hx.simulate(left_hand, "none", n_poses=3, leg=3, rng=0)

    def test_a_further_condition(self, left_hand):
        data = hx.simulate(left_hand, n_poses=20, rng=0, accept=lambda position, rotation: position[..., 0] > 0.5)
        assert (data.position[:, 0] > 0.5).all()
        leg = hx.simulate_leg(left_hand, 3, "leg", 20, rng=0, accept=lambda position, rotation: position[..., 2] > 16)
        assert (leg.position[:, 2] > 16).all()


class TestHopeless:
    def test_the_error_says_what_fraction_and_which_limit(self, left_hand):
        robot = replace(left_hand, limits=hx.Limits(leg_length=(1.0, 2.0), tilt=3.0))
        with pytest.raises(
            SamplingError,
            match=r"only 0 of \d+ random poses \(0\).*'direction' of leg 3.*leg_length refuses 100.*tilt refuses 0\.0%",
        ) as caught:
            hx.simulate(robot, "direction", 7, leg=3, rng=1)
        assert "\n" not in str(caught.value)

    def test_a_large_batch_gives_up_as_soon(self, left_hand, monkeypatch):
        """A thousand sets once took eight minutes to say no."""
        monkeypatch.setattr("hexopt.poses.FIRST_DRAWS", 20_000)
        monkeypatch.setattr("hexopt.poses.LARGEST_DRAW", 20_000)
        robot = replace(left_hand, limits=hx.Limits(leg_length=(1.0, 2.0)))
        with pytest.raises(SamplingError, match=r"only 0 of \d+ random poses") as caught:
            hx.simulate(robot, "direction", 7, 1000, leg=3, rng=1)
        assert int(str(caught.value).split()[3]) < 100_000

    def test_a_low_rate_alone_is_not_hopeless(self, left_hand, monkeypatch):
        """One pose in some hundred is accepted here: however many are asked for, they are found."""
        monkeypatch.setattr("hexopt.poses.FIRST_DRAWS", 1_000)
        monkeypatch.setattr("hexopt.poses.MOST_DRAWS", 10_000)
        robot = replace(left_hand, limits=hx.Limits(leg_length=(17.0, 20.3)))
        data = hx.simulate_leg(robot, 3, "none", 10, 20, all_legs=True, rng=0)
        assert hx.reachable(robot, data.position, data.rotation).all()

    def test_a_rare_pose_is_found_all_the_same(self, left_hand):
        """METHODS 6: under the paper's ranges half a percent of poses can be reached by all six legs."""
        robot = replace(left_hand, limits=hx.Limits(leg_length=(17.0, 20.3)))
        data = hx.simulate_leg(robot, 3, "direction", 5, 40, all_legs=True, rng=0)
        assert hx.reachable(robot, data.position, data.rotation).all()

    @pytest.mark.parametrize("seed", range(4))
    def test_a_large_set_finds_a_clamp_that_leaves_poses(self, left_hand, seed):
        """Few random points are within reach of a clamped leg, and a large set once gave up after two of them."""
        data = hx.simulate(left_hand, "leg", n_poses=10_000, leg=3, rng=seed)
        point, _, _ = geometry(left_hand, 3, data.leg(3))
        assert np.ptp(point, axis=0).max() < 8 * EPS * left_hand.size
        assert hx.reachable(left_hand, data.position, data.rotation).all()

    def test_a_condition_that_is_never_met(self, left_hand):
        never = lambda position, rotation: np.zeros(position.shape[:-1], dtype=bool)  # noqa: E731 - a name says it
        with pytest.raises(SamplingError, match="only 0 of"):
            hx.simulate_leg(left_hand, 3, "leg", 3, accept=never, rng=0)


class TestRandomness:
    def both(self, left_hand, rng, **settings):
        noise = hx.UniformNoise(0.01, 1e-4, 0.01)
        one = hx.simulate_leg(left_hand, 3, "direction", 5, 4, noise=noise, rng=rng, **settings)
        return one.position, one.rotation, one.length

    def test_the_same_seed_gives_the_same_bits(self, left_hand):
        for settings in ({}, {"all_legs": True}):
            for one, two in zip(self.both(left_hand, 3, **settings), self.both(left_hand, 3, **settings), strict=True):
                np.testing.assert_array_equal(one, two)
        for one, two in zip(self.both(left_hand, 3), self.both(left_hand, np.random.default_rng(3)), strict=True):
            np.testing.assert_array_equal(one, two)
        one, two = (hx.simulate(left_hand, n_poses=5, rng=7) for _ in range(2))
        np.testing.assert_array_equal(one.length, two.length)

    def test_another_seed_gives_others(self, left_hand):
        for one, two in zip(self.both(left_hand, 3), self.both(left_hand, 4), strict=True):
            assert (one != two).any()

    def test_noise_does_not_change_the_poses_behind_it(self, left_hand):
        noisy = hx.simulate_leg(left_hand, 3, "leg", 5, 4, noise=hx.UniformNoise(0.01), rng=0)
        exact = hx.simulate_leg(left_hand, 3, "leg", 5, 4, rng=0)
        assert 0 < np.abs(noisy.position - exact.position).max() <= 0.01
        np.testing.assert_array_equal(noisy.rotation, exact.rotation)

    @pytest.mark.parametrize("rng", [None, -1, 1.5, "seed", True])
    def test_no_hidden_randomness(self, left_hand, rng):
        with pytest.raises(InputError, match="rng"):
            hx.simulate_leg(left_hand, 3, "leg", 5, rng=rng)
        with pytest.raises(InputError, match="rng"):
            hx.simulate(left_hand, n_poses=3, rng=rng)

    def test_no_default(self, left_hand):
        with pytest.raises(TypeError, match="rng"):
            hx.simulate_leg(left_hand, 3, "leg", 5)
        with pytest.raises(TypeError, match="rng"):
            hx.simulate(left_hand)


class TestArguments:
    def test_one_set_has_no_batch(self, left_hand):
        assert hx.simulate_leg(left_hand, 3, "leg", 5, rng=0).position.shape == (5, 3)
        assert hx.simulate_leg(left_hand, 3, "leg", 5, 1, rng=0).position.shape == (1, 5, 3)
        assert hx.simulate(left_hand, n_poses=4, rng=0).length.shape == (4, 6)

    def test_noise_and_nominal_travel_with_the_data(self, left_hand, paper_noise):
        nominal = left_hand.perturbed(0.3, rng=0)
        for given in (nominal, nominal.leg(3)):
            data = hx.simulate_leg(left_hand, 3, "leg", 5, noise=paper_noise, nominal=given, rng=0)
            assert data.noise is paper_noise
            np.testing.assert_array_equal(data.nominal.base_point, nominal.base_points[2])
        whole = hx.simulate(left_hand, n_poses=3, noise=paper_noise, nominal=nominal, rng=0)
        assert whole.nominal is nominal
        assert (whole.leg(4).noise, whole.length_unit) == (paper_noise, "cm")

    @pytest.mark.parametrize(
        ("changes", "error", "message"),
        [
            ({"leg": 7}, InputError, "from 1 to 6"),
            ({"lock": "clamped"}, LockError, "lock: expected one of"),
            ({"n_poses": 0}, InputError, "n_poses: expected a whole number >= 1, got 0"),
            ({"n_poses": 2.0}, InputError, "n_poses"),
            ({"n_poses": True}, InputError, "n_poses"),
            ({"n_sets": 0}, InputError, "n_sets"),
            ({"n_sets": -3}, InputError, "n_sets"),
            ({"robot": hx.robots.left_hand().leg(3)}, InputError, "robot: expected a Hexapod, got Leg"),
            ({"nominal": hx.robots.left_hand().leg(2)}, InputError, "nominal: is leg 2, but leg 3 is simulated"),
            ({"nominal": hx.robots.jugglebot()}, UnitError, "measurements are in cm, the nominal geometry in mm"),
        ],
    )
    def test_wrong_ones(self, left_hand, changes, error, message):
        settings = {"robot": left_hand, "leg": 3, "lock": "leg", "n_poses": 5, "rng": 0, **changes}
        with pytest.raises(error, match=message):
            hx.simulate_leg(**settings)

    def test_wrong_ones_for_six_legs(self, left_hand):
        with pytest.raises(UnitError, match="measurements are in cm, the nominal geometry in um"):
            hx.simulate(left_hand, n_poses=3, nominal=hx.robots.rubin(), rng=0)
        with pytest.raises(InputError, match="n_poses"):
            hx.simulate(left_hand, n_poses=0, rng=0)
        with pytest.raises(InputError, match="robot: expected a Hexapod"):
            hx.simulate("left-hand", rng=0)
