"""The interior-point method against Clarabel, by the certificate, and its honesty about failure."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexopt.losses import L1, Chebyshev, GroupL1, Huber, Quadratic
from hexopt.numerics.certificate import certify
from hexopt.numerics.interior import interior_solves, solve_interior
from hexopt.numerics.programme import Ball, Interval, Programme, Term

LOSSES = {"quadratic": Quadratic(), "huber": Huber(), "l1": L1(), "chebyshev": Chebyshev()}
CURVED = ("quadratic", "huber")
TIGHT = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-12)


def random_programme(
    loss, rng, *, batch=10, rows=24, size=4, noise=1.0, outliers=0.0, box=None, prior=None, interval=None
):
    """Random data around a true point; `box` and `interval` are half-widths, about a point nearby."""
    matrix, truth = rng.standard_normal((batch, rows, size)), rng.standard_normal((batch, size))
    error = noise * rng.standard_normal((batch, rows)) * np.where(rng.random((batch, rows)) < outliers, 1e3, 1.0)
    terms = [Term(loss, matrix, np.einsum("bmp,bp->bm", matrix, truth) + error)]
    if prior:
        terms.append(Term(prior, np.broadcast_to(np.eye(size), (batch, size, size)), np.zeros((batch, size))))
    lower, upper = np.full((batch, size), -np.inf), np.full((batch, size), np.inf)
    if box is not None:
        middle = truth + noise * rng.uniform(-0.3, 0.3, truth.shape)
        lower = np.where(rng.random(truth.shape) < 0.2, lower, middle - box)
        upper = np.where(rng.random(truth.shape) < 0.2, upper, middle + box)
    intervals = []
    if interval is not None:
        side = rng.standard_normal((batch, 2, size))
        at = np.einsum("bqp,bp->bq", side, np.clip(truth, lower, upper))
        intervals.append(Interval(side, at - interval, at + interval))
    return Programme(tuple(terms), lower, upper, tuple(intervals))


def clarabel(programme):
    """The optimum of every member."""
    values = []
    for k in range(programme.batch):
        x = cp.Variable(programme.size)
        cost = sum(t.loss.expression(cp.reshape(t.matrix[k] @ x - t.rhs[k], (-1, 1), "C")) for t in programme.terms)
        limits = []
        for matrix, lower, upper in [
            (np.eye(programme.size), programme.lower[k], programme.upper[k]),
            *((one.matrix[k], one.lower[k], one.upper[k]) for one in programme.intervals),
        ]:
            even, low, high = lower == upper, np.isfinite(lower), np.isfinite(upper)
            side = matrix @ x
            limits += [side[even] == lower[even]] if even.any() else []
            limits += [side[low & ~even] >= lower[low & ~even]] if (low & ~even).any() else []
            limits += [side[high & ~even] <= upper[high & ~even]] if (high & ~even).any() else []
        values.append(cp.Problem(cp.Minimize(cost), limits).solve(solver="CLARABEL", **TIGHT))
    return np.array(values)


def proven(programme, curved):
    """Solve, and check by the certificate; the objectives."""
    solution = solve_interior(programme)
    assert solution.converged.all()
    assert (solution.values >= programme.lower).all()
    assert (solution.values <= programme.upper).all()
    certificate, value = certify(programme, solution), programme.objective(solution.values)
    assert (certificate.gap <= (5e-13 * np.maximum(1, value) if curved else 1e-10 * (1 + value))).all()
    assert certificate.primal_residual.max() < 1e-10
    assert certificate.dual_residual.max() < 1e-10
    assert solution.iterations.max() < 40
    return value


KINDS = {
    "free": {},
    "box": {"box": 0.1},
    "prior": {"prior": L1(2.0)},
    "inequality": {"interval": 0.05},
    "equality": {"interval": 0.0},
    "all": {"box": 0.2, "prior": L1(0.5), "interval": 0.1},
    "outliers": {"outliers": 0.1},
    "outliers in a box": {"outliers": 0.1, "box": 0.5},
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", LOSSES)
def test_it_finds_the_optimum_of_clarabel(name, kind):
    programme = random_programme(LOSSES[name], np.random.default_rng(1), **KINDS[kind])
    programme = programme.scaled()[0]
    assert interior_solves(programme)
    value = proven(programme, name in CURVED)
    np.testing.assert_allclose(value, clarabel(programme), rtol=1e-8)


@pytest.mark.parametrize("name", LOSSES)
def test_badly_scaled_columns_in_scaled_variables(name):
    programme = random_programme(LOSSES[name], np.random.default_rng(2), box=0.2, interval=0.1)
    by = np.array([1.0, 30.0, 1e3, 1e4])
    worse = Programme(
        tuple(replace(term, matrix=term.matrix * by) for term in programme.terms),
        programme.lower / by,
        programme.upper / by,
        tuple(replace(one, matrix=one.matrix * by) for one in programme.intervals),
    )
    value = proven(worse.scaled()[0], name in CURVED)
    np.testing.assert_allclose(value, proven(programme.scaled()[0], name in CURVED), rtol=1e-9)


@pytest.mark.parametrize("noise", [1e-6, 1e4])
@pytest.mark.parametrize("name", ["quadratic", "l1", "chebyshev"])
def test_homogeneous_losses_do_not_care_for_the_size_of_residuals(name, noise):
    programme = random_programme(LOSSES[name], np.random.default_rng(3), noise=noise, interval=0.1 * noise).scaled()[0]
    solution = solve_interior(programme)
    assert solution.converged.all()
    gap = certify(programme, solution).gap
    # the data themselves are rounded to 1e-16 of their size
    assert (gap <= 1e-12 * programme.objective(solution.values) + (0 if noise > 1 else 1e-13)).all()


def test_huber_with_tiny_and_with_huge_residuals():
    for noise in (1e-6, 1e4):
        programme = random_programme(Huber(), np.random.default_rng(4), noise=noise, box=noise).scaled()[0]
        proven(programme, curved=True)


def test_an_exact_fit_is_found():
    for loss in LOSSES.values():
        programme = random_programme(loss, np.random.default_rng(5), noise=0.0).scaled()[0]
        solution = solve_interior(programme)
        assert solution.converged.all()
        assert programme.objective(solution.values).max() < 1e-12


@pytest.mark.parametrize("name", LOSSES)
def test_unseen_directions_are_held_by_the_box(name):
    programme = random_programme(LOSSES[name], np.random.default_rng(6), rows=3, box=0.1).scaled()[0]
    bounded = Programme(programme.terms, np.maximum(programme.lower, -9.0), np.minimum(programme.upper, 9.0))
    proven(bounded, name in CURVED)


def test_several_losses_at_once():
    first = random_programme(Quadratic(), np.random.default_rng(7), box=0.3)
    rng = np.random.default_rng(8)
    more = [
        Term(loss, rng.standard_normal((10, 7, 4)), rng.standard_normal((10, 7)))
        for loss in (Chebyshev(), Huber(0.5), L1(0.1), Chebyshev())
    ]
    programme = Programme((more[0], *first.terms, *more[1:]), first.lower, first.upper).scaled()[0]
    np.testing.assert_allclose(proven(programme, curved=False), clarabel(programme), rtol=1e-8)


def test_limits_may_differ_by_member():
    programme = random_programme(L1(), np.random.default_rng(9), box=0.1, interval=0.05)
    one = programme.intervals[0]
    lower, upper = one.lower.copy(), one.upper.copy()
    lower[0], upper[1], lower[2, 0], upper[3, 1] = -np.inf, np.inf, upper[2, 0], lower[3, 1]
    lower[4], upper[4] = -np.inf, np.inf
    programme = Programme(programme.terms, programme.lower, programme.upper, (Interval(one.matrix, lower, upper),))
    programme = programme.scaled()[0]
    np.testing.assert_allclose(proven(programme, curved=False), clarabel(programme), rtol=1e-8)


def test_long_and_short_normals_of_intervals_are_alike():
    programme = random_programme(Quadratic(), np.random.default_rng(10), interval=0.0).scaled()[0]
    one = programme.intervals[0]
    short = replace(programme, intervals=(Interval(1e-6 * one.matrix, 1e-6 * one.lower, 1e-6 * one.upper),))
    expected, solution = solve_interior(programme), solve_interior(short)
    np.testing.assert_allclose(solution.values, expected.values, atol=1e-9)
    np.testing.assert_allclose(solution.intervals[0], 1e6 * expected.intervals[0], rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("name", LOSSES)
def test_a_batch_equals_its_members(name):
    programme = random_programme(LOSSES[name], np.random.default_rng(11), box=0.2, interval=0.1).scaled()[0]
    together = solve_interior(programme)
    for k in range(programme.batch):
        alone = solve_interior(programme.take(slice(k, k + 1)))
        np.testing.assert_allclose(alone.values[0], together.values[k], atol=1e-9)


def test_batches_of_many_chunks_and_of_none(monkeypatch):
    programme = random_programme(Chebyshev(), np.random.default_rng(12), interval=0.1).scaled()[0]
    whole = solve_interior(programme)
    monkeypatch.setattr("hexopt.numerics.interior.CHUNK", 300)
    parts = solve_interior(programme)
    np.testing.assert_allclose(parts.values, whole.values, atol=1e-10)
    np.testing.assert_allclose(parts.rows[0], whole.rows[0], atol=1e-9)
    np.testing.assert_allclose(parts.intervals[0], whole.intervals[0], atol=1e-9)
    none = solve_interior(programme.take(slice(0, 0)))
    assert none.values.shape == (0, 4)
    assert none.rows[0].shape == (0, 24)
    assert none.intervals[0].shape == (0, 2)


@pytest.mark.parametrize("name", LOSSES)
def test_an_infeasible_member_fails_alone(name):
    programme = random_programme(LOSSES[name], np.random.default_rng(13), box=0.2, interval=0.1)
    one = programme.intervals[0]
    matrix, lower, upper = one.matrix.copy(), one.lower.copy(), one.upper.copy()
    low, high = programme.lower.copy(), programme.upper.copy()
    matrix[3, 0], lower[3, 0], upper[3, 0] = [1, 0, 0, 0], 5.0, 6.0
    low[3, 0], high[3, 0] = -1.0, 1.0
    broken = Programme(programme.terms, low, high, (Interval(matrix, lower, upper),)).scaled()[0]
    solution = solve_interior(broken)
    assert solution.converged.tolist() == [k != 3 for k in range(10)]
    assert np.isfinite(solution.values).all()
    fine = np.arange(10) != 3
    expected = solve_interior(programme.scaled()[0])
    np.testing.assert_allclose(solution.values[fine], expected.values[fine], atol=1e-9)


def test_what_is_not_supported():
    rng = np.random.default_rng(14)
    programme = random_programme(L1(), rng)
    assert interior_solves(programme)
    assert not interior_solves(random_programme(GroupL1(), rng))
    ball = Ball(np.broadcast_to(np.eye(4), (10, 4, 4)), np.zeros((10, 4)), np.ones(10))
    assert not interior_solves(replace(programme, balls=(ball,)))


@given(
    seed=st.integers(0, 10**6),
    name=st.sampled_from(sorted(LOSSES)),
    rows=st.integers(5, 30),
    size=st.integers(1, 5),
    outliers=st.sampled_from([0.0, 0.2]),
    box=st.sampled_from([None, 0.05, 1.0]),
    interval=st.sampled_from([None, 0.0, 0.1]),
    prior=st.sampled_from([None, L1(0.7), Huber(0.3)]),
)
def test_the_certificate_holds(seed, name, rows, size, outliers, box, interval, prior):
    programme = random_programme(
        LOSSES[name],
        np.random.default_rng(seed),
        batch=3,
        rows=rows,
        size=max(size, 2 if interval is None else 3),
        outliers=outliers,
        box=box,
        interval=interval,
        prior=prior,
    ).scaled()[0]
    solution = solve_interior(programme)
    assert solution.converged.all()
    certificate = certify(programme, solution)
    assert (certificate.gap <= 1e-9 * (1 + programme.objective(solution.values))).all()
    assert certificate.primal_residual.max() < 1e-9
