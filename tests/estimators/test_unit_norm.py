"""The unit-norm programme: global against a semidefinite relaxation and random starts, exact, and honest."""

from dataclasses import replace

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import minimize

import hexopt as hx
from hexopt.testing import check_estimator
from hexopt.testing.motions import unit_change

EPS = np.finfo(float).eps
BOTH = [hx.UnitNormLeastSquares(), hx.UnitNormLeastSquares(weights="model")]
MODEL = BOTH[1]


def problem_of(robot, n_poses, n_sets=None, noise=None, rng=0, leg=3):
    nominal = robot.perturbed(0.1, rng=0).leg(leg)  # lends the offset, which stays true
    data = hx.simulate_leg(robot, leg, "direction", n_poses, n_sets, noise, nominal=nominal, rng=rng)
    return hx.loops.FixedDirection(data).linear("direct")


def rows_of(problem, estimator):
    return (problem.matrix, problem.rhs) if estimator.weights is None else problem.whitened()


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
def test_contract(estimator):
    """All but another scale of the columns: the unit norm fixes that of the direction."""
    check_estimator(
        estimator,
        lambda data: hx.loops.FixedDirection(data).linear(),
        lock="direction",
        claims=("exact", "order", "frame", "rank"),
    )


def test_contract_of_the_fixed_point():
    check_estimator(
        hx.Reweighted(MODEL),
        lambda data: hx.loops.FixedDirection(data),
        lock="direction",
        claims=("exact", "order", "frame", "rank"),
        tolerance=1e-3,
    )


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
def test_another_length_unit(left_hand, small_noise, estimator):
    data = hx.simulate_leg(left_hand, 3, "direction", 8, 5, small_noise, nominal=left_hand.leg(3), rng=0)
    motion = unit_change("cm")
    found, moved = (estimator.fit(hx.loops.FixedDirection(d).linear()) for d in (data, motion.data(data)))
    for name in ("base_point", "platform_point"):
        np.testing.assert_allclose(moved.params[name], motion.block(name, found.params[name]), rtol=1e-10)
    np.testing.assert_allclose(moved.params["direction"], found.params["direction"], atol=1e-10)


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
@pytest.mark.parametrize("n_poses", range(4, 21))
def test_every_noisy_set_is_certified(left_hand, paper_noise, estimator, n_poses):
    found = hx.estimate(problem_of(left_hand, n_poses, 1000, paper_noise), estimator)
    assert found.ok.all()
    assert (found.gap >= 0).all()
    assert (found.gap <= 1e-9 * found.objective).all()
    assert np.abs(np.linalg.norm(found.params["direction"], axis=-1) - 1).max() < 1e-15 * 3


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
@pytest.mark.parametrize("n_poses", [4, 9])
def test_it_is_the_semidefinite_relaxation(left_hand, paper_noise, estimator, n_poses):
    """In all nine unknowns at once: min ½⟨Q, Z⟩, Z ⪰ 0 of size 10, its last entry 1 and the trace of its n part 1."""
    problem = problem_of(left_hand, n_poses, 3, paper_noise)
    found = hx.estimate(problem, estimator)
    for matrix, rhs, objective in zip(*rows_of(problem, estimator), found.objective, strict=True):
        rows = np.column_stack([matrix, -rhs])
        _, triangle = np.linalg.qr(rows)
        basis = np.linalg.inv(triangle[:6, :6])  # unknowns in which the relaxation is well scaled
        scaled = triangle @ np.block([[basis, np.zeros((6, 4))], [np.zeros((4, 6)), np.eye(4)]])
        scaled[:6, 6:] = 0.0  # b and a, shifted by what minimises over them
        size = np.abs(scaled[6:9, 6:9]).max()
        lifted = cp.Variable((10, 10), PSD=True)
        quadratic = scaled.T @ scaled / size**2
        held = [lifted[9, 9] == 1, cp.trace(lifted[6:9, 6:9]) == 1]
        relaxed = cp.Problem(cp.Minimize(0.5 * cp.trace(quadratic @ lifted)), held)
        relaxed.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
        assert relaxed.status == "optimal"
        assert abs(relaxed.value - objective / size**2) < 1e-7


