"""The cvxpy route against the closed form, problem by problem."""

import cvxpy as cp
import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError

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

    def lazy(self, matrix, rhs):
        values, _ = original(self, matrix, rhs)
        return values * (1 + 1e-4), hx.Status.OPTIMAL

    original = hx.ConvexEstimator._solve
    monkeypatch.setattr(hx.ConvexEstimator, "_solve", lazy)
    found = hx.estimate(problem, hx.ConvexEstimator())
    assert set(found.status) == {hx.Status.INACCURATE}
    assert (found.gap > 1e-8 * (1 + found.objective)).all()
    closed = hx.estimate(problem, hx.LeastSquares(method="svd", weights="model"))
    np.testing.assert_allclose(found.gap, found.objective - closed.objective, rtol=1e-4)


def test_a_solver_that_gives_up_is_a_failure(left_hand, monkeypatch):
    def fail(self, **settings):
        raise cp.SolverError("no")

    monkeypatch.setattr(cp.Problem, "solve", fail)
    found = hx.estimate(problem_of(left_hand, "leg", "direct"), hx.ConvexEstimator())
    assert set(found.status) == {hx.Status.FAILED}
    assert np.isnan(found.values).all()


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"weights": "noise"}, "weights: expected None or 'model'"), ({"loss": 2.0}, "loss: expected Quadratic")],
)
def test_wrong_settings(settings, message):
    with pytest.raises(InputError, match=message):
        hx.ConvexEstimator(**settings)


class TestQuadratic:
    def test_rho_has_its_derivative(self, central_difference):
        loss = hx.Quadratic()
        z = np.linspace(-3, 3, 7)
        slope = [central_difference(lambda t: loss.rho(t).sum(), np.array([v]))[0] for v in z]
        np.testing.assert_allclose(loss.psi(z), slope, atol=1e-10)

    def test_numpy_and_cvxpy_agree(self):
        z = np.linspace(-3, 3, 7)
        loss = hx.Quadratic()
        np.testing.assert_allclose(loss.expression(cp.Constant(z)).value, loss.rho(z).sum(), rtol=1e-14)
