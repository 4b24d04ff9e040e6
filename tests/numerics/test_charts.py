"""Free coordinates about a point whose unit vectors keep their length."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexopt.arrays import matvec, norm
from hexopt.numerics.charts import Chart, across
from hexopt.numerics.lm import levenberg_marquardt

CHART = Chart(8, (slice(1, 4), slice(5, 8)))
POLES = np.vstack([np.eye(3), -np.eye(3), [[1e-9, 0, -1], [0, 1e-9, -1], [-1e-9, 1e-9, 0]]])


def unit(seed, shape=()):
    vector = np.random.default_rng(seed).standard_normal((*shape, 3))
    return vector / norm(vector)[..., None]


def point(seed, batch=()):
    return CHART.normalised(np.random.default_rng(seed).standard_normal((*batch, 8)))


class TestAcross:
    def test_an_orthonormal_frame(self):
        n = np.concatenate([unit(0, (50,)), POLES / norm(POLES)[:, None]])
        frame = np.concatenate([across(n), n[..., None]], axis=-1)
        np.testing.assert_allclose(
            np.swapaxes(frame, -1, -2) @ frame, np.broadcast_to(np.eye(3), frame.shape), atol=1e-15
        )

    def test_a_batch_equals_its_members(self):
        n = unit(1, (2, 3))
        np.testing.assert_array_equal(across(n)[1, 2], across(n[1, 2]))


class TestChart:
    def test_a_unit_vector_counts_two(self):
        assert (CHART.size, CHART.free) == (8, 6)
        assert CHART.basis(point(0, (4,))).shape == (4, 8, 6)

    def test_the_basis_is_orthonormal_and_across(self):
        x = point(0, (4,))
        basis = CHART.basis(x)
        np.testing.assert_allclose(
            np.swapaxes(basis, -1, -2) @ basis, np.broadcast_to(np.eye(6), (4, 6, 6)), atol=1e-15
        )
        for where in CHART.units:
            along = np.einsum("kp,kpq->kq", x[:, where], basis[:, where])
            np.testing.assert_allclose(along, 0, atol=1e-15)

    def test_the_basis_is_the_derivative_of_the_motion(self, central_difference):
        x = point(3)
        np.testing.assert_allclose(
            central_difference(lambda s: CHART.moved(x, s), np.zeros(6)), CHART.basis(x), atol=1e-10
        )

    @given(st.integers(0, 10**6), st.floats(-3, 3))
    def test_motion_keeps_unit_lengths(self, seed, size):
        x = point(seed, (3,))
        moved = CHART.moved(x, size * np.random.default_rng(seed).standard_normal((3, 6)))
        for where in CHART.units:
            np.testing.assert_allclose(norm(moved[:, where]), 1.0, rtol=1e-14)

    def test_no_motion_stays(self):
        x = point(4)
        np.testing.assert_allclose(CHART.moved(x, np.zeros(6)), x, atol=1e-15)

    def test_free_values_move_by_the_step(self):
        x, step = point(5), np.arange(6.0)
        np.testing.assert_allclose(CHART.moved(x, step)[[0, 4]], x[[0, 4]] + step[:2], atol=1e-15)

    def test_columns_by_free_coordinates_are_a_derivative(self, central_difference):
        x, columns = point(6), np.random.default_rng(7).standard_normal((5, 8))
        expected = central_difference(lambda s: matvec(columns, CHART.moved(x, s)), np.zeros(6))
        np.testing.assert_allclose(CHART.reduced(columns, x), expected, atol=1e-9)

    def test_coordinates_of_a_unit_vector_itself_are_zero(self):
        x = point(8)
        np.testing.assert_allclose(CHART.coordinates(x), [*x[[0, 4]], 0, 0, 0, 0], atol=1e-15)

    def test_normalising_leaves_its_argument(self):
        x = np.arange(1.0, 9.0)
        out = CHART.normalised(x)
        np.testing.assert_array_equal(x, np.arange(1.0, 9.0))
        np.testing.assert_allclose(norm(out[1:4]), 1.0)
        np.testing.assert_array_equal(out[[0, 4]], x[[0, 4]])

    def test_without_unit_vectors_it_is_plain_addition(self):
        chart, rng = Chart(4), np.random.default_rng(9)
        x, step, columns = rng.standard_normal((3, 4)), rng.standard_normal((3, 4)), rng.standard_normal((3, 5, 4))
        assert chart.free == 4
        np.testing.assert_array_equal(chart.moved(x, step), x + step)
        np.testing.assert_array_equal(chart.normalised(x), x)
        np.testing.assert_array_equal(chart.coordinates(x), x)
        np.testing.assert_array_equal(chart.reduced(columns, x), columns)
        np.testing.assert_array_equal(chart.basis(x), np.broadcast_to(np.eye(4), (3, 4, 4)))


class TestLevenbergMarquardtOnAChart:
    """The point of a sphere that is nearest to a given one, and the first eigenvector of a matrix."""

    def test_the_nearest_point_of_the_sphere(self):
        target = np.random.default_rng(0).standard_normal((20, 3)) * np.geomspace(0.3, 30, 20)[:, None]
        chart = Chart(3, (slice(0, 3),))

        def evaluate(x):
            return x - target, chart.reduced(np.broadcast_to(np.eye(3), (20, 3, 3)), x)

        found = levenberg_marquardt(evaluate, unit(1, (20,)), chart=chart)
        np.testing.assert_allclose(found.values, target / norm(target)[:, None], atol=1e-7)
        assert found.converged.all()

    def test_the_least_singular_vector(self):
        matrix = np.random.default_rng(2).standard_normal((10, 5, 3))
        chart = Chart(3, (slice(0, 3),))
        found = levenberg_marquardt(
            lambda x: (matvec(matrix, x), chart.reduced(matrix, x)), unit(3, (10,)), chart=chart, max_iterations=500
        )
        expected = np.linalg.svd(matrix)[2][:, -1]
        np.testing.assert_allclose(np.abs(np.einsum("ki,ki->k", found.values, expected)), 1.0, atol=1e-10)

    @pytest.mark.parametrize("batch", [1, 4])
    def test_the_start_is_left_as_it_is(self, batch):
        start = unit(4, (batch,))
        before = start.copy()
        chart = Chart(3, (slice(0, 3),))
        levenberg_marquardt(
            lambda x: (x - 1.0, chart.reduced(np.broadcast_to(np.eye(3), (batch, 3, 3)), x)), start, chart=chart
        )
        np.testing.assert_array_equal(start, before)
