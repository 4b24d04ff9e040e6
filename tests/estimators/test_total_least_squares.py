"""Total least squares: the textbook's answer, exact columns kept, no answer where there is none."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength
from hexopt.robots import BUILT_IN
from hexopt.testing import CLAIMS, check_estimator

EPS = np.finfo(float).eps
FORMS = [
    (FixedDirection, 3, "direct"),
    (FixedDirection, 3, "consecutive"),
    (FixedLeg, 3, "direct"),
    (FixedLeg, 3, "centred"),
    (FixedLength, 4, "direct"),
    (FixedLength, 4, "consecutive"),
]


def problem_of(matrix, rhs, names=None):
    names = names or [f"x{k}" for k in range(np.shape(matrix)[-1])]
    return hx.LinearProblem(np.array(matrix), np.array(rhs), hx.Parameters(tuple(hx.Block(n, 1, "cm") for n in names)))


def noisy_problem(rng, rows=12, size=4, batch=(5,)):
    matrix = rng.normal(size=(*batch, rows, size))
    rhs = np.einsum("...mp,p->...m", matrix, np.arange(1.0, size + 1)) + 0.3 * rng.normal(size=(*batch, rows))
    return matrix, rhs


@pytest.mark.parametrize(("loop", "n", "form"), FORMS)
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_exact_without_noise(robot, loop, n, form):
    model = BUILT_IN[robot]()
    for leg in range(1, 7):
        for extra in (0, 3):
            data = hx.simulate_leg(model, leg, loop.locks[0], n + extra, 100, rng=leg)
            found = hx.estimate(loop(data).linear(form), hx.TotalLeastSquares())
            assert found.ok.all()
            error = np.max(list(found.error(model.leg(leg)).values()), axis=0) / model.size
            assert (error <= 100 * EPS * found.condition).all()


def test_it_is_the_textbooks_answer():
    r"""No column is exact: :math:`x = -v_{1:p}/v_{p+1}` of the last right singular vector of [A y]."""
    matrix, rhs = noisy_problem(np.random.default_rng(0))
    found = hx.estimate(problem_of(matrix, rhs), hx.TotalLeastSquares(exact=()))
    _, s, vt = np.linalg.svd(np.concatenate([matrix, rhs[..., None]], axis=-1))
    last = vt[..., -1, :]
    np.testing.assert_allclose(found.values, -last[..., :-1] / last[..., -1:], rtol=1e-10)
    np.testing.assert_allclose(found.objective, s[..., -1] ** 2 / 2, rtol=1e-12)
    assert (np.abs(found.gap) <= 1e-12 * found.objective).all()
    plain = hx.estimate(problem_of(matrix, rhs), hx.LeastSquares())
    assert (np.abs(found.values - plain.values).max(axis=-1) > 1e-4).all()


def test_exact_columns_by_their_triangular_factor():
    """Van Huffel and Vandewalle: QR of the exact columns, total least squares on what is left, back-substitution."""
    matrix, rhs = noisy_problem(np.random.default_rng(1), batch=())
    found = hx.estimate(problem_of(matrix, rhs), hx.TotalLeastSquares(exact=("x0", "x2")))
    ordered = matrix[:, [0, 2, 1, 3]]
    q, _ = np.linalg.qr(ordered[:, :2], mode="complete")
    r = q.T @ np.column_stack([ordered, rhs])
    _, s, vt = np.linalg.svd(r[2:, 2:])
    x2 = -vt[-1, :2] / vt[-1, 2]
    x1 = np.linalg.solve(r[:2, :2], r[:2, 4] - r[:2, 2:4] @ x2)
    np.testing.assert_allclose(found.values[[0, 2, 1, 3]], [*x1, *x2], rtol=1e-10)
    assert float(found.objective) == pytest.approx(s[-1] ** 2 / 2, rel=1e-12)


def test_the_answer_needs_the_least_change():
    r"""E and f of the returned x make it a solution, :math:`E_1 = 0`; no other x needs less."""
    matrix, rhs = noisy_problem(np.random.default_rng(2), batch=())
    found = hx.estimate(problem_of(matrix, rhs), hx.TotalLeastSquares(exact=("x1",)))
    noisy = np.array([1.0, 0.0, 1.0, 1.0])

    def least_change(x):
        return 0.5 * ((matrix @ x - rhs) ** 2).sum() / (1 + noisy @ x**2)

    residual = matrix @ found.values - rhs
    weight = 1 + noisy @ found.values**2
    change, moved = -np.outer(residual, noisy * found.values) / weight, residual / weight
    np.testing.assert_allclose((matrix + change) @ found.values, rhs + moved, atol=1e-12)
    assert 0.5 * ((change**2).sum() + (moved**2).sum()) == pytest.approx(float(found.objective), rel=1e-12)
    others = found.values + np.random.default_rng(3).normal(size=(2000, 4)) * np.geomspace(1e-4, 10, 2000)[:, None]
    assert min(least_change(x) for x in others) > float(found.objective)


def test_all_columns_exact_is_least_squares():
    matrix, rhs = noisy_problem(np.random.default_rng(4))
    problem = problem_of(matrix, rhs)
    found = hx.estimate(problem, hx.TotalLeastSquares(exact=("x0", "x1", "x2", "x3")))
    expected = hx.estimate(problem, hx.LeastSquares())
    np.testing.assert_allclose(found.values, expected.values, rtol=1e-10)
    np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-10)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-8)


class TestExactColumns:
    @pytest.mark.parametrize(
        ("target", "exact"),
        [
            (lambda sets: FixedDirection(sets["direction"]).linear(), ("base_point",)),
            (lambda sets: FixedDirection(sets["direction"]).linear("consecutive"), ()),
            (lambda sets: FixedLeg(sets["leg"]).linear(), ("fixed_point",)),
            (lambda sets: FixedLeg(sets["leg"]).linear("centred"), ()),
            (lambda sets: FixedLength(sets["length"]).linear(), ("sphere",)),
            (lambda sets: LegLength(sets["leg"], unknown=("offset",)).linear(), ("offset",)),
            (
                lambda sets: hx.join(FixedDirection(sets["direction"]), FixedLeg(sets["leg"])),
                ("base_point", "fixed_point"),
            ),
            (
                lambda sets: hx.join(FixedDirection(sets["direction"]), FixedDirection(sets["other"])),
                ("base_point",),
            ),
            (lambda sets: hx.join(FixedLength(sets["length"]), FixedLength(sets["longer"])), ("sphere.1", "sphere.2")),
        ],
    )
    def test_they_are_told_from_the_numbers(self, left_hand, paper_noise, target, exact):
        locks = {"direction": 0, "leg": 1, "length": 2}
        sets = {k: hx.simulate_leg(left_hand, 3, k, 8, 3, noise=paper_noise, rng=s) for k, s in locks.items()}
        sets["other"] = hx.simulate_leg(left_hand, 3, "direction", 5, 3, noise=paper_noise, rng=3)
        sets["longer"] = hx.simulate_leg(left_hand, 3, "length", 6, 3, noise=paper_noise, rng=4)
        problem = target(sets)
        found = hx.estimate(problem, hx.TotalLeastSquares())
        np.testing.assert_array_equal(found.values, hx.estimate(problem, hx.TotalLeastSquares(exact=exact)).values)
        others = tuple(name for name in problem.parameters.names if name not in exact)
        if others:
            changed = hx.estimate(problem, hx.TotalLeastSquares(exact=others)).values
            assert (np.abs(changed - found.values).max(axis=-1) > 1e-9).all()

    def test_an_unknown_name(self, left_hand):
        problem = FixedLeg(hx.simulate_leg(left_hand, 3, "leg", 5, rng=0)).linear()
        with pytest.raises(InputError, match="unknown parameter 'base_point'; this problem has platform_point"):
            hx.estimate(problem, hx.TotalLeastSquares(exact=("base_point",)))

    @pytest.mark.parametrize("exact", ["base_point", [1, 2]])
    def test_no_names(self, exact):
        with pytest.raises(InputError, match="exact: expected names of blocks"):
            hx.TotalLeastSquares(exact=exact)

    def test_a_list_is_a_value_too(self):
        assert hx.TotalLeastSquares(exact=["a", "b"]) == hx.TotalLeastSquares(exact=("a", "b"))


@pytest.mark.parametrize(
    ("loop", "names"),
    [
        (FixedDirection, ("platform_point", "base_point")),
        (FixedLeg, ("platform_point",)),
        (FixedLength, ("base_point",)),
    ],
)
@pytest.mark.parametrize("form", ["direct", "consecutive"])
def test_the_covariance_is_that_of_the_errors(left_hand, small_noise, loop, names, form):
    data = hx.simulate_leg(left_hand, 3, loop.locks[0], 10, 2000, noise=small_noise, rng=0)
    found = hx.estimate(loop(data).linear(form), hx.TotalLeastSquares())
    assert found.covariance_kind == "sandwich"
    error = np.concatenate([found.params[k] - left_hand.leg(3).block(k) for k in names], axis=-1)
    inverse = np.linalg.inv(found.covariance_of(*names))
    square = np.einsum("ni,nij,nj->n", error, inverse, error) / error.shape[-1]
    assert abs(square.mean() - 1) < 5 * square.std() / np.sqrt(square.size)


def test_the_covariance_and_the_bias_where_errors_in_the_matrix_count():
    """Equal errors in all entries, as it assumes: unbiased, with its covariance; least squares is shrunk."""
    rng, truth, sigma, sets = np.random.default_rng(5), np.array([1.0, -2.0]), 0.1, 4000
    clean = rng.normal(size=(40, 2))
    matrix = clean + sigma * rng.normal(size=(sets, 40, 2))
    rhs = clean @ truth + sigma * rng.normal(size=(sets, 40))
    found = hx.estimate(problem_of(matrix, rhs), hx.TotalLeastSquares(exact=()))
    assert found.covariance_kind == "residual"
    error = found.values - truth
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(found.covariance), error) / 2
    assert square.mean() == pytest.approx(38 / 36, rel=0.1)  # an F distribution, and first-order statistics
    plain = hx.estimate(problem_of(matrix, rhs), hx.LeastSquares()).values - truth
    spread = error.std(axis=0) / np.sqrt(sets)
    assert (np.abs(error.mean(axis=0)) < 0.1 * np.abs(plain.mean(axis=0))).all()
    assert (np.abs(plain.mean(axis=0)) > 10 * spread).all()


def test_an_empty_batch(left_hand):
    problem = FixedLeg(hx.simulate_leg(left_hand, 3, "leg", 5, 4, rng=0)[[]]).linear()
    assert hx.estimate(problem, hx.TotalLeastSquares()).values.shape == (0, 6)


@pytest.mark.parametrize("exact", [3, "base_point", [1]])
def test_exact_takes_names(exact):
    with pytest.raises(InputError, match="exact: expected names of blocks"):
        hx.TotalLeastSquares(exact=exact)


class TestNoSolution:
    #: The least singular value of [A y] belongs to A alone: its right singular vector has no part of y.
    MATRIX, RHS = ((1.0, 0.0), (0.0, 0.1), (0.0, 0.0)), (1.0, 0.0, 1.0)

    def test_it_is_said(self):
        problem = problem_of(self.MATRIX, self.RHS)
        found = hx.estimate(problem, hx.TotalLeastSquares(exact=()), throw=False)
        assert found.status is hx.Status.FAILED
        assert np.isnan(found.values).all()
        with pytest.raises(EstimationError, match="TotalLeastSquares: ended with status FAILED"):
            hx.estimate(problem, hx.TotalLeastSquares(exact=()))
        assert hx.estimate(problem, hx.LeastSquares()).ok  # the rows do determine x

    def test_equal_singular_values(self):
        found = hx.estimate(problem_of([[1.0], [0.0]], [0.0, 1.0]), hx.TotalLeastSquares(exact=()), throw=False)
        assert found.status is hx.Status.FAILED

    def test_it_fails_alone(self):
        matrix, rhs = np.array([self.MATRIX] * 3), np.array([self.RHS] * 3)
        rhs[[0, 2]] = [1.0, 0.1, 0.01]
        found = hx.estimate(problem_of(matrix, rhs), hx.TotalLeastSquares(exact=()))
        assert found.ok.tolist() == [True, False, True]
        assert np.isfinite(found.objective).tolist() == np.isfinite(found.gap).tolist() == [True, False, True]
        alone = hx.estimate(problem_of(matrix[0], rhs[0]), hx.TotalLeastSquares(exact=()))
        np.testing.assert_allclose(found.values[2], alone.values, rtol=1e-12)


class TestRank:
    def test_what_is_unseen_is_named(self):
        rng = np.random.default_rng(0)
        matrix = np.repeat(rng.normal(size=(8, 1)), 2, axis=1)
        with pytest.raises(RankDeficientError) as caught:
            hx.estimate(problem_of(matrix, rng.normal(size=8)), hx.TotalLeastSquares())
        assert caught.value.combinations == ("x0 − x1",)

    def test_too_few_poses(self, left_hand):
        problem = FixedLeg(hx.simulate_leg(left_hand, 3, "leg", 1, rng=0)).linear()
        with pytest.raises(RankDeficientError, match=r"3 equations for 6 unknowns.*at least 3 poses"):
            hx.estimate(problem, hx.TotalLeastSquares(), throw=False)

    def test_as_many_rows_as_unknowns_hold_as_they_are(self):
        matrix, rhs = noisy_problem(np.random.default_rng(6), rows=4)
        found = hx.estimate(problem_of(matrix, rhs), hx.TotalLeastSquares(exact=("x0",)))
        np.testing.assert_allclose(found.values, np.linalg.solve(matrix, rhs[..., None])[..., 0], rtol=1e-9)
        assert found.covariance is None


class TestContract:
    def test_it_depends_on_scales_and_on_the_platform_frame(self):
        check_estimator(hx.TotalLeastSquares(), tolerance=1e-5, claims=("exact", "order", "rank"))
        for claim in ("scale", "frame"):
            with pytest.raises(AssertionError, match=f"breaks '{claim}'"):
                check_estimator(hx.TotalLeastSquares(), tolerance=1e-5, claims=(claim,))

    def test_with_exact_columns_alone_it_depends_on_nothing(self):
        estimator = hx.TotalLeastSquares(exact=("platform_point", "fixed_point"))
        check_estimator(estimator, lambda data: FixedLeg(data).linear(), lock="leg", tolerance=1e-5, claims=CLAIMS)
