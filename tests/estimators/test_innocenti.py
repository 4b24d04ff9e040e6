"""Innocenti's seven poses: the physical solution of twenty, its error under noise, and what has none."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError, UnitError
from hexopt.loops import FixedLeg, FixedLength
from hexopt.rotations import rotation_vector_to_matrix
from hexopt.testing import check_estimator

BOTH = ("platform_point", "base_point")
EPS = np.finfo(float).eps


def simulated(robot, n_sets=50, *, leg=3, off=0.5, noise=None, seed=0, n_poses=7, **changes):
    nominal = robot.perturbed(off, rng=seed)
    return hx.simulate_leg(robot, leg, "length", n_poses, n_sets, noise=noise, nominal=nominal, rng=seed, **changes)


def loop_of(data):
    return FixedLength(data, unknown=BOTH)


def fitted(data, throw=None, **settings):
    return hx.estimate(loop_of(data), hx.Innocenti(**settings), throw)


def uniform(err):
    """The paper's errors: err in length units and err in degrees."""
    return hx.UniformNoise(position=err, angle=np.deg2rad(err), length=err)


def test_it_keeps_the_contract():
    check_estimator(hx.Innocenti(), loop_of, lock="length", n_poses=7, tolerance=1e-5)


def test_with_a_nominal_of_its_own_it_keeps_the_contract():
    """It stays where it is when frames and units move, and claims no more."""
    near = hx.robots.left_hand().leg(3).replaced(base_point=[12.8, 3.95, 0.05])
    check_estimator(
        hx.Innocenti(near), loop_of, lock="length", n_poses=7, tolerance=1e-5, claims=("exact", "order", "rank")
    )


class TestExact:
    def test_on_every_leg_of_every_robot(self, robot):
        """From a nominal 0.5 cm off (of a robot of 16 cm): exact, or not told apart from another and called so."""
        for leg in range(1, 7):
            data = simulated(robot, leg=leg, off=0.03 * robot.size, seed=leg)
            found = fitted(data)
            assert found.ok.mean() >= 0.9
            assert set(found.codes[~found.ok]) <= {hx.Status.INACCURATE}
            error = np.max(list(found.error(robot.leg(leg)).values()), axis=0) / robot.size
            assert (error[found.ok] <= np.maximum(100 * EPS * found.condition[found.ok], 1e-12)).all()

    def test_from_the_true_nominal_none_fails(self, robot):
        for leg in (1, 4):
            found = fitted(simulated(robot, leg=leg, off=0.0))
            assert found.ok.all()

    def test_one_set(self, left_hand):
        data = simulated(left_hand, n_sets=None)
        found = fitted(data)
        assert found.ok is True
        assert found.parameters.names == (*BOTH, "sphere")
        assert found.error(left_hand.leg(3))["base_point"] < 1e-9
        lever = found.params["base_point"] - data.position.mean(axis=0)
        length = np.sqrt(2 * found.params["sphere"][0] + lever @ lever)  # σ = (ℓ² − ‖a − o‖²)/2
        np.testing.assert_allclose(left_hand.leg(3).true_length(data.length), length, rtol=1e-10)


class TestNoise:
    def test_factors_beside_the_papers(self, left_hand):
        """z-x'-z'' angles ± 35°, directions within 65°, length 17 to 20.3 cm: base 15, platform 13; "near 15"."""
        ranges = replace(left_hand.ranges, cone=np.deg2rad(65))
        found = fitted(simulated(left_hand, 1500, off=0.1, noise=uniform(0.01), ranges=ranges))
        assert 0.93 < found.ok.mean() < 0.98
        error = {name: value[found.ok] / 0.01 for name, value in found.error(left_hand.leg(3)).items()}
        assert 12 < error["base_point"].mean() < 18
        assert 10 < error["platform_point"].mean() < 16
        assert np.median(error["base_point"]) < 0.7 * error["base_point"].mean()  # heavy tails

    def test_the_covariance_is_that_of_repeated_measurement(self, left_hand):
        """The spread of both points from one set measured 1000 times."""
        noise = hx.NormalNoise(1e-5, 1e-6, 1e-5, coordinates="rotation_vector")
        exact = simulated(left_hand, None, seed=3)
        shape = (1000, 7)
        clean = [np.broadcast_to(part, (*shape, *part.shape[1:])) for part in (exact.position, exact.rotation)]
        position, rotation, length = noise.apply(*clean, np.zeros(shape), np.random.default_rng(0))
        data = hx.LegMeasurements(position, rotation, length, "length", noise, exact.nominal)
        found = fitted(data)
        assert found.ok.all()
        assert found.covariance_kind == "sandwich"
        assert found.degrees_of_freedom == 0
        expected = found.covariance_of(*BOTH)[0]
        spread = np.cov(found.values[:, :6], rowvar=False)
        root = np.linalg.inv(np.linalg.cholesky(expected))
        assert np.abs(np.linalg.eigvalsh(root @ spread @ root.T) - 1).max() < 0.2  # 6 entries, 1000 draws

    def test_intervals_cover(self, left_hand, small_noise):
        found = fitted(simulated(left_hand, 800, off=0.0, noise=small_noise))
        found = found[found.ok]
        truth = np.concatenate([left_hand.leg(3).block(name) for name in BOTH])
        apart = (found.values[:, :6] - truth) / found.standard_errors[:, :6]
        assert abs((np.abs(apart) < 1.96).mean() - 0.95) < 0.02

    def test_without_a_noise_model_there_is_a_reason(self, left_hand):
        found = fitted(simulated(left_hand, 3))
        assert found.covariance is None
        assert "no noise model" in found.covariance_kind
        assert found.chi2 is None
        assert np.isnan(found.gap).all()

    def test_seven_equations_are_met(self, left_hand):
        data = simulated(left_hand, 100, noise=uniform(0.1))
        found = fitted(data)
        good = found.ok
        rows = loop_of(data[good]).residual(found.values[good])
        assert np.abs(rows).max() < 1e-9 * left_hand.size**2
        assert found.objective[good].max() < 1e-16 * left_hand.size**4


