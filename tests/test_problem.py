"""Linear problems: checked shapes, row covariance, whitening."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import InputError
from hexopt.numerics.forms import Centred, Consecutive, Direct
from hexopt.problem import ConstantRowNoise, LinearProblem, RowCovariance

XYZ = hx.Parameters((hx.Block("base_point", 3, "cm"),))


def random_covariance(rng, shape, size):
    root = rng.standard_normal((*shape, size, size))
    return root @ np.swapaxes(root, -1, -2) + 0.1 * np.eye(size)


def problem(form="direct", *, n=5, d=3, batch=(), common=None, seed=0):
    """A random problem whose direct rows have a covariance a pose, and maybe a common part of given rank."""
    rng = np.random.default_rng(seed)
    blocks = random_covariance(rng, (*batch, n), d)
    shared = None if common is None else rng.standard_normal((*batch, n, d, common))
    forms = {"direct": Direct(), "centred": Centred()}
    multiplier = forms.get(form) or Consecutive(rng.uniform(1, 2, (*batch, n - 1)), rng.uniform(1, 2, (*batch, n - 1)))
    direct, rhs = rng.standard_normal((*batch, n, d, 3)), rng.standard_normal((*batch, n, d, 1))
    formed = multiplier.apply(direct)
    rows = formed.shape[-3] * d
    return LinearProblem(
        formed.reshape(*batch, rows, 3),
        multiplier.apply(rhs).reshape(*batch, rows),
        XYZ,
        rows_per_block=d,
        form=multiplier,
        noise=ConstantRowNoise(RowCovariance(blocks, shared)),
    )


def dense_covariance(p):
    """D S D' built with plain loops."""
    covariance = p.row_covariance()
    n, d = covariance.blocks.shape[-3:-1]
    direct = np.zeros((n * d, n * d))
    for i in range(n):
        direct[i * d : (i + 1) * d, i * d : (i + 1) * d] = covariance.blocks[i]
    if covariance.common is not None:
        u = covariance.common.reshape(n * d, -1)
        direct = direct + u @ u.T
    multiplier = p.form.apply(np.eye(n * d).reshape(n, d, n * d)).reshape(-1, n * d)
    return multiplier @ direct @ multiplier.T


def dense_root(p):
    """The whitening as one matrix, from what it does to the unit vectors."""
    m = p.matrix.shape[-2]
    return p.whitening().apply(np.eye(m))


@given(
    form=st.sampled_from(["direct", "consecutive", "centred"]),
    common=st.sampled_from([None, 1, 2]),
    d=st.integers(1, 3),
    n=st.integers(2, 6),
    seed=st.integers(0, 10**6),
)
def test_whitening_is_the_symmetric_root(form, common, d, n, seed):
    """W = W', and W'W is the inverse of D S D' (its pseudo-inverse where centring makes that singular)."""
    p = problem(form, n=n, d=d, common=common, seed=seed)
    root, covariance = dense_root(p), dense_covariance(p)
    inverse = np.linalg.pinv(covariance, hermitian=True, rcond=1e-10)
    np.testing.assert_allclose(root, root.T, atol=1e-9 * np.abs(root).max())
    np.testing.assert_allclose(root.T @ root, inverse, atol=1e-8 * np.abs(inverse).max())
    assert np.linalg.eigvalsh(root).min() > -1e-9 * np.abs(root).max()
    whitened = root @ covariance @ root.T
    if form == "centred":  # what is left is a projection that has lost one pose
        np.testing.assert_allclose(whitened @ whitened, whitened, atol=1e-8)
        np.testing.assert_allclose(np.trace(whitened), (n - 1) * d, atol=1e-8)
    else:
        np.testing.assert_allclose(whitened, np.eye(len(whitened)), atol=1e-8)


def test_centred_whitening_drops_exactly_the_mean():
    p = problem("centred", n=5, d=3)
    values = np.sort(np.linalg.eigvalsh(dense_root(p)))
    np.testing.assert_allclose(values[:3], 0, atol=1e-12)
    assert values[3] > 1e-2


def test_whitened_rows_have_unit_variance():
    """By Monte Carlo: rows with the covariance S, whitened, have the covariance I."""
    p = problem("direct", common=1)
    rng = np.random.default_rng(1)
    samples = np.linalg.cholesky(dense_covariance(p)) @ rng.standard_normal((15, 40_000))
    whitened = p.whitening().apply(samples)
    np.testing.assert_allclose(np.cov(whitened), np.eye(15), atol=0.04)


def test_whitened_is_whitening_applied():
    p = problem("consecutive")
    matrix, rhs = p.whitened()
    root = dense_root(p)
    np.testing.assert_allclose(matrix, root @ p.matrix, atol=1e-12)
    np.testing.assert_allclose(rhs, root @ p.rhs, atol=1e-12)


@pytest.mark.parametrize("form", ["direct", "consecutive", "centred"])
@pytest.mark.parametrize("common", [None, 2])
def test_a_batch_of_whitenings_equals_its_members(form, common):
    p = problem(form, batch=(4,), common=common)
    matrix, rhs = p.whitened()
    for i in range(4):
        row = p.noise.rows
        one = LinearProblem(
            p.matrix[i],
            p.rhs[i],
            XYZ,
            rows_per_block=3,
            form=p.form if not isinstance(p.form, Consecutive) else Consecutive(p.form.later[i], p.form.earlier[i]),
            noise=ConstantRowNoise(RowCovariance(row.blocks[i], None if common is None else row.common[i])),
        )
        np.testing.assert_allclose(one.whitened()[0], matrix[i], atol=1e-10)
        np.testing.assert_allclose(one.whitened()[1], rhs[i], atol=1e-10)


