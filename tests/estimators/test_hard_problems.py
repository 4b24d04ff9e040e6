"""Known hard regression problems, solved to as many digits as their condition allows.

The references are exact: rational arithmetic on the very numbers that the floats hold.
"""

import warnings
from fractions import Fraction

import numpy as np
import pytest

import hexopt as hx

EPS = np.finfo(float).eps


def exact(matrix, rhs):
    """The least-squares solution by Gaussian elimination of the normal equations in rational numbers."""
    a = [[Fraction(float(v)) for v in row] for row in matrix]
    y = [Fraction(float(v)) for v in rhs]
    p = len(a[0])
    g = [[sum(row[i] * row[j] for row in a) for j in range(p)] for i in range(p)]
    b = [sum(row[i] * v for row, v in zip(a, y, strict=True)) for i in range(p)]
    for i in range(p):
        for j in range(i + 1, p):
            factor = g[j][i] / g[i][i]
            g[j] = [u - factor * v for u, v in zip(g[j], g[i], strict=True)]
            b[j] -= factor * b[i]
    x = [Fraction(0)] * p
    for i in reversed(range(p)):
        x[i] = (b[i] - sum(g[i][j] * x[j] for j in range(i + 1, p))) / g[i][i]
    return np.array([float(v) for v in x])


def wampler(degree, coefficient=1.0):
    """Integers x = 0…20 and a polynomial with known coefficients (Wampler 1970)."""
    matrix = np.arange(21.0)[:, None] ** np.arange(degree + 1)
    return matrix, matrix @ coefficient ** np.arange(degree + 1.0)


def filip(degree):
    """Points between −9 and −3 as in NIST's Filip, a smooth function that no polynomial is."""
    x = np.linspace(-8.8, -3.1, 82)
    return x[:, None] ** np.arange(degree + 1), 0.8 + 0.1 * np.tanh(x + 6) + 0.003 * np.cos(50 * x)


def collinear(distance):
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(42, 6))
    matrix[:, 5] = matrix[:, :5].sum(axis=1) + distance * rng.normal(size=42)
    return matrix, matrix @ np.ones(6) + 1e-3 * rng.normal(size=42)


PROBLEMS = {
    **{f"Wampler, degree {degree}": wampler(degree) for degree in range(5, 11)},
    "Wampler 2": wampler(5, 0.1),
    **{f"Filip, degree {degree}": filip(degree) for degree in (5, 8, 9)},
    **{f"collinear to {distance:g}": collinear(distance) for distance in (1e-3, 1e-6, 1e-9, 1e-12)},
}


def posed(matrix, rhs):
    return hx.LinearProblem(matrix, rhs, hx.Parameters((hx.Block("x", matrix.shape[1], "cm"),)))


def condition(matrix):
    return np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0))


def scaled_error(matrix, rhs, values):
    """The error in units of the columns' lengths, relative to the answer and what of the residual κ lets in."""
    expected, length = exact(matrix, rhs), np.linalg.norm(matrix, axis=0)
    residual = np.linalg.norm(matrix @ expected - rhs)
    size = np.linalg.norm(length * expected) + condition(matrix) * residual
    return np.linalg.norm(length * (values - expected)) / size


def test_they_are_as_hard_as_they_are_said_to_be():
    worst = max(condition(matrix) for matrix, _ in PROBLEMS.values())
    assert 1e12 < worst < 1e14


ESTIMATORS = {
    "least squares": lambda sigma: hx.LeastSquares(),
    "by singular values": lambda sigma: hx.LeastSquares("svd"),
    "quadratic": lambda sigma: hx.ConvexEstimator(weights=None),
    "quadratic in σ": lambda sigma: hx.ConvexEstimator(weights=None, scale=sigma),
    "Huber": lambda sigma: hx.ConvexEstimator(hx.Huber(1e9), weights=None, scale=sigma),
    "GroupHuber": lambda sigma: hx.ConvexEstimator(hx.GroupHuber(1e9), weights=None, scale=sigma),
}


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("kind", ESTIMATORS)
def test_as_many_digits_as_the_condition_allows(kind, name):
    """The relative error is below 100·eps·κ: half of all digits where κ is 1e8, and a few where it is 1e13."""
    matrix, rhs = PROBLEMS[name]
    sigma = 1e-6 * float(np.linalg.norm(rhs))  # σ counts only well above the rounding of the right-hand side
    found = hx.estimate(posed(matrix, rhs), ESTIMATORS[kind](sigma), throw=False)
    if condition(matrix) > 1e12 and not found.ok:  # the digits that are left do not reach 1e-6 σ, and it says so
        assert found.status == hx.Status.INACCURATE
        return
    assert found.ok
    assert scaled_error(matrix, rhs, found.values) < 100 * EPS * condition(matrix)


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("loss", [hx.L1(), hx.Chebyshev()], ids=repr)
def test_other_losses_are_proven_or_say_that_they_are_not(loss, name):
    matrix, rhs = PROBLEMS[name]
    sigma = 1e-6 * float(np.linalg.norm(rhs))
    problem, estimator = posed(matrix, rhs), hx.ConvexEstimator(loss, weights=None, scale=sigma)
    found = hx.estimate(problem, estimator, throw=False)
    assert found.status in (hx.Status.OPTIMAL, hx.Status.INACCURATE)
    if found.ok:
        assert found.gap <= 1e-8 * (1 + found.objective)
        assert estimator.certificate(problem, found).ok


@pytest.mark.parametrize("name", [name for name, (matrix, _) in PROBLEMS.items() if condition(matrix) > 1e4])
def test_normal_equations_warn_or_give_up(name):
    """Their error grows with κ²: they warn while digits are left, and refuse where none is."""
    matrix, rhs = PROBLEMS[name]
    if condition(matrix) < 1e6:
        with pytest.warns(hx.NumericalWarning, match="normal equations"):
            hx.estimate(posed(matrix, rhs), hx.LeastSquares("normal"), throw=False)
        return
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", hx.NumericalWarning)
        found = hx.estimate(posed(matrix, rhs), hx.LeastSquares("normal"), throw=False)
    assert not found.ok
    assert np.isnan(found.values).all()
