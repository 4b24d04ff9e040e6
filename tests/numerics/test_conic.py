"""The direct Clarabel route against cvxpy, against its own certificate, and its honesty about failure."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from hexopt.errors import InputError
from hexopt.losses import L1, Chebyshev, GroupHuber, GroupL1, Huber, Loss, Quadratic
from hexopt.numerics import conic
from hexopt.numerics.certificate import certify
from hexopt.numerics.conic import conic_solves, solve_conic
from hexopt.numerics.programme import Ball, Interval, Programme, Term

BATCH, M, P = 4, 24, 6
LOSSES = {
    "quadratic": (Quadratic(), 1),
    "huber": (Huber(), 1),
    "l1": (L1(), 1),
    "group-huber": (GroupHuber(), 3),
    "group-l1": (GroupL1(0.5), 3),
    "chebyshev": (Chebyshev(), 1),
}
EXTRAS = {
    "free": {},
    "box": {"box": True},
    "interval": {"interval": True},
    "ball": {"ball": True},
    "everything": {"box": True, "interval": True, "ball": True},
    "lasso": {"prior": Term(L1(3.0), np.eye(P), np.zeros(P))},
    "group lasso": {"prior": Term(GroupL1(3.0), np.eye(P), np.zeros(P), 3)},
    "prior": {"prior": Term(Quadratic(), np.eye(P), np.ones(P))},
}


def draw(
    loss, size=1, *, box=False, interval=False, ball=False, prior=None, noise=1.0, outlier=0.0, columns=1.0, seed=0
):
    """Return a scaled batch; the truth is inside the constraints, and the box binds."""
    rng = np.random.default_rng(seed)
    matrix = rng.standard_normal((BATCH, M, P)) * columns
    truth = 5 * rng.standard_normal((BATCH, P)) / columns
    rhs = (matrix @ truth[..., None])[..., 0] + noise * rng.standard_normal((BATCH, M))
    rhs[:, :2] += outlier
    terms = [Term(loss, matrix, rhs, size)]
    if prior is not None:
        both = np.tile(prior.matrix, (BATCH, 1, 1)), np.tile(prior.rhs, (BATCH, 1))
        terms.append(Term(prior.loss, *both, prior.size))
    lower, upper = np.full((2, BATCH, P), [[[-np.inf]], [[np.inf]]])
    if box:
        lower, upper = np.where(
            rng.random((2, BATCH, P)) < 0.6, truth + [[[-0.02]], [[0.02]]] / np.abs(columns), (lower, upper)
        )
    intervals, balls = [], []
    if interval:
        rows = rng.standard_normal((BATCH, 3, P))
        side = (rows @ truth[..., None])[..., 0]
        room = np.array([0.0, 0.1, 0.1])
        low, high = side - room, side + room
        high[::2, 1], low[1::2, 2] = np.inf, -np.inf
        intervals.append(Interval(rows, low, high))
    if ball:
        rows = np.tile(np.eye(P)[:3], (BATCH, 1, 1))
        balls.append(Ball(rows, truth[:, :3] + 0.2, np.full(BATCH, 0.36)))
    return Programme(tuple(terms), lower, upper, tuple(intervals), tuple(balls)).scaled()[0]


def by_cvxpy(programme, i):
    """Return the objective of a member, by cvxpy."""
    import cvxpy as cp

    x = cp.Variable(programme.size)
    terms = [
        term.loss.expression(cp.reshape(term.matrix[i] @ x - term.rhs[i], (-1, term.size), order="C"))
        for term in programme.terms
    ]
    limits = [Interval(np.eye(programme.size)[None].repeat(programme.batch, 0), programme.lower, programme.upper)]
    rules = []
    for one in [*limits, *programme.intervals]:
        up, low = np.isfinite(one.upper[i]), np.isfinite(one.lower[i])
        rules += [one.matrix[i][up] @ x <= one.upper[i][up]] if up.any() else []
        rules += [one.matrix[i][low] @ x >= one.lower[i][low]] if low.any() else []
    rules += [cp.norm(one.matrix[i] @ x - one.centre[i]) <= one.radius[i] for one in programme.balls]
    problem = cp.Problem(cp.Minimize(cp.sum(terms)), rules)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # "may be inaccurate": beyond 1e-12 it stalls
        problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    return problem.value


def check(programme, found, share=1.0):
    """Converged, inside the constraints, and proven to be optimal."""
    assert found.converged.all()
    assert not found.infeasible.any()
    proof, value = certify(programme, found), programme.objective(found.values)
    unit = np.max([np.abs(term.rhs).max() for term in programme.terms])
    assert (proof.gap <= 1e-8 * share * (1 + value)).all(), proof.gap
    assert (proof.primal_residual <= 1e-9 * unit).all()
    assert (proof.dual_residual <= 1e-9 * (1 + unit)).all()
    assert ((programme.lower <= found.values) & (found.values <= programme.upper)).all()
    return value


@pytest.mark.parametrize("extra", EXTRAS)
@pytest.mark.parametrize("name", LOSSES)
def test_it_ends_where_cvxpy_does(name, extra):
    programme = draw(*LOSSES[name], **EXTRAS[extra])
    value = check(programme, solve_conic(programme))
    for i in range(2):
        np.testing.assert_allclose(value[i], by_cvxpy(programme, i), rtol=1e-7)


@pytest.mark.parametrize("extra", ["free", "box", "interval", "prior", "everything"])
@pytest.mark.parametrize("name", ["quadratic", "huber", "group-huber"])
def test_smooth_losses_are_sharp(name, extra):
    programme = draw(*LOSSES[name], **EXTRAS[extra])
    value = check(programme, solve_conic(programme), 1e-3)
    sharp = 5e-13 if extra != "everything" else 1e-11  # a ball and an equation together leave less
    assert (certify(programme, solve_conic(programme)).gap <= sharp * np.maximum(1, value)).all()


@pytest.mark.parametrize(
    "kind",
    [
        {"columns": 10.0 ** np.array([0, 1, 2, 3, 4, 0])},
        {"noise": 1e-6},
        {"noise": 1e-6, "columns": 1e4},
        {"noise": 1e4},
        {"outlier": 1e3},
    ],
    ids=["columns", "tiny", "tiny beside large", "large", "outliers"],
)
@pytest.mark.parametrize("name", LOSSES)
def test_scales_do_not_matter(name, kind):
    programme = draw(*LOSSES[name], **kind)
    value = check(programme, solve_conic(programme))
    gap = certify(programme, solve_conic(programme)).gap
    assert (gap <= 1e-7 * value).all()  # relative, however small the residuals are


@pytest.mark.parametrize("name", LOSSES)
def test_duals_have_the_sign_of_the_statement(name):
    """They balance, are subgradients, and the multipliers are complementary to the slacks."""
    programme = draw(*LOSSES[name], box=True, interval=True, ball=True)
    found = solve_conic(programme)
    (term,), (side,), (ball,) = programme.terms, programme.intervals, programme.balls
    (u,), (w,), (v,) = found.rows, found.intervals, found.balls
    total = [np.einsum("bqp,bq->bp", one.matrix, part) for one, part in ((term, u), (side, w), (ball, v))]
    box = -sum(total)
    x = found.values
    assert (np.minimum(programme.upper - x, 1) * np.maximum(box, 0) <= 1e-5).all()
    assert (np.minimum(x - programme.lower, 1) * np.maximum(-box, 0) <= 1e-5).all()
    value = np.einsum("bqp,bp->bq", side.matrix, x)
    assert (np.minimum(side.upper - value, 1) * np.maximum(w, 0) <= 1e-6).all()
    assert (np.minimum(value - side.lower, 1) * np.maximum(-w, 0) <= 1e-6).all()
    apart = np.einsum("bqp,bp->bq", ball.matrix, x) - ball.centre
    np.testing.assert_allclose(np.linalg.norm(v, axis=1) * ball.radius, (v * apart).sum(axis=1), atol=1e-6)
    blocks = term.blocks(u) * (1 - 1e-12)
    assert (term.loss.excess(term.residual(x), blocks) <= 1e-7 * (1 + programme.objective(x))).all()


@pytest.mark.parametrize("extra", ["free", "everything", "lasso"])
@pytest.mark.parametrize("name", LOSSES)
def test_a_member_does_not_depend_on_its_batch(name, extra):
    """An update of the persistent solver gives what a fresh solver gives."""
    programme = draw(*LOSSES[name], **EXTRAS[extra])
    together = solve_conic(programme)
    for i in range(BATCH):
        alone = solve_conic(programme.take([i]))
        value = programme.take([i]).objective(alone.values)
        np.testing.assert_allclose(programme.objective(together.values)[i], value[0], rtol=1e-8)
        if name in ("quadratic", "huber") and extra != "everything":
            np.testing.assert_allclose(together.values[i], alone.values[0], rtol=1e-7, atol=1e-7)


def test_an_update_is_a_fresh_solver(monkeypatch):
    """Without equilibration, of the first member's scales, they agree to the last bit."""
    programme = draw(GroupHuber(), 3, ball=True)
    updated = solve_conic(programme)
    member = conic._Engine._member

    def fresh(engine, *args):
        engine.solvers.clear()
        return member(engine, *args)

    monkeypatch.setattr(conic._Engine, "_member", fresh)
    np.testing.assert_array_equal(solve_conic(programme).values, updated.values)


