"""Locked legs whose reading is taken too: derivatives, the true leg, which sets see what."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, LockError, RankDeficientError
from hexopt.loops import FixedLeg, FixedLength, ReadLeg, ReadLength, Sets
from hexopt.rotations import euler_to_matrix

LOOPS = {"leg": ReadLeg, "length": ReadLength}
INVOLVED = ReadLeg.involved
CASES = [
    (lock, unknown)
    for lock in LOOPS
    for count in range(1, len(INVOLVED) + 1)
    for unknown in itertools.combinations(INVOLVED, count)
]
N = 4
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)


def random_data(lock, batch=(), seed=0):
    """Poses that satisfy no lock: derivatives must hold everywhere."""
    rng = np.random.default_rng(seed)
    return hx.LegMeasurements(
        rng.uniform(-3, 3, (*batch, N, 3)) + np.array([0, 0, 9]),
        euler_to_matrix(rng.uniform(-1, 1, (*batch, N, 3))),
        rng.uniform(2, 4, (*batch, N)),
        lock,
    )


def random_leg(seed=1, batch=()):
    rng = np.random.default_rng(seed)
    return {
        "platform_point": rng.uniform(-3, 3, (*batch, 3)),
        "base_point": rng.uniform(-3, 3, (*batch, 3)),
        "offset": rng.uniform(5, 6, batch),
        "gain": rng.uniform(0.8, 1.2, batch),
    }


def make(lock, unknown, data, leg):
    return LOOPS[lock](data, unknown=unknown, **{key: leg[key] for key in INVOLVED if key not in unknown})


def random_values(loop, batch=(), seed=2):
    """Values whose fixed point is far from the base joint."""
    x = np.random.default_rng(seed).uniform(1, 2, (*batch, loop.parameters.size))
    x[..., loop.parameters.main.size :] += 5.0
    return x


def simulated(lock, robot=None, *, n=8, n_sets=None, noise=NOISE, seed=0, exact=False):
    robot = robot or hx.robots.left_hand()
    data = hx.simulate_leg(robot, 3, lock, n, n_sets, noise=None if exact else noise, rng=seed)
    return replace(data, noise=noise)


@pytest.mark.parametrize(("lock", "unknown"), CASES)
class TestDerivatives:
    def test_by_the_parameters(self, lock, unknown, central_difference):
        loop = make(lock, unknown, random_data(lock), random_leg())
        x = random_values(loop)
        assert loop.jacobian(x).shape == (N, loop.rows, loop.parameters.size)
        np.testing.assert_allclose(loop.jacobian(x), central_difference(loop.residual, x), atol=1e-9)

    def test_by_the_known_values(self, lock, unknown, central_difference):
        data, leg = random_data(lock), random_leg()
        loop = make(lock, unknown, data, leg)
        x = random_values(loop)
        for key in set(INVOLVED) - set(unknown):
            expected = central_difference(
                lambda value, key=key: make(lock, unknown, data, {**leg, key: value}).residual(x), leg[key]
            ).reshape(N, loop.rows, -1)
            found = np.broadcast_to(loop.known_jacobian(x, key), expected.shape)
            np.testing.assert_allclose(found, expected, atol=1e-9)

    def test_by_the_error_of_a_pose(self, lock, unknown, central_difference):
        """Each pose's error moves its own rows, and no other."""
        loop = make(lock, unknown, random_data(lock), random_leg())
        x = random_values(loop)
        found = loop.noise_jacobian(x)
        assert found.shape == (N, loop.rows, 7)
        moved = central_difference(lambda e: loop.shifted(e).residual(x), np.zeros((N, 7))).reshape(N, loop.rows, N, 7)
        for i in range(N):
            np.testing.assert_allclose(moved[i, :, i], found[i], atol=1e-9)
            assert not np.delete(moved[i], i, axis=1).any()

    def test_a_batch_equals_its_members(self, lock, unknown):
        data, leg = random_data(lock, (2, 3)), random_leg(batch=(2, 3))
        loop = make(lock, unknown, data, leg)
        x = random_values(loop, (2, 3))
        member = hx.LegMeasurements(data.position[1, 2], data.rotation[1, 2], data.length[1, 2], lock)
        alone = make(lock, unknown, member, {key: value[1, 2] for key, value in leg.items()})
        for ask in ("residual", "jacobian", "noise_jacobian"):
            np.testing.assert_allclose(getattr(loop, ask)(x)[1, 2], getattr(alone, ask)(x[1, 2]), atol=1e-14)

    def test_many_values_on_one_set(self, lock, unknown):
        loop = make(lock, unknown, random_data(lock), random_leg())
        x = random_values(loop, (5,))
        for ask, shape in (("residual", ()), ("jacobian", (loop.parameters.size,)), ("noise_jacobian", (7,))):
            together = np.broadcast_to(getattr(loop, ask)(x), (5, N, loop.rows, *shape))
            np.testing.assert_allclose(together[3], getattr(loop, ask)(x[3]), atol=1e-14)

    def test_many_known_values_on_one_set(self, lock, unknown):
        data, leg = random_data(lock), random_leg(batch=(5,))
        loop = make(lock, unknown, data, leg)
        x = random_values(loop, (5,))
        alone = make(lock, unknown, data, {key: value[3] for key, value in leg.items()})
        for ask, shape in (("residual", ()), ("jacobian", (loop.parameters.size,)), ("noise_jacobian", (7,))):
            together = np.broadcast_to(getattr(loop, ask)(x), (5, N, loop.rows, *shape))
            np.testing.assert_allclose(together[3], getattr(alone, ask)(x[3]), atol=1e-14)


