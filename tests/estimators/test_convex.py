"""The cvxpy route against the closed form, problem by problem."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError
from hexopt.estimators.convex import routes
from hexopt.estimators.convex.scale import mad_scale

LOOPS = {
    "direction": hx.loops.FixedDirection,
    "leg": hx.loops.FixedLeg,
    "length": hx.loops.FixedLength,
}
CASES = [(lock, form) for lock, kind in LOOPS.items() for form in kind.forms]


def problem_of(robot, lock, form, n=8, n_sets=6):
    size = robot.size / 20
    noise = hx.UniformNoise(0.01 * size, np.deg2rad(0.01), 0.01 * size / robot.gains[2])
    data = hx.simulate_leg(robot, 3, lock, n, n_sets, noise=noise, rng=0)
    return LOOPS[lock](data).linear(form)


@pytest.mark.parametrize("weights", [None, "model"])
@pytest.mark.parametrize(("lock", "form"), CASES)
def test_it_is_least_squares(robot, lock, form, weights):
    """Both routes agree to 1e-6 σ, and every success has a small gap."""
    problem = problem_of(robot, lock, form)
    convex = hx.estimate(problem, hx.ConvexEstimator(weights=weights))
    closed = hx.estimate(problem, hx.LeastSquares(method="svd", weights=weights))
    assert convex.ok.all()
    sigma = closed.standard_errors
    assert (np.abs(convex.values - closed.values) / sigma).max() < 1e-6
    np.testing.assert_allclose(convex.covariance, closed.covariance, rtol=1e-4, atol=1e-4 * closed.covariance.max())
    np.testing.assert_allclose(convex.objective, closed.objective, rtol=1e-7)
    assert (convex.gap <= 1e-8 * (1 + convex.objective)).all()
    assert convex.covariance_kind == closed.covariance_kind


def test_the_programme_is_a_cvxpy_problem_in_x(left_hand):
    """`cvxpy_problem` is the definition: its own optimum is the estimate's."""
    problem = problem_of(left_hand, "direction", "direct", n_sets=None)
    estimator = hx.ConvexEstimator()
    programme = estimator.cvxpy_problem(problem)
    assert isinstance(programme, cp.Problem)
    (x,) = programme.variables()
    assert (x.name(), x.shape) == ("x", (9,))
    programme.solve(solver=cp.CLARABEL)
    found = hx.estimate(problem, estimator)
    np.testing.assert_allclose(programme.value, found.objective, rtol=1e-6)
    x.value = found.values
    np.testing.assert_allclose(programme.objective.value, found.objective, rtol=1e-9)


def test_a_batch_has_no_single_programme(left_hand):
    with pytest.raises(InputError, match="cvxpy_problem takes one problem, got a batch of"):
        hx.ConvexEstimator().cvxpy_problem(problem_of(left_hand, "leg", "direct"))


def test_the_gap_is_recomputed_from_the_returned_point(left_hand, monkeypatch):
    """A solver that stops early and says "optimal" is found out."""
    problem = problem_of(left_hand, "leg", "direct")

    def lazy(programme, start):
        found = original(programme, start)
        return replace(found, values=found.values * (1 + 1e-4))

    original = routes.solve_newton
    monkeypatch.setattr(routes, "solve_newton", lazy)
    monkeypatch.setattr(routes, "interior_solves", lambda programme: False)
    found = hx.estimate(problem, hx.ConvexEstimator(backend="batched"))
    assert set(found.status) == {hx.Status.INACCURATE}
    assert np.isnan(found.values).all()
    assert (found.gap > 1e-8 * (1 + found.objective)).all()
    closed = hx.estimate(problem, hx.LeastSquares(method="svd", weights="model"))
    np.testing.assert_allclose(found.gap, found.objective - closed.objective, rtol=1e-4)


