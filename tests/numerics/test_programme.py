"""Programmes in standard form, and the certificate that finds out whoever claims too much."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexopt.losses import L1, Chebyshev, GroupHuber, GroupL1, Huber, Quadratic
from hexopt.numerics.certificate import certify
from hexopt.numerics.programme import Ball, Interval, Programme, Solution, Term

pytestmark = pytest.mark.filterwarnings("ignore:Solution may be inaccurate")  # as the certificate says itself

LOSSES = [Quadratic(), Huber(), GroupHuber(), L1(), GroupL1(), Chebyshev()]
SMOOTH = LOSSES[:3]
KINDS = ["free", "box", "interval", "equation", "ball", "all"]
TIGHT = {"tol_gap_abs": 1e-12, "tol_gap_rel": 1e-12, "tol_feas": 1e-12, "max_iter": 200}
P = 4


def programme(loss, kind="free", batch=3, seed=0, prior=True):
    """Random members about zero, so that the constraints of the kind bind for some of them."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(batch, 12, P))
    rhs = (matrix @ rng.normal(size=(batch, P, 1)))[..., 0] + rng.normal(size=(batch, 12))
    terms = [Term(loss, matrix, rhs, 3)]
    if prior:
        terms.append(Term(Quadratic(), np.broadcast_to(0.5 * np.eye(P), (batch, P, P)), rng.normal(size=(batch, P))))
    lower = np.full((batch, P), -np.inf)
    upper = -lower
    intervals, balls = [], []
    if kind in ("box", "all"):
        lower[:, 0], upper[:, 1] = -0.2, 0.2
    if kind in ("interval", "all"):
        rows = rng.normal(size=(batch, 2, P))
        sides = np.array([[-0.1, -np.inf]]), np.array([[0.1, 0.3]])
        intervals.append(Interval(rows, *(np.broadcast_to(side, (batch, 2)) for side in sides)))
    if kind in ("equation", "all"):
        intervals.append(Interval(rng.normal(size=(batch, 1, P)), np.full((batch, 1), 0.1), np.full((batch, 1), 0.1)))
    if kind in ("ball", "all"):
        eye = np.broadcast_to(np.eye(P)[1:], (batch, P - 1, P))
        balls.append(Ball(eye, 0.1 * np.ones((batch, P - 1)), np.full(batch, 0.5)))
    return Programme(tuple(terms), lower, upper, tuple(intervals), tuple(balls))


