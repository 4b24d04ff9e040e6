"""The least condition number: by hand, against cvxpy, and what any multipliers may prove."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError
from hexopt.information import PoseInformation, main_covariance, pose_information
from hexopt.selection.condition import condition_bound, relax_condition
from hexopt.selection.feasible import Feasible
from hexopt.selection.indices import ConditionNumber
from hexopt.selection.objective import Objective
from hexopt.selection.reference import relaxed_by_cvxpy

NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)


def information_of(blocks, fixed=None, main=None):
    size = np.shape(blocks)[-1]
    before = np.zeros((size, size)) if fixed is None else np.asarray(fixed, dtype=float)
    names = tuple("xyzuvw"[: main or size])
    return PoseInformation(np.asarray(blocks, dtype=float)[None], before[None], names, names, np.ones(len(names)))


def drawn(seed, n_poses=30, size=4, fixed=0.0):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(n_poses, 2, size)) * rng.uniform(0.3, 3, size)
    before = fixed * rng.normal(size=(size, size))
    return information_of(np.swapaxes(rows, -1, -2) @ rows, before.T @ before, main=2)


def counted(n_poses, number, cap=1.0):
    return Feasible(np.full(n_poses, float(cap)), np.ones(n_poses), float(number))


TWO = np.array([np.diag([1.0, 0.0]), np.diag([0.0, 4.0])])


@pytest.mark.parametrize(
    ("feasible", "fixed", "kappa", "weights"),
    [
        (counted(2, 2, 2), None, 1.0, [1.6, 0.4]),
        (counted(2, 2), None, 2.0, [1.0, 1.0]),  # the cap binds only because N of them are measured
        (Feasible(np.ones(2), np.array([1.0, 1.5]), 2.5), None, 1.0, None),  # with costs, less may be spent
        (Feasible(np.array([0.0, 1.0]), np.ones(2), 1.0), [[3.0, 0], [0, 0]], np.sqrt(4 / 3), [0.0, 1.0]),
    ],
)
def test_by_hand(feasible, fixed, kappa, weights):
    found = relax_condition(information_of(TWO, fixed), feasible)
    assert found.value == pytest.approx(kappa, rel=1e-6)
    assert found.bound == pytest.approx(kappa, rel=1e-6)
    assert found.ok
    if weights is not None:
        np.testing.assert_allclose(found.weights, weights, atol=1e-5)


@pytest.mark.parametrize("fixed", [0.0, 3.0])
@pytest.mark.parametrize(
    "feasible",
    [counted(30, 8), counted(30, 8, 8), Feasible(np.full(30, 0.5), np.linspace(1, 2, 30), 9.0)],
    ids=["cap", "free", "cost"],
)
def test_agrees_with_cvxpy(fixed, feasible):
    information = drawn(1, fixed=fixed)
    found = relax_condition(information, feasible)
    assert found.ok
    assert found.value == pytest.approx(relaxed_by_cvxpy(Objective(information, ConditionNumber()), feasible), rel=1e-6)
    assert feasible.holds(found.weights)
    if feasible.counts_poses:
        assert found.weights.sum() == pytest.approx(8, rel=1e-12)


@pytest.mark.parametrize(("lock", "loop"), [("direction", hx.loops.FixedDirection), ("leg", hx.loops.FixedLeg)])
@pytest.mark.parametrize(("number", "cap"), [(8, 1), (8, 8), (300, 1)])
def test_many_candidates_and_bad_scales(lock, loop, number, cap):
    """κ is near a million here, its square 1e12."""
    data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, 2000, noise=NOISE, rng=0)
    information = pose_information(loop(data))
    found = relax_condition(information, counted(2000, number, cap))
    assert found.ok
    assert 1 < found.bound <= found.value * (1 + 1e-9)
    full = Objective(information, ConditionNumber())
    assert found.value == pytest.approx(full.value(found.weights), rel=1e-4)  # the criterion rounds by κ² · 2e-16
    rng = np.random.default_rng(0)
    for _ in range(20):
        design = np.bincount(rng.choice(2000, number, replace=cap > 1), minlength=2000).astype(float)
        assert full.value(design) > found.bound


@given(seed=st.integers(0, 10_000), rank=st.integers(1, 4))
def test_any_multipliers_stay_below_every_value(seed, rank):
    rng = np.random.default_rng(seed)
    information = drawn(seed, 15, fixed=rng.choice([0.0, 1.0]))
    free = Feasible(np.full(15, 2.0), rng.uniform(0.5, 2, 15), 7.0)
    feasible = (counted(15, 6), free)[seed % 2]
    large, small = rng.normal(size=(2, 4, rank))
    bound = condition_bound(information, feasible, large, small)
    assert bound >= 1
    for _ in range(20):
        shares = rng.dirichlet(np.full(15, 0.5)) * feasible.total / feasible.cost
        weights = np.minimum(shares, feasible.cap)
        if feasible.counts_poses:
            room = feasible.cap - weights
            weights = weights + room * (feasible.total - weights.sum()) / room.sum()
        else:
            weights = weights * rng.random()
        total = information.total(weights)[0]
        values = np.linalg.eigvalsh(total)
        assert values[-1] >= bound**2 * values[0] * (1 - 1e-9)


def test_the_bound_is_one_where_multipliers_say_nothing():
    information = drawn(0)
    assert condition_bound(information, counted(30, 8), np.zeros((4, 1)), np.ones((4, 1))) == 1
    assert condition_bound(information, counted(30, 8), np.ones((4, 1)), np.zeros((4, 1))) == 1


def test_a_failing_solver_proves_nothing(monkeypatch):
    monkeypatch.setattr("hexopt.selection.condition.solve_cones", lambda *_: None)
    found = relax_condition(drawn(0), counted(30, 8))
    assert not found.ok
    assert found.bound == 1


def test_what_cannot_be_designed():
    two = PoseInformation(np.ones((2, 3, 1, 1)), np.zeros((2, 1, 1)), ("x",), ("",), np.ones(1))
    with pytest.raises(InputError, match="one scenario, got 2"):
        relax_condition(two, counted(3, 1))
    with pytest.raises(InputError, match="5 poses to be measured, but the candidates make 2"):
        relax_condition(information_of(TWO), counted(2, 5))
    with pytest.raises(RankDeficientError, match="all candidates together do not see y"):
        relax_condition(information_of(TWO[:1]), counted(1, 1))


def test_the_schur_complement_has_no_such_programme():
    """Half of either has a worse condition number than both: not even quasi-convex. That of the full M is."""
    roots = np.array([[[2.0, -2, 2], [2, -1, 1], [0, 1, 0]], [[2, 2, 1], [0, -1, 0], [-1, -2, -1]]])
    one, two = np.swapaxes(roots, -1, -2) @ roots

    def condition(matrix):
        values = np.linalg.eigvalsh(matrix)
        return values[-1] / values[0]

    def eliminated(matrix):
        return condition(np.linalg.inv(main_covariance(matrix, 2)))

    middle = (one + two) / 2
    assert [eliminated(m) for m in (one, two)] == pytest.approx([1.25, 2.0])
    assert eliminated(middle) > 11
    assert condition(middle) < max(condition(one), condition(two))
    assert not ConditionNumber().convex