def test_a_slower_route_takes_what_a_faster_one_did_not_prove(left_hand, monkeypatch):
    problem = problem_of(left_hand, "leg", "direct")
    expected = hx.estimate(problem, hx.ConvexEstimator(hx.Huber()))

    def half(programme, start):
        found = original(programme, start)
        return replace(found, values=found.values * np.array([1, 1 + 1e-4] * 3)[:, None])

    original = routes.solve_newton
    monkeypatch.setattr(routes, "solve_newton", half)
    found = hx.estimate(problem, hx.ConvexEstimator(hx.Huber()))
    assert found.ok.all()
    sigma = expected.standard_errors
    assert (np.abs(found.values - expected.values) / sigma).max() < 1e-6


def test_a_solver_that_gives_up_is_a_failure(left_hand, monkeypatch):
    def fail(self, **settings):
        raise cp.SolverError("no")

    monkeypatch.setattr(cp.Problem, "solve", fail)
    found = hx.estimate(problem_of(left_hand, "leg", "direct"), hx.ConvexEstimator(backend="cvxpy"))
    assert set(found.status) == {hx.Status.FAILED}
    assert np.isnan(found.values).all()


class TestCertificate:
    """The certificate is computed from a point, whoever found it."""

    LOSSES = (hx.Quadratic(), hx.Huber(), hx.GroupHuber(), hx.L1(), hx.GroupL1(), hx.Chebyshev())

    @pytest.mark.parametrize("loss", LOSSES, ids=repr)
    def test_it_passes_what_was_found_and_catches_what_was_tampered(self, left_hand, loss):
        problem = problem_of(left_hand, "direction", "direct", n=12)
        estimator = hx.ConvexEstimator(loss)
        found = hx.estimate(problem, estimator)
        proof = estimator.certificate(problem, found)
        assert found.ok.all()
        assert proof.ok.all()
        assert (proof.gap <= 1e-8 * (1 + found.objective)).all()
        values = found.values.copy()
        values[1, 4] += 0.01 * np.sqrt(
            np.abs(np.linalg.inv(problem.whitened()[0][1].T @ problem.whitened()[0][1])[4, 4])
        )
        tampered = estimator.certificate(problem, replace(found, values=values))
        np.testing.assert_array_equal(tampered.ok, np.arange(6) != 1)

    def test_nothing_is_proven_of_nan(self, left_hand):
        problem = problem_of(left_hand, "leg", "direct")
        found = hx.estimate(problem, hx.ConvexEstimator())
        failed = replace(found, values=np.where(np.arange(6)[:, None] == 2, np.nan, found.values))
        proof = hx.ConvexEstimator().certificate(problem, failed)
        np.testing.assert_array_equal(proof.ok, np.arange(6) != 2)
        assert np.isnan(proof.gap[2])

    def test_a_gap_bounds_the_distance_from_the_optimum(self, left_hand):
        problem = problem_of(left_hand, "leg", "direct")
        for loss in self.LOSSES:
            estimator = hx.ConvexEstimator(loss)
            found = hx.estimate(problem, estimator)
            worse = found.values * (1 + 1e-4)
            matrix, rhs = problem.whitened()
            residual = (matrix @ worse[..., None])[..., 0] - rhs
            above = loss.total(residual.reshape(6, -1, 3)) - found.objective
            assert (estimator.certificate(problem, replace(found, values=worse)).gap >= above * (1 - 1e-9)).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"weights": "noise"}, "weights: expected None, 'model' or an array, got 'noise'"),
        ({"weights": [1.0, -1.0]}, "weights: expected numbers ≥ 0, found -1"),
        ({"loss": 2.0}, r"loss: expected a loss such as Huber\(1.345\), got 2.0"),
        ({"prior": hx.Box({"a": (0, 1)})}, "prior: expected GaussianPrior"),
        ({"bounds": [1]}, "bounds: expected Box"),
        ({"scale": 0}, "scale: expected None, 'mad' or a number > 0, got 0"),
        ({"backend": "gpu"}, "backend: expected 'auto', 'batched', 'clarabel', 'cvxpy'; got 'gpu'"),
        ({"loss": hx.Huber(), "weights": None}, "has a threshold in σ"),
        ({"prior": hx.Ridge({"base_point": [0, 0, 0]}, 1.0), "weights": None}, "a prior is weighed against rows in σ"),
    ],
)
def test_wrong_settings(settings, message):
    with pytest.raises(InputError, match=message):
        hx.ConvexEstimator(**settings)


