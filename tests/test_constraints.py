"""Constraints: satisfied, with forces of the stated sign that balance, and clear about what cannot be."""

import pickle
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError, UnitError

pytestmark = pytest.mark.filterwarnings("ignore:Solution may be inaccurate")  # of cvxpy

PARAMETERS = hx.Parameters(
    (hx.Block("platform_point", 3, "cm"), hx.Block("base_point", 3, "cm"), hx.Block("offset", 1, "cm"))
)
LOOPS = {"leg": hx.loops.FixedLeg, "direction": hx.loops.FixedDirection}
LOSSES = [hx.Quadratic(), hx.Huber(), hx.GroupHuber(), hx.L1(), hx.GroupL1(), hx.Chebyshev()]
SMOOTH = LOSSES[:3]
UP = [[0, 0, 1]]


def nominal():
    return hx.robots.left_hand().leg(3)


def problem_of(lock, n, n_sets=None, rng=0):
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=noise, rng=rng)
    return LOOPS[lock](data).linear("direct")


def plain(n_sets=None, blocks=6, seed=0, shift=0.0):
    """Rows of unit variance in blocks of three; the unconstrained answer is near a random truth."""
    rng = np.random.default_rng(seed)
    batch = () if n_sets is None else (n_sets,)
    matrix = rng.normal(size=(*batch, 3 * blocks, 7))
    truth = rng.normal(size=(*batch, 7)) + shift
    rhs = (matrix @ truth[..., None])[..., 0] + rng.normal(size=(*batch, 3 * blocks))
    return hx.LinearProblem(matrix, rhs, PARAMETERS, rows_per_block=3)


def solved(problem, bounds, loss=None, throw=None, **settings):
    """In rows whose standard deviation is 1."""
    estimator = hx.ConvexEstimator(loss or hx.Quadratic(), bounds=bounds, weights=None, scale=1.0, **settings)
    return hx.estimate(problem, estimator, throw)


def imbalance(problem, found, *pulls):
    """The gradient of the loss, A'u, and what the constraints add: zero at an optimum."""
    total = np.einsum("...mp,...m->...p", problem.matrix, found.duals["rows"])
    return total + sum(pulls)


# --- boxes --------------------------------------------------------------------------------------------------


