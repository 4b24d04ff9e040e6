"""The relaxation: against its definition, on its own proof, and where it has to refuse."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError
from hexopt.information import PoseInformation, pose_information
from hexopt.selection import interior_point, relaxation
from hexopt.selection.criteria import AOptimal, Criterion, DOptimal
from hexopt.selection.feasible import Feasible
from hexopt.selection.interior_point import minimise
from hexopt.selection.objective import Objective
from hexopt.selection.reference import relaxed_by_cvxpy
from hexopt.selection.relaxation import relax

CRITERIA = [AOptimal(), DOptimal()]
LOCKS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}
NOISE = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)


def one_leg(lock, n, scenarios=1):
    robot = hx.robots.left_hand()
    loop = LOCKS.get(lock, hx.loops.LegLength)
    data = replace(hx.simulate_leg(robot, 3, lock, n, rng=0), noise=NOISE)
    return pose_information(
        loop(data), at=[None, *(robot.perturbed(0.3, rng=k).leg(3) for k in range(1, scenarios))][:scenarios]
    )


def counted(n, total, cap=1.0):
    return Feasible(np.full(n, float(cap)), np.ones(n), float(total))


def relative(criterion, one, other, main):
    """How far apart two values are, as a share of the variance."""
    return abs(1 - float(criterion.efficiency(one, other, main)))


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("lock", [*LOCKS, "none"])
@pytest.mark.parametrize("case", ["capped", "repeated", "costs", "measured", "seen before"])
def test_it_agrees_with_its_definition(lock, criterion, case):
    information, feasible = one_leg(lock, 60), counted(60, 7, 7 if case == "repeated" else 1)
    if case == "costs":
        feasible = replace(feasible, cost=np.random.default_rng(0).uniform(0.3, 3.0, 60))
    if case in ("measured", "seen before"):
        before = information.blocks[:, :1] if case == "measured" else 5 * information.blocks
        information = replace(information, fixed=information.fixed + before.sum(axis=1))
    objective = Objective(information, criterion)
    found = relax(objective, feasible, goal=1e-8)
    assert found.ok
    assert feasible.holds(found.weights)
    # Clarabel gives up on D of unlocked poses at the smaller tolerance
    defined = relaxed_by_cvxpy(objective, feasible, 1e-7 if lock == "none" and criterion.name == "D" else 1e-8)
    assert relative(criterion, defined, found.value, information.main) < 1e-6
    assert defined >= found.bound - 1e-6 * abs(found.bound)


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("worst", [False, True])
def test_it_agrees_with_its_definition_over_scenarios(criterion, worst):
    objective, feasible = Objective(one_leg("length", 50, scenarios=3), criterion, worst), counted(50, 8)
    found = relax(objective, feasible, goal=1e-8)
    assert found.ok
    assert found.mix.sum() == pytest.approx(1.0)
    defined = relaxed_by_cvxpy(objective, feasible)
    assert relative(criterion, defined, found.value, 3) < 1e-6


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize(("total", "cap"), [(4, 4), (20, 20), (7, 1), (150, 1), (1900, 1)])
def test_rounds_over_many_candidates_prove_the_same_as_all_at_once(criterion, total, cap):
    information = one_leg("direction", 2000)
    objective, feasible = Objective(information, criterion), counted(2000, total, cap)
    found = relax(objective, feasible)
    assert found.ok
    assert feasible.holds(found.weights)
    assert found.weights.sum() == pytest.approx(total)
    assert found.value == objective.value(found.weights)
    whole = minimise(objective, feasible, 1e-9)
    assert relative(criterion, objective.value(whole.weights), found.value, 6) < 1e-6


@pytest.mark.parametrize("worst", [False, True])
def test_ten_scenarios_and_more_candidates_than_are_taken_at_once(worst):
    objective = Objective(one_leg("length", 1500, scenarios=10), AOptimal(), worst)
    found = relax(objective, counted(1500, 10))
    assert found.ok
    assert found.mix.shape == (10, 1)


def test_candidates_that_alone_see_something_are_found():
    """One pose in 3000 sees the second parameter, and no sample has it."""
    rows = np.zeros((3000, 1, 2))
    rows[:, 0, 0] = np.random.default_rng(0).uniform(1, 2, 3000)
    rows[1717] = [0.0, 1.0]
    blocks = (np.swapaxes(rows, -1, -2) @ rows)[None]
    information = PoseInformation(blocks, np.zeros((1, 2, 2)), ("a", "b"), ("", ""), np.ones(2))
    found = relax(Objective(information, DOptimal()), counted(3000, 10, 10))
    assert found.ok
    assert found.weights[1717] == pytest.approx(5.0, rel=1e-3)


def test_candidates_that_help_nothing_are_all_as_good():
    """What is of interest is known already, and the candidates see another coordinate."""
    blocks = np.zeros((1, 3000, 3, 3))
    blocks[..., 2, 2] = 1.0
    information = PoseInformation(blocks, np.eye(3)[None], ("a", "b"), ("", ""), np.ones(2))
    found = relax(Objective(information, AOptimal()), counted(3000, 5))
    assert found.ok
    assert found.value == pytest.approx(2.0)
    assert found.weights.sum() == pytest.approx(5.0)


def test_duplicates_share_a_weight_and_change_nothing(random_pool):
    information = random_pool(2, n=30)
    twice = information.take(np.repeat(np.arange(30), 2))
    one = relax(Objective(information, AOptimal()), counted(30, 6, 2), goal=1e-8)
    two = relax(Objective(twice, AOptimal()), counted(60, 6, 1), goal=1e-8)
    assert two.value == pytest.approx(one.value, rel=1e-7)


def test_all_at_their_cap_is_proven_without_a_search(random_pool):
    found = relax(Objective(random_pool(0, n=12), AOptimal()), counted(12, 12))
    np.testing.assert_array_equal(found.weights, 1.0)
    assert found.ok
    assert found.relative == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("criterion", "curved"), [(AOptimal(), "linear"), (DOptimal(), "logdet")])
def test_second_derivatives_against_differences(random_pool, criterion, curved):
    assert criterion.curved == curved
    objective, feasible = Objective(random_pool(4, n=15, m=6, k=2, scenarios=2), criterion), counted(15, 5)
    posed = interior_point._Posed(objective, feasible)
    at = posed.start()
    now = interior_point._Derivatives(posed, at)
    step = 1e-6
    for i in (0, 7):
        shift = np.where(np.arange(15) == i, step, 0.0)
        ahead = interior_point._Derivatives(posed, replace(at, x=at.x + shift))
        behind = interior_point._Derivatives(posed, replace(at, x=at.x - shift))
        slope = (posed.value(ahead.values) - posed.value(behind.values)) / (2 * step)
        assert slope == pytest.approx(-now.gains[i], rel=1e-6)
        bend = -(ahead.gains - behind.gains) / (2 * step)
        np.testing.assert_allclose(now.factor @ now.factor[i], bend, rtol=1e-5, atol=1e-7 * np.abs(bend).max())


def test_a_status_is_no_proof(monkeypatch, random_pool):
    """A solver that claims success with poor weights is found out by the bound."""

    def careless(objective, feasible, goal):
        return replace(minimise(objective, feasible, 0.1), gap=0.0)

    monkeypatch.setattr(relaxation, "minimise", careless)
    found = relax(Objective(random_pool(6, n=60), AOptimal()), counted(60, 8))
    assert not found.ok
    assert found.gap > 0
    assert found.stopped == "the gap does not get smaller"


def test_weights_that_are_not_allowed_are_no_answer(monkeypatch, random_pool):
    def greedy(objective, feasible, goal):
        found = minimise(objective, feasible, goal)
        return replace(found, weights=1.001 * found.weights)

    monkeypatch.setattr(relaxation, "minimise", greedy)
    found = relax(Objective(random_pool(6, n=60), AOptimal()), counted(60, 8))
    assert not found.ok
    assert found.relative == np.inf


def test_a_convex_criterion_without_second_derivatives_has_a_bound_that_holds(random_pool):
    class Root(AOptimal):
        """The root of tr C, convex in the weights."""

        name, curved = "root", ""

        def pieces(self, covariance):
            return np.sqrt(super().pieces(covariance))

        def slopes(self, covariance):
            return super().slopes(covariance) / (2 * self.pieces(covariance)[..., None, None])

    information, feasible = random_pool(8, n=50), counted(50, 8)
    found = relax(Objective(information, Root()), feasible)
    best = relax(Objective(information, AOptimal()), feasible)
    assert found.bound <= np.sqrt(best.value)
    assert found.bound == pytest.approx(np.sqrt(best.value), rel=1e-5)


class TestRefusals:
    def test_fewer_candidates_than_are_to_be_measured(self, random_pool):
        with pytest.raises(InputError, match="13 to be measured, but all candidates together make 12"):
            relax(Objective(random_pool(0, n=12), AOptimal()), counted(12, 13))

    def test_what_no_candidate_sees_is_named(self):
        information = one_leg("direction", 30)
        blind = np.eye(8)
        blind[2, 2] = 0.0
        hidden = replace(information, blocks=blind @ information.blocks @ blind)
        with pytest.raises(RankDeficientError, match=r"do not see platform_point\.z") as error:
            relax(Objective(hidden, AOptimal()), counted(30, 7))
        assert error.value.combinations == ("platform_point.z",)

    def test_a_combination_is_named(self):
        rows = np.random.default_rng(0).normal(size=(20, 1, 2)) @ np.array([[1.0, 0, 0], [0, 1, 1]])
        blocks = (np.swapaxes(rows, -1, -2) @ rows)[None]
        information = PoseInformation(blocks, np.zeros((1, 3, 3)), ("a", "b", "c"), ("",) * 3, np.ones(3))
        with pytest.raises(RankDeficientError, match="do not see b − c"):
            relax(Objective(information, DOptimal()), counted(20, 7))

    def test_a_criterion_that_is_not_convex(self, random_pool):
        class Crooked(AOptimal):
            name, convex = "crooked", False

        assert issubclass(Crooked, Criterion)
        with pytest.raises(InputError, match="crooked is not convex"):
            relax(Objective(random_pool(0), Crooked()), counted(12, 5))

    def test_a_criterion_without_a_definition_here(self, random_pool):
        class Other(AOptimal):
            name = "other"

        with pytest.raises(InputError, match="other: expected A, D, E, G or κ"):
            relaxed_by_cvxpy(Objective(random_pool(0), Other()), counted(12, 5))