def test_wrong_combinations(left_hand):
    problem = problem_of(left_hand, "direction", "consecutive")
    with pytest.raises(InputError, match="looks at whole poses: use the direct form"):
        hx.estimate(problem, hx.ConvexEstimator(hx.GroupHuber()))
    with pytest.raises(InputError, match="backend='batched': no batched route takes this"):
        hx.estimate(problem_of(left_hand, "leg", "direct"), hx.ConvexEstimator(hx.GroupL1(), backend="batched"))
    with pytest.raises(InputError, match=r"weights: expected shape \(6, 24\) or its last part, got \(5,\)"):
        hx.estimate(problem_of(left_hand, "leg", "direct"), hx.ConvexEstimator(weights=np.ones(5)))
    with pytest.raises(InputError, match="scale='mad' needs more than 6 equations, there are 6"):
        hx.estimate(
            problem_of(left_hand, "leg", "direct", n=2),
            hx.ConvexEstimator(hx.Huber(), hx.Ridge({"platform_point": [0, 0, 0]}, 1.0), weights=None, scale="mad"),
        )


def test_given_weights_are_inverse_variances(left_hand):
    """Weights 1/σ² of rows equal rows divided by σ; a zero weight drops its row."""
    problem = problem_of(left_hand, "leg", "direct", n_sets=None)
    sigma = np.linspace(0.5, 2, 24)
    found = hx.estimate(problem, hx.ConvexEstimator(weights=sigma**-2.0))
    scaled = hx.LinearProblem(
        problem.matrix / sigma[:, None], problem.rhs / sigma, problem.parameters, rows_per_block=3
    )
    expected = hx.estimate(scaled, hx.LeastSquares())
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-10)
    kept = np.ones(24)
    kept[:3] = 0
    dropped = hx.estimate(problem, hx.ConvexEstimator(hx.L1(), weights=kept))
    rest = hx.LinearProblem(problem.matrix[3:], problem.rhs[3:], problem.parameters, rows_per_block=3)
    np.testing.assert_allclose(
        dropped.values, hx.estimate(rest, hx.ConvexEstimator(hx.L1(), weights=None)).values, atol=1e-7
    )


class TestScale:
    def test_mad_finds_the_noise_among_outliers(self, left_hand):
        """1.4826 times the median absolute residual is near σ, outliers or not."""
        rng = np.random.default_rng(0)
        matrix, noise = rng.normal(size=(200, 90, 6)), 0.02 * rng.normal(size=(200, 90))
        noise[:, :9] += 5.0
        scale = mad_scale(matrix, noise, "rows")
        assert 0.019 < np.median(scale) < 0.025
        np.testing.assert_allclose(mad_scale(1e3 * matrix, 1e3 * noise, "rows"), 1e3 * scale, rtol=1e-6)

    def test_exact_readings_have_the_scale_one(self):
        matrix = np.random.default_rng(0).normal(size=(12, 3))
        assert mad_scale(matrix, matrix @ np.ones(3), "rows") == 1.0

    def test_a_number_is_the_sigma_of_raw_rows(self, left_hand):
        problem = problem_of(left_hand, "leg", "direct")
        by_number = hx.estimate(problem, hx.ConvexEstimator(hx.Huber(1.5), weights=None, scale=0.01))
        by_hand = hx.LinearProblem(problem.matrix / 0.01, problem.rhs / 0.01, problem.parameters, rows_per_block=3)
        expected = hx.estimate(by_hand, hx.ConvexEstimator(hx.Huber(1.5), weights=None, scale=1.0))
        np.testing.assert_allclose(by_number.values, expected.values, rtol=1e-9)
        np.testing.assert_allclose(by_number.covariance, expected.covariance, rtol=1e-9)