def ends_of_random_starts(matrix, rhs, unit, count, rng):
    """Where sequential quadratic programming ends from random starts, and the objective over `unit` there."""

    def value(x):
        return 0.5 * np.sum((matrix @ x - rhs) ** 2) / unit

    def slope(x):
        return matrix.T @ (matrix @ x - rhs) / unit

    sphere = {"type": "eq", "fun": lambda x: x[6:] @ x[6:] - 1, "jac": lambda x: 2 * np.r_[np.zeros(6), x[6:]]}
    for _ in range(count):
        start = 10 * rng.standard_normal(9)
        start[6:] /= np.linalg.norm(start[6:])
        end = minimize(
            value, start, jac=slope, method="SLSQP", constraints=sphere, options={"maxiter": 500, "ftol": 1e-14}
        )
        if abs(end.x[6:] @ end.x[6:] - 1) < 1e-9:
            yield end.x, end.fun


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
def test_no_random_start_ends_lower(left_hand, estimator):
    """Errors so large that the sphere pulls: |λ| is a good share of the smallest curvature."""
    noise = hx.UniformNoise(position=1.0, angle=0.05, length=1.0)
    problem = problem_of(left_hand, 5, 3, noise, rng=3)
    found = hx.estimate(problem, estimator)
    assert found.ok.all()
    rng = np.random.default_rng(0)
    for matrix, rhs, values, objective in zip(*rows_of(problem, estimator), found.values, found.objective, strict=True):
        ends = list(ends_of_random_starts(matrix, rhs, objective, 100, rng))
        assert len(ends) >= 80
        assert min(fun for _, fun in ends) > 1 - 1e-8
        x, fun = min(ends, key=lambda end: end[1])
        assert fun < 1 + 1e-8
        np.testing.assert_allclose(x, values, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("n_poses", [3, 4, 7])
def test_exact_without_noise(robot, n_poses):
    for leg in range(1, 7):
        problem = problem_of(robot, n_poses, 50, rng=leg, leg=leg)
        found = hx.estimate(problem, BOTH[0])
        assert found.ok.all()
        error = np.max(list(found.error(robot.leg(leg)).values()), axis=0) / robot.size
        assert (error <= 100 * EPS * found.condition).all()


def test_covariance_is_that_of_restricted_least_squares(left_hand, paper_noise):
    """Against a tangent basis T written out, and A T by another solver; no error along n."""
    problem = problem_of(left_hand, 7, noise=paper_noise)
    found = hx.estimate(problem, MODEL)
    n = found.params["direction"]
    tangent = np.zeros((9, 8))
    tangent[:6, :6] = np.eye(6)
    tangent[6:, 6:] = np.linalg.svd(n[None])[2][1:].T
    matrix, _ = problem.whitened()
    inverse = np.linalg.pinv(matrix @ tangent)
    expected = tangent @ inverse @ inverse.T @ tangent.T
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-7, atol=1e-9 * expected.max())
    assert found.covariance_kind == "model"
    assert np.abs(found.covariance[6:, 6:] @ n).max() < 1e-12 * expected.max()
    raw = hx.estimate(problem, BOTH[0])
    gain = tangent @ np.linalg.pinv(problem.matrix @ tangent)
    gain = gain.reshape(9, 7, 3)
    sandwich = problem.noise.covariance(found.values).propagated(gain)
    assert raw.covariance_kind == "sandwich"
    np.testing.assert_allclose(raw.covariance, sandwich, rtol=0.05, atol=0.01 * sandwich.max())


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
def test_influence_is_the_derivative_by_the_rows(left_hand, small_noise, estimator, central_difference):
    """Exactly so where the rows are without error; there the multiplier is zero."""
    exact = problem_of(left_hand, 6)
    exact = replace(
        exact, noise=problem_of(left_hand, 6, noise=small_noise).noise, at=hx.LeastSquares().fit(exact).values
    )
    found = hx.estimate(exact, estimator)
    derivative = central_difference(lambda y: estimator.fit(replace(exact, rhs=y)).values, exact.rhs, 1e-4)
    np.testing.assert_allclose(found.influence.reshape(9, 18), derivative, atol=1e-6 * np.abs(derivative).max())


def test_the_errors_are_as_large_as_it_says(left_hand):
    """Mean of eᵀC⁺e over 4000 sets is the rank of C, 8; χ² has its degrees of freedom."""
    noise = hx.NormalNoise(1e-3, np.deg2rad(1e-3), 1e-3, coordinates="rotation_vector")
    problem = problem_of(left_hand, 7, 4000, noise)
    found = hx.estimate(problem, MODEL)
    assert found.degrees_of_freedom == 21 - 8
    assert abs(found.chi2.mean() - 13) < 4 * np.sqrt(2 * 13 / 4000)
    truth = left_hand.leg(3)
    main = np.concatenate([truth.platform_point, truth.base_point])
    error = found.values[:, :6] - main
    square = np.einsum("bi,bi->b", error, np.linalg.solve(found.covariance[:, :6, :6], error[..., None])[..., 0])
    assert abs(square.mean() - 6) < 4 * np.sqrt(2 * 6 / 4000)