def middle_box(problem, loss, low, high):
    """A box about the free answer, moved: bounds by entry as shares of one."""
    free = solved(problem, None, loss).values[3:6]
    return hx.Box({"base_point": (free + low, free + high)})


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_box_that_does_not_bind_changes_nothing(loss):
    problem = plain()
    free = solved(problem, None, loss)
    found = solved(
        problem, hx.Box({"base_point": (free.values[3:6] - 1, free.values[3:6] + 1), "offset": (None, 99)}), loss
    )
    tolerance = 1e-9 if loss in SMOOTH else 1e-7
    np.testing.assert_allclose(found.values, free.values, atol=tolerance)
    np.testing.assert_allclose(found.objective, free.objective, rtol=1e-10)
    np.testing.assert_allclose(found.duals["box"], 0, atol=1e-9)
    if isinstance(loss, hx.Chebyshev):
        assert found.covariance is None
    else:
        np.testing.assert_allclose(found.covariance, free.covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_active_bounds_have_forces_of_the_stated_sign_that_balance(loss):
    """Positive where the upper bound holds the estimate back, negative where the lower does, zero elsewhere."""
    problem = plain(seed=1)
    box = middle_box(problem, loss, np.array([0.2, -9.0, -9.0]), np.array([9.0, -0.2, 9.0]))
    found = solved(problem, box, loss)
    lower, upper = box.bounds["base_point"]
    x = found.values[3:6]
    assert (x >= lower - 1e-9).all()
    assert (x <= upper + 1e-9).all()
    force = found.duals["box"]
    assert force.shape == (7,)
    np.testing.assert_allclose(imbalance(problem, found, force), 0, atol=1e-7)
    np.testing.assert_array_equal(force[[0, 1, 2, 6]], 0)
    slack = np.where(force[3:6] > 0, upper - x, x - lower)
    np.testing.assert_allclose(force[3:6] * slack, 0, atol=1e-7)
    if loss in SMOOTH:
        assert x[0] == lower[0]
        assert x[1] == upper[1]
        assert force[3] < -1e-3
        assert force[4] > 1e-3
        z = (problem.residual(found.values)).reshape(-1, 3)
        np.testing.assert_allclose(found.duals["rows"], loss.psi(z).reshape(-1), atol=1e-8)
    assert found.primal_residual <= 1e-9
    assert found.objective >= solved(problem, None, loss).objective - 1e-9


@pytest.mark.parametrize("backend", ["auto", "batched", "clarabel", "cvxpy"])
def test_every_backend_finds_the_same_point(backend):
    problem = plain(3, seed=2)
    box = hx.Box({"base_point": (-0.1, 0.1), "offset": (None, 0.0)})
    found = solved(problem, box, backend=backend)
    expected = solved(problem, box)
    assert found.ok.all()
    np.testing.assert_allclose(found.values, expected.values, atol=1e-7)
    np.testing.assert_allclose(found.duals["box"], expected.duals["box"], atol=1e-5)


@given(seed=st.integers(0, 10**6), share=st.floats(0.0, 2.0))
@settings(max_examples=30)
def test_a_box_is_satisfied_and_optimal(seed, share):
    """Stationarity and complementarity by hand, wherever the box lies."""
    problem = plain(4, seed=seed)
    rng = np.random.default_rng(seed + 1)
    point = rng.normal(size=(4, 3)) * share
    lower, upper = point - 0.1, point + 0.1 + share
    found = solved(problem, hx.Box({"base_point": (lower, upper)}), hx.Huber())
    assert found.ok.all()
    x, force = found.values[:, 3:6], found.duals["box"]
    assert (x >= lower - 1e-9).all()
    assert (x <= upper + 1e-9).all()
    np.testing.assert_allclose(imbalance(problem, found, force), 0, atol=1e-8)
    np.testing.assert_allclose(np.maximum(force[:, 3:6], 0) * (upper - x), 0, atol=1e-9)
    np.testing.assert_allclose(np.minimum(force[:, 3:6], 0) * (x - lower), 0, atol=1e-9)


def test_a_box_around_a_leg_or_several():
    robot = hx.robots.left_hand()
    box = hx.Box.around(robot.leg(3), 0.5)
    assert (box.unit, box.if_present) == ("cm", True)
    for name in ("platform_point", "base_point"):
        lower, upper = box.bounds[name]
        np.testing.assert_allclose(upper - lower, 1.0)
        np.testing.assert_allclose(0.5 * (upper + lower), robot.leg(3).block(name), atol=1e-15)
    several = hx.Box.around([robot.leg(3), robot.leg(4)], [0.1, 0.2, 0.3])
    assert set(several.bounds) == {f"leg{i}.{name}" for i in (3, 4) for name in ("platform_point", "base_point")}
    lower, upper = several.bounds["leg4.base_point"]
    np.testing.assert_allclose(upper - lower, [0.2, 0.4, 0.6])
    one = hx.Box.around(robot.leg(3), {"base_point": 0.5})
    assert list(one.bounds) == ["base_point"]
    with pytest.raises(InputError, match=r"Box.around: unknown point 'offset'; there are platform_point, base_point"):
        hx.Box.around(robot.leg(3), {"offset": 0.5})


def test_a_box_around_what_a_problem_does_not_have():
    """Of the two points a type II problem has one; it is bounded alone."""
    problem = problem_of("leg", 6)
    point = nominal().replaced(platform_point=nominal().platform_point + 1.0)
    found = hx.estimate(problem, hx.ConvexEstimator(bounds=hx.Box.around(point, 0.5)))
    np.testing.assert_allclose(found.values[:3], point.platform_point - 0.5, atol=1e-12)
    assert (found.duals["box"][:3] < 0).all()


def test_a_number_bounds_all_entries_and_none_bounds_nothing():
    (part,) = hx.Box({"base_point": (-1, None), "offset": ([0.5], 2)}).rows(PARAMETERS)
    np.testing.assert_array_equal(part.lower, [-1, -1, -1, 0.5])
    np.testing.assert_array_equal(part.upper, [np.inf, np.inf, np.inf, 2])
    np.testing.assert_array_equal(part.matrix, np.eye(7)[3:])
    assert part.is_box


def test_bounds_of_a_batch_one_for_each_set():
    problem = plain(5, seed=3)
    upper = np.linspace(-2, 2, 5)
    wide = np.broadcast_to(upper[:, None], (5, 3))
    found = solved(problem, hx.Box({"base_point": (None, wide), "offset": (None, upper[:, None])}))
    assert found.ok.all()
    assert (found.values[:, 3:] <= upper[:, None] + 1e-9).all()
    for i in range(5):
        alone = solved(problem_at(problem, i), hx.Box({"base_point": (None, upper[i]), "offset": (None, upper[i])}))
        np.testing.assert_allclose(found.values[i], alone.values, atol=1e-10)
        np.testing.assert_allclose(found.duals["box"][i], alone.duals["box"], atol=1e-8)


def problem_at(problem, i):
    return hx.LinearProblem(problem.matrix[i], problem.rhs[i], problem.parameters, problem.rows_per_block)


def test_two_boxes_are_their_intersection():
    problem = plain(seed=4)
    free = solved(problem, None).values[3:6]
    one = hx.Box({"base_point": (free + 0.1, None)})
    two = hx.Box({"base_point": (free - 1, free + 0.3)})
    both = hx.Box({"base_point": (free + 0.1, free + 0.3)})
    np.testing.assert_allclose(solved(problem, [one, two]).values, solved(problem, both).values, atol=1e-10)
    assert set(solved(problem, [one, two]).duals) == {"rows", "box"}


def test_the_name_of_a_box_is_that_of_its_forces():
    found = solved(plain(), hx.Box({"offset": (None, 0)}, name="cad"))
    assert set(found.duals) == {"rows", "cad"}


# --- balls --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_ball_holds_the_point_on_its_surface(loss):
    """The force points outwards, and balances."""
    problem = plain(seed=5)
    free = solved(problem, None, loss).values
    centre = free[3:6] + np.array([1.0, 1.0, 0.0])
    found = solved(problem, hx.Ball({"base_point": (centre, 0.5)}), loss)
    apart = found.values[3:6] - centre
    assert np.linalg.norm(apart) <= 0.5 + 1e-9
    force = found.duals["ball.base_point"]
    np.testing.assert_allclose(imbalance(problem, found, np.pad(force, (3, 1))), 0, atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(force) * 0.5, force @ apart, atol=1e-6)
    if loss in SMOOTH:
        np.testing.assert_allclose(np.linalg.norm(apart), 0.5, atol=1e-8)
        assert force @ apart > 0


def test_a_ball_that_does_not_bind_changes_nothing():
    problem = plain(seed=6)
    for loss in SMOOTH:
        free = solved(problem, None, loss)
        found = solved(problem, hx.Ball({"base_point": (free.values[3:6] + 0.1, 1.0)}), loss)
        np.testing.assert_allclose(found.values, free.values, atol=1e-9 if loss == hx.Quadratic() else 1e-7)
        np.testing.assert_allclose(found.duals["ball.base_point"], 0, atol=1e-7)
        np.testing.assert_allclose(found.covariance, free.covariance, rtol=1e-6, atol=1e-12)


def test_a_ball_is_the_same_in_every_frame():
    """Turning the axes of a point turns the answer; a box does not do that."""
    problem = plain(seed=7)
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    wide = np.eye(7)
    wide[3:6, 3:6] = turn
    turned = hx.LinearProblem(problem.matrix @ wide.T, problem.rhs, PARAMETERS, rows_per_block=3)
    centre = np.array([0.5, -0.5, 0.2])
    one = solved(problem, hx.Ball({"base_point": (centre, 0.3)}))
    two = solved(turned, hx.Ball({"base_point": (turn @ centre, 0.3)}))
    np.testing.assert_allclose(wide @ one.values, two.values, atol=1e-7)


def test_a_ball_around_a_leg():
    robot = hx.robots.left_hand()
    ball = hx.Ball.around([robot.leg(2)], {"leg2.base_point": 0.2})
    centre, radius = ball.balls["leg2.base_point"]
    np.testing.assert_array_equal(centre, robot.leg(2).base_point)
    assert (list(ball.balls), float(radius), ball.unit) == (["leg2.base_point"], 0.2, "cm")
    problem = problem_of("leg", 6)
    point = nominal().replaced(platform_point=nominal().platform_point + 1.0)
    found = hx.estimate(problem, hx.ConvexEstimator(bounds=hx.Ball.around(point, 0.5)))
    np.testing.assert_allclose(np.linalg.norm(found.values[:3] - point.platform_point), 0.5, atol=1e-9)
    assert set(found.duals) == {"rows", "ball.platform_point"}


def test_balls_of_a_batch():
    problem = plain(3, seed=8)
    centres, radii = np.random.default_rng(1).normal(size=(3, 3)), np.array([0.1, 0.2, 5.0])
    found = solved(problem, hx.Ball({"base_point": (centres, radii)}))
    assert found.ok.all()
    apart = np.linalg.norm(found.values[:, 3:6] - centres, axis=-1)
    assert (apart <= radii + 1e-9).all()
    for i in range(3):
        alone = solved(problem_at(problem, i), hx.Ball({"base_point": (centres[i], radii[i])}))
        np.testing.assert_allclose(found.values[i], alone.values, atol=1e-7)


# --- linear -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_linear_inequality_holds_and_balances(loss):
    """Two points at the same height within 0.01."""
    problem = plain(seed=9)
    flat = hx.Linear({"platform_point": [0, 0, 1], "base_point": [0, 0, -1]}, lower=-0.01, upper=0.01)
    found = solved(problem, flat, loss)
    free = solved(problem, None, loss).values
    side = found.values[2] - found.values[5]
    assert abs(side) <= 0.01 + 1e-9
    (force,) = found.duals["linear"]
    pull = force * np.array([0, 0, 1, 0, 0, -1, 0])
    np.testing.assert_allclose(imbalance(problem, found, pull), 0, atol=1e-7)
    np.testing.assert_allclose(force * (0.01 * np.sign(force) - side), 0, atol=1e-7)
    if loss in SMOOTH:
        assert np.sign(force) == np.sign(free[2] - free[5])
        assert abs(force) > 1e-3


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_tied_parameters_are_equal(loss):
    """The rows of an equation may have a force of either sign; the answer is that of fewer unknowns."""
    problem = plain(seed=10)
    tie = hx.Linear({"platform_point": np.eye(3), "base_point": -np.eye(3)}, equal=[0.1, 0.0, -0.1])
    found = solved(problem, tie, loss)
    np.testing.assert_allclose(found.values[:3] - found.values[3:6], [0.1, 0, -0.1], atol=1e-9)
    pull = np.concatenate([found.duals["linear"], -found.duals["linear"], [0]])
    np.testing.assert_allclose(imbalance(problem, found, pull), 0, atol=1e-6)
    tied = np.concatenate([problem.matrix[:, :3] + problem.matrix[:, 3:6], problem.matrix[:, 6:]], axis=-1)
    rhs = problem.rhs - problem.matrix[:, :3] @ [0.1, 0, -0.1]
    fewer = hx.Parameters((hx.Block("base_point", 3, "cm"), hx.Block("offset", 1, "cm")))
    small = solved(hx.LinearProblem(tied, rhs, fewer, rows_per_block=3), None, loss)
    np.testing.assert_allclose(found.objective, small.objective, rtol=1e-8)
    if loss in SMOOTH:
        np.testing.assert_allclose(found.values[3:], small.values, atol=1e-7)
        np.testing.assert_allclose(found.covariance[3:, 3:], small.covariance, rtol=1e-5, atol=1e-12)


def test_a_linear_inequality_that_does_not_bind_changes_nothing():
    problem = plain(seed=11)
    for loss in SMOOTH:
        free = solved(problem, None, loss)
        found = solved(problem, hx.Linear({"base_point": [1, 1, 1]}, upper=free.values[3:6].sum() + 0.5), loss)
        np.testing.assert_allclose(found.values, free.values, atol=1e-9 if loss == hx.Quadratic() else 1e-7)
        np.testing.assert_allclose(found.duals["linear"], 0, atol=1e-9)
        np.testing.assert_allclose(found.covariance, free.covariance, rtol=1e-6, atol=1e-12)


def test_linear_bounds_of_a_batch():
    problem = plain(4, seed=12)
    equal = np.array([[0.0], [1.0], [2.0], [3.0]])
    found = solved(problem, hx.Linear({"base_point": [1, 1, 1], "offset": -1.0}, equal=equal))
    assert found.ok.all()
    np.testing.assert_allclose(found.values[:, 3:6].sum(axis=-1) - found.values[:, 6], equal[:, 0], atol=1e-9)
    assert found.duals["linear"].shape == (4, 1)


def test_several_constraints_each_with_a_name():
    """The second "linear" is "linear.2"."""
    problem = plain(seed=13)
    bounds = [
        hx.Linear({"platform_point": [1, 0, 0]}, upper=-1.0),
        hx.Box({"offset": (None, -1.0)}),
        hx.Linear({"platform_point": [0, 1, 0], "base_point": [0, 1, 0]}, equal=0.0),
        hx.Ball({"base_point": (np.zeros(3), 0.4)}),
        hx.Linear({"offset": 1.0, "base_point": [1, 1, 1]}, lower=-9.0, name="sum"),
    ]
    found = solved(problem, bounds)
    assert set(found.duals) == {"rows", "linear", "box", "linear.2", "ball.base_point", "sum"}
    x = found.values
    assert x[0] <= -1 + 1e-9
    assert x[6] <= -1 + 1e-9
    assert abs(x[1] + x[4]) <= 1e-9
    assert np.linalg.norm(x[3:6]) <= 0.4 + 1e-9
    pull = found.duals["box"].copy()
    pull[0] += found.duals["linear"][0]
    pull[[1, 4]] += found.duals["linear.2"][0]
    pull[3:6] += found.duals["ball.base_point"] + found.duals["sum"][0]
    pull[6] += found.duals["sum"][0]
    np.testing.assert_allclose(imbalance(problem, found, pull), 0, atol=1e-6)


@pytest.mark.parametrize("kind", ["ball", "tie"])
@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_every_small_problem_is_proven(loss, kind):
    """Sixteen random ones, with a ball or equations that hold."""
    problem = plain(16, seed=21)
    free = solved(problem, None, loss, covariance=False).values
    held = {
        "ball": hx.Ball({"base_point": (free[:, 3:6] + [1.0, 1.0, 0.0], 0.5)}),
        "tie": hx.Linear({"platform_point": np.eye(3), "base_point": -np.eye(3)}, equal=[0.1, 0.0, -0.1]),
    }[kind]
    found = solved(problem, held, loss, covariance=False)
    assert found.ok.all()


# --- covariance ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", SMOOTH, ids=repr)
def test_what_is_fixed_has_no_variance(loss):
    """And the other parameters have that of a problem without it."""
    problem = plain(seed=14)
    held = np.array([0.3, -0.2, 0.1])
    fewer = hx.Parameters((hx.Block("platform_point", 3, "cm"), hx.Block("offset", 1, "cm")))
    columns = [0, 1, 2, 6]
    small = solved(
        hx.LinearProblem(
            problem.matrix[:, columns], problem.rhs - problem.matrix[:, 3:6] @ held, fewer, rows_per_block=3
        ),
        None,
        loss,
    )
    for bounds in (hx.Box({"base_point": (held, held)}), hx.Linear({"base_point": np.eye(3)}, equal=held)):
        found = solved(problem, bounds, loss)
        np.testing.assert_allclose(found.values[3:6], held, atol=1e-9)
        np.testing.assert_allclose(found.values[columns], small.values, atol=1e-7)
        np.testing.assert_allclose(found.covariance[3:6], 0, atol=1e-12)
        np.testing.assert_allclose(found.covariance[np.ix_(columns, columns)], small.covariance, rtol=1e-5, atol=1e-12)


def test_an_active_bound_leaves_no_variance():
    problem = plain(seed=1)
    box = middle_box(problem, hx.Quadratic(), np.array([0.2, -9.0, -9.0]), np.array([9.0, 9.0, 9.0]))
    found = solved(problem, box)
    assert np.flatnonzero(found.standard_errors == 0).tolist() == [3]
    np.testing.assert_array_equal(found.covariance[3], 0)
    assert (np.linalg.eigvalsh(np.delete(np.delete(found.covariance, 3, 0), 3, 1)) > 0).all()


def test_a_tie_leaves_no_variance_along_it():
    problem = plain(seed=15)
    found = solved(problem, hx.Linear({"base_point": [1.0, 1.0, 0]}, equal=0.5))
    along = np.array([0, 0, 0, 1.0, 1.0, 0, 0])
    np.testing.assert_allclose(found.covariance @ along, 0, atol=1e-12)
    assert (found.standard_errors[[3, 4]] > 1e-3).all()


FIXED = {
    "box": lambda b: hx.Box({"platform_point": (b, b)}),
    "linear": lambda b: hx.Linear({"platform_point": np.eye(3)}, equal=b),
}


def exact_leg_problem(n):
    """Rows without any error, whose forces at the true point are all zero."""
    data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", n, rng=0)
    return hx.loops.FixedLeg(data).linear("direct")


@pytest.mark.parametrize(("kind", "n"), [("box", 1), ("linear", 1), ("linear", 5)])
def test_a_fixed_parameter_that_needs_no_force_has_no_variance_either(kind, n):
    """It is where the measurements want it: an equation all the same."""
    found = hx.estimate(
        exact_leg_problem(n),
        hx.ConvexEstimator(bounds=FIXED[kind](nominal().platform_point), weights=None, scale=0.01),
    )
    np.testing.assert_allclose(found.values[:3], nominal().platform_point, atol=1e-9)
    np.testing.assert_allclose(found.covariance[:3], 0, atol=1e-9)
    np.testing.assert_allclose(found.standard_errors[3:], 0.01 / np.sqrt(n), rtol=1e-6)


# --- too few poses ------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore:invalid value encountered in sqrt")  # of the covariance: see the test above
@pytest.mark.parametrize("kind", FIXED)
@pytest.mark.parametrize("n", [1, 2])
def test_bounds_that_fix_a_parameter_decide_what_too_few_poses_do_not_see(kind, n):
    problem = problem_of("leg", n)
    with pytest.raises(RankDeficientError):
        hx.estimate(problem, hx.ConvexEstimator())
    bounds = FIXED[kind](nominal().platform_point)
    found = hx.estimate(problem, hx.ConvexEstimator(bounds=bounds))
    np.testing.assert_allclose(found.values[:3], nominal().platform_point, atol=1e-9)
    arm = problem.matrix.reshape(n, 3, 6)[:, :, :3] @ nominal().platform_point - problem.rhs.reshape(n, 3)
    np.testing.assert_allclose(found.values[3:], arm.mean(axis=0), atol=1e-3)
    assert len(found.decided) == 6 - np.linalg.matrix_rank(problem.matrix)
    assert found.decided[0] in found.summary()


def test_a_box_that_leaves_room_does_not_make_it_unique():
    """One pose sees three of six; the room of the box is all that is known of the others."""
    problem = problem_of("leg", 1)
    point = nominal().platform_point
    with pytest.raises(RankDeficientError, match=r"unseen: .*platform_point"):
        hx.estimate(problem, hx.ConvexEstimator(bounds=hx.Box({"platform_point": (point - 30, point + 30)})))
    found = hx.estimate(
        problem, hx.ConvexEstimator(bounds=hx.Box({"platform_point": (point - 30, point + 30)})), throw=False
    )
    assert found.status is hx.Status.RANK_DEFICIENT
    assert len(found.unseen) == 3
    assert np.isnan(found.values).all()
    assert found.decided == ()


def test_touching_a_bound_is_not_being_held_by_it():
    """Two poses do not see the axis of the turn: where on it the box was touched is where the solver came from."""
    bounds = hx.Box.around(nominal(), 5.0)
    found = hx.estimate(problem_of("leg", 2, 60), hx.ConvexEstimator(bounds=bounds))
    assert (found.codes == hx.Status.RANK_DEFICIENT).all()


def test_a_failed_estimate_has_no_covariance():
    found = hx.estimate(problem_of("leg", 2, 60), hx.ConvexEstimator(bounds=hx.Box.around(nominal(), 5.0)))
    assert not found.ok.all()
    assert np.isnan(found.covariance[~found.ok]).all()


# --- infeasible ---------------------------------------------------------------------------------------------

CLASHES = {
    "two boxes": lambda high: [hx.Box({"offset": (0.0, None)}), hx.Box({"offset": (None, high)})],
    "box and linear": lambda high: [hx.Box({"offset": (0.0, None)}), hx.Linear({"offset": 1.0}, upper=high)],
    "two equations": lambda high: [
        hx.Linear({"offset": 1.0}, equal=0.5),
        hx.Linear({"offset": 2.0}, equal=np.where(high < 0, 3.0, 1.0)),
    ],
    "ball and linear": lambda high: [
        hx.Ball({"base_point": (np.zeros(3), 1.0)}),
        hx.Linear({"base_point": [1, 0, 0]}, lower=np.where(high < 0, 2.0, 0.1)),
    ],
}


@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.Huber(), hx.L1()], ids=repr)
@pytest.mark.parametrize("name", CLASHES)
def test_what_cannot_be_is_infeasible_alone(name, loss):
    """The others of the batch are right."""
    problem = plain(3, seed=16)
    high = np.array([[1.0], [-1.0], [2.0]])
    found = solved(problem, CLASHES[name](high), loss, covariance=False)
    assert found.status.tolist() == [hx.Status.OPTIMAL, hx.Status.INFEASIBLE, hx.Status.OPTIMAL]
    assert np.isnan(found.values[1]).all()
    for part in found.duals.values():
        assert np.isnan(part[1]).all()
    for i in (0, 2):
        alone = solved(problem_at(problem, i), CLASHES[name](high[i]), loss, covariance=False)
        np.testing.assert_allclose(found.objective[i], alone.objective, rtol=1e-9)