def test_chunks_do_not_matter(monkeypatch):
    programme = draw(Huber(), box=True)
    whole = solve_conic(programme)
    monkeypatch.setattr(conic, "CHUNK", 3)
    np.testing.assert_array_equal(solve_conic(programme).values, whole.values)


def test_bounds_that_are_infinite_for_some_members():
    """Each member has bounds of its own; what is infinite has no multiplier, and a far bound no influence."""
    programme = draw(Huber(), box=True, interval=True)
    far = replace(programme, upper=np.where(np.isinf(programme.upper), 1e12, programme.upper))
    found = solve_conic(programme)
    check(programme, found)
    np.testing.assert_allclose(solve_conic(far).values, found.values, rtol=1e-8, atol=1e-8)
    (side,), (w,) = programme.intervals, found.intervals
    assert (w[np.isinf(side.upper)] <= 0).all()
    assert (w[np.isinf(side.lower)] >= 0).all()


def test_a_ball_may_be_far():
    programme = draw(Huber(), ball=True)
    radius = np.array([1e12, 0.36, 1e9, 1e5])
    open_ball = replace(programme, balls=(replace(programme.balls[0], radius=radius),))
    found = solve_conic(open_ball)
    check(open_ball, found)
    free = solve_conic(replace(programme, balls=()))
    np.testing.assert_allclose(found.values[[0, 2, 3]], free.values[[0, 2, 3]], rtol=1e-7, atol=1e-7)