class TestChoice:
    def test_the_nearest_to_the_nominal(self, left_hand):
        """Each real solution is found by a nominal at it."""
        data = simulated(left_hand, None, seed=1)
        every = hx.Innocenti().solutions(loop_of(data))
        assert every.real.sum() > 2
        for k in np.flatnonzero(every.real):
            nominal = data.nominal.replaced(
                platform_point=every.platform_points[k].real, base_point=every.base_points[k].real
            )
            found = fitted(data, nominal=nominal)
            np.testing.assert_allclose(found.params["base_point"], nominal.base_point, rtol=1e-7, atol=1e-7)
            np.testing.assert_allclose(found.params["platform_point"], nominal.platform_point, rtol=1e-7, atol=1e-7)

    def test_a_nominal_a_set(self, left_hand):
        """Batched: here every set's own truth."""
        data = simulated(left_hand, 4, seed=1)
        leg = left_hand.leg(3)
        many = leg.replaced(base_point=np.tile(leg.base_point, (4, 1)), platform_point=leg.platform_point)
        np.testing.assert_array_equal(fitted(data, nominal=many).values, fitted(data, nominal=leg).values)

    def test_between_two_it_does_not_guess(self, left_hand):
        data = simulated(left_hand, None, seed=1)
        every = hx.Innocenti().solutions(loop_of(data))
        a, b = every.base_points[every.real].real, every.platform_points[every.real].real
        points = np.concatenate([b, a], axis=-1)
        truth = np.concatenate([left_hand.leg(3).block(name) for name in BOTH])
        one, two = np.linalg.norm(points - truth, axis=-1).argsort()[:2]
        middle = data.nominal.replaced(platform_point=(b[one] + b[two]) / 2, base_point=(a[one] + a[two]) / 2)
        found = fitted(data, throw=False, nominal=middle)
        assert found.status in (hx.Status.INACCURATE, hx.Status.INFEASIBLE)
        assert np.isnan(found.values).all()

    def test_a_lost_one_is_infeasible(self, left_hand):
        """Under large errors two real solutions may become complex: the nearest is, whatever others are real."""
        data = simulated(left_hand, 300, off=0.0, noise=uniform(0.1))
        found = fitted(data)
        lost = found.codes == hx.Status.INFEASIBLE
        assert 0.02 < lost.mean() < 0.2
        assert np.isnan(found.values[lost]).all()
        assert np.isnan(found.covariance[lost]).all()
        every = hx.Innocenti().solutions(loop_of(data))
        points = np.concatenate([every.platform_points, every.base_points], axis=-1)
        truth = np.concatenate([left_hand.leg(3).block(name) for name in BOTH])
        nearest = np.linalg.norm(points - truth, axis=-1).argmin(axis=-1)
        np.testing.assert_array_equal(every.real[np.arange(300), nearest], ~lost)
        with pytest.raises(EstimationError, match="INFEASIBLE"):
            fitted(data[int(np.argmax(lost))])