@pytest.mark.parametrize("name", CLASHES)
def test_one_infeasible_problem_raises(name):
    with pytest.raises(EstimationError, match="ConvexEstimator: ended with status INFEASIBLE"):
        solved(plain(seed=16), CLASHES[name](np.array([-1.0])))


# --- what is refused ----------------------------------------------------------------------------------------

KINDS = {
    "Box": lambda names, **kw: hx.Box(dict.fromkeys(names, (-1, 1)), **kw),
    "Ball": lambda names, **kw: hx.Ball({name: ([0, 0, 0], 1) for name in names}, **kw),
    "Linear": lambda names: hx.Linear({name: [1, 1, 1] for name in names}, upper=1),
}


@pytest.mark.parametrize("kind", KINDS)
def test_an_unknown_name_is_an_error_that_lists_the_known_ones(kind):
    with pytest.raises(
        InputError, match=rf"{kind}: unknown parameter 'bace_point'.*platform_point, base_point, offset"
    ):
        KINDS[kind](["bace_point"]).rows(PARAMETERS)


@pytest.mark.parametrize("kind", ["Box", "Ball"])
def test_absent_names_are_left_out_if_asked_for_but_not_all(kind):
    (part,) = KINDS[kind](["fixed_point", "base_point"], if_present=True).rows(PARAMETERS)
    np.testing.assert_array_equal(part.matrix, np.eye(7)[3:6])
    with pytest.raises(InputError, match="unknown parameter 'fixed_point'"):
        KINDS[kind](["fixed_point"], if_present=True).rows(PARAMETERS)


