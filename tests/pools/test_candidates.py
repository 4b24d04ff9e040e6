"""Candidate poses: reachable, on one clamp, exact, covering what is feasible; and errors that say why none are."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import hexopt as hx
from hexopt.errors import InputError, LockError, SamplingError, UnitError
from hexopt.information import pose_information
from hexopt.kinematics import leg_vectors

EPS = np.finfo(float).eps
LOCKS = list(hx.Lock)
HELD = [hx.Lock.DIRECTION, hx.Lock.LEG, hx.Lock.LENGTH]
LOOPS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}


def nothing(position, rotation):
    """Refuse every pose."""
    return np.zeros(len(position), dtype=bool)


def held(robot, leg, pool):
    """Return directions (n, 3), joints B (n, 3) and true lengths (n,) of a leg, recomputed from the poses."""
    vectors = leg_vectors(robot, pool.position, pool.rotation)[:, leg - 1]
    lengths = np.linalg.norm(vectors, axis=-1)
    return vectors / lengths[:, None], vectors + robot.base_points[leg - 1], lengths


def near_home(robot, leg, lock):
    """Return what a clamp holds a little off home, and the vector of the leg there."""
    vector = 1.01 * robot.home_vectors[leg - 1] + 0.005 * robot.home_lengths[leg - 1] * np.array([1.0, -1.0, 0.0])
    length = np.linalg.norm(vector)
    values = {"direction": 3 * vector, "leg": robot.base_points[leg - 1] + vector, "length": length}
    return values[lock], vector


@pytest.mark.parametrize("lock", LOCKS)
class TestEveryRobot:
    @pytest.mark.parametrize("leg", [1, 3, 6])
    def test_all_legs_reach_them_and_the_readings_are_exact(self, robot, lock, leg):
        pool = hx.candidates(robot, leg, lock, 300, rng=leg)
        assert (pool.n_poses, pool.batch_shape, pool.length.shape) == (300, (), (300, 6))
        assert hx.reachable(robot, pool.position, pool.rotation).all()
        np.testing.assert_array_equal(pool.length, hx.inverse_kinematics(robot, pool.position, pool.rotation))
        assert (pool.lock, pool.locked_leg) == (lock, None if lock == "none" else leg)
        assert len(np.unique(pool.position, axis=0)) == 300

    def test_the_clamp_is_that_of_home(self, robot, lock):
        pool = hx.candidates(robot, 2, lock, 200, rng=0)
        self.check(robot, pool, lock, robot.home_vectors[1])

    def test_the_clamp_is_the_one_given(self, robot, lock):
        if lock == "none":
            with pytest.raises(InputError, match="given: the lock 'none' holds nothing"):
                hx.candidates(robot, 2, lock, 5, given=1.0, rng=0)
            return
        given, vector = near_home(robot, 2, lock)
        self.check(robot, hx.candidates(robot, 2, lock, 200, given=given, rng=0), lock, vector)

    def check(self, robot, pool, lock, vector):
        direction, point, length = held(robot, 2, pool)
        slack = 8 * EPS * robot.size
        if lock in ("direction", "leg"):
            np.testing.assert_allclose(
                direction, np.broadcast_to(vector / np.linalg.norm(vector), (200, 3)), atol=slack / length.min()
            )
        else:
            assert np.ptp(direction, axis=0).max() > 1e-3
        if lock in ("length", "leg"):
            np.testing.assert_allclose(length, np.linalg.norm(vector), rtol=0, atol=slack)
        else:
            assert np.ptp(length) > 1e-3 * length.mean()
        if lock == "leg":
            np.testing.assert_allclose(point, np.broadcast_to(vector + robot.base_points[1], (200, 3)), atol=slack)


class TestUse:
    def test_loops_of_the_leg_and_of_the_robot_take_them(self, left_hand, paper_noise):
        nominal = left_hand.perturbed(0.3, rng=0)
        for lock, loop in LOOPS.items():
            pool = hx.candidates(left_hand, 3, lock, 40, paper_noise, nominal=nominal, rng=0)
            assert pool.nominal is nominal
            assert pool.noise is paper_noise
            assert pose_information(loop(pool.leg(3))).n_poses == 40
            whole = hx.loops.WholeRobot(pool)
            assert whole.batch_shape == ()

    def test_noise_is_assumed_and_not_added(self, left_hand, paper_noise):
        noisy = hx.candidates(left_hand, 3, "leg", 40, paper_noise, rng=0)
        exact = hx.candidates(left_hand, 3, "leg", 40, rng=0)
        for name in ("position", "rotation", "length"):
            np.testing.assert_array_equal(getattr(noisy, name), getattr(exact, name))

    def test_unlocked_ones_need_no_leg(self, left_hand):
        one, two = (hx.candidates(left_hand, leg, "none", 40, rng=0) for leg in (None, 1))
        np.testing.assert_array_equal(one.position, two.position)

    def test_the_same_seed_gives_the_same_bits(self, left_hand):
        one, two = (hx.candidates(left_hand, 3, "length", 3000, rng=7) for _ in range(2))
        np.testing.assert_array_equal(one.position, two.position)
        np.testing.assert_array_equal(one.length, two.length)
        assert (one.position != hx.candidates(left_hand, 3, "length", 3000, rng=8).position).any()

    def test_a_further_condition(self, left_hand):
        seen = []

        def high(position, rotation):
            seen.append(hx.reachable(left_hand, position, rotation).all())
            return position[:, 2] > 19

        pool = hx.candidates(left_hand, 3, "direction", 500, accept=high, rng=0)
        assert (pool.position[:, 2] > 19).all()
        assert all(seen)

    def test_more_than_one_draw_can_hold(self, left_hand, monkeypatch):
        monkeypatch.setattr("hexopt.pools.drawn.MOST_AT_ONCE", 1000)
        pool = hx.candidates(left_hand, 3, "direction", 2345, rng=0)
        assert pool.n_poses == len(np.unique(pool.position, axis=0)) == 2345


class TestCoverage:
    """The poses are spread as those of a plain rejection written out with SciPy's rotations."""

    N = 4000

    def plain(self, robot, lock, rng):
        """Uniform x-y-z angles, lengths and directions within 90° of the vertical; then the limits, one by one."""
        a, b, vector = robot.base_points[2], np.array(robot.platform_points), robot.home_vectors[2]
        home = np.linalg.norm(vector)
        found = []
        while sum(map(len, found)) < self.N:
            m = 200_000
            turn = Rotation.from_euler("xyz", rng.uniform(-25, 25, (m, 3)), degrees=True)
            length = np.full(m, home) if lock in ("leg", "length") else rng.uniform(17.25, 25.25, m)
            direction = np.broadcast_to(vector / home, (m, 3))
            if lock in ("length", "none"):
                height, around = rng.uniform(0, 1, m), rng.uniform(0, 2 * np.pi, m)
                side = np.sqrt(1 - height**2)
                direction = np.column_stack([side * np.cos(around), side * np.sin(around), height])
            position = a + length[:, None] * direction - turn.apply(b[2])
            good = np.ones(m, dtype=bool)
            for k in range(6):
                leg = position + turn.apply(b[k]) - robot.base_points[k]
                size = np.linalg.norm(leg, axis=1)
                good &= (size >= 17.25 - 1e-9) & (size <= 25.25 + 1e-9) & (leg[:, 2] >= np.cos(np.pi / 4) * size)
            found.append(np.column_stack([position, turn.as_rotvec()])[good])
        return np.concatenate(found)[: self.N]

    @pytest.mark.parametrize("lock", LOCKS)
    def test_every_coordinate(self, left_hand, lock):
        pool = hx.candidates(left_hand, 3, lock, self.N, rng=1)
        ours = np.column_stack([pool.position, Rotation.from_matrix(pool.rotation).as_rotvec()])
        theirs = self.plain(left_hand, lock, np.random.default_rng(2))
        for one, two in zip(ours.T, theirs.T, strict=True):
            assert stats.ks_2samp(one, two).pvalue > 0.01
            # and no corner is left out: the extremes agree within 8 % of the width
            width = np.ptp(two)
            assert abs(one.min() - two.min()) < 0.08 * width
            assert abs(one.max() - two.max()) < 0.08 * width

    def test_ranges_narrow_them(self, left_hand):
        ranges = hx.PoseRanges(angles=(0.0, 0.0, 0.1), length=(19.0, 20.0), cone=0.1, lock_cone=0.1, sequence="xyz")
        pool = hx.candidates(left_hand, 3, "direction", 200, ranges=ranges, rng=0)
        _, _, length = held(left_hand, 3, pool)
        assert 19 - 1e-12 <= length.min() < length.max() <= 20 + 1e-12
        np.testing.assert_allclose(pool.rotation[:, 2, 2], 1.0, atol=1e-15)