@pytest.mark.parametrize("lock", LOOPS)
class TestTheTrueLeg:
    def test_it_closes_the_loop(self, lock, robot):
        for number in (1, 4):
            data = hx.simulate_leg(robot, number, lock, 6, 20, rng=0)
            residual = LOOPS[lock](data).residual(robot.leg(number))
            assert np.abs(residual).max() < 40 * np.finfo(float).eps * robot.size

    def test_the_nuisance_is_the_physical_one(self, lock, left_hand):
        leg, data = left_hand.leg(3), simulated(lock, exact=True)
        loop = LOOPS[lock](data)
        found = loop.parameters.split(loop.values(leg))
        point = data.position[0] + data.rotation[0] @ leg.platform_point
        if lock == "leg":
            np.testing.assert_allclose(found["fixed_point"], point, rtol=1e-12)
        else:
            np.testing.assert_allclose(found["locked_length"], np.linalg.norm(point - leg.base_point), rtol=1e-12)


class TestWhatASetSees:
    def test_fixed_leg_alone_sees_b_and_a_distance(self):
        """b as without the reading; of a and the offset only one number."""
        data = simulated("leg", exact=True)
        leg = data.nominal
        with pytest.raises(RankDeficientError, match=r"base_point") as caught:
            ReadLeg(data).crlb(leg)
        assert len(caught.value.combinations) == 3  # a and the offset have four, the distance of a from c is one
        offset = ReadLeg(data, unknown=("platform_point", "offset"))
        bound = offset.crlb(leg)
        np.testing.assert_allclose(bound[:3, :3], FixedLeg(data).crlb(leg), rtol=1e-7)

    def test_fixed_length_sees_all_but_the_gain(self):
        data = simulated("length", n=12, exact=True)
        leg = data.nominal
        bound = ReadLength(data).crlb(leg)
        without = FixedLength(data, unknown=("platform_point", "base_point")).crlb(leg)
        np.testing.assert_allclose(bound[:6, :6], without, rtol=1e-5)  # the reading finds the offset, no more
        with pytest.raises(RankDeficientError, match="gain"):
            ReadLength(data, unknown=INVOLVED).crlb(leg)

    def test_a_known_offset_makes_the_reading_count(self):
        """Then it measures the locked length."""
        data = simulated("length", n=12, exact=True)
        leg = data.nominal
        known = ReadLength(data, unknown=("platform_point", "base_point")).crlb(leg)
        without = FixedLength(data, unknown=("platform_point", "base_point")).crlb(leg)
        assert (np.diag(known) < np.diag(without)).all()
        assert np.trace(known) < 0.9 * np.trace(without)

    @pytest.mark.parametrize("model", [3, 4])
    def test_three_fixed_lengths_see_the_gain(self, model):
        sets = [simulated("length", n=12, exact=True, seed=seed) for seed in range(3)]
        loop = Sets(*(ReadLength(data, unknown=INVOLVED[:model]) for data in sets))
        assert np.isfinite(loop.crlb(sets[0].nominal)).all()

    def test_minimum_poses(self):
        leg, length = simulated("leg"), simulated("length")
        assert ReadLeg(leg).minimum_poses == 3
        assert ReadLength(length).minimum_poses == 7
        assert ReadLength(length, unknown=("base_point", "offset")).minimum_poses == 4