def test_the_unit_norm_helps(left_hand, paper_noise):
    """Of seven poses, root mean square error of the base against the same weights without it."""
    problem = problem_of(left_hand, 7, 1000, paper_noise)
    truth = left_hand.leg(3)
    size = [
        np.sqrt(np.mean(hx.estimate(problem, one).error(truth)["base_point"] ** 2))
        for one in (MODEL, hx.LeastSquares(weights="model"))
    ]
    assert size[0] < 0.95 * size[1]


def test_the_unit_norm_takes_the_bias_away(left_hand):
    """Of errors in variables, at N = 50 and 0.5 cm and degrees: near 3 errors without it, with weights or not."""
    noise = hx.UniformNoise(position=0.5, angle=np.deg2rad(0.5), length=0.5)
    problem = problem_of(left_hand, 50, 2000, noise)
    truth = left_hand.leg(3).base_point

    def bias(estimator):
        return np.linalg.norm(hx.estimate(problem, estimator).params["base_point"].mean(axis=0) - truth) / 0.5

    assert bias(hx.LeastSquares(weights="model")) > 2.5
    for estimator in BOTH:
        assert bias(estimator) < 0.2


def test_residuals_stand_in_for_a_noise_model(left_hand, paper_noise):
    problem = replace(problem_of(left_hand, 9, 2000, paper_noise), noise=None)
    found = hx.estimate(problem, BOTH[0])
    assert found.covariance_kind == "residual"
    error = found.params["platform_point"] - left_hand.leg(3).platform_point
    spread = np.diagonal(found.covariance_of("platform_point"), axis1=1, axis2=2)
    ratio = np.mean(error**2, axis=0) / spread.mean(axis=0)
    assert (np.abs(np.log(ratio)) < np.log(1.5)).all()


@pytest.mark.parametrize("estimator", BOTH, ids=repr)
def test_one_bad_member_fails_alone(left_hand, paper_noise, estimator):
    good = problem_of(left_hand, 7, 3, paper_noise)
    matrix = good.matrix.copy()
    matrix[1, :, 2] = 0.0
    found = hx.estimate(replace(good, matrix=matrix), estimator)
    assert found.ok.tolist() == [True, False, True]
    assert found.unseen == ("platform_point.z",)
    reference = hx.estimate(good, estimator)
    for name in ("values", "covariance", "influence"):
        part, expected = getattr(found, name), getattr(reference, name)
        assert np.isnan(part[1]).all()
        np.testing.assert_array_equal(part[[0, 2]], expected[[0, 2]])


def test_one_direction_of_several(left_hand, paper_noise):
    """Of two sets of a leg, joined, either direction may be held to the sphere; the other stays free."""
    problem = hx.join(*(problem_of(left_hand, 5, 4, paper_noise, rng=i) for i in range(2)))
    free = hx.estimate(problem, hx.LeastSquares(weights="model"))
    for held, other in (("direction.1", "direction.2"), ("direction.2", "direction.1")):
        found = hx.estimate(problem, hx.UnitNormLeastSquares(held, "model"))
        assert found.ok.all()
        np.testing.assert_allclose(np.linalg.norm(found.params[held], axis=-1), 1, rtol=1e-14)
        assert (np.abs(np.linalg.norm(found.params[other], axis=-1) - 1) > 1e-9).all()
        assert (found.objective > free.objective).all()


