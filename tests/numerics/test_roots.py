"""Inverse Cholesky factors of many covariances against LAPACK, and members that have none."""

import numpy as np
import pytest
import scipy.linalg

from hexopt.numerics.roots import inverse_cholesky


def covariances(size, batch=(), seed=0, spread=0.0):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((*batch, size, size + 2))
    scale = 10.0 ** rng.uniform(-spread, spread, (*batch, size))
    return scale[..., :, None] * (root @ np.swapaxes(root, -1, -2)) * scale[..., None, :]


@pytest.mark.parametrize("size", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("batch", [(), (5,), (2, 3)])
def test_it_whitens(size, batch):
    s = covariances(size, batch)
    w = inverse_cholesky(s)
    assert w.shape == s.shape
    assert (np.triu(w, 1) == 0).all()
    np.testing.assert_allclose(w @ s @ np.swapaxes(w, -1, -2), np.broadcast_to(np.eye(size), s.shape), atol=1e-10)


@pytest.mark.parametrize("size", [1, 3, 8])
def test_it_is_what_lapack_finds(size):
    s = covariances(size, seed=1)
    factor = np.linalg.cholesky(s)
    expected = scipy.linalg.solve_triangular(factor, np.eye(size), lower=True)
    np.testing.assert_allclose(inverse_cholesky(s), expected, rtol=1e-9, atol=1e-12)


def test_units_of_any_size():
    """Scaling a variable scales its column: nothing is judged by its magnitude."""
    s, scale = covariances(4, (50,), 2), np.geomspace(1e-8, 1e8, 4)
    scaled = scale[:, None] * s * scale
    np.testing.assert_allclose(inverse_cholesky(scaled) * scale, inverse_cholesky(s), rtol=1e-9)


def test_only_the_lower_triangle_is_read():
    s = covariances(4, seed=3)
    np.testing.assert_array_equal(
        inverse_cholesky(np.tril(s) + np.triu(np.full((4, 4), np.nan), 1)), inverse_cholesky(s)
    )


def test_a_batch_equals_its_members():
    s = covariances(3, (2, 3), 4)
    np.testing.assert_allclose(inverse_cholesky(s)[1, 2], inverse_cholesky(s[1, 2]), rtol=1e-14)


class TestWithoutAFactor:
    @pytest.mark.parametrize(
        "bad",
        [
            np.zeros((3, 3)),
            np.ones((3, 3)),
            np.diag([1.0, 1.0, 0.0]),
            np.diag([0.0, 1.0, 1.0]),
            np.diag([1.0, -1.0, 1.0]),
            np.full((3, 3), np.nan),
        ],
        ids=["zero", "rank 1", "last", "first", "negative", "NaN"],
    )
    def test_it_fails_alone(self, bad):
        s = covariances(3, (3,), 5)
        good = inverse_cholesky(s)
        s[1] = bad
        found = inverse_cholesky(s)
        assert np.isnan(found[1]).any()
        np.testing.assert_array_equal(found[[0, 2]], good[[0, 2]])

    def test_rounding_of_a_singular_matrix_is_no_variance(self):
        """Projections across unit vectors, whose last pivot is rounding."""
        n = np.random.default_rng(6).standard_normal((500, 3))
        n[:, 2] = np.copysign(1.0, n[:, 2])
        n /= np.linalg.norm(n, axis=1)[:, None]
        found = inverse_cholesky(np.eye(3) - n[:, :, None] * n[:, None, :])
        assert np.isnan(found[:, 2]).all(axis=-1).all()

    def test_its_argument_stays(self):
        s = covariances(3, seed=7)
        before = s.copy()
        inverse_cholesky(s)
        np.testing.assert_array_equal(s, before)