@pytest.mark.parametrize("kind", ["Box", "Ball"])
def test_another_unit_is_an_error(kind):
    with pytest.raises(UnitError, match=rf"{kind} of base_point is in mm, the problem in cm"):
        KINDS[kind](["base_point"], unit="mm").rows(PARAMETERS)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hx.Box({"offset": (2, 1)}), r"Box of offset: the lower bound 2 is above the upper bound 1"),
        (lambda: hx.Box({"base_point": ([0, 3, 0], [1, 2, 1])}), "the lower bound 3 is above the upper bound 2"),
        (lambda: hx.Box.around(nominal(), -0.1), "lower bound .* is above the upper bound"),
        (lambda: hx.Box({"offset": (np.nan, 1)}), "offset: a bound is NaN; write None or an infinity"),
        (lambda: hx.Box({"offset": ("a", 1)}), "offset: expected numbers, infinities or None"),
        (lambda: hx.Box({"offset": 1}), r"Box: offset needs a pair \(lower, upper\), got 1"),
        (lambda: hx.Box({"offset": (1, 2, 3)}), r"Box: offset needs a pair \(lower, upper\)"),
        (lambda: hx.Box({"offset": None}), r"Box: offset needs a pair \(lower, upper\)"),
        (lambda: hx.Box({"base_point": ([1, 2], [1, 2, 3])}), "base_point: bounds of shapes .* do not fit"),
        (lambda: hx.Box({}), "Box: bounds is given by parameter name"),
        (lambda: hx.Box((1, 2)), "Box: bounds is given by parameter name"),
        (lambda: hx.Ball({"base_point": ([0, 0, 0], 0)}), "expected a finite centre and a radius > 0"),
        (lambda: hx.Ball({"base_point": ([0, 0, 0], -1)}), "expected a finite centre and a radius > 0"),
        (lambda: hx.Ball({"base_point": ([0, 0, 0], np.inf)}), "expected a finite centre and a radius > 0"),
        (lambda: hx.Ball({"base_point": ([0, 0, np.inf], 1)}), "expected a finite centre and a radius > 0"),
        (lambda: hx.Ball({"base_point": ([0, 0, np.nan], 1)}), "base_point"),
        (lambda: hx.Ball({"base_point": ([0, 0, 0], None)}), "base_point"),
        (lambda: hx.Ball({"base_point": [0, 0, 0]}), r"Ball: base_point needs a pair \(centre, radius\)"),
        (lambda: hx.Ball({}), "Ball: balls is given by parameter name"),
        (
            lambda: hx.Linear({"base_point": np.eye(3), "offset": 1.0}, upper=1),
            r"Linear: coefficients of \[1, 3\] rows do not fit together",
        ),
        (lambda: hx.Linear({"offset": 1.0}, upper=1, equal=1), "Linear: give equal, or lower and upper, not both"),
        (lambda: hx.Linear({"offset": 1.0}, lower=1, equal=1), "Linear: give equal, or lower and upper, not both"),
        (lambda: hx.Linear({"offset": 1.0}), "Linear: give lower, upper or equal"),
        (lambda: hx.Linear({"offset": 1.0}, lower=2, upper=1), "the lower bound 2 is above the upper bound 1"),
        (lambda: hx.Linear({"offset": 1.0}, upper=np.nan), "Linear: upper: a bound is NaN"),
        (lambda: hx.Linear({"offset": np.inf}, upper=1), r"coefficients of offset: expected finite numbers"),
        (
            lambda: hx.Linear({"base_point": np.ones((2, 2, 3))}, upper=1),
            r"expected finite numbers of shape \(q, size\)",
        ),
        (lambda: hx.Linear({"base_point": np.ones((2, 3))}, lower=[0, 0, 0], upper=[1, 1]), "do not fit"),
        (lambda: hx.Linear({}, upper=1), "Linear: coefficients is given by parameter name"),
    ],
)
def test_bounds_that_make_no_sense_are_refused_at_once(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda: hx.Box({"offset": (np.inf, None)}),
        lambda: hx.Box({"offset": (None, -np.inf)}),
        lambda: hx.Linear({"offset": 1.0}, equal=np.inf),
    ],
)
def test_an_infinite_bound_on_the_wrong_side_is_refused(make):
    with pytest.raises(InputError, match="bound"):
        make()


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        (hx.Box({"base_point": ([1, 2], [3, 4])}), r"base_point: expected 3 values \(base_point.x"),
        (hx.Ball({"base_point": ([1, 2], 1)}), "base_point: expected 3 values"),
        (hx.Ball({"base_point": (1.0, 1)}), "base_point: expected 3 values"),
        (hx.Linear({"base_point": [1, 1]}, upper=1), r"coefficients of base_point: expected 3 \(base_point.x"),
        (
            hx.Linear({"base_point": np.eye(3)}, upper=[1, 2]),
            r"Linear: 3 rows of coefficients, but bounds of shape \(2,\)",
        ),
    ],
)
def test_bounds_of_a_wrong_size_are_refused(bounds, message):
    with pytest.raises(InputError, match=message):
        solved(plain(), bounds)


