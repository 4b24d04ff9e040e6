"""Levenberg–Marquardt against scipy's, and its honesty about failure."""

import itertools

import numpy as np
import pytest
from scipy.optimize import least_squares

from hexopt.numerics.lm import levenberg_marquardt


def batched(residual, jacobian):
    """An `evaluate` for a batch from functions of one point."""

    def evaluate(x):
        with np.errstate(all="ignore"):
            return np.stack([residual(v) for v in x]), np.stack([jacobian(v) for v in x])

    return evaluate


def rosenbrock(v):
    return np.array([10 * (v[1] - v[0] ** 2), 1 - v[0]])


def rosenbrock_jacobian(v):
    return np.array([[-20 * v[0], 10.0], [-1.0, 0.0]])


T = np.linspace(0, 4, 25)
Y = 2.5 * np.exp(-1.3 * T) + 0.5 + 0.01 * np.random.default_rng(0).standard_normal(25)


def decay(v):
    return v[0] * np.exp(-v[1] * T) + v[2] - Y


def decay_jacobian(v):
    e = np.exp(-v[1] * T)
    return np.stack([e, -v[0] * T * e, np.ones_like(T)], axis=1)


CASES = {
    "rosenbrock": (rosenbrock, rosenbrock_jacobian, [[-1.2, 1.0], [0.0, 0.0], [3.0, -4.0], [10.0, 10.0]]),
    "decay": (decay, decay_jacobian, [[1.0, 1.0, 0.0], [3.0, 0.5, 1.0], [0.1, 3.0, -1.0]]),
}


@pytest.mark.parametrize("case", CASES)
def test_it_ends_where_scipy_does(case):
    residual, jacobian, starts = CASES[case]
    found = levenberg_marquardt(batched(residual, jacobian), np.array(starts))
    assert found.converged.all()
    for start, values in zip(starts, found.values, strict=True):
        expected = least_squares(residual, start, jacobian, method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15)
        np.testing.assert_allclose(values, expected.x, rtol=1e-8)
        np.testing.assert_allclose(jacobian(values).T @ residual(values), 0, atol=1e-10)


@pytest.mark.parametrize("case", CASES)
def test_a_batch_equals_its_members(case):
    residual, jacobian, starts = CASES[case]
    together = levenberg_marquardt(batched(residual, jacobian), np.array(starts))
    for i, start in enumerate(starts):
        alone = levenberg_marquardt(batched(residual, jacobian), np.array([start]))
        np.testing.assert_allclose(together.values[i], alone.values[0], rtol=1e-12)
        assert together.iterations[i] == alone.iterations[0]


def test_bad_scales_do_not_matter():
    scale = np.array([1e-8, 1e8])
    found = levenberg_marquardt(
        batched(lambda v: rosenbrock(v / scale), lambda v: rosenbrock_jacobian(v / scale) / scale),
        np.array([[-1.2, 1.0]]) * scale,
    )
    assert found.converged.all()
    np.testing.assert_allclose(found.values[0] / scale, [1, 1], rtol=1e-10)


def test_too_few_iterations_are_no_success():
    found = levenberg_marquardt(batched(rosenbrock, rosenbrock_jacobian), np.array([[-1.2, 1.0]]), max_iterations=3)
    assert not found.converged.any()
    assert found.iterations[0] == 3


def test_a_function_without_minimum_is_no_success():
    """exp(−x) has its infimum at infinity: the steps never become small."""
    found = levenberg_marquardt(
        batched(lambda v: np.exp(-v), lambda v: -np.exp(-v)[:, None]), np.array([[0.0]]), max_iterations=60
    )
    assert not found.converged.any()


def test_a_member_that_is_not_finite_fails_alone():
    def residual(v):
        return np.array([np.log(v[0]), v[1]])

    def jacobian(v):
        return np.array([[1 / v[0], 0.0], [0.0, 1.0]])

    found = levenberg_marquardt(batched(residual, jacobian), np.array([[2.0, 1.0], [-1.0, 1.0], [0.5, 3.0]]))
    np.testing.assert_array_equal(found.converged, [True, False, True])
    np.testing.assert_allclose(found.values[[0, 2]], [[1, 0], [1, 0]], atol=1e-12)


def test_a_step_out_of_the_domain_is_taken_back():
    found = levenberg_marquardt(batched(lambda v: np.log(v), lambda v: np.diag(1 / v)), np.array([[20.0], [1e-6]]))
    assert found.converged.all()
    np.testing.assert_allclose(found.values, 1.0, rtol=1e-12)


def test_the_start_is_untouched():
    start = np.array([[-1.2, 1.0]])
    levenberg_marquardt(batched(rosenbrock, rosenbrock_jacobian), start)
    np.testing.assert_array_equal(start, [[-1.2, 1.0]])


def test_members_that_have_ended_need_not_be_evaluated():
    residual, jacobian, starts = CASES["decay"]
    asked = []

    def chosen(members):
        asked.append(set(members.tolist()))
        return batched(residual, jacobian)

    found = levenberg_marquardt(batched(residual, jacobian), np.array(starts), chosen=chosen)
    plain = levenberg_marquardt(batched(residual, jacobian), np.array(starts))
    np.testing.assert_array_equal(found.values, plain.values)
    np.testing.assert_array_equal(found.iterations, plain.iterations)
    assert all(later <= earlier for earlier, later in itertools.pairwise(asked))
    assert len(asked[-1]) < 3


def test_polishing_brings_the_last_digits():
    """Where the iteration ends early, one undamped step makes the gradient much smaller."""
    residual, jacobian, starts = CASES["decay"]
    fine = levenberg_marquardt(batched(residual, jacobian), np.array(starts), absolute=1e-4)
    for values, moved in zip(fine.values, fine.end.moved, strict=True):
        gradient = jacobian(values).T @ residual(values)
        left = np.linalg.lstsq(jacobian(values), -residual(values))[0]
        assert np.linalg.norm(jacobian(values) @ left) < 0.1 * moved * np.linalg.norm(residual(values))
        assert np.abs(gradient).max() < 1e-6


@pytest.mark.parametrize("case", CASES)
def test_what_it_says_of_its_end(case):
    """To first order: the objective, and the condition of columns of unit length."""
    residual, jacobian, starts = CASES[case]
    found = levenberg_marquardt(batched(residual, jacobian), np.array(starts))
    for i, values in enumerate(found.values):
        assert found.end.objective[i] == pytest.approx(0.5 * residual(values) @ residual(values), rel=1e-9, abs=1e-25)
        columns = jacobian(values) / np.linalg.norm(jacobian(values), axis=0)
        condition = np.linalg.cond(columns)
        assert condition * (1 - 1e-6) <= found.end.condition[i] <= np.sqrt(len(values)) * condition * (1 + 1e-6)


def test_of_what_did_not_converge_it_says_nothing():
    found = levenberg_marquardt(batched(rosenbrock, rosenbrock_jacobian), np.array([[-1.2, 1.0]]), max_iterations=3)
    assert np.isinf([found.end.objective, found.end.moved, found.end.condition]).all()
