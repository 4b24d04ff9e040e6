"""Leg lengths linearised anew and anew: what the inverse kinematics finds, or an honest failure."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError
from hexopt.loops import LegLength
from hexopt.testing import check_estimator

EPS = np.finfo(float).eps
MODELS = {36: 2, 42: 3, 48: 4}


def simulated(robot, model=42, *, leg=3, n=10, n_sets=200, off=None, noise=None, seed=0):
    """Unlocked poses, and a nominal that is 0.5 cm off in every unknown, scaled to the robot."""
    off = 0.5 * robot.size / hx.robots.left_hand().size if off is None else off
    nominal = robot.perturbed(off, offsets=off if model > 36 else 0.0, rng=leg).leg(leg)
    if model == 48:
        nominal = nominal.replaced(gain=1.02 * nominal.gain)
    return hx.simulate_leg(robot, leg, "none", n, n_sets, noise=noise, nominal=nominal, rng=seed)


def loop_of(data, model=42):
    return LegLength(data, unknown=LegLength.involved[: MODELS[model]])


@pytest.mark.parametrize("model", MODELS)
def test_exact_without_noise(robot, model):
    """At three poses more than the fewest; on Rubin from 0.5 cm as it is, which scaled is twice its travel."""
    off = 5000.0 if robot.length_unit == "um" else None
    for leg in range(1, 7):
        n = loop_of(simulated(robot, model, n_sets=1), model).minimum_poses + 3
        found = hx.estimate(loop_of(simulated(robot, model, leg=leg, n=n, off=off), model), hx.GengHaynes())
        assert found.ok.mean() >= 0.99
        assert np.isnan(found.values[~found.ok]).all()
        error = np.max([e for key, e in found.error(robot.leg(leg)).items() if key != "gain"], axis=0) / robot.size
        assert (error <= 100 * EPS * found.condition)[found.ok].all()


def test_on_rubin_a_start_beyond_its_travel_may_diverge():
    """From 3 % of its size, 23 mm, the first step is half of it: nothing damps that, and what fails says so."""
    robot = hx.robots.rubin()
    found = hx.estimate(loop_of(simulated(robot, leg=5, n_sets=1000)), hx.GengHaynes())
    assert set(found.status) == {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED}
    assert 0.9 < found.ok.mean() < 0.99
    error = np.max(list(found.error(robot.leg(5)).values()), axis=0)[found.ok] / robot.size
    exact = error <= 100 * EPS * found.condition[found.ok]
    assert exact.mean() > 0.995  # the others are other stationary points, as no gap denies


@pytest.mark.parametrize("model", MODELS)
def test_it_finds_what_the_inverse_kinematics_finds(left_hand, paper_noise, model):
    data = simulated(left_hand, model, n=15, n_sets=20, noise=paper_noise)
    found = hx.estimate(loop_of(data, model), hx.GengHaynes())
    expected = hx.estimate(loop_of(data, model), hx.InverseKinematics())
    np.testing.assert_allclose(found.values, expected.values, atol=1e-7)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-9)
    assert found.covariance_kind == "sandwich"


def test_each_step_is_a_linear_least_squares_solution(left_hand, paper_noise):
    """After k steps it is where k calls of numpy's lstsq lead."""
    data = simulated(left_hand, n=15, n_sets=None, noise=paper_noise)
    loop, x = loop_of(data), loop_of(data).values(data.nominal)
    steps = 0
    for _ in range(50):
        step = np.linalg.lstsq(loop.jacobian(x)[:, 0], -loop.residual(x)[:, 0])[0]
        x, steps = x + step, steps + 1
        if np.abs(step).max() < 1e-9:
            break
    found = hx.estimate(loop, hx.GengHaynes())
    np.testing.assert_allclose(found.values, x, atol=1e-9)
    assert abs(int(found.iterations) - steps) <= 1
    assert hx.estimate(loop, hx.GengHaynes(max_iterations=2), throw=False).status is hx.Status.NOT_CONVERGED


@pytest.mark.parametrize("model", MODELS)
def test_contract(model):
    check_estimator(hx.GengHaynes(), lambda data: loop_of(data, model), n_poses=14, tolerance=1e-5)


def test_contract_with_a_start_of_its_own():
    leg = hx.robots.left_hand().leg(3)
    estimator = hx.GengHaynes(leg.replaced(base_point=leg.base_point + 0.1), max_iterations=20)
    check_estimator(estimator, loop_of, n_poses=14, tolerance=1e-5, claims=("exact", "order", "rank"))


