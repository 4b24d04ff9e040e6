"""E by its semidefinite programme: against cvxpy, brute force, and what any multipliers may prove."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import RankDeficientError
from hexopt.information import PoseInformation, pose_information
from hexopt.selection import column_generation
from hexopt.selection.certificate import lower_bound
from hexopt.selection.cones import Rows, packed, root_of, solve_cones, unpacked
from hexopt.selection.criteria import EOptimal
from hexopt.selection.feasible import Feasible
from hexopt.selection.objective import Objective
from hexopt.selection.reference import relaxed_by_cvxpy
from hexopt.selection.relaxation import relax
from hexopt.selection.semidefinite import _Largest, relax_largest, semidefinite_bound

NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
LOOPS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}


def made(lock, n_poses, scenarios=1, worst=False, seed=0):
    """E of the poses of one locked leg."""
    robot = hx.robots.left_hand()
    data = hx.simulate_leg(robot, 3, lock, n_poses, noise=NOISE, rng=seed)
    known = {"platform_point": robot.leg(3).platform_point} if lock == "length" else {}
    at = None if scenarios == 1 else [robot.perturbed(0.5, rng=k) for k in range(scenarios)]
    return Objective(pose_information(LOOPS[lock](data, **known), at=at), EOptimal(), worst)


def drawn(seed, n_poses=30, size=5, main=3, scenarios=1, fixed=0.0, worst=False):
    """E of random information, of two rows a pose."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(scenarios, n_poses, 2, size)) * rng.uniform(0.3, 3, size)
    before = fixed * rng.normal(size=(scenarios, size, size))
    information = PoseInformation(
        np.swapaxes(rows, -1, -2) @ rows,
        np.swapaxes(before, -1, -2) @ before,
        ("x",) * main,
        ("",) * main,
        np.ones(main),
    )
    return Objective(information, EOptimal(), worst)


def counted(n_poses, number, cap=1.0):
    return Feasible(np.full(n_poses, float(cap)), np.ones(n_poses), float(number))


def priced(n_poses, budget, seed=0):
    return Feasible(np.full(n_poses, 1.0), np.random.default_rng(seed).uniform(0.5, 3.0, n_poses), budget)


def some_weights(feasible, rng):
    """Weights at random within what is allowed, few or many of them."""
    weights = np.where(rng.random(len(feasible.cap)) < rng.uniform(0.2, 1), rng.random(len(feasible.cap)), 0.0)
    weights = weights * np.minimum(feasible.cap, 1e6)
    return weights * min(1.0, feasible.total / max(feasible.cost @ weights, 1e-12))


# --- the relaxation


@pytest.mark.parametrize("lock", LOOPS)
@pytest.mark.parametrize("cap", [1, 10])
def test_agrees_with_cvxpy(lock, cap):
    objective, feasible = made(lock, 120), counted(120, 10, cap)
    found = relax_largest(objective, feasible)
    assert found.ok
    assert found.value == pytest.approx(relaxed_by_cvxpy(objective, feasible), rel=1e-6)


@pytest.mark.parametrize("worst", [False, True])
@pytest.mark.parametrize("feasible", [counted(40, 9), counted(40, 9, 9), priced(40, 12.0)], ids=["cap", "free", "cost"])
@pytest.mark.parametrize("fixed", [0.0, 1.0])
def test_scenarios_costs_and_what_is_known_agree_with_cvxpy(worst, feasible, fixed):
    objective = drawn(3, 40, scenarios=3, fixed=fixed, worst=worst)
    found = relax_largest(objective, feasible)
    assert found.ok
    assert feasible.holds(found.weights)
    assert found.value == objective.value(found.weights)
    assert found.value == pytest.approx(relaxed_by_cvxpy(objective, feasible), rel=1e-6)


@pytest.mark.parametrize("lock", LOOPS)
@pytest.mark.parametrize(("number", "cap"), [(10, 10), (7, 1), (400, 1), (2500, 1)])
def test_many_candidates_are_solved_by_columns(lock, number, cap):
    objective, feasible = made(lock, 5000), counted(5000, number, cap)
    found = relax_largest(objective, feasible, goal=1e-6)
    assert found.ok
    assert found.stopped == "proven to the goal"
    assert found.iterations < 30
    assert feasible.holds(found.weights)
    assert (found.value - found.bound) / found.value <= 1e-6
    assert found.value == objective.value(found.weights)


def test_relax_sends_e_here():
    objective, feasible = made("leg", 50), counted(50, 6)
    found = relax(objective, feasible)
    assert found.ok
    assert found.gap <= 1e-6 * found.value
    assert found.bound == pytest.approx(relax_largest(objective, feasible).bound, rel=1e-6)


