"""What an answer of the convex family must not claim: found by attack, each once a wrong claim."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.problem import ConstantRowNoise, RowCovariance

LEG = hx.robots.left_hand().leg(3)
ERR = 0.01 / np.sqrt(3)
NOISE = hx.NormalNoise(position=ERR, angle=np.deg2rad(ERR), length=ERR)


def locked(kind, lock, n, n_sets, rng=1):
    data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=NOISE, nominal=LEG, rng=rng)
    return kind(data)


def ill_conditioned(condition, rng=0):
    """Rows of unit σ, of which a direction is seen `condition` times worse than the others, and that direction."""
    rng = np.random.default_rng(rng)
    basis, _ = np.linalg.qr(rng.normal(size=(30, 6)))
    turn, _ = np.linalg.qr(rng.normal(size=(6, 6)))
    size = np.r_[np.full(5, 5.0), 5 / condition]
    matrix = basis * size @ turn.T
    rhs = matrix @ rng.normal(size=6) * 10 + rng.standard_t(2, size=30)
    noise = ConstantRowNoise(RowCovariance(np.ones((30, 1, 1))))
    parameters = hx.Parameters((hx.Block("x", 6, "cm"),))
    problem = hx.LinearProblem(matrix, rhs, parameters, noise=noise)
    return problem, hx.LinearProblem(basis, rhs, parameters, noise=noise), turn[:, -1] / size[-1]


@pytest.mark.parametrize("condition", [1e6, 1e9, 1e10, 1e12])
@pytest.mark.parametrize("backend", ["auto", "clarabel", "cvxpy"])
@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.Huber(), hx.L1()], ids=repr)
def test_a_tiny_imbalance_of_ill_conditioned_columns_proves_nothing(loss, backend, condition):
    """A success is as good as that of the same rows in orthonormal columns; moved by a tenth of a σ it is caught."""
    problem, basis, weak = ill_conditioned(condition)
    estimator = hx.ConvexEstimator(loss, backend=backend, covariance=False)
    found = hx.estimate(problem, estimator, throw=False)
    best = hx.estimate(basis, hx.ConvexEstimator(loss, covariance=False))
    if found.ok:
        allowed = 1e-8 * (1 + best.objective) + 1e3 * np.finfo(float).eps * condition  # rounding of the residuals
        assert found.objective - best.objective <= allowed
        moved = replace(found, values=found.values + 0.1 * weak)
        assert not estimator.certificate(problem, moved).ok


@pytest.mark.parametrize("backend", ["auto", "cvxpy"])
@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.Huber(), hx.GroupHuber()], ids=repr)
def test_a_box_far_away_is_not_infeasible(loss, backend):
    point = LEG.platform_point
    far = hx.Box({"platform_point": (point + 1e6, point + 1e6 + 1)})
    problem = locked(hx.loops.FixedDirection, "direction", 7, 5).linear()
    found = hx.estimate(problem, hx.ConvexEstimator(loss, bounds=far, backend=backend))
    assert hx.Status.INFEASIBLE not in set(found.status)


@pytest.mark.parametrize("unit", [1e-5, 1.0, 1e4])
@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.L1(), hx.GroupHuber()], ids=repr)
def test_the_unit_does_not_matter_to_a_lasso(loss, unit):
    """Columns over c and a strength over c: the same programme in a length unit c times as small."""
    problem = locked(hx.loops.FixedLeg, "leg", 7, 20).linear()
    scaled = replace(problem, matrix=problem.matrix / unit, noise=None)
    matrix, rhs = problem.whitened()
    scaled = hx.LinearProblem(matrix / unit, rhs, problem.parameters, rows_per_block=3)
    mean = {"platform_point": unit * (LEG.platform_point + 0.01)}
    lasso = hx.Lasso(mean, 100.0 / unit)
    found = hx.estimate(scaled, hx.ConvexEstimator(loss, lasso, weights=None, scale=1.0))
    assert found.ok.all()
    same = hx.LinearProblem(matrix, rhs, problem.parameters, rows_per_block=3)
    lasso = hx.Lasso({"platform_point": LEG.platform_point + 0.01}, 100.0)
    expected = hx.estimate(same, hx.ConvexEstimator(loss, lasso, weights=None, scale=1.0))
    np.testing.assert_allclose(found.values / unit, expected.values, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("loss", [hx.Huber(), hx.GroupHuber(), hx.L1(), hx.GroupL1()], ids=repr)
def test_the_error_of_a_known_value_is_in_the_covariance(loss):
    """b known from a first step brings an error that all poses share; intervals that ignore it cover 80 %."""
    first = locked(hx.loops.FixedLeg, "leg", 7, 2000, rng=2)
    known = hx.estimate(first.linear(), hx.LeastSquares(weights="model"))
    data = hx.simulate_leg(hx.robots.left_hand(), 3, "length", 20, 2000, noise=NOISE, nominal=LEG, rng=3)
    second = hx.loops.FixedLength(data, platform_point=known)
    found = hx.estimate(second.linear(), hx.ConvexEstimator(loss))
    error = np.abs(found.params["base_point"] - LEG.base_point)
    sigma = found.standard_errors[..., found.parameters["base_point"]]
    assert 0.93 < (error < 1.96 * sigma).mean() < 0.98


@pytest.mark.parametrize("threshold", [0.01, 0.3, 1.345])
@pytest.mark.parametrize("kind", [hx.Huber, hx.GroupHuber])
def test_intervals_of_small_thresholds_are_no_shorter(kind, threshold):
    """Rows that a fit with a small threshold interpolates are no evidence; its limit is L1, with honest intervals."""
    problem = locked(hx.loops.FixedLeg, "leg", 7, 2000, rng=4).linear()
    found = hx.estimate(problem, hx.ConvexEstimator(kind(threshold)))
    error = np.abs(found.params["platform_point"] - LEG.platform_point)[found.ok]
    sigma = found.standard_errors[found.ok][..., :3]
    assert found.ok.mean() > 0.99
    assert 0.93 < (error < 1.96 * sigma).mean() < 0.995


def test_a_scale_says_nothing_of_correlated_rows():
    loop = locked(hx.loops.FixedLeg, "leg", 9, 3)
    robust = hx.ConvexEstimator(hx.Huber(), weights=None, scale="mad")
    found = hx.estimate(loop.linear("consecutive"), robust)
    assert found.covariance is None
    assert "consecutive rows are correlated" in found.covariance_kind
    assert hx.estimate(loop.linear(), robust).covariance_kind == "residual"


def test_rows_of_weight_zero_are_as_good_as_absent():
    problem = locked(hx.loops.FixedLeg, "leg", 9, None).linear()
    weights = np.r_[np.zeros(6), np.ones(21)]
    rest = hx.LinearProblem(problem.matrix[6:], problem.rhs[6:], problem.parameters, rows_per_block=3)
    found = hx.estimate(problem, hx.ConvexEstimator(hx.Huber(), weights=weights, scale="mad"))
    expected = hx.estimate(rest, hx.ConvexEstimator(hx.Huber(), weights=None, scale="mad"))
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-7)
    np.testing.assert_allclose(found.standard_errors, expected.standard_errors, rtol=0.05)
    assert found.degrees_of_freedom == expected.degrees_of_freedom


@pytest.mark.parametrize("settings", [{}, {"weights": None}, {"loss": hx.L1(), "weights": None}], ids=str)
def test_a_multiplier_is_the_derivative_of_the_objective(settings):
    """By the bound: −dual at the lower side, in the unit of the stated objective."""
    problem = locked(hx.loops.FixedLeg, "leg", 9, None).linear()
    free = hx.estimate(problem, hx.ConvexEstimator(**settings)).values[0]

    def solved(lower):
        return hx.estimate(
            problem, hx.ConvexEstimator(bounds=hx.Box({"platform_point": ([lower, -99, -99], None)}), **settings)
        )

    step = 1e-4
    slope = (solved(free + 0.1 + step).objective - solved(free + 0.1 - step).objective) / (2 * step)
    np.testing.assert_allclose(-solved(free + 0.1).duals["box"][0], slope, rtol=1e-4)


def test_a_failed_member_has_no_objective():
    def fail(self, **settings):
        raise cp.SolverError("no")

    import cvxpy as cp

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cp.Problem, "solve", fail)
        problem = locked(hx.loops.FixedLeg, "leg", 9, 3).linear()
        found = hx.estimate(problem, hx.ConvexEstimator(backend="cvxpy"))
    assert np.isnan(found.objective).all()
    assert np.isnan(found.gap).all()


@pytest.mark.parametrize("n_poses", [1, 2])
def test_a_lasso_on_some_blocks_does_not_replace_poses(left_hand, n_poses):
    """Fewer rows than unknowns, of which the lasso decides three."""
    noise = hx.NormalNoise(0.01, 1e-4, 0.01)
    data = hx.simulate_leg(left_hand, 3, "direction", n_poses, noise=noise, rng=1)
    problem = hx.loops.FixedDirection(data).linear()
    prior = hx.Lasso({"base_point": left_hand.leg(3).base_point}, 1.0)
    found = hx.estimate(problem, hx.ConvexEstimator(prior=prior, weights="model"), throw=False)
    if n_poses == 1:
        assert found.status is hx.Status.RANK_DEFICIENT
        assert found.unseen
    else:  # with a decided there are enough
        assert found.status is hx.Status.OPTIMAL
        assert found.decided
