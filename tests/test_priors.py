"""Priors: their rows against the formula, what they refuse, and the estimates that they make."""

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError, UnitError

PARAMETERS = hx.Parameters(
    (hx.Block("platform_point", 3, "cm"), hx.Block("base_point", 3, "cm"), hx.Block("offset", 1, "cm"))
)
MATRIX = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 0.5]])
LOOPS = {"leg": hx.loops.FixedLeg, "direction": hx.loops.FixedDirection}
SIGMA = 0.01


def measured(lock, n, n_sets=None, rng=0):
    noise = hx.UniformNoise(SIGMA, np.deg2rad(0.01), SIGMA)
    return hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=noise, rng=rng)


def problem_of(lock, n, n_sets=None, rng=0):
    return LOOPS[lock](measured(lock, n, n_sets, rng)).linear("direct")


def nominal():
    return hx.robots.left_hand().leg(3)


def plain(n_rows=12, seed=0):
    """A problem in σ with three unknown points and an offset, and its matrix and right-hand side."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n_rows, 7))
    rhs = rng.normal(size=n_rows)
    return hx.LinearProblem(matrix, rhs, PARAMETERS)


def value(prior, x, parameters=PARAMETERS):
    """The prior's loss at x, by its rows."""
    total = 0.0
    for rows in prior.rows(parameters):
        residual = (rows.matrix @ x[..., None])[..., 0] - rows.rhs
        blocks = residual.reshape(*residual.shape[:-1], residual.shape[-1] // rows.size, rows.size)
        total = total + rows.loss.total(blocks)
    return total


# --- rows ---------------------------------------------------------------------------------------------------

X = np.random.default_rng(1).normal(size=7)
MEAN = np.random.default_rng(2).normal(size=7)
NAMED = {"platform_point": MEAN[:3], "base_point": MEAN[3:6], "offset": MEAN[6]}
D = X - MEAN
JOINT = np.cov(np.random.default_rng(3).normal(size=(7, 20)))


@pytest.mark.parametrize(
    ("covariance", "expected"),
    [
        (
            {"platform_point": 0.25, "base_point": 4.0, "offset": 0.01},
            0.5 * (D[:3] @ D[:3] / 0.25 + D[3:6] @ D[3:6] / 4 + D[6] ** 2 / 0.01),
        ),
        (
            {"platform_point": MATRIX, "base_point": 2 * MATRIX, "offset": [[0.01]]},
            0.5
            * (D[:3] @ np.linalg.solve(MATRIX, D[:3]) + D[3:6] @ np.linalg.solve(2 * MATRIX, D[3:6]) + 100 * D[6] ** 2),
        ),
        (
            {"offset": 0.01, "base_point": 4.0, "platform_point": MATRIX},
            0.5 * (D[:3] @ np.linalg.solve(MATRIX, D[:3]) + D[3:6] @ D[3:6] / 4 + 100 * D[6] ** 2),
        ),
        (JOINT, 0.5 * D @ np.linalg.solve(JOINT, D)),
    ],
    ids=["variances", "matrices", "mixed, in another order", "joint"],
)
def test_rows_are_the_formula(covariance, expected):
    """½‖rows‖² = ½(x − μ)'Λ⁻¹(x − μ)."""
    np.testing.assert_allclose(value(hx.GaussianPrior(NAMED, covariance), X), expected, rtol=1e-12)


def test_the_joint_covariance_is_in_the_order_of_the_mean():
    """Whatever the order of the parameters."""
    order = [6, 3, 4, 5]
    joint = JOINT[np.ix_(order, order)]
    prior = hx.GaussianPrior({"offset": MEAN[6], "base_point": MEAN[3:6]}, joint)
    np.testing.assert_allclose(value(prior, X), 0.5 * D[order] @ np.linalg.solve(joint, D[order]), rtol=1e-12)


def test_a_batch_of_means_and_of_covariances():
    means = np.random.default_rng(4).normal(size=(5, 3))
    scales = np.linspace(1, 3, 5)
    for covariance in (MATRIX, scales[:, None, None] * MATRIX):
        prior = hx.GaussianPrior({"base_point": means, "offset": MEAN[6]}, {"base_point": covariance, "offset": 0.01})
        x = np.broadcast_to(X, (5, 7))
        apart = X[3:6] - means
        inverse = np.linalg.inv(np.broadcast_to(covariance, (5, 3, 3)))
        expected = 0.5 * (np.einsum("bi,bij,bj->b", apart, inverse, apart) + 100 * D[6] ** 2)
        np.testing.assert_allclose(value(prior, x), expected, rtol=1e-12)
        np.testing.assert_allclose(prior.centre(PARAMETERS)[:, 3:6], means)
        assert np.isnan(prior.centre(PARAMETERS)[:, :3]).all()


def test_a_batch_of_offsets():
    offsets = np.array([1.0, 2.0, 3.0, 4.0])
    prior = hx.GaussianPrior({"offset": offsets}, {"offset": 0.25})
    expected = 0.5 * np.square(X[6] - offsets) / 0.25
    np.testing.assert_allclose(value(prior, np.broadcast_to(X, (4, 7))), expected, rtol=1e-12)


def test_ridge_is_a_normal_prior_of_variance_one_over_its_strength():
    ridge = hx.Ridge(NAMED, 4.0)
    normal = hx.GaussianPrior(NAMED, np.eye(7) / 4.0)
    np.testing.assert_allclose(value(ridge, X), 2.0 * D @ D, rtol=1e-13)
    np.testing.assert_allclose(value(normal, X), 2.0 * D @ D, rtol=1e-13)


def test_lasso_sums_lengths_or_entries():
    lengths = np.linalg.norm(D[:3]) + np.linalg.norm(D[3:6]) + abs(D[6])
    np.testing.assert_allclose(value(hx.Lasso(NAMED, 3.0), X), 3 * lengths, rtol=1e-13)
    np.testing.assert_allclose(value(hx.Lasso(NAMED, 3.0, by="entry"), X), 3 * np.abs(D).sum(), rtol=1e-13)


@pytest.mark.parametrize(
    "prior",
    [
        hx.GaussianPrior({"offset": 15.25}, {"offset": 0.01}),
        hx.Ridge({"offset": 15.25}, 1),
        hx.Lasso({"offset": 15.25}, 1),
    ],
    ids=lambda prior: type(prior).__name__,
)
def test_a_scalar_block_takes_a_number(prior):
    (rows,) = prior.rows(PARAMETERS)
    assert rows.matrix.shape == (1, 7)
    assert rows.rhs.shape == (1,)
    np.testing.assert_array_equal(np.isfinite(prior.centre(PARAMETERS)), np.arange(7) == 6)
    assert prior.centre(PARAMETERS)[6] == 15.25


@pytest.mark.parametrize("kind", [hx.GaussianPrior, hx.Ridge, hx.Lasso])
def test_around_a_leg_or_several(kind):
    robot = hx.robots.left_hand()
    one = kind.around(robot.leg(3), 0.1)
    assert one.unit == "cm"
    assert one.if_present
    assert set(one.mean) == {"platform_point", "base_point"}
    np.testing.assert_array_equal(one.mean["base_point"], robot.leg(3).base_point)
    several = kind.around([robot.leg(3), robot.leg(5)], 0.1)
    assert set(several.mean) == {f"leg{i}.{name}" for i in (3, 5) for name in ("platform_point", "base_point")}
    np.testing.assert_array_equal(several.mean["leg5.base_point"], robot.leg(5).base_point)
    assert kind.around((robot.leg(i) for i in (3, 5)), 0.1) == several


def test_tolerances_by_name():
    prior = hx.GaussianPrior.around(nominal(), {"base_point": 0.2})
    assert prior == hx.GaussianPrior(
        {"base_point": nominal().base_point}, {"base_point": 0.2**2}, unit="cm", if_present=True
    )
    with pytest.raises(
        InputError, match=r"GaussianPrior.around: unknown point 'leg3.base_point'; there are platform_p"
    ):
        hx.GaussianPrior.around(nominal(), {"leg3.base_point": 0.2})


@pytest.mark.parametrize("tolerance", [[0.1, 0.1, 0.2], {"base_point": [0.1, 0.1, 0.2]}], ids=["one", "by name"])
def test_a_tolerance_for_each_entry(tolerance):
    """As the radius of `Box.around`, and as its docstring says: each entry ± tolerance."""
    (rows,) = hx.GaussianPrior.around(nominal(), tolerance).rows(PARAMETERS)
    np.testing.assert_allclose(rows.matrix[-3:, 3:6], np.diag([10.0, 10.0, 5.0]))


@pytest.mark.parametrize("kind", [hx.GaussianPrior, hx.Ridge, hx.Lasso])
@pytest.mark.parametrize("wrong", [[], [3], "leg", 5])
def test_around_takes_legs_only(kind, wrong):
    with pytest.raises(InputError, match=rf"{kind.__name__}.around: expected a Leg, or a list of legs"):
        kind.around(wrong, 0.1)


# --- what is refused ----------------------------------------------------------------------------------------

PRIORS = {
    "GaussianPrior": lambda mean, **kw: hx.GaussianPrior(mean, dict.fromkeys(mean, 0.01), **kw),
    "Ridge": lambda mean, **kw: hx.Ridge(mean, 1.0, **kw),
    "Lasso": lambda mean, **kw: hx.Lasso(mean, 1.0, **kw),
}


@pytest.mark.parametrize("kind", PRIORS)
class TestNames:
    def test_an_unknown_name_is_an_error_that_lists_the_known_ones(self, kind):
        prior = PRIORS[kind]({"bace_point": [1, 2, 3]})
        with pytest.raises(
            InputError, match=rf"{kind}: unknown parameter 'bace_point'.*platform_point, base_point, offset"
        ):
            prior.rows(PARAMETERS)

    def test_absent_names_are_left_out_if_asked_for_but_not_all(self, kind):
        mean = {"gain": 1.0, "offset": 2.0}
        (rows,) = PRIORS[kind](mean, if_present=True).rows(PARAMETERS)
        assert rows.matrix.shape == (1, 7)
        with pytest.raises(InputError, match="unknown parameter 'gain'"):
            PRIORS[kind](mean).rows(PARAMETERS)
        with pytest.raises(InputError, match="unknown parameter 'gain'"):
            PRIORS[kind]({"gain": 1.0}, if_present=True).rows(PARAMETERS)

    def test_another_unit_is_an_error(self, kind):
        prior = PRIORS[kind]({"base_point": [1, 2, 3]}, unit="mm")
        with pytest.raises(UnitError, match=rf"{kind} of base_point is in mm, the problem in cm"):
            prior.rows(PARAMETERS)
        direction = hx.Parameters((hx.Block("direction", 3, "1"),))
        assert PRIORS[kind]({"direction": [1, 2, 3]}, unit="mm").rows(direction)

    def test_a_wrong_number_of_values_names_the_entries(self, kind):
        with pytest.raises(InputError, match=r"base_point: expected 3 values \(base_point.x, base_point.y"):
            PRIORS[kind]({"base_point": [1, 2]}).rows(PARAMETERS)

    @pytest.mark.parametrize("mean", [{"base_point": [1, 2, np.nan]}, {"base_point": ["a", 1, 2]}], ids=["NaN", "text"])
    def test_what_is_no_number_is_refused(self, kind, mean):
        with pytest.raises(InputError, match="base_point"):
            PRIORS[kind](mean)


@pytest.mark.parametrize("wrong", [{}, [1, 2, 3], None, {3: [1, 2, 3]}], ids=repr)
def test_the_mean_is_by_name(wrong):
    for make in (lambda: hx.GaussianPrior(wrong, {}), lambda: hx.Ridge(wrong, 1.0), lambda: hx.Lasso(wrong, 1.0)):
        with pytest.raises(InputError, match="mean is given by parameter name, such as"):
            make()


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        ({"base_point": [[1, 0, 1], [0, 1, 0], [0, 0, 1]]}, "covariance of base_point: the matrix is not symmetric"),
        ({"base_point": np.diag([1, 1, -1])}, "expected a positive definite matrix, its smallest eigenvalue is -1"),
        ({"base_point": np.diag([1, 1, 0])}, r"its smallest eigenvalue is 0; to fix a parameter use bounds=Linear"),
        ({"base_point": np.ones((3, 3))}, "expected a positive definite matrix"),
        ({"base_point": 0.0}, "expected a positive definite matrix"),
        ({"base_point": -1.0}, "expected a positive definite matrix"),
        ({"base_point": [1, 1, 1]}, r"expected a variance or a matrix, got shape \(3,\); write np.diag"),
        ({"base_point": np.ones((3, 2))}, r"expected a square matrix, got shape \(3, 2\)"),
        ({"base_point": np.nan}, "covariance of base_point"),
        ({"offset": 1.0}, "mean names base_point; covariance offset"),
        ({}, "mean names base_point; covariance"),
        (np.diag([1, 1, 0.0]), "expected a positive definite matrix"),
        ([[1, 2], [3, 4]], "covariance: the matrix is not symmetric"),
        (np.ones((3, 2)), "expected a square matrix"),
        (1.0, r"covariance: expected shape \(..., q, q\)"),
        ([1.0, 1.0, 1.0], r"covariance: expected shape \(..., q, q\)"),
        ("a", "covariance: expected numbers"),
    ],
)
def test_a_wrong_covariance_is_refused_at_once(covariance, message):
    with pytest.raises(InputError, match=message):
        hx.GaussianPrior({"base_point": [1, 2, 3]}, covariance)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        ({"base_point": np.eye(2)}, r"covariance of base_point: expected 3 × 3, got shape \(2, 2\)"),
        (np.eye(4), r"covariance: expected 3 × 3 for base_point, got shape \(4, 4\)"),
    ],
)
def test_a_covariance_of_a_wrong_size_is_an_error(covariance, message):
    prior = hx.GaussianPrior({"base_point": [1, 2, 3]}, covariance)
    with pytest.raises(InputError, match=message):
        prior.rows(PARAMETERS)