def test_one_scenario_is_its_own_average_and_worst():
    one, other = (relax_largest(drawn(1, worst=worst), counted(30, 8)) for worst in (False, True))
    assert one.value == pytest.approx(other.value, rel=1e-7)
    np.testing.assert_array_equal(one.mix, [[1.0]])


def test_excluded_candidates_get_nothing():
    objective, feasible = drawn(2, 40), counted(40, 8)
    best = relax_largest(objective, feasible)
    out = int(best.weights.argmax())
    cap = feasible.cap.copy()
    cap[out] = 0.0
    less = relax_largest(objective, Feasible(cap, feasible.cost, feasible.total))
    assert less.ok
    assert less.weights[out] == 0
    assert less.bound > best.value


def test_every_design_of_whole_poses_is_above_the_bound():
    objective, feasible = drawn(5, 10), counted(10, 5)
    found = relax_largest(objective, feasible)
    best = min(objective.value(np.bincount(list(c), minlength=10).astype(float)) for c in combinations(range(10), 5))
    assert found.bound <= best
    assert found.bound > 0.5 * best


def test_a_failing_solver_proves_nothing(monkeypatch):
    monkeypatch.setattr("hexopt.selection.semidefinite.solve_cones", lambda *_: None)
    objective, feasible = made("leg", 1000), counted(1000, 8)
    found = relax_largest(objective, feasible)
    assert not found.ok
    assert found.bound == 0
    assert "the solver failed" in found.stopped
    assert found.value == objective.value(found.weights)
    assert feasible.holds(found.weights)


@pytest.mark.parametrize(("name", "words"), [("ROUNDS", "too many rounds"), ("IDLE", "no other pose pays")])
def test_a_search_that_stops_early_says_so(monkeypatch, name, words):
    monkeypatch.setattr(column_generation, name, {"ROUNDS": 1, "IDLE": 0}[name])
    monkeypatch.setattr(column_generation, "SAMPLE", 50)
    found = relax_largest(made("direction", 500), counted(500, 60), goal=0.0)
    assert words in found.stopped
    assert not found.ok
    assert 0 < found.bound < found.value
    assert found.relative == pytest.approx(1 - found.bound / found.value)


@pytest.mark.parametrize(("number", "cap"), [(8, 8), (8, 1), (150, 1)])
def test_few_columns_a_round_lead_there_too(monkeypatch, number, cap):
    objective, feasible = made("direction", 400), counted(400, number, cap)
    at_once = relax_largest(objective, feasible)
    for name, size in (("SAMPLE", 20), ("NEW", 10), ("MANY", 40)):
        monkeypatch.setattr(column_generation, name, size)
    found = relax_largest(objective, feasible)
    assert found.ok
    assert found.iterations > 1
    assert found.value == pytest.approx(at_once.value, rel=2e-7)


def test_what_no_candidate_sees():
    objective = drawn(0)
    blind = objective.information.blocks.copy()
    blind[..., 1, :] = blind[..., :, 1] = 0.0
    information = PoseInformation(blind, objective.information.fixed, ("a", "b", "c"), ("",) * 3, np.ones(3))
    with pytest.raises(RankDeficientError, match="all candidates together do not see b"):
        relax_largest(Objective(information, EOptimal()), counted(30, 8))


# --- the proof


@given(seed=st.integers(0, 10_000), worst=st.booleans(), scenarios=st.integers(1, 3), rank=st.integers(1, 5))
def test_any_multipliers_stay_below_every_value(seed, worst, scenarios, rank):
    rng = np.random.default_rng(seed)
    objective = drawn(seed, 20, scenarios=scenarios, fixed=rng.choice([0.0, 0.3]), worst=worst)
    feasible = (counted(20, 6), counted(20, 6, 6), priced(20, 9.0, seed))[seed % 3]
    root = rng.normal(size=(scenarios, 5, rank)) * rng.uniform(0, 2, (scenarios, 1, 1))
    bound, gains = semidefinite_bound(objective, feasible, root)
    top = gains @ feasible.best(gains)
    for _ in range(20):
        weights = some_weights(feasible, rng)
        value = objective.value(weights)
        assert bound <= value * (1 + 1e-12)
        assert bound + top - gains @ weights <= value * (1 + 1e-12)