def test_an_equation_for_some_members_only():
    programme = draw(Quadratic(), interval=True)
    side = programme.intervals[0]
    upper = side.upper.copy()
    upper[1, 0] += 1.0
    mixed = replace(programme, intervals=(replace(side, upper=upper),))
    check(mixed, solve_conic(mixed))


def infeasible_cases():
    """Yield changes that leave member 1 without a feasible point."""

    def crossed(programme):
        lower = programme.lower.copy()
        lower[1, 0], programme.upper[1, 0] = 1.0, 0.0
        return replace(programme, lower=lower)

    def rows(programme):
        matrix = np.tile(np.eye(P)[:1] + np.eye(P)[1:2], (BATCH, 2, 1))
        lower, upper = np.full((BATCH, 2), -np.inf), np.full((BATCH, 2), np.inf)
        upper[:, 0], lower[1, 1] = 100.0, 101.0
        return replace(programme, intervals=(Interval(matrix, lower, upper),))

    def box_and_row(programme):
        upper = np.where(np.arange(BATCH)[:, None] == 1, 1.0, programme.upper)
        lower = np.where(np.arange(BATCH) == 1, 10.0, -np.inf)[:, None]
        row = Interval(np.ones((BATCH, 1, P)), lower, np.full((BATCH, 1), np.inf))
        return replace(programme, upper=upper, intervals=(row,))

    def balls(programme):
        matrix = np.tile(np.eye(P)[:3], (BATCH, 1, 1))
        apart = np.where(np.arange(BATCH) == 1, 500.0, 0.0)[:, None] * np.ones(3)
        one, other = Ball(matrix, 0 * apart, np.full(BATCH, 300.0)), Ball(matrix, apart, np.full(BATCH, 300.0))
        return replace(programme, balls=(one, other))

    def radius(programme):
        return replace(
            programme, balls=(Ball(np.ones((BATCH, 1, P)), np.zeros((BATCH, 1)), np.array([1e3, -1, 1e3, 1e3])),)
        )

    return [crossed, rows, box_and_row, balls, radius]