def test_a_joint_covariance_needs_all_of_its_names():
    prior = hx.GaussianPrior({"base_point": [1, 2, 3], "gain": 1}, np.eye(4), if_present=True)
    with pytest.raises(InputError, match="covariance: expected 3 × 3 for base_point"):
        prior.rows(PARAMETERS)


@pytest.mark.parametrize("kind", [hx.Ridge, hx.Lasso])
@pytest.mark.parametrize(
    "strength",
    [
        0,
        -1.0,
        np.nan,
        np.inf,
        True,
        None,
        [1.0],
        "a",
        1j,
    ],
    ids=repr,
)
def test_a_wrong_strength_is_refused(kind, strength):
    with pytest.raises(InputError, match=f"{kind.__name__}: strength must be a number > 0"):
        kind({"offset": 1.0}, strength)


def test_by_is_joint_or_entry():
    with pytest.raises(InputError, match="Lasso: by is 'joint' or 'entry', got 'block'"):
        hx.Lasso({"offset": 1.0}, 1.0, by="block")


def test_the_estimator_takes_priors_only():
    with pytest.raises(InputError, match=r"prior: expected GaussianPrior"):
        hx.ConvexEstimator(prior={"offset": 1.0})
    with pytest.raises(InputError, match=r"bounds: expected Box"):
        hx.ConvexEstimator(bounds=hx.Ridge({"offset": 1.0}, 1.0))


