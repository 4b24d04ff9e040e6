"""The batched Newton route against cvxpy, far from and near to its solution."""

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexopt.losses import L1, GroupHuber, Huber, Quadratic
from hexopt.numerics.certificate import certify
from hexopt.numerics.newton import newton_solves, solve_newton
from hexopt.numerics.programme import Ball, Interval, Programme, Term

pytestmark = pytest.mark.filterwarnings("ignore:Solution may be inaccurate")  # of cvxpy, the reference

LOSSES = [Quadratic(), Huber(), GroupHuber(), Huber(0.1)]
TIGHT = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12, "max_iter": 200}
P = 5


def programme(loss, batch=6, seed=0, *, box=False, prior=False, outliers=False, blocks=10):
    """Rows of unit variance in blocks of three; 15 % of the blocks are off by a thousand on request."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(batch, 3 * blocks, P))
    truth = rng.normal(size=(batch, P))
    noise = rng.normal(size=(batch, blocks, 3))
    if outliers:
        bad = rng.uniform(size=(batch, blocks)) < 0.15
        noise[bad] += 1e3 * rng.normal(size=(int(bad.sum()), 3))
    rhs = (matrix @ truth[..., None])[..., 0] + noise.reshape(batch, -1)
    terms = [Term(loss, matrix, rhs, 3)]
    if prior:
        root = rng.normal(size=(batch, P, P))
        terms.append(Term(Quadratic(), root, (root @ truth[..., None])[..., 0] + rng.normal(size=(batch, P))))
    low = truth + rng.uniform(-0.3, 0.1, size=(batch, P)) if box else np.full((batch, P), -np.inf)
    high = low + 0.3 if box else np.full((batch, P), np.inf)
    scaled, _ = Programme(tuple(terms), low, high).scaled()
    return scaled


def by_cvxpy(one, i):
    """The optimum of one member, solved about zero and then about the answer."""
    centre = np.zeros(P)
    for _ in range(2):
        x = cp.Variable(P)
        objective = 0
        for term in one.terms:
            z = term.matrix[i] @ x + (term.matrix[i] @ centre - term.rhs[i])
            objective += term.loss.expression(cp.reshape(z, (len(term.rhs[i]) // term.size, term.size), order="C"))
        held = []
        if one.is_boxed:
            held = [x >= one.lower[i] - centre, x <= one.upper[i] - centre]
        cp.Problem(cp.Minimize(objective), held).solve(solver=cp.CLARABEL, **TIGHT)
        centre = centre + x.value
    return np.clip(centre, one.lower[i], one.upper[i])


@pytest.mark.parametrize("prior", [False, True], ids=["", "prior"])
@pytest.mark.parametrize("box", [False, True], ids=["", "box"])
@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_it_is_cvxpys_optimum(loss, box, prior):
    one = programme(loss, box=box, prior=prior)
    found = solve_newton(one)
    assert found.converged.all()
    assert (found.values >= one.lower).all()
    assert (found.values <= one.upper).all()
    expected = np.stack([by_cvxpy(one, i) for i in range(3)])
    best = one.take(slice(3)).objective(expected)
    np.testing.assert_allclose(one.objective(found.values)[:3], best, rtol=1e-9)
    np.testing.assert_allclose(found.values[:3], expected, atol=1e-5)
    proof = certify(one, found)
    assert (proof.gap <= 1e-12 * (1 + one.objective(found.values))).all()


def proven(one, found):
    """Whether the certificate puts the values within 1e-6 σ of the optimum."""
    return certify(one, found).gap <= 0.5e-12 * np.maximum(1, one.objective(found.values))


@pytest.mark.parametrize("box", [False, True], ids=["", "box"])
@pytest.mark.parametrize(("loss", "share"), [(Quadratic(), 1), (GroupHuber(), 1), (Huber(), 0.985), (Huber(0.1), 0.9)])
def test_it_converges_among_outliers_of_a_thousand_sigma(loss, share, box):
    """Nearly always; and it knows when: what it calls converged is proven, and hardly anything else is."""
    one = programme(loss, batch=400, seed=1, outliers=True, box=box)
    found = solve_newton(one)
    good = proven(one, found)
    assert good.mean() >= share
    assert good[found.converged].all()
    assert (good & ~found.converged).mean() <= 0.02
    assert np.isfinite(found.values).all()


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25)
def test_what_is_called_converged_is_proven(seed):
    loss = LOSSES[seed % len(LOSSES)]
    one = programme(loss, batch=10, seed=seed, outliers=bool(seed & 4), box=bool(seed & 8), prior=bool(seed & 16))
    found = solve_newton(one)
    assert proven(one, found)[found.converged].all()


def test_outliers_leave_robust_losses_near_the_truth():
    """Unlike least squares: a check that the problems above are what they say."""
    robust, plain = (programme(loss, 50, 3, outliers=True, blocks=30) for loss in (GroupHuber(), Quadratic()))
    clean = solve_newton(programme(Quadratic(), 50, 3, blocks=30)).values
    apart = [np.median(np.abs(solve_newton(one).values - clean)) for one in (robust, plain)]
    assert apart[0] < 0.02 * apart[1]


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_batch_is_its_members(loss):
    """With members that take a different number of iterations."""
    easy, hard = programme(loss, 8, box=True), programme(loss, 8, outliers=True, box=True)
    one = Programme(
        tuple(
            Term(a.loss, np.concatenate([a.matrix, b.matrix]), np.concatenate([a.rhs, b.rhs]), a.size)
            for a, b in zip(easy.terms, hard.terms, strict=True)
        ),
        np.concatenate([easy.lower, hard.lower]),
        np.concatenate([easy.upper, hard.upper]),
    )
    found = solve_newton(one)
    for i in range(16):
        alone = solve_newton(one.take(slice(i, i + 1)))
        np.testing.assert_allclose(found.values[i], alone.values[0], atol=1e-10)
        assert found.converged[i] == alone.converged[0]


def test_a_quadratic_takes_one_step():
    found = solve_newton(programme(Quadratic()))
    assert (found.iterations == 1).all()


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_the_start_does_not_matter(loss):
    """A member whose start is not finite starts at zero."""
    one = programme(loss, outliers=True, box=True)
    expected = solve_newton(one)
    start = 1e3 * np.random.default_rng(0).normal(size=(6, P))
    start[2], start[3, 1] = np.nan, np.inf
    found = solve_newton(one, start)
    good = found.converged & expected.converged
    assert good.mean() >= (0.8 if loss == Huber(0.1) else 1)
    np.testing.assert_allclose(one.objective(found.values)[good], one.objective(expected.values)[good], rtol=1e-11)


def test_an_empty_batch_has_an_empty_solution():
    one = programme(Huber(), 3, box=True, prior=True).take(slice(0, 0))
    found = solve_newton(one)
    assert found.values.shape == (0, P)
    assert found.converged.shape == found.iterations.shape == (0,)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_fewer_rows_than_unknowns_in_a_box(loss):
    """The optimum is not unique, yet its value is: zero, or what the box leaves."""
    one = programme(loss, 200, blocks=1, box=True)
    found = solve_newton(one)
    good = found.converged
    assert good.mean() >= 0.9
    assert np.isfinite(found.values).all()
    proof = certify(one, found)
    assert (proof.gap[good] <= 1e-11).all()
    assert (proof.dual_residual[good] <= 1e-9).all()
    for i in np.flatnonzero(good)[:3]:
        best = one.take(slice(i, i + 1)).objective(by_cvxpy(one, i)[None])
        np.testing.assert_allclose(one.objective(found.values)[i], best[0], atol=1e-7)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_column_of_zeros_harms_no_one(loss):
    one = programme(loss, 4)
    (term,) = one.terms
    matrix = term.matrix.copy()
    matrix[1, :, 2] = 0.0
    odd = Programme((Term(loss, matrix, term.rhs, 3),), one.lower, one.upper)
    found, expected = solve_newton(odd), solve_newton(one)
    assert np.isfinite(found.values).all()
    np.testing.assert_allclose(found.values[[0, 2, 3]], expected.values[[0, 2, 3]], atol=1e-10)


def test_a_member_that_is_not_finite_fails_alone():
    one = programme(Huber(), 4)
    (term,) = one.terms
    matrix = term.matrix.copy()
    matrix[1, 0, 0] = np.nan
    found = solve_newton(Programme((Term(Huber(), matrix, term.rhs, 3),), one.lower, one.upper))
    expected = solve_newton(one)
    assert found.converged.tolist() == [True, False, True, True]
    np.testing.assert_allclose(found.values[[0, 2, 3]], expected.values[[0, 2, 3]], atol=1e-10)


def test_equal_bounds_fix_an_unknown():
    one = programme(Huber(), 5)
    lower, upper = one.lower.copy(), one.upper.copy()
    lower[:, 1] = upper[:, 1] = 0.25
    found = solve_newton(Programme(one.terms, lower, upper))
    assert found.converged.all()
    np.testing.assert_array_equal(found.values[:, 1], 0.25)
    (term,) = one.terms
    rest = [0, 2, 3, 4]
    small = Term(Huber(), term.matrix[:, :, rest], term.rhs - 0.25 * term.matrix[:, :, 1], 3)
    np.testing.assert_allclose(
        found.values[:, rest], solve_newton(Programme((small,), lower[:, rest], upper[:, rest])).values, atol=1e-10
    )


def test_exact_rows_end_at_zero():
    """Nothing is left to decrease: converged all the same."""
    one = programme(Huber(), 5)
    (term,) = one.terms
    truth = np.random.default_rng(0).normal(size=(5, P))
    rhs = np.einsum("bmp,bp->bm", term.matrix, truth)
    found = solve_newton(Programme((Term(Huber(), term.matrix, rhs, 3),), one.lower, one.upper))
    assert found.converged.all()
    np.testing.assert_allclose(found.values, truth, atol=1e-13)


def test_what_it_takes():
    """Smooth losses in a box."""
    one = programme(Huber(), 2, box=True, prior=True)
    assert newton_solves(one)
    eye, ones = np.broadcast_to(np.eye(P), (2, P, P)), np.ones((2, P))
    assert not newton_solves(Programme(one.terms, one.lower, one.upper, (Interval(eye, -ones, ones),)))
    assert not newton_solves(Programme(one.terms, one.lower, one.upper, (), (Ball(eye, ones, ones[:, 0]),)))
    assert not newton_solves(Programme((Term(L1(), eye, ones), *one.terms), one.lower, one.upper))
