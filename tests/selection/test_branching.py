"""Branch and bound: against all designs counted out, its bounds, budgets and repeats, and what stops it."""

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import hexopt as hx
from hexopt.information import pose_information
from hexopt.selection import branching
from hexopt.selection.batched_relaxation import BatchedRelaxation
from hexopt.selection.branching import prove
from hexopt.selection.certificate import lower_bound
from hexopt.selection.criteria import AOptimal, DOptimal, EOptimal
from hexopt.selection.exchange import exchange
from hexopt.selection.feasible import Feasible
from hexopt.selection.interior_point import minimise
from hexopt.selection.objective import Objective
from hexopt.selection.relaxation import relax
from hexopt.selection.rounding import starts_of

CRITERIA = [AOptimal(), DOptimal()]
pools = settings(deadline=None, max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])


def of_each(n, number, cap=1.0):
    return Feasible(np.full(n, cap), np.ones(n), float(number))


def begun(objective, feasible):
    """The relaxation, and the worst of the starts, so that there is something to find."""
    relaxation = relax(objective, feasible)
    starts = starts_of(objective, feasible, relaxation.weights, 6, np.random.default_rng(0))
    return relaxation, max(starts, key=objective.value)


def all_values(objective, number):
    """The objective of all designs of distinct poses, in chunks."""
    info = objective.information
    designs = np.array(list(combinations(range(info.n_poses), number)))
    flat = info.blocks.reshape(len(info.blocks), info.n_poses, -1)
    values = []
    for part in np.array_split(designs, -(-len(designs) // 50_000)):
        chosen = np.zeros((len(part), info.n_poses))
        np.put_along_axis(chosen, part, 1.0, axis=1)
        totals = (chosen @ flat).reshape(len(flat), len(part), info.size, info.size).swapaxes(0, 1)
        values.append(objective.of_totals(info.fixed + totals))
    return np.concatenate(values)


def assert_best(objective, feasible, proof, best):
    assert proof.proven
    assert feasible.holds(proof.counts)
    assert proof.value == objective.value(proof.counts)
    assert proof.value == pytest.approx(best, rel=1e-9)
    assert best - 2e-9 * abs(best) <= proof.bound <= proof.value
    assert "no design is better" in proof.stopped


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
@pytest.mark.parametrize("lock", ["direction", "length"])
def test_it_finds_the_best_of_all_designs(lock, criterion):
    data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, 30, noise=hx.UniformNoise(0.01, 0.0002, 0.01), rng=0)
    loop = {"direction": hx.loops.FixedDirection, "length": hx.loops.FixedLength}[lock](data)
    information = pose_information(loop).take(np.arange(30 if lock == "length" else 20))
    objective, feasible = Objective(information, criterion), of_each(information.n_poses, 6)
    relaxation, start = begun(objective, feasible)
    values = all_values(objective, 6)
    proof = prove(objective, feasible, start, relaxation)
    assert_best(objective, feasible, proof, values.min())
    assert relaxation.bound <= values.min()


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
@pools
@given(seed=st.integers(0, 1000), number=st.integers(3, 7), scenarios=st.integers(1, 2))
def test_random_pools(random_pool, criterion, seed, number, scenarios):
    objective, feasible = Objective(random_pool(seed, scenarios=scenarios), criterion), of_each(12, number)
    relaxation, start = begun(objective, feasible)
    assert_best(objective, feasible, prove(objective, feasible, start, relaxation), all_values(objective, number).min())


@pytest.mark.parametrize("criterion", [*CRITERIA, EOptimal()], ids=lambda c: c.name)
def test_without_enumeration_of_nodes(random_pool, monkeypatch, criterion):
    monkeypatch.setattr(branching, "FEW", 1)
    objective, feasible = Objective(random_pool(3, n=10), criterion), of_each(10, 4)
    start = starts_of(objective, feasible, np.full(10, 0.4), 1)[0]
    relaxation = relax(objective, feasible)
    assert_best(objective, feasible, prove(objective, feasible, start, relaxation), all_values(objective, 4).min())


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
def test_repeats_and_costs(random_pool, criterion):
    objective = Objective(random_pool(4, n=6), criterion)
    for feasible in (
        of_each(6, 5, cap=2.0),
        Feasible(np.ones(6), np.linspace(1, 2, 6), 6.3),
        Feasible(np.array([2.0, 1.0, 2.0, 1.0, 1.0, 1.0]), np.linspace(1, 2, 6), 6.3),
    ):
        every = [np.array(c) for c in product(*(range(int(cap) + 1) for cap in feasible.cap))]
        best = min(objective.value(c) for c in every if feasible.holds(c))
        relaxation, start = begun(objective, feasible)
        assert_best(objective, feasible, prove(objective, feasible, start, relaxation), best)


def test_the_worst_scenario(random_pool):
    objective, feasible = Objective(random_pool(5, n=9, scenarios=2), AOptimal(), worst=True), of_each(9, 4)
    relaxation, start = begun(objective, feasible)
    assert_best(objective, feasible, prove(objective, feasible, start, relaxation), all_values(objective, 4).min())


@pytest.mark.parametrize("limits", [{"seconds": 0.0}, {"nodes": 0}, {"nodes": 1}])
@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
def test_what_stops_it_early_is_honest(random_pool, criterion, limits):
    objective, feasible = Objective(random_pool(6, n=20, rank=1), criterion), of_each(20, 6)
    relaxation, start = begun(objective, feasible)
    best = all_values(objective, 6).min()
    proof = prove(objective, feasible, start, relaxation, **limits)
    assert not proof.proven
    assert "not proven" in proof.stopped
    assert relaxation.bound - 1e-6 * abs(best) <= proof.bound < best
    assert best <= proof.value + 1e-12 * abs(best)
    assert proof.value <= objective.value(start)
    assert proof.nodes <= limits.get("nodes", 0) + branching.BATCH


def test_poor_weights_cost_time_and_no_truth(random_pool):
    objective, feasible = Objective(random_pool(7), AOptimal()), of_each(12, 5)
    relaxation, start = begun(objective, feasible)
    poor = np.full(12, 5 / 12)
    worse = type(relaxation)(**{**vars(relaxation), "weights": poor, "bound": np.inf, "mix": None})
    proof = prove(objective, feasible, start, worse)
    assert_best(objective, feasible, proof, all_values(objective, 5).min())


def test_all_candidates_and_one_pose(random_pool):
    objective = Objective(random_pool(8, fixed=0.1), AOptimal())
    for number in (1, 11, 12):
        feasible = of_each(12, number)
        relaxation = relax(objective, feasible)
        start = starts_of(objective, feasible, relaxation.weights, 1)[0]
        proof = prove(objective, feasible, start, relaxation)
        assert_best(objective, feasible, proof, all_values(objective, number).min())


def test_duplicates_in_the_pool(random_pool):
    once = random_pool(9, n=8)
    objective, feasible = Objective(once.take(np.repeat(np.arange(8), 2)), DOptimal()), of_each(16, 4)
    relaxation, start = begun(objective, feasible)
    assert_best(objective, feasible, prove(objective, feasible, start, relaxation), all_values(objective, 4).min())


def test_a_proven_start_is_kept(random_pool):
    objective, feasible = Objective(random_pool(10), DOptimal()), of_each(12, 5)
    relaxation, start = begun(objective, feasible)
    first = prove(objective, feasible, start, relaxation)
    again = prove(objective, feasible, first.counts, relaxation)
    np.testing.assert_array_equal(again.counts, first.counts)
    assert exchange(objective, feasible, first.counts)[1] == first.value
    with pytest.raises(ValueError, match="read-only"):
        first.counts[0] = 1


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
def test_relaxations_at_once_are_those_one_by_one(random_pool, criterion):
    info = random_pool(11, n=40, m=6, k=4)
    objective, cost = Objective(info, criterion), np.linspace(1, 2, 40)
    rng = np.random.default_rng(0)
    cap = (rng.random((5, 40)) < 0.7) * rng.integers(1, 3, (5, 40)).astype(float)
    rest, fixed = np.linspace(4, 9, 5), info.blocks[0, :5] * 0.5
    found = BatchedRelaxation(objective, of_each(40, 5)).solve(fixed, cap, rest, 1e-8, np.inf)
    weighed = BatchedRelaxation(objective, Feasible(np.ones(40), cost, 5.0)).solve(fixed, cap, rest, 1e-8, np.inf)
    for costs, all_weights in ((np.ones(40), found), (cost, weighed)):
        for before, most, total, weights in zip(fixed, cap, rest, all_weights, strict=True):
            free = np.flatnonzero(most)
            inner = Objective(type(info)(**{**vars(info.take(free)), "fixed": before[None]}), criterion)
            room = Feasible(most[free], costs[free], float(total))
            assert (weights[most == 0] == 0).all()
            assert room.holds(weights[free])
            value, bound = inner.value(weights[free]), lower_bound(inner, room, weights[free])[0]
            assert bound <= value <= bound + 1e-7 * abs(bound)
            assert value == pytest.approx(inner.value(minimise(inner, room).weights), rel=1e-7)
