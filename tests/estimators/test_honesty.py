"""What an estimate must not hide: lost errors, dependent rows, a lock's blind spot, a solver's tolerance."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import hexopt as hx

NOISE = hx.UniformNoise(0.01, float(np.deg2rad(0.01)), 0.01)


def simulated(lock, n_poses, n_sets=None, noise=NOISE, seed=1):
    return hx.simulate_leg(hx.robots.left_hand(), 3, lock, n_poses, n_sets, noise=noise, rng=seed)


def test_a_known_estimate_whose_error_is_lost_leaves_no_covariance():
    first = hx.loops.FixedLeg(simulated("leg", 5)).linear()
    data = simulated("length", 8)
    without = hx.estimate(first, hx.LeastSquares(covariance=False))
    for weights in (None, "model"):
        loop = hx.loops.FixedLength(data, platform_point=without)
        found = hx.estimate(loop.linear(), hx.LeastSquares(weights=weights))
        assert found.covariance is None
        assert "platform_point cannot be carried: it has no covariance" in found.covariance_kind
    unknown = hx.loops.FixedLength(replace(data, noise=None), platform_point=hx.estimate(first, hx.LeastSquares()))
    found = hx.estimate(unknown.linear(), hx.LeastSquares())
    assert found.covariance is None
    assert "no noise model" in found.covariance_kind
    exact = hx.loops.FixedLength(replace(data, noise=None), platform_point=without.params["platform_point"])
    assert hx.estimate(exact.linear(), hx.LeastSquares()).covariance_kind == "residual"


@pytest.mark.parametrize(
    ("loop", "lock", "form", "point"),
    [
        ("FixedLeg", "leg", "direct", "platform_point"),
        ("FixedLeg", "leg", "consecutive", "platform_point"),
        ("FixedLeg", "leg", "centred", "platform_point"),
        ("FixedDirection", "direction", "consecutive", "base_point"),
    ],
)
def test_residual_errors_know_that_differences_of_neighbours_are_dependent(loop, lock, form, point):
    data = replace(simulated(lock, 12, 4000, hx.NormalNoise(position=0.005)), noise=None)
    found = hx.estimate(getattr(hx.loops, loop)(data).linear(form), hx.LeastSquares())
    assert found.covariance_kind == "residual"
    where = found.parameters[point]
    z = (found.values[:, where] - data.nominal.block(point)) / found.standard_errors[:, where]
    inside = (np.abs(z) < stats.t.ppf(0.975, found.degrees_of_freedom)).mean()
    assert abs(inside - 0.95) < 0.015


@pytest.mark.parametrize("lock", ["direction", "leg"])
@pytest.mark.parametrize("noise", [None, NOISE])
def test_noise_does_not_let_lengths_see_across_a_locked_direction(lock, noise):
    found = hx.estimate(hx.loops.LegLength(simulated(lock, 12, 3, noise)), hx.InverseKinematics())
    assert (found.codes == hx.Status.RANK_DEFICIENT).all()
    assert np.isnan(found.values).all()
    with pytest.raises(hx.errors.RankDeficientError, match="base_point"):
        hx.estimate(hx.loops.LegLength(simulated(lock, 12, None, noise)), hx.InverseKinematics())


def test_cvxpy_agrees_where_residuals_are_small_beside_the_numbers():
    robot = hx.robots.rubin()
    noise = hx.NormalNoise(position=1.0, angle=1e-6, length=1.0)
    data = hx.simulate_leg(robot, 2, "length", 8, 3, noise=noise, rng=4)
    problem = hx.loops.FixedLength(data).linear()
    reference = hx.estimate(problem, hx.LeastSquares("svd", weights="model"))
    found = hx.estimate(problem, hx.ConvexEstimator())
    assert found.ok.all()
    assert (np.abs(found.values - reference.values) < 1e-6 * reference.standard_errors).all()


def test_an_estimate_in_another_unit_is_refused():
    b = hx.estimate(hx.loops.FixedLeg(simulated("leg", 5)).linear(), hx.LeastSquares())
    robot = hx.robots.jugglebot()
    data = hx.simulate_leg(robot, 3, "length", 6, rng=0)
    with pytest.raises(hx.errors.UnitError, match="platform_point: the measurements are in mm, the estimate in cm"):
        hx.loops.FixedLength(data, platform_point=b)


def test_normal_equations_that_lost_too_much_are_no_success():
    data = hx.simulate_leg(hx.robots.rubin(), 1, "direction", 3, 20, rng=0)
    with pytest.warns(hx.NumericalWarning):
        found = hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), hx.LeastSquares("normal"))
    assert found.ok.sum() < 10
    assert np.isnan(found.values[~found.ok]).all()
    error = found.error(hx.robots.rubin().leg(1))["base_point"] / hx.robots.rubin().size
    assert (error[found.ok] < 1e-7).all()


def test_measurements_keep_their_numbers_when_the_callers_array_changes():
    exact = simulated("leg", 4)
    position = np.array(exact.position)
    data = hx.LegMeasurements(position, exact.rotation, exact.length, "leg")
    position[0] = np.nan
    np.testing.assert_array_equal(data.position, exact.position)
    assert data.length_unit == "unstated"


def test_a_rounded_home_orientation_gives_true_rotations():
    turn = hx.rotations.euler_to_matrix([0.1, 0.2, 0.3]).round(7)
    robot = replace(hx.robots.left_hand(), home_rotation=turn)
    rotation = hx.simulate_leg(robot, 3, "none", 20, rng=0).rotation
    assert np.abs(np.swapaxes(rotation, -1, -2) @ rotation - np.eye(3)).max() < 1e-14