def test_a_prior_needs_rows_in_standard_deviations():
    with pytest.raises(InputError, match="a prior is weighed against rows in σ"):
        hx.ConvexEstimator(prior=hx.Ridge({"offset": 1.0}, 1.0), weights=None)


def test_a_batch_of_means_must_fit_the_problem():
    prior = hx.Ridge({"platform_point": np.zeros((4, 3))}, 1.0)
    with pytest.raises(InputError, match=r"a prior or bound has a batch of \(4,\), the problem of \(3,\)"):
        hx.estimate(problem_of("leg", 5, 3), hx.ConvexEstimator(prior=prior))


# --- they are values ----------------------------------------------------------------------------------------

VALUES = [
    hx.GaussianPrior(NAMED, JOINT),
    hx.GaussianPrior({"base_point": [1, 2, 3]}, {"base_point": MATRIX}, unit="cm"),
    hx.GaussianPrior({"offset": 1.0}, {"offset": 0.01}, if_present=True),
    hx.Ridge(NAMED, 2.0, unit="mm"),
    hx.Lasso(NAMED, 2.0),
    hx.Lasso(NAMED, 2.0, by="entry"),
]


@pytest.mark.parametrize("prior", VALUES, ids=lambda prior: type(prior).__name__)
def test_a_prior_is_a_value(prior):
    assert pickle.loads(pickle.dumps(prior)) == prior
    assert eval(repr(prior), vars(hx) | {type(prior).__name__: type(prior)}) == prior
    with pytest.raises(FrozenInstanceError):
        prior.unit = "in"