@pytest.mark.parametrize("form", ["direct", "consecutive", "centred"])
@pytest.mark.parametrize("common", [None, 2])
def test_a_gain_on_formed_rows_is_one_on_direct_rows(form, common):
    """gain·D·rows = direct_gain·rows, and its covariance is gain·(D S D')·gain'."""
    p = problem(form, common=common)
    rng = np.random.default_rng(2)
    gain = rng.standard_normal((2, p.matrix.shape[0]))
    on_direct = p.direct_gain(gain)
    assert on_direct.shape == (2, 5, 3)
    rows = rng.standard_normal((5, 3, 1))
    np.testing.assert_allclose(
        gain @ p.form.apply(rows).reshape(-1), np.einsum("pnd,nd->p", on_direct, rows[..., 0]), atol=1e-12
    )
    np.testing.assert_allclose(
        p.row_covariance().propagated(on_direct), gain @ dense_covariance(p) @ gain.T, atol=1e-10
    )


class TestSingularNoise:
    def singular(self, blocks, common=None, form=None):
        n, d = blocks.shape[:2]
        rng = np.random.default_rng(0)
        return LinearProblem(
            rng.standard_normal((n * d, 3)),
            rng.standard_normal(n * d),
            XYZ,
            rows_per_block=d,
            form=form or Direct(),
            noise=ConstantRowNoise(RowCovariance(blocks, common)),
        )

    @pytest.mark.parametrize("form", [Direct(), Centred()])
    def test_rows_without_error_cannot_be_weighted(self, form):
        blocks = np.stack([np.eye(3)] * 4)
        blocks[1:3, 1, 1] = 0.0  # centring hides what a single one has too much
        with pytest.raises(InputError, match="leaves some equations without any error"):
            self.singular(blocks, form=form).whitening()

    def test_a_singular_covariance_that_is_not_diagonal(self):
        with pytest.raises(InputError, match="without any error"):
            self.singular(np.stack([np.ones((3, 3))] * 4)).whitening()

    def test_a_common_part_alone_is_singular(self):
        with pytest.raises(InputError, match="without any error"):
            self.singular(np.zeros((4, 3, 3)), np.ones((4, 3, 2))).whitening()

    def test_a_common_part_can_fill_what_poses_miss(self):
        blocks = np.stack([np.diag([1.0, 1.0, 0.0])] * 1)
        root = self.singular(blocks, np.array([[[0.0], [0.0], [2.0]]])).whitening()
        np.testing.assert_allclose(root.apply(np.eye(3)), np.diag([1, 1, 0.5]), atol=1e-14)


def test_unknown_noise_says_what_to_do():
    p = LinearProblem(np.eye(3), np.ones(3), XYZ)
    for ask in (p.whitening, p.row_covariance):
        with pytest.raises(InputError, match=r"noise is unknown.*UniformNoise.*weights=None"):
            ask()


def test_the_noise_is_evaluated_at_the_unweighted_solution_unless_told():
    seen = []

    class Recorder:
        def covariance(self, values):
            seen.append(values)
            return RowCovariance(np.ones((6, 1, 1)))

    rng = np.random.default_rng(0)
    matrix, rhs = rng.standard_normal((6, 3)), rng.standard_normal(6)
    LinearProblem(matrix, rhs, XYZ, noise=Recorder()).whitening()
    LinearProblem(matrix, rhs, XYZ, noise=Recorder(), at=[1.0, 2.0, 3.0]).whitening()
    np.testing.assert_allclose(seen[0], np.linalg.lstsq(matrix, rhs)[0], rtol=1e-12)
    np.testing.assert_array_equal(seen[1], [1, 2, 3])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"matrix": np.ones((5, 2))}, r"matrix: expected shape \(\.\.\., m, 3\)"),
        ({"rhs": np.ones(4)}, "disagree"),
        ({"rhs": np.ones((2, 5))}, "disagree"),
        ({"matrix": np.full((5, 3), np.nan)}, "matrix: 15 value.*NaN"),
        ({"rhs": np.full(5, np.inf)}, "rhs: 5 value.*infinite"),
        ({"matrix": np.empty((0, 3)), "rhs": np.empty(0)}, "no equation"),
        ({"rows_per_block": 2}, "no multiple of rows_per_block=2"),
        ({"at": np.nan}, "at: "),
    ],
)
def test_wrong_problems(changes, message):
    with pytest.raises(InputError, match=message):
        LinearProblem(**{"matrix": np.ones((5, 3)), "rhs": np.ones(5), "parameters": XYZ, **changes})


def test_the_residual_is_a_x_minus_y():
    p = problem(batch=(2,))
    x = np.random.default_rng(3).standard_normal((2, 3))
    np.testing.assert_allclose(p.residual(x)[1], p.matrix[1] @ x[1] - p.rhs[1], atol=1e-14)
