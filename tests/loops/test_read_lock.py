"""Locked legs whose reading is taken too: the true leg, which sets see what."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, LockError, RankDeficientError
from hexopt.loops import FixedLeg, FixedLength, ReadLeg, ReadLength, Sets

LOOPS = {"leg": ReadLeg, "length": ReadLength}
INVOLVED = ReadLeg.involved
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)


def simulated(lock, robot=None, *, n=8, n_sets=None, noise=NOISE, seed=0, exact=False):
    robot = robot or hx.robots.left_hand()
    data = hx.simulate_leg(robot, 3, lock, n, n_sets, noise=None if exact else noise, rng=seed)
    return replace(data, noise=noise)


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