class TestNone:
    """No feasible candidate: soon an error, which names the clamp, the limits, and the way out."""

    @pytest.fixture(autouse=True)
    def _soon(self, monkeypatch):
        monkeypatch.setattr("hexopt.poses.FIRST_DRAWS", 50_000)

    @pytest.mark.parametrize(
        ("lock", "given", "message"),
        [
            (
                "direction",
                [1, 0, 0.2],
                r"at the direction \(0\.9806, 0, 0\.1961\).*base_tilt refuses 100\.0%.*another d",
            ),
            ("leg", [0, 0, 50], r"at the fixed point \(0, 0, 50\).*\(leg_length refuses 100\.0%.*another fixed point"),
            (
                "length",
                30.0,
                r"at the true length 30 cm, .*\(leg_length refuses 100\.0%.*another true length \(given=\)$",
            ),
        ],
    )
    def test_it_says_which_limit_kills_them(self, left_hand, lock, given, message):
        with pytest.raises(SamplingError, match=rf"^only 0 of \d+ .* the lock '{lock}' of leg 3, {message}"):
            hx.candidates(left_hand, 3, lock, 10, given=given, rng=0)

    def test_a_home_beyond_the_limits(self, left_hand):
        robot = replace(left_hand, home_position=np.array([0.0, 0.0, 40.0]))
        with pytest.raises(
            SamplingError, match=r"of home, are feasible \(leg_length refuses 100\.0%.*another fixed point"
        ):
            hx.candidates(robot, 3, "leg", 10, rng=0)

    def test_limits_that_no_pose_meets(self, left_hand):
        robot = replace(left_hand, limits=hx.Limits(leg_length=(1.0, 2.0), tilt=3.0))
        with pytest.raises(
            SamplingError, match=r"no lock, built from leg 1, .*\(leg_length refuses 100\.0%, tilt refuses 0"
        ):
            hx.candidates(robot, None, "none", 10, rng=0)

    def test_a_condition_that_is_never_met(self, left_hand):
        with pytest.raises(SamplingError, match=r"that all legs reach, accept refuses 100\.0%\); widen"):
            hx.candidates(left_hand, 3, "leg", 10, accept=nothing, rng=0)
        free = hx.robots.linuxcnc()
        with pytest.raises(SamplingError, match=r"\(of those that all legs reach, accept refuses 100\.0%\)"):
            hx.candidates(free, None, "none", 10, accept=nothing, rng=0)

    def test_too_few_for_so_many(self, left_hand, monkeypatch):
        monkeypatch.setattr("hexopt.poses.MOST_DRAWS", 100_000)
        rare = lambda position, rotation: position[:, 0] > 9  # noqa: E731 - a name says it
        with pytest.raises(SamplingError, match=r"^only [1-9]\d* of \d+ .*or ask for fewer poses$"):
            hx.candidates(left_hand, None, "none", 1000, accept=rare, rng=0)


