"""Both joint centres from equal lengths: exact, as scipy finds them, with the covariance that errors have."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError, UnitError
from hexopt.loops import FixedLength
from hexopt.testing import CLAIMS, check_estimator

BOTH = ("platform_point", "base_point")
EPS = np.finfo(float).eps


def loop_of(data):
    return FixedLength(data, unknown=BOTH)


def simulated(robot, n=10, n_sets=200, *, leg=3, off=None, noise=None, seed=0):
    """Poses of one locked length, and a nominal that is 0.5 cm off, scaled to the robot."""
    off = 0.5 * robot.size / hx.robots.left_hand().size if off is None else off
    return hx.simulate_leg(
        robot, leg, "length", n, n_sets, noise=noise, nominal=robot.perturbed(off, rng=leg), rng=seed
    )


@pytest.mark.parametrize("n", [7, 10])
def test_exact_without_noise(robot, n):
    """From 7 poses: nothing is left over there, so that another of the solutions may be found, or none."""
    for leg in range(1, 7):
        found = hx.estimate(loop_of(simulated(robot, n, leg=leg)), hx.ZhuangRoth())
        error = np.max(list(found.error(robot.leg(leg)).values()), axis=0) / robot.size
        exact = error <= 100 * EPS * found.condition
        if n == 10:
            assert found.ok.mean() >= 0.99
            assert exact[found.ok].all()
        assert (found.ok & exact).mean() > 0.9
        assert np.isnan(found.values[~found.ok]).all()


def test_it_is_what_scipy_finds(left_hand, paper_noise):
    data = simulated(left_hand, 12, 8, noise=paper_noise)
    found = hx.estimate(loop_of(data), hx.ZhuangRoth())
    assert found.covariance_kind == "sandwich"
    assert np.isnan(found.gap).all()
    for i in range(8):

        def differences(x, i=i):
            squares = ((data.position[i] + data.rotation[i] @ x[:3] - x[3:]) ** 2).sum(axis=-1)
            return 0.5 * (squares[1:] - squares[0])

        expected = least_squares(
            differences, found.values[i] + 0.01, "3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac"
        )
        np.testing.assert_allclose(found.values[i], expected.x, atol=1e-6 * found.standard_errors[i].max())
        assert found.objective[i] == pytest.approx(expected.cost, rel=1e-9)


def test_only_the_first_pose_is_special(left_hand, paper_noise):
    data = simulated(left_hand, 12, 8, noise=paper_noise)
    values = hx.estimate(loop_of(data), hx.ZhuangRoth()).values
    rest = hx.estimate(loop_of(data.poses([0, *range(11, 0, -1)])), hx.ZhuangRoth()).values
    np.testing.assert_allclose(rest, values, atol=1e-9)
    other = hx.estimate(loop_of(data.poses(range(11, -1, -1))), hx.ZhuangRoth()).values
    assert (np.abs(other - values).max(axis=-1) > 1e-4).all()


@pytest.mark.parametrize("assumed", [True, False])
def test_the_covariance_is_that_of_the_errors(left_hand, small_noise, assumed):
    """In the mean e'C⁻¹e/p is 1; where the variance comes from the residuals, its scale is known to N − 7 poses."""
    data = simulated(left_hand, 15, 2000, noise=small_noise)
    if not assumed:
        data = hx.LegMeasurements(data.position, data.rotation, data.length, "length", nominal=data.nominal)
    found = hx.estimate(loop_of(data), hx.ZhuangRoth())
    assert found.covariance_kind == ("sandwich" if assumed else "residual")
    error = found.values - np.concatenate([left_hand.leg(3).block(name) for name in BOTH])
    square = np.einsum("ni,ni->n", error, np.linalg.solve(found.covariance, error[..., None])[..., 0]) / 6
    if assumed:
        assert abs(square.mean() - 1) < 5 * square.std() / np.sqrt(square.size)
    else:
        assert 0.5 < np.median(square) < 2  # the rows are correlated and uneven, which their residuals do not tell


@pytest.mark.parametrize("off", [0.0, 0.5])
def test_contract(off):
    estimator = hx.ZhuangRoth(max_iterations=100)
    claims = [claim for claim in CLAIMS if claim != "order"]
    check_estimator(estimator, loop_of, lock="length", n_poses=14, tolerance=1e-5, claims=claims)
    leg = hx.robots.left_hand().leg(3)
    start = leg.replaced(base_point=leg.base_point + off)
    check_estimator(hx.ZhuangRoth(start), loop_of, lock="length", n_poses=14, claims=("exact", "rank"), tolerance=1e-5)