class TestHonesty:
    @pytest.mark.parametrize("spread", [3, 30, 3000, 1e30])
    def test_from_anywhere_a_success_is_a_stationary_point(self, left_hand, spread):
        data, leg = simulated(left_hand, n_sets=150), left_hand.leg(3)
        shift = np.random.default_rng(0).uniform(-spread, spread, (2, 150, 3))
        start = hx.Leg(3, leg.platform_point + shift[0], leg.base_point + shift[1], leg.offset + shift[0, :, 0])
        loop = loop_of(data)
        found = hx.estimate(loop, hx.GengHaynes(start))
        assert set(found.status) <= {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED}
        assert found.ok.all() == (spread == 3)
        assert np.isnan(found.values[~found.ok]).all()
        values = np.where(found.ok[:, None], found.values, loop.values(leg))
        residual, jacobian = loop.residual(values)[..., 0], loop.jacobian(values)[..., 0, :]
        gradient = np.abs(np.einsum("snp,sn->sp", jacobian, residual))
        size = np.linalg.norm(jacobian, axis=1) * np.linalg.norm(residual, axis=1)[:, None]
        assert (gradient <= 1e-5 * size + 1e-9)[found.ok].all()

    def test_a_single_divergence_raises(self, left_hand):
        leg = left_hand.leg(3)
        start = leg.replaced(base_point=leg.base_point + np.array([300.0, -200.0, 500.0]))
        with pytest.raises(EstimationError, match="GengHaynes: ended with status NOT_CONVERGED"):
            hx.estimate(loop_of(simulated(left_hand, n_sets=None)), hx.GengHaynes(start))

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_a_locked_direction_hides_the_base_point(self, left_hand, paper_noise, lock):
        data = hx.simulate_leg(left_hand, 3, lock, 20, noise=paper_noise, rng=0)
        with pytest.raises(RankDeficientError, match="base_point across the leg's locked direction") as caught:
            hx.estimate(loop_of(data), hx.GengHaynes())
        assert caught.value.combinations == ("base_point across the leg's locked direction",)

    def test_a_known_value_that_failed_fails_alone(self, left_hand, paper_noise):
        sets = hx.simulate_leg(left_hand, 3, "leg", 5, 3, noise=paper_noise, rng=0)
        position, rotation = np.array(sets.position), np.array(sets.rotation)
        position[1], rotation[1] = position[1, :1], rotation[1, :1]
        still = hx.LegMeasurements(position, rotation, sets.length, "leg", paper_noise, sets.nominal)
        b = hx.estimate(hx.loops.FixedLeg(still).linear(), hx.LeastSquares())
        data = simulated(left_hand, n=10, n_sets=3, noise=paper_noise)
        found = hx.estimate(LegLength(data, unknown=("base_point", "offset"), platform_point=b), hx.GengHaynes())
        assert found.ok.tolist() == [True, False, True]
        assert (found.error(left_hand.leg(3))["base_point"][[0, 2]] < 0.3).all()

    def test_too_few_poses(self, left_hand):
        with pytest.raises(RankDeficientError, match=r"6 equations for 7 unknowns.*at least 7 poses"):
            hx.estimate(loop_of(simulated(left_hand, n=6)), hx.GengHaynes(), throw=False)


class TestWrongCalls:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"start": [1, 2, 3]}, "start: expected a Leg"),
            ({"max_iterations": 0}, "max_iterations: expected a whole number >= 1, got 0"),
            ({"max_iterations": 2.5}, "max_iterations: expected a whole number >= 1, got 2.5"),
            ({"max_iterations": "a"}, "max_iterations: expected a whole number >= 1, got 'a'"),
        ],
    )
    def test_wrong_settings(self, settings, message):
        with pytest.raises(InputError, match=message):
            hx.GengHaynes(**settings)

    def test_a_start_of_another_leg(self, left_hand):
        with pytest.raises(InputError, match="leg 3 was measured, and leg 5 is given"):
            hx.estimate(loop_of(simulated(left_hand)), hx.GengHaynes(left_hand.leg(5)))

    def test_no_start(self, left_hand):
        data = simulated(left_hand)
        bare = hx.LegMeasurements(data.position, data.rotation, data.length, "none", length_unit="cm")
        loop = LegLength(bare, gain=1.0)
        with pytest.raises(InputError, match="GengHaynes needs an initial guess: give start="):
            hx.estimate(loop, hx.GengHaynes())
        assert hx.estimate(loop, hx.GengHaynes(left_hand.leg(3))).ok.all()