def test_unequal_priors():
    for i, one in enumerate(VALUES):
        assert [one == other for other in VALUES].count(True) == 1, i
    assert hx.Ridge({"offset": 1.0}, 1.0) != hx.Ridge({"offset": 1.0}, 2.0)
    assert hx.Ridge({"offset": 1.0}, 1.0) != hx.Ridge({"offset": 2.0}, 1.0)
    assert hx.Ridge({"offset": 1.0}, 1.0) != "Ridge"


def test_a_prior_does_not_change_with_the_arrays_that_it_was_made_of():
    mean, covariance = np.zeros(3), np.eye(3)
    prior = hx.GaussianPrior({"base_point": mean}, {"base_point": covariance})
    mean[:] = 5
    covariance[:] = 5
    np.testing.assert_array_equal(prior.mean["base_point"], 0)
    np.testing.assert_array_equal(prior.covariance["base_point"], np.eye(3))
    with pytest.raises(ValueError, match="read-only"):
        prior.mean["base_point"][0] = 1


def test_a_long_prior_has_a_short_repr():
    assert "<array of shape (30, 3)>" in repr(hx.Ridge({"base_point": np.zeros((30, 3))}, 1.0))


# --- estimates ----------------------------------------------------------------------------------------------


def by_hand(matrix, rhs, mean, covariance, where):
    """The augmented normal equations: answer and posterior covariance."""
    pick = np.eye(matrix.shape[-1])[where]
    precision = pick.T @ np.linalg.inv(covariance) @ pick
    hessian = matrix.T @ matrix + precision
    return np.linalg.solve(hessian, matrix.T @ rhs + precision[:, where] @ mean), np.linalg.inv(hessian)