class TestHonesty:
    @pytest.mark.parametrize("spread", [30, 3000])
    def test_from_anywhere_a_success_is_a_stationary_point(self, left_hand, spread):
        data, leg = simulated(left_hand, 10, 100), left_hand.leg(3)
        shift = np.random.default_rng(0).uniform(-spread, spread, (2, 100, 3))
        start = hx.Leg(3, leg.platform_point + shift[0], leg.base_point + shift[1])
        found = hx.estimate(loop_of(data), hx.ZhuangRoth(start))
        assert set(found.status) <= {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED, hx.Status.RANK_DEFICIENT}
        assert np.isnan(found.values[~found.ok]).all()
        b, a = found.values[found.ok, None, :3], found.values[found.ok, None, 3:]
        arm = np.einsum("snij,skj->sni", data.rotation[found.ok], b)
        vectors = data.position[found.ok] + arm - a
        residual = 0.5 * ((vectors**2).sum(axis=-1)[:, 1:] - (vectors**2).sum(axis=-1)[:, :1])
        rows = np.concatenate([np.einsum("sni,snij->snj", vectors, data.rotation[found.ok]), -vectors], axis=-1)
        rows = rows[:, 1:] - rows[:, :1]
        gradient = np.abs(np.einsum("snp,sn->sp", rows, residual))
        size = np.linalg.norm(rows, axis=1) * np.linalg.norm(residual, axis=1)[:, None]
        assert (gradient <= 1e-6 * size + 1e-9).all()

    def test_too_few_iterations(self, left_hand):
        found = hx.estimate(loop_of(simulated(left_hand)), hx.ZhuangRoth(max_iterations=2))
        assert set(found.status) == {hx.Status.NOT_CONVERGED}
        assert np.isnan(found.covariance).all()
        assert np.isnan(found.objective).all()
        with pytest.raises(EstimationError, match="ZhuangRoth: ended with status NOT_CONVERGED"):
            hx.estimate(loop_of(simulated(left_hand, n_sets=None)), hx.ZhuangRoth(max_iterations=2))

    def test_turns_about_one_axis_do_not_see_the_joint_along_it(self, left_hand):
        leg, rng = left_hand.leg(3), np.random.default_rng(0)
        rotation = hx.rotations.rotation_vector_to_matrix(np.outer(rng.uniform(-0.5, 0.5, 12), [0.0, 0.0, 1.0]))
        direction = rng.normal(size=(12, 3)) + np.array([0.0, 0.0, 4.0])
        direction *= 18 / np.linalg.norm(direction, axis=-1)[:, None]
        position = leg.base_point + direction - rotation @ leg.platform_point
        data = hx.LegMeasurements(position, rotation, None, "length", nominal=left_hand.perturbed(0.3, rng=0).leg(3))
        with pytest.raises(RankDeficientError) as caught:
            hx.estimate(loop_of(data), hx.ZhuangRoth())
        assert caught.value.combinations == ("platform_point.z + base_point.z",)

    def test_too_few_poses(self, left_hand):
        with pytest.raises(RankDeficientError, match=r"5 equations for 6 unknowns.*at least 7 poses"):
            hx.estimate(loop_of(simulated(left_hand, 6)), hx.ZhuangRoth(), throw=False)


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
            hx.ZhuangRoth(**settings)

    def test_a_known_joint(self, left_hand):
        with pytest.raises(InputError, match="finds both points, the loop has the unknown base_point: write estimate"):
            hx.estimate(FixedLength(simulated(left_hand)), hx.ZhuangRoth())

    def test_a_start_of_another_leg(self, left_hand):
        with pytest.raises(InputError, match="leg 3 was measured, and leg 5 is given"):
            hx.estimate(loop_of(simulated(left_hand)), hx.ZhuangRoth(left_hand.leg(5)))

    def test_no_start(self, left_hand):
        data = simulated(left_hand)
        bare = hx.LegMeasurements(data.position, data.rotation, None, "length", length_unit="cm")
        with pytest.raises(InputError, match="ZhuangRoth needs an initial guess: give start="):
            hx.estimate(loop_of(bare), hx.ZhuangRoth())
        assert hx.estimate(loop_of(bare), hx.ZhuangRoth(left_hand.leg(3))).ok.all()

    def test_a_start_in_another_unit(self, left_hand):
        with pytest.raises(UnitError, match="in cm, the leg in mm"):
            hx.estimate(loop_of(simulated(left_hand)), hx.ZhuangRoth(hx.robots.jugglebot().leg(3)))