@pytest.mark.parametrize(
    "bounds",
    [
        hx.Box({"base_point": (np.zeros((4, 3)), None)}),
        hx.Ball({"base_point": (np.zeros(3), np.ones(4))}),
        hx.Linear({"offset": 1.0}, upper=np.ones((4, 1))),
    ],
    ids=lambda bounds: type(bounds).__name__,
)
def test_bounds_of_another_batch_are_refused(bounds):
    with pytest.raises(InputError, match=r"a prior or bound has a batch of \(4,\), the problem of \(3,\)"):
        solved(plain(3), bounds)


# --- they are values ----------------------------------------------------------------------------------------

VALUES = [
    hx.Box({"base_point": ([0, 1, 2], [3, 4, 5]), "offset": (0.5, 1)}, unit="cm"),
    hx.Box({"base_point": ([0, 1, 2], [3, 4, 5])}, name="cad"),
    hx.Ball({"base_point": ([0, 1, 2], 0.5)}, if_present=True),
    hx.Linear({"base_point": np.eye(3), "offset": [[1], [2], [3]]}, equal=[0, 0, 1]),
    hx.Linear({"base_point": [0, 0, 1]}, lower=-1, upper=1, name="flat"),
]
OPEN = [hx.Box({"offset": (None, 1)}), hx.Linear({"offset": 1.0}, upper=1)]


