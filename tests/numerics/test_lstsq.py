"""Least squares against LAPACK's, and against exact solutions where the matrix is hard."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hexopt.numerics.lstsq import null_combinations, solve, solve_normal_equations, solve_svd

EPS = np.finfo(float).eps
ACCURATE = [solve_svd, solve]
ALL = [*ACCURATE, solve_normal_equations]


def exact(matrix, rhs):
    """Solve the normal equations in rational arithmetic, without any rounding."""
    rows = [[Fraction(float(v)) for v in row] for row in np.column_stack([matrix, rhs])]
    p = matrix.shape[1]
    gram = [[sum(row[i] * row[j] for row in rows) for j in range(p + 1)] for i in range(p)]
    for i in range(p):
        pivot = next(k for k in range(i, p) if gram[k][i])
        gram[i], gram[pivot] = gram[pivot], gram[i]
        for k in range(p):
            if k != i and gram[k][i]:
                factor = gram[k][i] / gram[i][i]
                gram[k] = [a - factor * b for a, b in zip(gram[k], gram[i], strict=True)]
    return np.array([float(gram[i][p] / gram[i][i]) for i in range(p)])


def scaled_condition(matrix):
    return np.linalg.cond(matrix / np.linalg.norm(matrix, axis=0))


def spoilt(m, p, condition, rng, noise=0.0):
    """A matrix of given condition whose columns have lengths from 1e-3 to 1e3, and a right-hand side."""
    u = np.linalg.qr(rng.standard_normal((m, p))).Q
    v = np.linalg.qr(rng.standard_normal((p, p))).Q
    matrix = (u * np.geomspace(1, 1 / condition, p)) @ v.T * np.geomspace(1e-3, 1e3, p)
    return matrix, matrix @ rng.standard_normal(p) + noise * rng.standard_normal(m)


@pytest.mark.parametrize("solver", ALL)
@given(m=st.integers(3, 20), p=st.integers(1, 6), batch=st.sampled_from([(), (4,), (2, 3)]), seed=st.integers(0, 10**9))
def test_well_conditioned_problems_are_numpys(solver, m, p, batch, seed):
    assume(m >= p)
    rng = np.random.default_rng(seed)
    matrix, rhs = rng.standard_normal((*batch, m, p)), rng.standard_normal((*batch, m))
    found = solver(matrix, rhs)
    for index in np.ndindex(batch):
        condition = scaled_condition(matrix[index])
        assume(condition < 300)
        expected, squares, _, _ = np.linalg.lstsq(matrix[index], rhs[index], rcond=None)
        tolerance = 20 * EPS * condition**2 * np.linalg.norm(expected) + 1e-14
        np.testing.assert_allclose(found.values[index], expected, atol=tolerance)
        np.testing.assert_allclose(found.inverse[index], np.linalg.pinv(matrix[index]), atol=100 * EPS * condition**2)
        if m > p:
            np.testing.assert_allclose(2 * found.objective[index], squares[0], atol=1e-12)
        assert found.full_rank[index]
        assert 0.99 * condition < found.condition[index] < 1.01 * np.sqrt(p) * condition
        assert abs(found.gap[index]) < 1e-24 * condition**4


@pytest.mark.parametrize("solver", ACCURATE)
@pytest.mark.parametrize("condition", [1e0, 1e2, 0.9e3, 1.1e3, 1e5, 1e8, 1e11, 1e13])
def test_as_many_digits_as_the_condition_allows(solver, condition):
    """Against the exact solution of the same rounded numbers, without residuals: error ≤ 100·eps·κ."""
    rng = np.random.default_rng(int(np.log10(condition)))
    for _ in range(10):
        matrix, rhs = spoilt(12, 5, condition, rng)
        truth = exact(matrix, rhs)
        scale = np.linalg.norm(matrix, axis=0)
        error = np.linalg.norm(scale * (solver(matrix, rhs).values - truth)) / np.linalg.norm(scale * truth)
        assert error <= 100 * EPS * scaled_condition(matrix)


@pytest.mark.parametrize("solver", ACCURATE)
@pytest.mark.parametrize("condition", [1e0, 1e2, 0.9e3, 1.1e3, 1e5, 1e7])
def test_residuals_cost_no_more_than_the_square_that_theory_allows(solver, condition):
    """With a residual r the solution itself moves by eps·κ²·‖r‖/‖A‖ under rounding of A (Wedin)."""
    rng = np.random.default_rng(int(np.log10(condition)) + 50)
    for _ in range(10):
        matrix, rhs = spoilt(12, 5, condition, rng, noise=1e-3)
        truth = exact(matrix, rhs)
        scale = np.linalg.norm(matrix, axis=0)
        residual = np.linalg.norm(matrix @ truth - rhs)
        kappa = scaled_condition(matrix)
        error = np.linalg.norm(scale * (solver(matrix, rhs).values - truth))
        assert error <= 100 * EPS * (kappa * np.linalg.norm(scale * truth) + kappa**2 * residual)


#: Longley's macroeconomic data (1967): employment by six regressors; certified by NIST (StRD, Longley).
LONGLEY = np.array(
    [
        [60323, 83.0, 234289, 2356, 1590, 107608, 1947],
        [61122, 88.5, 259426, 2325, 1456, 108632, 1948],
        [60171, 88.2, 258054, 3682, 1616, 109773, 1949],
        [61187, 89.5, 284599, 3351, 1650, 110929, 1950],
        [63221, 96.2, 328975, 2099, 3099, 112075, 1951],
        [63639, 98.1, 346999, 1932, 3594, 113270, 1952],
        [64989, 99.0, 365385, 1870, 3547, 115094, 1953],
        [63761, 100.0, 363112, 3578, 3350, 116219, 1954],
        [66019, 101.2, 397469, 2904, 3048, 117388, 1955],
        [67857, 104.6, 419180, 2822, 2857, 118734, 1956],
        [68169, 108.4, 442769, 2936, 2798, 120445, 1957],
        [66513, 110.8, 444546, 4681, 2637, 121950, 1958],
        [68655, 112.6, 482704, 3813, 2552, 123366, 1959],
        [69564, 114.2, 502601, 3931, 2514, 125368, 1960],
        [69331, 115.7, 518173, 4806, 2572, 127852, 1961],
        [70551, 116.9, 554894, 4007, 2827, 130081, 1962],
    ]
)
LONGLEY_CERTIFIED = [
    -3482258.63459582,
    15.0618722713733,
    -0.358191792925910e-01,
    -2.02022980381683,
    -1.03322686717359,
    -0.511041056535807e-01,
    1829.15146461355,
]


def wampler(kind):
    """Wampler's polynomials of degree 5 over 0…20 (1970); certified coefficients by NIST."""
    x = np.arange(21.0)
    matrix = np.vander(x, 6, increasing=True)
    if kind == 1:
        return matrix, matrix.sum(axis=1), np.ones(6)
    coefficients = 0.1 ** np.arange(6)
    rhs = np.array([float(sum(Fraction(int(v), 10) ** k for k in range(6))) for v in x])
    return matrix, rhs, coefficients