@pytest.mark.parametrize("backend", ["auto", "batched", "clarabel"])
def test_the_estimate_solves_the_augmented_normal_equations(backend):
    """As does the posterior covariance."""
    problem = plain()
    prior = hx.GaussianPrior(NAMED, JOINT)
    found = hx.estimate(problem, hx.ConvexEstimator(prior=prior, weights=None, scale=0.5, backend=backend))
    expected, covariance = by_hand(problem.matrix / 0.5, problem.rhs / 0.5, MEAN, JOINT, slice(0, 7))
    np.testing.assert_allclose(found.values, expected, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-9)
    assert found.covariance_kind == "posterior"
    residual = (problem.matrix @ expected - problem.rhs) / 0.5
    apart = expected - MEAN
    chi2 = residual @ residual + apart @ np.linalg.solve(JOINT, apart)
    np.testing.assert_allclose(found.objective, 0.5 * chi2, rtol=1e-10)
    np.testing.assert_allclose(found.chi2, chi2, rtol=1e-10)
    assert found.degrees_of_freedom == 12
    assert found.gap <= 1e-10


def test_whitened_rows_and_a_batch_of_means():
    """With weights="model" the rows are whitened about the unweighted answer; every member has its own mean."""
    problem = problem_of("leg", 6, 4)
    b = nominal().platform_point + np.random.default_rng(0).normal(size=(4, 3)) * 0.1
    prior = hx.GaussianPrior({"platform_point": b}, {"platform_point": 0.02**2 * MATRIX})
    found = hx.estimate(problem, hx.ConvexEstimator(prior=prior))
    matrix, rhs = problem.whitened()
    for i in range(4):
        expected, covariance = by_hand(matrix[i], rhs[i], b[i], 0.02**2 * MATRIX, slice(0, 3))
        np.testing.assert_allclose(found.values[i], expected, atol=1e-9)
        np.testing.assert_allclose(found.covariance[i], covariance, rtol=1e-8, atol=1e-15)
    assert found.decided == ()


