"""Forms are linear maps; apply and adjoint are transposes of each other."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexopt.numerics.forms import Centred, Consecutive, Direct


def random_form(name, n, rng, batch=()):
    if name == "consecutive":
        return Consecutive(rng.uniform(-2, 2, (*batch, n - 1)), rng.uniform(-2, 2, (*batch, n - 1)))
    return {"direct": Direct, "centred": Centred}[name]()


def dense(form, n):
    """Return the multiplier as a matrix (k, n), built column by column."""
    return np.stack([form.apply(np.eye(n)[:, i].reshape(n, 1, 1))[:, 0, 0] for i in range(n)], axis=1)


NAMES = ["direct", "centred", "consecutive"]


@given(
    name=st.sampled_from(NAMES),
    n=st.integers(2, 8),
    d=st.integers(1, 3),
    c=st.integers(1, 4),
    batch=st.sampled_from([(), (3,), (2, 3)]),
    seed=st.integers(0, 2**32 - 1),
)
def test_adjoint_is_the_transpose(name, n, d, c, batch, seed):
    """⟨D x, y⟩ = ⟨x, D' y⟩ for every column, in every batch."""
    rng = np.random.default_rng(seed)
    form = random_form(name, n, rng, batch)
    x = rng.standard_normal((*batch, n, d, c))
    forward = form.apply(x)
    y = rng.standard_normal(forward.shape)
    left = np.einsum("...kdc,...kdc->...c", forward, y)
    right = np.einsum("...ndc,...ndc->...c", x, form.adjoint(y))
    np.testing.assert_allclose(left, right, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_every_component_and_column_is_treated_alike(name):
    """A form acts on the pose index alone: D ⊗ I."""
    rng = np.random.default_rng(0)
    form = random_form(name, 5, rng)
    rows = rng.standard_normal((5, 3, 2))
    np.testing.assert_allclose(form.apply(rows), np.einsum("kn,ndc->kdc", dense(form, 5), rows), atol=1e-15)


def test_consecutive_is_later_times_next_minus_earlier_times_this():
    rows = np.arange(4.0).reshape(4, 1, 1) + 1
    form = Consecutive(np.array([10.0, 20.0, 30.0]), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(form.apply(rows)[:, 0, 0], [10 * 2 - 1, 20 * 3 - 2 * 2, 30 * 4 - 3 * 3])


def test_consecutive_broadcasts_its_weights_over_a_batch():
    rng = np.random.default_rng(1)
    shared = random_form("consecutive", 5, rng)
    rows = rng.standard_normal((3, 5, 2, 4))
    np.testing.assert_array_equal(shared.apply(rows)[1], shared.apply(rows[1]))
    formed = shared.apply(rows)
    np.testing.assert_array_equal(shared.adjoint(formed)[1], shared.adjoint(formed[1]))
    own = random_form("consecutive", 5, rng, (3,))
    assert own.adjoint(formed[0]).shape == (3, 5, 2, 4)


def test_centred_is_a_projection_that_removes_the_mean():
    matrix = dense(Centred(), 6)
    np.testing.assert_allclose(matrix, np.eye(6) - 1 / 6, atol=1e-15)
    np.testing.assert_allclose(matrix @ matrix, matrix, atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_before_is_the_length_of_the_subtracted_terms(name):
    """Columns that do not cancel at all keep their length: `before` says what the length could have been."""
    rng = np.random.default_rng(2)
    form = random_form(name, 6, rng)
    rows = rng.standard_normal((6, 3, 2))
    squares = np.einsum("ndc,ndc->nc", rows, rows)
    expected = squares.sum(axis=0)
    if name == "consecutive":
        expected = form.later**2 @ squares[1:] + form.earlier**2 @ squares[:-1]
    np.testing.assert_allclose(form.before(squares), expected, rtol=1e-14)