@pytest.mark.parametrize("solver", ACCURATE)
class TestCertifiedRegressions:
    def test_longley(self, solver):
        matrix = np.column_stack([np.ones(16), LONGLEY[:, 1:]])
        found = solver(matrix, LONGLEY[:, 0])
        np.testing.assert_allclose(found.values, LONGLEY_CERTIFIED, rtol=1e-9)
        np.testing.assert_allclose(np.sqrt(2 * found.objective / 9), 304.854073561965, rtol=1e-11)

    @pytest.mark.parametrize("kind", [1, 2])
    def test_wampler(self, solver, kind):
        matrix, rhs, coefficients = wampler(kind)
        kappa = scaled_condition(matrix)
        assert kappa > 1e3
        np.testing.assert_allclose(solver(matrix, rhs).values, coefficients, rtol=100 * EPS * kappa * 100)

    def test_a_filip_like_polynomial_of_degree_10_is_refused_or_right(self, solver):
        """κ of the scaled matrix is 1e13…1e15: an answer must be as good as that allows, or there is none."""
        x = np.linspace(-8.8, -3.2, 82)
        for degree in (8, 9, 10, 12, 14):
            matrix = np.vander(x, degree + 1)
            coefficients = np.ones(degree + 1)
            found = solver(matrix, matrix @ coefficients)
            if found.full_rank:
                scale = np.linalg.norm(matrix, axis=0)
                error = np.linalg.norm(scale * (found.values - coefficients)) / np.linalg.norm(scale)
                assert error <= 100 * EPS * found.condition
            else:
                assert np.isnan(found.values).all()
                assert scaled_condition(matrix) > 1e12

    def test_nearly_collinear_columns(self, solver):
        rng = np.random.default_rng(0)
        for gap in (1e-2, 1e-4, 1e-6, 1e-9, 1e-12):
            base = rng.integers(-1000, 1000, (10, 3)).astype(float)
            matrix = np.column_stack([base, base[:, 0] + gap * np.round(1000 * rng.standard_normal(10))])
            truth = exact(matrix, rhs := matrix @ [1.0, 2.0, 3.0, 4.0])
            found = solver(matrix, rhs)
            scale = np.linalg.norm(matrix, axis=0)
            error = np.linalg.norm(scale * (found.values - truth)) / np.linalg.norm(scale * truth)
            assert error <= 100 * EPS * scaled_condition(matrix)