def test_ridge_is_the_normal_prior():
    problem = problem_of("direction", 6, 3)
    ridge = hx.estimate(problem, hx.ConvexEstimator(prior=hx.Ridge.around(nominal(), 25.0)))
    normal = hx.estimate(problem, hx.ConvexEstimator(prior=hx.GaussianPrior.around(nominal(), 0.2)))
    np.testing.assert_allclose(ridge.values, normal.values, atol=1e-10)
    np.testing.assert_allclose(ridge.covariance, normal.covariance, rtol=1e-9)
    assert ridge.covariance_kind == normal.covariance_kind == "posterior"


def test_two_priors_multiply():
    """Two halves of the precision are the whole."""
    problem = plain()
    whole = hx.GaussianPrior(NAMED, JOINT)
    half = hx.GaussianPrior(NAMED, 2 * JOINT)
    one, two = (
        hx.estimate(problem, hx.ConvexEstimator(prior=prior, weights=None, scale=1.0))
        for prior in (whole, [half, half])
    )
    np.testing.assert_allclose(one.values, two.values, atol=1e-11)
    np.testing.assert_allclose(one.covariance, two.covariance, atol=1e-11)
    assert {"rows", "prior", "prior.2"} == set(two.duals)


def test_a_vague_prior_changes_nothing_and_a_sharp_one_everything():
    problem = problem_of("leg", 8)
    free = hx.estimate(problem, hx.LeastSquares(weights="model"))
    b = nominal().platform_point + 0.3
    for tolerance, expected in ((1e4, free.values[:3]), (1e-7, b)):
        prior = hx.GaussianPrior({"platform_point": b}, {"platform_point": tolerance**2})
        found = hx.estimate(problem, hx.ConvexEstimator(prior=prior))
        np.testing.assert_allclose(found.values[:3], expected, atol=1e-8)


@pytest.mark.parametrize("loss", [hx.Huber(), hx.GroupHuber()], ids=repr)
def test_an_outlier_pulls_less_on_a_robust_loss_with_a_prior(loss):
    """The force of the prior is ψ of its rows."""
    problem = problem_of("leg", 10, rng=3)
    bad = problem.rhs.copy()
    bad[3:6] += 5.0
    problem = hx.LinearProblem(
        problem.matrix, bad, problem.parameters, problem.rows_per_block, problem.form, problem.noise, problem.at
    )
    prior = hx.GaussianPrior({"platform_point": nominal().platform_point}, {"platform_point": 0.05**2})
    found = hx.estimate(problem, hx.ConvexEstimator(loss, prior=prior))
    normal = hx.estimate(problem, hx.ConvexEstimator(prior=prior))
    apart = (np.abs(one.values[:3] - nominal().platform_point).max() for one in (found, normal))
    assert next(apart) < 0.2 * next(apart)
    assert found.covariance_kind == "posterior"
    (rows,) = prior.rows(problem.parameters)
    np.testing.assert_allclose(rows.matrix @ found.values - rows.rhs, found.duals["prior"], atol=1e-9)


# --- fewer poses than unknowns ------------------------------------------------------------------------------