@pytest.mark.parametrize(
    "bounds",
    [
        *VALUES,
        *OPEN,
    ],
    ids=lambda bounds: type(bounds).__name__,
)
def test_a_constraint_is_a_value(bounds):
    assert pickle.loads(pickle.dumps(bounds)) == bounds
    with pytest.raises(FrozenInstanceError):
        bounds.name = "other"
    assert eval(repr(bounds), vars(hx) | {type(bounds).__name__: type(bounds)}) == bounds


def test_unequal_constraints():
    every = VALUES + OPEN
    for i, one in enumerate(every):
        assert [one == other for other in every].count(True) == 1, i


def test_equal_is_held_by_both_bounds():
    assert hx.Linear({"offset": 1.0}, equal=2.0) == hx.Linear({"offset": 1.0}, lower=2.0, upper=2.0)


def test_bounds_do_not_change_with_the_arrays_that_they_were_made_of():
    lower, coefficient = np.zeros(3), np.ones(3)
    box = hx.Box({"base_point": (lower, None)})
    linear = hx.Linear({"base_point": coefficient}, lower=lower[:1])
    lower[:], coefficient[:] = 5, 5
    np.testing.assert_array_equal(box.bounds["base_point"][0], 0)
    np.testing.assert_array_equal(linear.coefficients["base_point"], 1)
    np.testing.assert_array_equal(linear.lower, 0)