def test_normal_equations_lose_the_square():
    """The paper's equations are what they are: at κ = 1e6 they keep some 4 digits fewer than the SVD."""
    rng = np.random.default_rng(0)
    matrix, rhs = spoilt(12, 5, 1e6, rng)
    truth, scale = exact(matrix, rhs), np.linalg.norm(matrix, axis=0)
    errors = [np.linalg.norm(scale * (s(matrix, rhs).values - truth)) for s in (solve_normal_equations, solve_svd)]
    assert errors[0] > 1e3 * errors[1]
    assert errors[0] < 1e-2 * np.linalg.norm(scale * truth)


@pytest.mark.parametrize("solver", ALL)
class TestRankDeficiency:
    def batch(self):
        rng = np.random.default_rng(1)
        matrix, rhs = rng.standard_normal((6, 10, 4)), rng.standard_normal((6, 10))
        matrix[1, :, 2] = matrix[1, :, 0]  # to the bit
        matrix[3, :, 3] = 0.3 * matrix[3, :, 1] - 7 * matrix[3, :, 2]  # to rounding
        matrix[4, :, 1] = 0.0
        return matrix, rhs

    def test_a_deficient_member_fails_alone(self, solver):
        matrix, rhs = self.batch()
        found = solver(matrix, rhs)
        np.testing.assert_array_equal(found.full_rank, [True, False, True, False, False, True])
        assert np.isnan(found.values[~found.full_rank]).all()
        assert np.isinf(found.condition[~found.full_rank]).all()
        assert np.isnan(found.inverse[~found.full_rank]).all()
        for i in np.flatnonzero(found.full_rank):
            np.testing.assert_allclose(found.values[i], np.linalg.lstsq(matrix[i], rhs[i])[0], rtol=1e-11)

    def test_members_equal_singles(self, solver):
        matrix, rhs = self.batch()
        found = solver(matrix, rhs)
        for i in range(6):
            single = solver(matrix[i], rhs[i])
            assert bool(single.full_rank) == bool(found.full_rank[i])
            np.testing.assert_allclose(single.values, found.values[i], rtol=1e-12)

    def test_cancellation_counts(self, solver):
        """A matrix of pure rounding is well conditioned and says nothing: its entries are what is left of 1 − 1."""
        rng = np.random.default_rng(2)
        matrix, rhs = 1e-16 * rng.standard_normal((9, 3)), 1e-16 * rng.standard_normal(9)
        assert solver(matrix, rhs).full_rank
        found = solver(matrix, rhs, 1e16)
        assert not found.full_rank
        assert np.isnan(found.values).all()

    def test_cancellation_multiplies_the_condition(self, solver):
        rng = np.random.default_rng(3)
        matrix, rhs = rng.standard_normal((4, 9, 3)), rng.standard_normal((4, 9))
        plain, lossy = solver(matrix, rhs), solver(matrix, rhs, np.array([1.0, 10.0, 1e3, 1e16]))
        np.testing.assert_array_equal(lossy.full_rank, [True, True, True, False])
        np.testing.assert_allclose(lossy.condition[:3], plain.condition[:3] * [1, 10, 1e3], rtol=1e-10)
        np.testing.assert_allclose(lossy.values[:3], plain.values[:3], rtol=1e-11)

    def test_without_the_inverse(self, solver):
        matrix, rhs = self.batch()
        found = solver(matrix, rhs, inverse=False)
        assert found.inverse.shape == (6, 4, 0)
        np.testing.assert_array_equal(found.values, solver(matrix, rhs).values)

    def test_an_empty_batch(self, solver):
        found = solver(np.empty((0, 5, 2)), np.empty((0, 5)))
        assert found.values.shape == (0, 2)
        assert found.full_rank.shape == (0,)