@pytest.mark.parametrize(("lock", "n"), [("leg", 1), ("leg", 2), ("direction", 1), ("direction", 2)])
@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.Huber(), hx.GroupHuber()], ids=repr)
def test_a_prior_decides_what_too_few_poses_do_not_see(lock, n, loss):
    """The estimate says so, and names the combinations."""
    problem = problem_of(lock, n)
    found = hx.estimate(problem, hx.ConvexEstimator(loss, prior=hx.GaussianPrior.around(nominal(), 0.1)))
    assert found.status is hx.Status.OPTIMAL
    assert found.unseen == ()
    rank = np.linalg.matrix_rank(problem.matrix)
    assert len(found.decided) == problem.parameters.size - rank
    assert all(any(name in one for name in problem.parameters.names) for one in found.decided)
    text = found.summary()
    for one in found.decided:
        assert f"decided by the prior or bounds, not by the measurements: {one}" in text
    points = found.values[: 6 if lock == "direction" else 3]
    expected = np.concatenate([nominal().platform_point, nominal().base_point])[: len(points)]
    assert np.abs(points - expected).max() < 0.4
    assert np.isfinite(found.standard_errors).all()
    assert (found.standard_errors[: len(points)] <= 0.1 + 1e-9).all()


@pytest.mark.parametrize(("lock", "n"), [("leg", 1), ("leg", 2), ("direction", 1), ("direction", 2)])
@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.Huber(), hx.GroupHuber(), hx.L1(), hx.Chebyshev()], ids=repr)
def test_without_a_prior_too_few_poses_are_an_error(lock, n, loss):
    with pytest.raises(RankDeficientError):
        hx.estimate(problem_of(lock, n), hx.ConvexEstimator(loss))


def test_enough_poses_decide_by_themselves():
    found = hx.estimate(problem_of("leg", 6), hx.ConvexEstimator(prior=hx.GaussianPrior.around(nominal(), 0.1)))
    assert found.decided == ()
    assert "decided" not in found.summary()


def test_a_prior_of_too_few_parameters_leaves_the_rest_unseen():
    """One pose sees three combinations of six; a prior of the height alone decides one more."""
    prior = hx.GaussianPrior({"base_point": nominal().base_point}, {"base_point": 0.1**2})
    problem = problem_of("direction", 1)
    with pytest.raises(RankDeficientError, match="platform_point"):
        hx.estimate(problem, hx.ConvexEstimator(prior=prior))
    found = hx.estimate(problem, hx.ConvexEstimator(prior=prior), throw=False)
    assert found.unseen
    assert np.isnan(found.values).all()


def test_only_the_members_that_need_it_are_decided_by_the_prior():
    """The second set of poses does not turn."""
    good = problem_of("leg", 4, 2)
    matrix = np.array(good.matrix)
    matrix[1] = np.tile(matrix[1, :3], (4, 1))
    problem = hx.LinearProblem(matrix, good.rhs, good.parameters, 3, good.form, good.noise)
    found = hx.estimate(
        problem,
        hx.ConvexEstimator(
            prior=hx.Ridge({"platform_point": nominal().platform_point}, 100.0), scale=0.01, weights=None
        ),
    )
    assert found.ok.all()
    assert len(found.decided) == 3


def test_a_member_of_a_batch_is_not_called_decided_for_another():
    good = problem_of("leg", 4, 2)
    matrix = np.array(good.matrix)
    matrix[1] = np.tile(matrix[1, :3], (4, 1))
    problem = hx.LinearProblem(matrix, good.rhs, good.parameters, 3, good.form, good.noise)
    prior = hx.Ridge({"platform_point": nominal().platform_point}, 100.0)
    found = hx.estimate(problem, hx.ConvexEstimator(prior=prior, scale=0.01, weights=None))
    assert found[0].decided == ()


