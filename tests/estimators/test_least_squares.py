"""Least squares: settings, what it reports, its certificate."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError

METHODS = ["auto", "svd", "normal"]
pytestmark = pytest.mark.filterwarnings("ignore:normal equations")


def problem_of(robot, lock="direction", form="direct", n=8, n_sets=30):
    size = robot.size / 20
    noise = hx.UniformNoise(0.01 * size, np.deg2rad(0.01), 0.01 * size / robot.gains[2])
    kind = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}[lock]
    return kind(hx.simulate_leg(robot, 3, lock, n, n_sets, noise=noise, rng=0)).linear(form)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"method": "qr"}, "method: expected 'auto', 'svd', 'normal'; got 'qr'"),
        ({"weights": True}, "weights: expected"),
    ],
)
def test_wrong_settings(settings, message):
    with pytest.raises(InputError, match=message):
        hx.LeastSquares(**settings)


@pytest.mark.parametrize("lock", ["direction", "leg", "length"])
def test_all_methods_agree(left_hand, lock):
    problem = problem_of(left_hand, lock)
    found = {method: hx.estimate(problem, hx.LeastSquares(method=method)) for method in METHODS}
    for method in ("auto", "normal"):
        np.testing.assert_allclose(found[method].values, found["svd"].values, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found[method].covariance, found["svd"].covariance, rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(found[method].influence, found["svd"].influence, rtol=1e-5, atol=1e-8)


def test_the_influence_is_the_derivative_of_the_values(left_hand):
    """∂values/∂(direct rows), by moving the right-hand side."""
    for form in ("direct", "consecutive"):
        for weights in (None, "model"):
            problem = problem_of(left_hand, "leg", form, n_sets=None)
            estimator = hx.LeastSquares(weights=weights)
            found = hx.estimate(problem, estimator)
            move = 1e-3 * np.random.default_rng(0).standard_normal((8, 3, 1))
            moved = hx.LinearProblem(
                problem.matrix,
                problem.rhs + problem.form.apply(move).reshape(-1),
                problem.parameters,
                rows_per_block=3,
                form=problem.form,
                noise=problem.noise,
                at=found.values,
            )
            there = hx.LinearProblem(
                problem.matrix,
                problem.rhs,
                problem.parameters,
                rows_per_block=3,
                form=problem.form,
                noise=problem.noise,
                at=found.values,
            )
            one, two = hx.estimate(there, estimator), hx.estimate(moved, estimator)
            np.testing.assert_allclose(
                two.values - one.values, np.einsum("pnd,nd->p", one.influence, move[..., 0]), atol=1e-12
            )


def test_without_covariance_the_values_are_the_same(left_hand):
    problem = problem_of(left_hand)
    for method in METHODS:
        for weights in (None, "model"):
            full, lean = (hx.estimate(problem, hx.LeastSquares(method, weights, covariance=c)) for c in (True, False))
            np.testing.assert_array_equal(lean.values, full.values)
            assert lean.covariance is None
            assert lean.influence is None
            assert "covariance=False" in lean.covariance_kind
            assert lean.degrees_of_freedom == full.degrees_of_freedom


@pytest.mark.parametrize("method", ["auto", "svd"])
@pytest.mark.parametrize("lock", ["direction", "leg", "length"])
def test_the_gap_certifies(robot, lock, method):
    """Weighted problems have no units: every success has gap ≤ 1e-8·(1 + objective)."""
    found = hx.estimate(problem_of(robot, lock), hx.LeastSquares(method=method, weights="model"))
    assert found.ok.all()
    assert (found.gap >= 0).all()
    assert (found.gap <= 1e-8 * (1 + found.objective)).all()


@pytest.mark.parametrize("method", METHODS)
def test_the_gap_is_what_another_point_would_lose(left_hand, method, monkeypatch):
    """Recomputed from returned values: spoil the solver, and the gap tells by how much."""
    problem = problem_of(left_hand, "leg", n_sets=None)
    best = hx.estimate(problem, hx.LeastSquares(method="svd"))
    assert best.gap < 1e-20
    x = best.values + 0.01
    residual = problem.residual(x)
    basis = np.linalg.qr(problem.matrix).Q
    np.testing.assert_allclose(
        0.5 * ((basis.T @ residual) ** 2).sum(), 0.5 * residual @ residual - best.objective, rtol=1e-9
    )


def test_chi2_and_objective(left_hand):
    problem = problem_of(left_hand, n_sets=2000, n=10)
    weighted = hx.estimate(problem, hx.LeastSquares(weights="model"))
    np.testing.assert_array_equal(weighted.chi2, 2 * weighted.objective)
    assert weighted.degrees_of_freedom == 30 - 9
    assert abs(weighted.chi2.mean() - 21) < 5 * np.sqrt(42 / 2000)
    assert hx.estimate(problem, hx.LeastSquares()).chi2 is None


def test_the_estimator_is_named(left_hand):
    found = hx.estimate(problem_of(left_hand, n_sets=None), hx.LeastSquares("svd"))
    assert found.estimator.startswith("FixedDirection by LeastSquares(method='svd'")