class TestSynthetic:
    """A direction alone, whose programme is plain to see."""

    names = hx.Parameters((hx.Block("direction", 3, "1"), hx.Block("base_point", 1, "cm")))

    def made(self, roots, rhs):
        matrix = np.zeros((4, 4))
        matrix[:3, :3], matrix[3, 3] = np.diag(roots), 1.0
        matrix[0, 3] = 0.5
        return hx.LinearProblem(matrix, np.array(rhs, dtype=float), self.names)

    def test_two_minimisers_are_no_answer(self):
        problem = self.made([0.0, 2.0, 3.0], [0.0, 1.0, 1.0, 0.0])
        matrix = problem.matrix.copy()
        matrix[0, 0] = 1.0
        problem = replace(problem, matrix=matrix)
        found = hx.estimate(problem, BOTH[0], throw=False)
        assert found.status is hx.Status.RANK_DEFICIENT
        assert np.isnan(found.values).all()
        with pytest.raises(hx.RankDeficientError, match=r"on which side the answer lies along direction.x − 0.4·base"):
            hx.estimate(problem, BOTH[0])

    def test_a_direction_that_points_nowhere(self):
        found = hx.estimate(self.made([1.0, 1.0, 1.0], np.zeros(4)), BOTH[0], throw=False)
        assert found.status is hx.Status.RANK_DEFICIENT

    def test_the_multiplier_pulls_the_direction_to_the_sphere(self):
        for factor in (0.5, 1.0, 2.0):
            found = hx.estimate(self.made([1.0, 1.0, 1.0], [0.6 * factor, 0.0, 0.8 * factor, 0.0]), BOTH[0])
            assert np.sign(np.round(found.duals["unit_norm"], 12)) == np.sign(factor - 1)

    def test_an_empty_batch(self):
        problem = self.made([1.0, 2.0, 3.0], [1.0, 1.0, 1.0, 0.0])
        none = replace(problem, matrix=np.empty((0, 4, 4)), rhs=np.empty((0, 4)), cancellation=np.ones(4))
        assert hx.estimate(none, BOTH[0]).values.shape == (0, 4)


class TestCertificate:
    def test_it_proves_the_answer_of_another_solver_and_no_worse_one(self, left_hand, paper_noise):
        problem = problem_of(left_hand, 7, 3, paper_noise)
        found = hx.estimate(problem, MODEL)
        assert MODEL.certificate(problem, found).ok.all()
        values = found.values.copy()
        values[0, 6:] = -values[0, 6:]
        values[1, 0] += 1e-3 * found.standard_errors[1, 0]
        values[2, 6:] *= 1 + 1e-9
        proof = MODEL.certificate(problem, replace(found, values=values))
        assert not proof.ok.any()
        matrix, rhs = problem.whitened()
        objective = 0.5 * np.sum((np.einsum("bmp,bp->bm", matrix, values) - rhs) ** 2, axis=1)
        assert (proof.gap[:2] >= (objective - found.objective)[:2]).all()
        assert proof.primal_residual[2] > 5e-10

    def test_it_asks_for_values_of_this_problem(self, left_hand, paper_noise):
        problem = problem_of(left_hand, 7, 3, paper_noise)
        found = hx.estimate(problem, MODEL)
        with pytest.raises(hx.InputError, match=r"\(9,\) values are no answer to \(3,\) problems"):
            MODEL.certificate(problem, found[0])


class TestReweighted:
    def test_it_is_the_fixed_point_of_its_weights(self, left_hand, paper_noise):
        problem = problem_of(left_hand, 7, 200, paper_noise)
        found = hx.estimate(problem, hx.Reweighted(MODEL))
        assert found.ok.all()
        assert found.iterations.max() <= 10
        again = hx.estimate(replace(problem, at=found.values), MODEL)
        assert (np.abs(again.values - found.values) <= 1e-6 * again.standard_errors).all()
        assert (found.gap <= 1e-9 * found.objective).all()


class TestWrongCalls:
    def test_settings(self):
        with pytest.raises(hx.InputError, match="weights: expected None or 'model', got 'huber'"):
            hx.UnitNormLeastSquares(weights="huber")
        with pytest.raises(hx.InputError, match="block: expected the name of a block, such as 'direction', got 3"):
            hx.UnitNormLeastSquares(block=3)

    def test_a_form_without_the_direction(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "direction", 5, rng=0)
        with pytest.raises(hx.InputError, match="and no 'direction'; the direct form: write"):
            hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), BOTH[0])

    def test_too_few_poses(self, left_hand):
        with pytest.raises(hx.RankDeficientError, match="too few poses: 6 equations for 9 unknowns"):
            hx.estimate(problem_of(left_hand, 2), BOTH[0])

    def test_weights_need_a_noise_model(self, left_hand):
        with pytest.raises(hx.InputError, match="the noise is unknown"):
            hx.estimate(problem_of(left_hand, 5), MODEL)


def test_values_without_a_covariance(left_hand):
    noise = hx.NormalNoise(0.01, 1e-4, 0.01)
    problem = hx.loops.FixedDirection(hx.simulate_leg(left_hand, 3, "direction", 7, 3, noise=noise, rng=1)).linear()
    found, full = (hx.estimate(problem, hx.UnitNormLeastSquares(covariance=value)) for value in (False, True))
    np.testing.assert_array_equal(found.values, full.values)
    assert found.degrees_of_freedom == full.degrees_of_freedom
    assert (found.covariance, found.influence) == (None, None)
    assert "not asked for" in found.covariance_kind