# --- lasso --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["joint", "entry"])
def test_a_strong_lasso_gives_the_nominal_and_a_weak_one_nothing(by):
    problem = problem_of("direction", 8)
    free = hx.estimate(problem, hx.ConvexEstimator())
    strong = hx.estimate(problem, hx.ConvexEstimator(prior=hx.Lasso.around(nominal(), 1e6, by=by)))
    np.testing.assert_allclose(strong.params["platform_point"], nominal().platform_point, atol=1e-7)
    np.testing.assert_allclose(strong.params["base_point"], nominal().base_point, atol=1e-7)
    weak = hx.estimate(problem, hx.ConvexEstimator(prior=hx.Lasso.around(nominal(), 1e-4, by=by)))
    assert (np.abs(weak.values - free.values) / free.standard_errors).max() < 1e-3
    for found in (strong, weak):
        assert found.gap <= 1e-8 * (1 + found.objective)
        assert found.covariance is None
        assert found.covariance_kind == "a lasso is biased by design, and has no standard errors"
        with pytest.raises(InputError, match="there is no covariance: a lasso is biased by design"):
            _ = found.standard_errors


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("by", ["joint", "entry"])
def test_only_what_moved_leaves_the_nominal(by):
    """The base joint is 2 away in x, in units in which a row has the variance 1; nothing else has moved."""
    rng = np.random.default_rng(11)
    matrix = rng.normal(size=(8, 60, 7))
    rhs = matrix @ (MEAN + 2.0 * np.eye(7)[3]) + rng.normal(size=(8, 60))
    problem = hx.LinearProblem(matrix, rhs, PARAMETERS)
    found = hx.estimate(problem, hx.ConvexEstimator(prior=hx.Lasso(NAMED, 40.0, by=by), weights=None, scale=1.0))
    assert found.ok.all()
    apart = found.values - MEAN
    assert (apart[:, 3] > 0.5).all()
    still = [0, 1, 2, 6] if by == "joint" else [0, 1, 2, 4, 5, 6]
    np.testing.assert_allclose(apart[:, still], 0, atol=1e-7)
    force = np.abs(found.duals["prior"])  # of the platform joint
    assert (np.linalg.norm(force, axis=-1) < 40).all() if by == "joint" else (force < 40).all()


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("strength", [10.0, 100.0, 300.0, 1e3])
def test_a_group_lasso_of_any_strength_is_proven(strength):
    """The nominal's base joint is 0.5 cm off; from no effect to complete rest."""
    moved = nominal().replaced(base_point=nominal().base_point - [0.5, 0, 0])
    lasso = hx.Lasso.around(moved, strength)
    assert hx.estimate(problem_of("direction", 30, 10), hx.ConvexEstimator(prior=lasso)).ok.all()


def test_a_lasso_is_soft_thresholding_of_orthonormal_rows():
    """min ½‖x − y‖² + λ‖x − μ‖ shrinks y − μ towards zero by λ."""
    parameters = hx.Parameters((hx.Block("a", 3, "cm"), hx.Block("b", 3, "cm")))
    y = np.array([3.0, -0.2, 0.8, 0.1, 0.2, -0.3])
    problem = hx.LinearProblem(np.eye(6), y, parameters)
    mean = {"a": [1.0, 0, 0], "b": [0, 0, 0]}
    apart = y - np.array([1.0, 0, 0, 0, 0, 0])
    entry, joint = (
        hx.estimate(problem, hx.ConvexEstimator(prior=hx.Lasso(mean, 0.5, by=by), weights=None, scale=1.0))
        for by in ("entry", "joint")
    )
    expected = np.sign(apart) * np.maximum(np.abs(apart) - 0.5, 0)
    np.testing.assert_allclose(entry.values - y + apart, expected, atol=1e-7)
    length = np.linalg.norm(apart[:3])
    expected = np.concatenate([apart[:3] * (1 - 0.5 / length), np.zeros(3)])
    np.testing.assert_allclose(joint.values - y + apart, expected, atol=1e-7)
    np.testing.assert_allclose(entry.duals["rows"], entry.values - y, atol=1e-7)
    assert (np.abs(entry.duals["prior"]) <= 0.5 + 1e-9).all()


def test_a_lasso_decides_at_its_kink_only():
    """One pose: a strong lasso holds the platform joint at the nominal, which makes the answer unique."""
    problem = problem_of("leg", 1)
    point = {"platform_point": nominal().platform_point}
    for by in ("joint", "entry"):
        found = hx.estimate(problem, hx.ConvexEstimator(prior=hx.Lasso(point, 1e3, by=by)))
        np.testing.assert_allclose(found.values[:3], nominal().platform_point, atol=1e-7)
        assert len(found.decided) == 3