class TestMistakes:
    def test_another_lock(self):
        for kind, lock in ((ReadLeg, "length"), (ReadLength, "leg")):
            with pytest.raises(LockError, match=kind.__name__):
                kind(simulated(lock))

    @pytest.mark.parametrize("lock", LOOPS)
    def test_no_reading(self, lock):
        loop = LOOPS[lock](replace(simulated(lock), length=None))
        with pytest.raises(InputError, match="readings"):
            loop.residual(loop.data.nominal)

    @pytest.mark.parametrize("lock", LOOPS)
    def test_it_is_not_linear(self, lock):
        loop = LOOPS[lock](simulated(lock))
        assert not loop.is_linear
        with pytest.raises(InputError, match=r"linear|form"):
            loop.linear()

    @pytest.mark.parametrize("lock", LOOPS)
    def test_a_start_needs_a_nominal(self, lock):
        loop = LOOPS[lock](replace(simulated(lock), nominal=None), gain=1.0)
        with pytest.raises(InputError, match="initial guess"):
            loop.start()


class TestShiftedMeasurements:
    """What the loops' derivatives by errors stand on."""

    def test_one_leg(self):
        data = simulated("leg", n_sets=3)
        error = 0.1 * np.random.default_rng(0).standard_normal((3, 8, 7))
        moved = data.shifted(error)
        np.testing.assert_array_equal(moved.position, data.position + error[..., :3])
        np.testing.assert_array_equal(moved.length, data.length + error[..., 6])
        turn = hx.rotations.rotation_vector_to_matrix(error[..., 3:6])
        np.testing.assert_allclose(moved.rotation, turn @ data.rotation, atol=1e-15)
        assert (moved.lock, moved.noise, moved.nominal) == (data.lock, data.noise, data.nominal)

    def test_six_readings_and_none(self, left_hand):
        data = hx.simulate(left_hand, n_poses=5, rng=0)
        error = 0.1 * np.random.default_rng(0).standard_normal((5, 12))
        np.testing.assert_array_equal(data.shifted(error).length, data.length + error[:, 6:])
        alone = replace(simulated("leg"), length=None)
        assert alone.shifted(np.zeros((8, 7))).length is None

    def test_the_data_stay(self):
        data = simulated("leg")
        before = [np.array(part) for part in (data.position, data.rotation, data.length)]
        data.shifted(np.ones((8, 7)))
        for part, kept in zip((data.position, data.rotation, data.length), before, strict=True):
            np.testing.assert_array_equal(part, kept)

    def test_many_errors_of_one_set(self):
        """Errors (5, n, 7) of one set give a batch of five."""
        error = 0.1 * np.random.default_rng(0).standard_normal((5, 8, 7))
        data = simulated("leg")
        assert data.shifted(error).batch_shape == (5,)
        np.testing.assert_array_equal(data.shifted(error).position[3], data.shifted(error[3]).position)