def by_cvxpy(one):
    """Every member in the unknowns and residuals, with its duals: values, Solution and optimal objectives."""
    count = one.batch
    values, best = np.zeros((count, P)), np.zeros(count)
    rows = [np.zeros(term.rhs.shape) for term in one.terms]
    intervals = [np.zeros(part.lower.shape) for part in one.intervals]
    balls = [np.zeros(part.centre.shape) for part in one.balls]
    for i in range(count):
        x = cp.Variable(P)
        z = [cp.Variable(term.rhs.shape[-1]) for term in one.terms]
        held = [a == t.matrix[i] @ x - t.rhs[i] for a, t in zip(z, one.terms, strict=True)]
        for side in ("lower", "upper"):
            bound = getattr(one, side)[i]
            which = np.flatnonzero(np.isfinite(bound))
            if len(which):
                held.append(x[which] >= bound[which] if side == "lower" else x[which] <= bound[which])
        pairs = []
        for part in one.intervals:
            low, high = (np.flatnonzero(np.isfinite(bound[i])) for bound in (part.lower, part.upper))
            inner = part.matrix[i] @ x
            pairs.append((low, inner[low] >= part.lower[i][low], high, inner[high] <= part.upper[i][high]))
        rims = [cp.norm(part.matrix[i] @ x - part.centre[i]) <= part.radius[i] for part in one.balls]
        objective = sum(
            t.loss.expression(cp.reshape(a, (a.size // t.size, t.size), order="C"))
            for a, t in zip(z, one.terms, strict=True)
        )
        every = held + [part for pair in pairs for part in (pair[1], pair[3])] + rims
        problem = cp.Problem(cp.Minimize(objective), every)
        problem.solve(solver=cp.CLARABEL, **TIGHT)
        values[i], best[i] = x.value, problem.value
        for target, part in zip(rows, held, strict=False):
            target[i] = -part.dual_value
        for target, (low, below, high, above) in zip(intervals, pairs, strict=True):
            target[i, low] -= below.dual_value
            target[i, high] += above.dual_value
        for target, part, ball in zip(balls, rims, one.balls, strict=True):
            apart = ball.matrix[i] @ x.value - ball.centre[i]
            target[i] = float(part.dual_value) * apart / np.linalg.norm(apart)
    values = np.clip(values, one.lower, one.upper)
    claim = Solution(values, np.ones(count, bool), np.zeros(count, int), tuple(rows), tuple(intervals), tuple(balls))
    return claim, best


def at(x):
    """A claim without duals: they follow from the residuals."""
    return Solution(x, np.ones(len(x), bool), np.zeros(len(x), int))


def dual_value(one, proof):
    """−ρ*(u) − y'u − …, by the definition: NumPy alone."""
    total = np.zeros(one.batch)
    for term, u in zip(one.terms, proof.rows, strict=True):
        blocks = term.blocks(u * (1 - 1e-12))
        conjugate = term.loss.conjugate(blocks)
        total -= conjugate.reshape(one.batch, -1).sum(axis=-1) + (u * term.rhs).sum(axis=-1)

    def support(multiplier, lower, upper):
        bound = np.where(multiplier > 0, upper, lower)
        return np.multiply(multiplier, bound, out=np.zeros(bound.shape), where=multiplier != 0).sum(axis=-1)

    total -= support(proof.box, one.lower, one.upper)
    for part, w in zip(one.intervals, proof.intervals, strict=True):
        total -= support(w, part.lower, part.upper)
    for ball, v in zip(one.balls, proof.balls, strict=True):
        total -= ball.radius * np.linalg.norm(v, axis=-1) + (v * ball.centre).sum(axis=-1)
    return total


def balance(one, proof):
    total = proof.box.copy()
    for matrix, dual in zip(
        [t.matrix for t in one.terms] + [c.matrix for c in (*one.intervals, *one.balls)],
        [*proof.rows, *proof.intervals, *proof.balls],
        strict=True,
    ):
        total += np.einsum("bmp,bm->bp", matrix, dual)
    return total


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_at_the_optimum_the_gap_is_nearly_zero(loss, kind):
    """And it is the objective minus the dual value of duals that balance."""
    one = programme(loss, kind)
    claim, best = by_cvxpy(one)
    proof = certify(one, claim)
    assert (proof.gap >= 0).all()
    assert (proof.gap <= 1e-7 * (1 + best)).all()
    assert (proof.primal_residual <= 1e-8).all()
    assert (proof.dual_residual <= 1e-10).all()
    np.testing.assert_allclose(balance(one, proof), 0, atol=1e-10)
    np.testing.assert_allclose(one.objective(claim.values), best, rtol=1e-7)
    np.testing.assert_allclose(one.objective(claim.values) - dual_value(one, proof), proof.gap, atol=1e-7)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_the_gap_bounds_the_distance_from_the_optimum(loss, kind):
    """For any point inside the constraints, with the right duals or with none."""
    one = programme(loss, kind, seed=1)
    claim, best = by_cvxpy(one)
    rng = np.random.default_rng(2)
    for size in (1e-6, 1e-3, 0.1, 1.0):
        # towards a point inside: the constraints stay satisfied, but for the equations
        x = np.clip(claim.values + size * rng.normal(size=claim.values.shape), one.lower, one.upper)
        for solution in (replace(claim, values=x), at(x)):
            proof = certify(one, solution)
            valid = proof.dual_residual <= 1e-9
            assert (proof.gap >= 0).all()
            inside = valid & (proof.primal_residual <= 1e-12)
            above = one.objective(x) - best
            assert (proof.gap[inside] >= above[inside] - 1e-7 * (1 + best[inside])).all()
            if one.is_free:
                assert inside.all()


CACHE = {}


@given(seed=st.integers(0, 10**6), power=st.floats(-4, 1))
@settings(max_examples=30)
def test_any_balanced_dual_is_a_lower_bound(seed, power):
    """Duals that are tampered with are mended or shrunk, so that the gap still holds."""
    rng = np.random.default_rng(seed)
    loss = LOSSES[seed % len(LOSSES)]
    one = programme(loss, "box", batch=1, seed=seed % 7)
    key = (seed % len(LOSSES), seed % 7)
    if key not in CACHE:
        CACHE[key] = by_cvxpy(one)
    claim, best = CACHE[key]
    rows = tuple(part + 10**power * rng.normal(size=part.shape) for part in claim.rows)
    x = np.clip(claim.values + 10**power * rng.normal(size=claim.values.shape), one.lower, one.upper)
    for solution in (replace(claim, rows=rows), replace(claim, rows=rows, values=x)):
        proof = certify(one, solution)
        assert proof.dual_residual > 1e-9 or proof.gap >= one.objective(solution.values) - best - 1e-7 * (1 + best)
        for term, u in zip(one.terms, proof.rows, strict=True):
            assert np.isfinite(term.loss.conjugate(term.blocks(u * (1 - 1e-12)))).all()
        assert (proof.box[np.isneginf(one.lower) & np.isposinf(one.upper)] == 0).all()


def test_a_violated_constraint_shows_in_the_primal_residual():
    one = programme(Quadratic(), "all")
    claim, _ = by_cvxpy(one)
    x = claim.values.copy()
    x[:, 0] = -0.2 - 3.0
    proof = certify(one, replace(claim, values=x))
    assert (proof.primal_residual >= 3.0 - 1e-9).all()
    far = certify(programme(Quadratic(), "ball"), at(np.full((3, P), 10.0)))
    np.testing.assert_allclose(far.primal_residual, np.linalg.norm(np.full(3, 9.9)) - 0.5)


def test_forces_on_constraints_that_do_not_hold_cost():
    """A multiplier of an inactive side makes the gap grow by its slack."""
    one = programme(Quadratic(), "interval", seed=4)
    claim, best = by_cvxpy(one)
    wrong = tuple(part + 0.5 for part in claim.intervals)
    proof = certify(one, replace(claim, intervals=wrong))
    assert (proof.gap > 1e-4).all()
    assert (proof.gap >= one.objective(claim.values) - best - 1e-9).all()


@pytest.mark.parametrize("loss", SMOOTH, ids=repr)
def test_smooth_losses_need_no_duals(loss):
    """ψ of the residuals are the duals; the gap is quadratic in the distance."""
    one = programme(loss, seed=5)
    claim, _ = by_cvxpy(one)
    gaps = [certify(one, at(claim.values + size)).gap for size in (1e-2, 1e-3)]
    assert (gaps[0] > 50 * gaps[1]).all()
    assert (gaps[1] > 0).all()


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_member_is_certified_as_it_is_alone(loss):
    one = programme(loss, "all", batch=4, seed=6)
    claim, _ = by_cvxpy(one)
    proof = certify(one, claim)
    for i in range(4):
        part = slice(i, i + 1)
        alone = certify(
            one.take(part),
            Solution(
                *(value[part] for value in (claim.values, claim.converged, claim.iterations)),
                *(tuple(a[part] for a in many) for many in (claim.rows, claim.intervals, claim.balls)),
            ),
        )
        np.testing.assert_allclose(alone.gap, proof.gap[part], atol=1e-12)
        np.testing.assert_allclose(alone.box, proof.box[part], atol=1e-12)


def test_an_empty_batch_is_certified():
    one = programme(Huber(), "all", batch=3).take(slice(0, 0))
    proof = certify(one, at(np.zeros((0, P))))
    assert proof.gap.shape == proof.primal_residual.shape == proof.dual_residual.shape == (0,)
    assert proof.box.shape == (0, P)
    assert one.objective(np.zeros((0, P))).shape == (0,)


# --- changes of variables -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_scaling_and_centring_leave_the_objective_and_the_constraints(loss, kind):
    one = programme(loss, kind, seed=7)
    rng = np.random.default_rng(8)
    x, centre = rng.normal(size=(2, 3, P))
    scaled, length = one.scaled()
    np.testing.assert_allclose(scaled.objective(x * length), one.objective(x), rtol=1e-12)
    square = sum(np.square(term.matrix).sum(axis=-2) for term in scaled.terms)
    np.testing.assert_allclose(square, 1.0, rtol=1e-12)
    about = one.about(centre)
    np.testing.assert_allclose(about.objective(x - centre), one.objective(x), rtol=1e-11)
    for other, y in ((scaled, x * length), (about, x - centre)):
        assert (other.is_boxed, other.is_free, other.batch, other.size) == (
            one.is_boxed,
            one.is_free,
            one.batch,
            one.size,
        )
        np.testing.assert_array_equal((y > other.upper) | (y < other.lower), (x > one.upper) | (x < one.lower))
        for mine, theirs in zip(one.intervals, other.intervals, strict=True):
            for side in ("lower", "upper"):
                here = np.einsum("bqp,bp->bq", mine.matrix, x) - getattr(mine, side)
                there = np.einsum("bqp,bp->bq", theirs.matrix, y) - getattr(theirs, side)
                np.testing.assert_allclose(there, here, atol=1e-12)
        for mine, theirs in zip(one.balls, other.balls, strict=True):
            here = np.einsum("bqp,bp->bq", mine.matrix, x) - mine.centre
            there = np.einsum("bqp,bp->bq", theirs.matrix, y) - theirs.centre
            np.testing.assert_allclose(there, here, atol=1e-12)
            np.testing.assert_array_equal(theirs.radius, mine.radius)


def test_a_column_of_zeros_keeps_its_length():
    matrix = np.array([[[1.0, 0.0], [2.0, 0.0]]])
    free = np.full((1, 2), np.inf)
    scaled, length = Programme((Term(Quadratic(), matrix, np.ones((1, 2))),), -free, free).scaled()
    np.testing.assert_allclose(length, [[np.sqrt(5), 1.0]])
    assert np.isfinite(scaled.terms[0].matrix).all()


@pytest.mark.parametrize("which", [slice(1, 3), np.array([2, 0]), np.array([True, False, True])], ids=repr)
def test_members_are_taken_with_all_they_have(which):
    one = programme(GroupHuber(), "all", seed=9)
    x = np.random.default_rng(1).normal(size=(3, P))
    part = one.take(which)
    np.testing.assert_allclose(part.objective(x[which]), one.objective(x)[which], rtol=1e-14)
    np.testing.assert_array_equal(part.balls[0].radius, one.balls[0].radius[which])
    np.testing.assert_array_equal(part.intervals[1].lower, one.intervals[1].lower[which])
    np.testing.assert_array_equal(part.upper, one.upper[which])


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_what_a_term_computes_is_what_its_matrix_says(loss):
    """Residuals, Aᵀu and AᵀψʹA against plain NumPy."""
    (term, _) = programme(loss, seed=10).terms
    rng = np.random.default_rng(3)
    x = rng.normal(size=(3, P))
    z = np.einsum("bmp,bp->bm", term.matrix, x) - term.rhs
    np.testing.assert_allclose(term.residual(x), z.reshape(3, 4, 3), atol=1e-13)
    prime = loss.psi_prime(z.reshape(3, 4, 3))
    full = np.zeros((3, 12, 12))
    for k in range(4):
        own = slice(3 * k, 3 * k + 3)
        full[:, own, own] = prime[:, k] if loss.per == "pose" else prime[:, k][..., None] * np.eye(3)
    expected = np.einsum("bmp,bmn,bnq->bpq", term.matrix, full, term.matrix)
    np.testing.assert_allclose(term.gram(z.reshape(3, 4, 3)), expected, atol=1e-12)


def test_rounding_on_the_side_without_a_bound_costs_nothing():
    """A multiplier of −1e-12 has no lower bound to hold it; the gap would be infinite."""
    one = programme(Quadratic(), "interval", seed=4)
    claim, best = by_cvxpy(one)
    wrong = tuple(np.where(np.isneginf(one.intervals[0].lower), -1e-12, part) for part in claim.intervals)
    slack = (np.einsum("bqp,bp->bq", one.intervals[0].matrix, claim.values) < one.intervals[0].upper - 1e-3)[:, 1]
    assert slack.any()
    proof = certify(one, replace(claim, intervals=wrong))
    assert (proof.gap[slack] <= 1e-8 * (1 + best[slack])).all()