@given(seed=st.integers(0, 10_000), size=st.floats(1e-6, 1.0))
def test_perturbed_multipliers_prove_no_more(seed, size):
    rng = np.random.default_rng(seed)
    objective, feasible = drawn(seed % 20, scenarios=2, worst=bool(seed % 2)), counted(30, 8)
    best = relax_largest(objective, feasible)
    master = column_generation.Restricted(np.arange(30), feasible.cap, np.zeros((0, 30)))
    root = _Largest(objective, feasible).solve(master, best.weights)[2].root
    exact = semidefinite_bound(objective, feasible, root)[0]
    assert exact == pytest.approx(best.value, rel=1e-6)
    moved = root + size * np.abs(root).max() * rng.normal(size=root.shape)
    assert semidefinite_bound(objective, feasible, moved)[0] <= best.value
    assert semidefinite_bound(objective, feasible, 1e3 * root)[0] == pytest.approx(exact, rel=1e-12)


def test_multipliers_that_see_nothing_prove_nothing():
    objective, feasible = drawn(0), counted(30, 8)
    bound, gains = semidefinite_bound(objective, feasible, np.zeros((1, 5, 2)))
    assert bound == 0
    assert not gains.any()
    only_nuisance = np.zeros((1, 5, 1))
    only_nuisance[0, 4] = 1.0
    assert semidefinite_bound(objective, feasible, only_nuisance)[0] == 0


def test_one_eigenvector_leaves_a_gap():
    """The largest eigenvalue is multiple at the optimum: one of its gradients bounds badly, the multipliers do not."""
    objective, feasible = drawn(4, 60), counted(60, 10)
    found = relax_largest(objective, feasible)
    variances = np.linalg.eigvalsh(objective.information.covariance(found.weights)[0])
    assert variances[-2] == pytest.approx(variances[-1], rel=1e-4)
    assert found.relative < 1e-6
    assert lower_bound(objective, feasible, found.weights)[0] < 0.98 * found.value


def test_worse_weights_do_not_pass():
    objective, feasible = drawn(4, 60), counted(60, 10)
    found = relax_largest(objective, feasible)
    rng = np.random.default_rng(0)
    worse = 0.99 * found.weights + 0.01 * some_weights(feasible, rng)
    assert feasible.holds(worse)
    assert objective.value(worse) - found.bound > 1e-5 * found.value


# --- cones


@given(seed=st.integers(0, 1000), size=st.integers(1, 6))
def test_packed_matrices(seed, size):
    one, two = np.random.default_rng(seed).normal(size=(2, 3, size, size))
    one, two = one + np.swapaxes(one, -1, -2), two + np.swapaxes(two, -1, -2)
    np.testing.assert_allclose((packed(one) * packed(two)).sum(axis=-1), (one * two).sum(axis=(-2, -1)), atol=1e-12)
    np.testing.assert_allclose(unpacked(packed(one), size), one, atol=1e-14)


def test_packed_matrices_go_column_by_column():
    root = np.sqrt(2)
    np.testing.assert_allclose(
        packed(np.array([[1.0, 2, 4], [2, 3, 5], [4, 5, 6]])), [1, 2 * root, 3, 4 * root, 5 * root, 6]
    )


def test_the_part_that_is_positive():
    root = root_of(np.diag([4.0, -1.0]))
    np.testing.assert_allclose(root @ root.T, np.diag([4.0, 0.0]), atol=1e-15)


def test_solve_cones_finds_the_smallest_eigenvalue():
    matrix = np.array([[2.0, 1.0], [1.0, 3.0]])
    rows = Rows("semidefinite", packed(np.eye(2))[:, None], packed(matrix), 2)
    x, (dual,) = solve_cones(np.array([-1.0]), [rows])
    assert x[0] == pytest.approx(np.linalg.eigvalsh(matrix)[0], rel=1e-7)
    assert np.trace(unpacked(dual, 2)) == pytest.approx(1, rel=1e-7)


class Found:
    """What a solver that loses its digits returns."""

    x, z = [np.nan], [0.0, 0.0, 0.0]


class PanicException(BaseException):  # the name that it has in Rust
    pass


@pytest.mark.parametrize("outcome", [Found(), PanicException("lost")])
def test_solve_cones_gives_nothing_where_there_is_no_number(monkeypatch, outcome):
    class Solver:
        def __init__(self, *_):
            pass

        def solve(self):
            if isinstance(outcome, BaseException):
                raise outcome
            return outcome

    monkeypatch.setattr("clarabel.DefaultSolver", Solver)
    rows = Rows("semidefinite", packed(np.eye(2))[:, None], np.ones(3), 2)
    assert solve_cones(np.array([-1.0]), [rows]) is None


def test_solve_cones_lets_other_errors_through(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("clarabel.DefaultSolver", interrupted)
    with pytest.raises(KeyboardInterrupt):
        solve_cones(np.array([-1.0]), [Rows("orthant", np.eye(1), np.ones(1))])
