"""Fedorov's exchange: local optima by brute force, updates against values from scratch, budgets, starts."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hexopt.errors import RankDeficientError
from hexopt.information import PoseInformation
from hexopt.selection.criteria import AOptimal, DOptimal, EOptimal
from hexopt.selection.exchange import _Search, best_of, exchange, factors
from hexopt.selection.feasible import Feasible
from hexopt.selection.indices import ConditionNumber, ObservabilityIndex
from hexopt.selection.objective import Objective
from hexopt.selection.rounding import rounded, starts_of

CRITERIA = [AOptimal(), DOptimal(), EOptimal()]
FOR_COMPARISON = [ConditionNumber(), ObservabilityIndex(1), ObservabilityIndex(4)]
pools = settings(deadline=None, max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])


def of_each(n, number, cap=1.0):
    return Feasible(np.full(n, cap), np.ones(n), float(number))


def even(feasible):
    return np.full(len(feasible.cap), feasible.total / feasible.cost.sum())


def swaps(feasible, counts):
    """Yield every design that differs by one pose taken out and at most one put in, and those with one more."""
    n = len(counts)
    for old in [None, *np.flatnonzero(counts)]:
        for new in [None, *range(n)]:
            other = counts.copy()
            if old is not None:
                other[old] -= 1
            if new is not None:
                other[new] += 1
            if feasible.holds(other) and (other.sum() == counts.sum() or not feasible.counts_poses):
                yield other


def assert_locally_best(objective, feasible, counts, value):
    assert value == pytest.approx(objective.value(counts), rel=1e-12)
    assert feasible.holds(counts)
    others = np.array([objective.value(other) for other in swaps(feasible, counts)])
    assert others.min() >= value - 1e-9 * abs(value)


@pytest.mark.parametrize("criterion", CRITERIA + FOR_COMPARISON, ids=lambda c: c.name)
@pools
@given(seed=st.integers(0, 1000), number=st.integers(3, 8))
def test_it_ends_where_no_swap_helps(random_pool, criterion, seed, number):
    objective, feasible = Objective(random_pool(seed), criterion), of_each(12, number)
    start = starts_of(objective, feasible, even(feasible), 1)[0]
    counts, value = exchange(objective, feasible, start)
    assert value <= objective.value(start)
    assert counts.sum() == number
    assert_locally_best(objective, feasible, counts, value)


@pytest.mark.parametrize("worst", [False, True])
@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
def test_several_scenarios(random_pool, criterion, worst):
    objective, feasible = Objective(random_pool(1, scenarios=3), criterion, worst), of_each(12, 5)
    counts, value = best_of(objective, feasible, starts_of(objective, feasible, even(feasible)))
    assert_locally_best(objective, feasible, counts, value)


def test_poses_may_be_repeated_up_to_their_caps(random_pool):
    objective = Objective(random_pool(2), AOptimal())
    feasible = Feasible(np.r_[3.0, 2.5, np.full(10, 2.0)], np.ones(12), 9.0)
    counts, value = best_of(objective, feasible, starts_of(objective, feasible, even(feasible)))
    assert counts.max() > 1
    assert counts[1] <= 2
    assert_locally_best(objective, feasible, counts, value)


@pytest.mark.parametrize("criterion", CRITERIA, ids=lambda c: c.name)
def test_costs_stay_within_the_budget_and_fill_it(random_pool, criterion):
    objective = Objective(random_pool(3), criterion)
    feasible = Feasible(np.ones(12), np.linspace(1, 3, 12), 11.5)
    counts, value = best_of(objective, feasible, starts_of(objective, feasible, even(feasible)))
    left = feasible.total - feasible.cost @ counts
    assert 0 <= left < feasible.cost[counts == 0].min()
    assert_locally_best(objective, feasible, counts, value)


def test_an_expensive_pose_gives_way_to_two(random_pool):
    # the first pose costs as much as two others, of which each brings as much
    info = random_pool(4, n=10, m=3, k=3, rank=3)
    objective = Objective(info, DOptimal())
    feasible = Feasible(np.ones(10), np.r_[2.0, np.ones(9)], 2.0)
    start = np.eye(10, dtype=np.intp)[0]
    counts, value = exchange(objective, feasible, start)
    assert counts.sum() == 2
    assert value < objective.value(start)


@pools
@given(seed=st.integers(0, 1000), rank=st.integers(1, 4), scenarios=st.integers(1, 2))
def test_updates_are_values_from_scratch(random_pool, seed, rank, scenarios):
    info = random_pool(seed, rank=rank, scenarios=scenarios, fixed=0.01)
    objective, feasible = Objective(info, AOptimal()), of_each(12, 5)
    counts = np.r_[np.ones(5), np.zeros(7)].astype(np.intp)
    search = _Search(objective, feasible, counts, factors(info.blocks))
    new = np.arange(5, 12)
    for old in (0, 3, None):
        direct = [objective.value(counts + np.eye(12)[j] - (0 if old is None else np.eye(12)[old])) for j in new]
        np.testing.assert_allclose(search.values(new, old), direct, rtol=1e-8)


def test_updates_where_the_other_poses_are_too_few(random_pool):
    # four rows for four coordinates: without a pose the rest is singular, and with a copy of another the whole is
    info = random_pool(5, n=10, m=4, k=3, rank=1)
    info = info.take(np.r_[0:10, 1])
    objective, feasible = Objective(info, AOptimal()), of_each(11, 4)
    counts = np.r_[np.ones(4), np.zeros(7)].astype(np.intp)
    values = _Search(objective, feasible, counts, factors(info.blocks)).values(np.arange(4, 11), 0)
    direct = [objective.value(counts - np.eye(11)[0] + np.eye(11)[j]) for j in range(4, 11)]
    np.testing.assert_allclose(values[:-1], direct[:-1], rtol=1e-6)
    assert values[-1] == direct[-1] == np.inf


@pools
@given(seed=st.integers(0, 1000), rank=st.integers(1, 5))
def test_factors_give_the_blocks(random_pool, seed, rank):
    blocks = random_pool(seed, rank=rank).blocks.copy()
    blocks[:, 3] = 0.0
    found = factors(blocks)
    assert found.shape == (1, 12, rank, 5)
    np.testing.assert_allclose(np.swapaxes(found, -1, -2) @ found, blocks, rtol=1e-9, atol=1e-9 * blocks.max())


def test_duplicates_in_the_pool(random_pool):
    info = random_pool(6)
    twice = info.take(np.repeat(np.arange(12), 2))
    feasible = of_each(24, 6)
    objective = Objective(twice, DOptimal())
    counts, value = best_of(objective, feasible, starts_of(objective, feasible, even(feasible)))
    assert_locally_best(objective, feasible, counts, value)
    once = Objective(info, DOptimal())
    repeats = of_each(12, 6, cap=2.0)
    found = best_of(once, repeats, starts_of(once, repeats, even(repeats)))
    assert value == pytest.approx(found[1], rel=1e-9)


def test_all_candidates(random_pool):
    objective, feasible = Objective(random_pool(7), AOptimal()), of_each(12, 12)
    starts = starts_of(objective, feasible, np.ones(12))
    assert len(starts) == 1
    counts, value = best_of(objective, feasible, starts)
    np.testing.assert_array_equal(counts, np.ones(12))
    assert value == objective.value(np.ones(12))


def test_one_pose_after_what_was_measured(random_pool):
    objective, feasible = Objective(random_pool(8, fixed=0.1), AOptimal()), of_each(12, 1)
    counts, value = best_of(objective, feasible, starts_of(objective, feasible, even(feasible)))
    values = [objective.value(one) for one in np.eye(12)]
    assert value == min(values)
    assert counts.argmax() == np.argmin(values)


def test_a_start_that_sees_too_little_is_an_error(random_pool):
    objective, feasible = Objective(random_pool(9), AOptimal()), of_each(12, 3)
    with pytest.raises(RankDeficientError, match="do not see all parameters"):
        exchange(objective, feasible, np.eye(12, dtype=np.intp)[0])


def test_starts_are_mended():
    # ten poses that see the same two coordinates, and one that sees the third: weights that leave it out
    rows = np.zeros((1, 11, 2, 3))
    rows[0, :10, :, :2] = np.random.default_rng(0).normal(size=(10, 2, 2))
    rows[0, 10, 0, 2] = 1.0
    info = PoseInformation(np.swapaxes(rows, -1, -2) @ rows, np.zeros((1, 3, 3)), ("a", "b"), ("", ""), np.ones(2))
    objective, feasible = Objective(info, AOptimal()), of_each(11, 2)
    for start in starts_of(objective, feasible, np.r_[np.full(10, 0.2), 0.0], 12, np.random.default_rng(1)):
        assert start[10] == 1
        assert start.sum() == 2
        assert np.isfinite(objective.value(start))


def test_starts_are_the_same_again_and_differ_from_each_other(random_pool):
    objective, feasible = Objective(random_pool(10, n=30), AOptimal()), of_each(30, 6)
    weights = even(feasible)
    plain = starts_of(objective, feasible, weights)
    assert len(plain) == len({start.tobytes() for start in plain}) > 3
    np.testing.assert_array_equal(plain, starts_of(objective, feasible, weights))
    drawn = [starts_of(objective, feasible, weights, 20, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert {s.tobytes() for s in drawn[0]} != {s.tobytes() for s in drawn[2]}
    assert all(start.sum() == 6 and start.max() == 1 for start in drawn[0])


def test_whole_weights_are_kept():
    weights = np.array([0.3, 2.0, 0.0, 1.0, 0.7])
    np.testing.assert_array_equal(rounded(of_each(5, 4, cap=2.0), weights), [0, 2, 0, 1, 1])
    np.testing.assert_array_equal(rounded(of_each(5, 6, cap=2.0), weights), [1, 2, 1, 1, 1])
    costs = Feasible(np.full(5, 2.0), np.array([1.0, 2.0, 5.0, 1.0, 3.0]), 7.0)
    np.testing.assert_array_equal(rounded(costs, weights), [1, 2, 0, 2, 0])


def test_too_few_poses_say_how_many_it_takes(random_pool):
    objective = Objective(random_pool(11), AOptimal())
    with pytest.raises(RankDeficientError, match=r"no design of 2 .* all 5 parameters .* choose 3 or more"):
        starts_of(objective, of_each(12, 2), np.full(12, 2 / 12))
    with pytest.raises(RankDeficientError, match=r"no design within the budget of 1\.5"):
        starts_of(objective, Feasible(np.ones(12), np.full(12, 0.9), 1.5), np.full(12, 0.1))


def test_candidates_that_see_too_little_together(random_pool):
    info = random_pool(12, m=3, k=3, rank=1).take(np.zeros(12, dtype=np.intp))
    with pytest.raises(RankDeficientError, match="all candidates together"):
        starts_of(Objective(info, AOptimal()), of_each(12, 6), np.full(12, 0.5))