@pytest.mark.parametrize("case", infeasible_cases(), ids=lambda case: case.__name__)
@pytest.mark.parametrize("name", ["huber", "group-l1"])
def test_an_infeasible_member_is_alone(name, case):
    programme = case(draw(*LOSSES[name]))
    found = solve_conic(programme)
    np.testing.assert_array_equal(found.infeasible, [False, True, False, False])
    np.testing.assert_array_equal(found.converged, [True, False, True, True])
    assert np.isnan(found.values[1]).all()
    rest = programme.take([0, 2, 3])
    check(rest, solve_conic(rest))
    np.testing.assert_allclose(found.values[[0, 2, 3]], solve_conic(rest).values, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize("where", ["matrix", "rhs", "interval", "centre", "lower"])
def test_numbers_that_are_not_finite_cost_their_member(where, bad):
    programme = draw(Huber(), interval=True, ball=True, box=True)
    (term,), (side,), (ball,) = programme.terms, programme.intervals, programme.balls
    {"matrix": term.matrix, "rhs": term.rhs, "interval": side.matrix, "centre": ball.centre, "lower": programme.lower}[
        where
    ][2] = bad
    found = solve_conic(programme)
    np.testing.assert_array_equal(found.converged, [True, True, False, True])
    assert np.isnan(found.values[2]).all()
    np.testing.assert_array_equal(
        found.infeasible, np.arange(BATCH) == (2 if where == "lower" and bad == np.inf else -1)
    )
    check(programme.take([0, 1, 3]), solve_conic(programme.take([0, 1, 3])))


def test_a_panic_costs_its_member(monkeypatch):
    import clarabel

    panic = type("PanicException", (BaseException,), {})
    solver, count = clarabel.DefaultSolver, iter(range(100))

    class Panicking:
        def __init__(self, *args):
            self.inner = solver(*args)

        def update(self, **numbers):
            self.inner.update(**numbers)

        def solve(self):
            if next(count) % 5 == 1:  # member 1 in the first pass, which is tried again about zero in the next
                raise panic
            return self.inner.solve()

    programme = draw(Huber())
    expected = solve_conic(programme)
    monkeypatch.setattr(clarabel, "DefaultSolver", Panicking)
    found = solve_conic(programme)
    assert found.converged.all()
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-8)


def test_an_interruption_is_no_panic(monkeypatch):
    import clarabel

    def interrupt(*args):
        raise KeyboardInterrupt

    monkeypatch.setattr(clarabel, "DefaultSolver", interrupt)
    with pytest.raises(KeyboardInterrupt):
        solve_conic(draw(Huber()))


def test_an_exact_fit():
    programme = draw(Huber(), noise=0.0)
    found = solve_conic(programme)
    assert (check(programme, found) < 1e-20).all()


@pytest.mark.parametrize("name", LOSSES)
def test_what_no_row_sees_is_left_anywhere(name):
    """A column of zeros and one that repeats another: the answer is not unique, and still optimal."""
    programme = draw(*LOSSES[name])
    programme.terms[0].matrix[:, :, 0] = 0.0
    programme.terms[0].matrix[:, :, 1] = programme.terms[0].matrix[:, :, 2]
    check(programme, solve_conic(programme))


def test_what_the_box_fixes_is_exact():
    programme = draw(Huber())
    programme.lower[:, :3] = programme.upper[:, :3] = 2.0
    found = solve_conic(programme)
    check(programme, found)
    np.testing.assert_array_equal(found.values[:, :3], 2.0)


def test_numbers_that_overflow_cost_their_member():
    programme = draw(Quadratic())
    programme.terms[0].rhs[1] = 1e200
    np.testing.assert_array_equal(solve_conic(programme).converged, [True, False, True, True])


def test_zero_is_an_answer():
    programme = draw(L1())
    programme.terms[0].rhs[:] = 0.0
    np.testing.assert_allclose(solve_conic(programme).values, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", LOSSES)
def test_no_members(name):
    programme = draw(*LOSSES[name], box=True, interval=True, ball=True).take(slice(0, 0))
    found = solve_conic(programme)
    assert found.values.shape == (0, P)
    assert found.converged.shape == found.infeasible.shape == found.iterations.shape == (0,)
    assert [part.shape for part in (*found.rows, *found.intervals, *found.balls)] == [(0, M), (0, 3), (0, 3)]


def test_other_losses_are_refused():
    class Cauchy(Huber):
        curvature = None

    class SmoothLargest(Chebyshev):
        curvature = 1

    assert all(conic_solves(draw(*one)) for one in LOSSES.values())
    for loss in (Cauchy(), SmoothLargest()):
        assert isinstance(loss, Loss)
        assert not conic_solves(draw(loss))
        with pytest.raises(InputError, match="curvature"):
            solve_conic(draw(loss))


def test_it_is_silent(capfd):
    solve_conic(draw(GroupHuber(), 3, ball=True))
    assert capfd.readouterr() == ("", "")