def one_axis(leg, n_sets=3, noise=None):
    """Poses of one leg length, all turned about z."""
    rng = np.random.default_rng(0)
    rotation = rotation_vector_to_matrix(rng.uniform(-0.6, 0.6, (n_sets, 7, 1)) * np.array([0, 0, 1.0]))
    direction = rng.standard_normal((n_sets, 7, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    position = leg.base_point + 19 * direction - rotation @ leg.platform_point
    if noise is not None:
        position, rotation, _ = noise.apply(position, rotation, np.zeros((n_sets, 7)), rng)
    return hx.LegMeasurements(position, rotation, None, "length", noise, leg)


class TestDegenerate:
    def test_turned_about_one_axis(self, left_hand):
        """Both points may move along it together; the sphere's constant follows."""
        found = fitted(one_axis(left_hand.leg(3)))
        assert (found.codes == hx.Status.RANK_DEFICIENT).all()
        assert np.isnan(found.values).all()
        (unseen,) = found.unseen
        assert "platform_point.z" in unseen
        assert "base_point.z" in unseen
        assert "point.x" not in unseen
        assert "point.y" not in unseen
        with pytest.raises(RankDeficientError, match=r"platform_point\.z"):
            fitted(one_axis(left_hand.leg(3))[0])

    @pytest.mark.parametrize("err", [1e-4, 1e-2])
    def test_turned_about_one_axis_with_noise(self, left_hand, err):
        """Noise makes the equations look as if they saw the axis: an answer along it is as bad as it says."""
        noise = hx.UniformNoise(err, np.deg2rad(err), err, coordinates="rotation_vector")
        data = one_axis(left_hand.leg(3), 300, noise)
        leg = left_hand.leg(3)
        found = fitted(data, nominal=leg.replaced(base_point=leg.base_point + 0.1))
        if err < 1e-3:
            assert not found.ok.any()
            return
        good = found[found.ok]
        assert found.ok.any()
        assert np.median(good.standard_errors[:, 5]) > 3 * left_hand.size
        assert (np.abs(good.values[:, 5] - leg.base_point[2]) < 2 * good.standard_errors[:, 5]).mean() > 0.95

    def test_a_leg_that_does_not_move(self, left_hand):
        """V stands still: any a will do."""
        data = hx.simulate_leg(left_hand, 3, "leg", 7, 3, nominal=left_hand.perturbed(0.3, rng=0), rng=0)
        found = fitted(replace(data, lock="length"))
        assert (found.codes == hx.Status.RANK_DEFICIENT).all()
        assert found.unseen

    def test_a_repeated_pose_fails_alone(self, left_hand):
        data = simulated(left_hand, 4, noise=uniform(0.01))
        position, rotation = np.array(data.position), np.array(data.rotation)
        position[2, 4], rotation[2, 4] = position[2, 1], rotation[2, 1]
        found = fitted(replace(data, position=position, rotation=rotation))
        clean = fitted(data)
        assert found.status[2] is hx.Status.RANK_DEFICIENT
        assert found.condition[2] == np.inf
        others = [0, 1, 3]
        np.testing.assert_array_equal(found.values[others], clean.values[others])
        np.testing.assert_array_equal(found.covariance[others], clean.covariance[others])

    def test_an_empty_batch(self, left_hand):
        found = fitted(simulated(left_hand, 2)[:0])
        assert found.values.shape == (0, 7)


class TestWrongCalls:
    @pytest.mark.parametrize(("n", "words"), [(6, "measure 1 more"), (8, r"data\.poses\(range\(7\)\)")])
    def test_not_seven_poses(self, left_hand, n, words):
        data = simulated(left_hand, 2, n_poses=n)
        for call in (fitted, lambda data: hx.Innocenti().solutions(loop_of(data))):
            with pytest.raises(InputError, match=rf"exactly 7 poses, got {n}: .*{words}"):
                call(data)

    @pytest.mark.parametrize("unknown", ["base_point", "platform_point"])
    def test_other_unknowns(self, left_hand, unknown):
        loop = FixedLength(simulated(left_hand), unknown=unknown)
        with pytest.raises(InputError, match=r"both points.*unknown="):
            hx.estimate(loop, hx.Innocenti())

    def test_another_loop(self, left_hand):
        loop = FixedLeg(hx.simulate_leg(left_hand, 3, "leg", 7, rng=0))
        with pytest.raises(InputError, match="FixedLength"):
            hx.estimate(loop, hx.Innocenti())
        with pytest.raises(InputError, match="FixedLength"):
            hx.Innocenti().solutions(loop)

    def test_a_nominal_of_another_leg(self, left_hand):
        with pytest.raises(InputError, match="leg 3 was measured, and leg 5 is given"):
            fitted(simulated(left_hand, 2), nominal=left_hand.leg(5))

    def test_no_nominal(self, left_hand):
        """The choice needs one; all solutions do not."""
        data = replace(simulated(left_hand, 2), nominal=None)
        with pytest.raises(InputError, match="which of 20 solutions"):
            fitted(data)
        assert hx.Innocenti().solutions(loop_of(data)).complete.all()
        near = hx.robots.left_hand().perturbed(0.1, rng=0).leg(3)
        assert fitted(data, nominal=near).ok.all()

    def test_a_nominal_that_is_none(self, left_hand):
        with pytest.raises(InputError, match="expected a Leg, got Hexapod"):
            hx.Innocenti(left_hand)

    def test_a_nominal_in_another_unit(self, left_hand):
        leg = left_hand.leg(3)
        with pytest.raises(UnitError, match="cm"):
            fitted(simulated(left_hand), nominal=hx.Leg(3, leg.platform_point, leg.base_point, length_unit="mm"))