class TestArguments:
    @pytest.mark.parametrize(
        ("changes", "error", "message"),
        [
            ({"robot": "left-hand"}, InputError, "robot: expected a Hexapod"),
            ({"leg": 7}, InputError, "from 1 to 6"),
            ({"leg": None}, LockError, r"leg: which leg \(1…6\) has the lock 'direction'"),
            ({"lock": "clamped"}, LockError, "lock: expected one of"),
            ({"n": 0}, InputError, "n: expected a whole number >= 1"),
            ({"rng": None}, InputError, "rng: a seed"),
            ({"noise": 0.1}, InputError, "noise: expected a noise model"),
            ({"nominal": hx.robots.jugglebot()}, UnitError, "in cm, the nominal geometry in mm"),
            ({"ranges": (1, 2)}, InputError, r"ranges: expected PoseRanges\(…\), got \(1, 2\)"),
            ({"given": [0, 0, 0]}, InputError, r"given \(the direction\): expected a vector other than zero"),
            ({"given": [0, 0, np.nan]}, InputError, r"given \(the direction\): 1 value\(s\) are NaN"),
            ({"given": 3.0}, InputError, r"given \(the direction\): expected shape \(3\)"),
            ({"lock": "leg", "given": [12.76, 3.9, 0]}, InputError, "a point away from the leg's base joint"),
            ({"lock": "length", "given": 0.0}, InputError, "expected a length > 0, got 0"),
            ({"lock": "length", "given": [1, 2, 3]}, InputError, r"given \(the true length\): expected shape \(\)"),
            (
                {"accept": lambda p, r: p},
                InputError,
                r"accept: expected a mask of \d+ booleans, one a pose, got float64",
            ),
            ({"accept": lambda p, r: np.bool_(True)}, InputError, r"got bool of shape \(\)"),
            ({"accept": 3}, InputError, r"accept: expected a function of positions \(m, 3\) and .*, got 3"),
            ({"accept": lambda p: p}, InputError, "accept: expected a function of positions"),
            ({"noise": hx.UniformNoise}, InputError, "noise: expected a noise model such as"),
        ],
    )
    def test_wrong_ones(self, left_hand, changes, error, message):
        settings = {"robot": left_hand, "leg": 3, "lock": "direction", "n": 5, "rng": 0, **changes}
        with pytest.raises(error, match=message):
            hx.candidates(**settings)