@pytest.mark.parametrize("solver", ALL)
def test_the_input_is_untouched(solver):
    rng = np.random.default_rng(4)
    matrix, rhs = rng.standard_normal((3, 5, 2)), rng.standard_normal((3, 5))
    before = matrix.copy(), rhs.copy()
    solver(matrix, rhs)
    np.testing.assert_array_equal(matrix, before[0])
    np.testing.assert_array_equal(rhs, before[1])


class TestNullCombinations:
    def test_none_for_a_matrix_that_sees_everything(self):
        assert null_combinations(np.random.default_rng(0).standard_normal((6, 3))).shape == (0, 3)

    @given(seed=st.integers(0, 10**9), rank=st.integers(0, 4), p=st.integers(1, 5), m=st.integers(1, 8))
    def test_they_span_the_null_space(self, seed, rank, p, m):
        rng = np.random.default_rng(seed)
        rank = min(rank, p, m)
        matrix = rng.standard_normal((m, rank)) @ rng.standard_normal((rank, p)) * np.geomspace(1, 1e3, p)
        found = null_combinations(matrix)
        assert found.shape == (p - rank, p)
        assert np.linalg.matrix_rank(found) == p - rank
        assert np.abs(matrix @ found.T).max(initial=0.0) < 1e-6 * (np.abs(matrix).max() + 1e-300)

    def test_a_single_unseen_parameter_stands_alone(self):
        matrix = np.random.default_rng(1).standard_normal((8, 4))
        matrix[:, 1] = 0.0
        matrix[:, 3] = -2 * matrix[:, 2]
        np.testing.assert_allclose(np.abs(null_combinations(matrix)), [[0, 1, 0, 0], [0, 0, 1, 0.5]], atol=1e-9)

    def test_units_do_not_matter(self):
        """Combinations are in the units of the parameters: a column in µm is a million times smaller."""
        matrix = np.random.default_rng(2).standard_normal((8, 3))
        matrix[:, 2] = matrix[:, 0] + matrix[:, 1]
        scale = np.array([1.0, 1e-6, 1e6])
        plain, rescaled = null_combinations(matrix)[0], null_combinations(matrix * scale)[0]
        ratio = rescaled * scale / plain
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)
