"""The lower bound: what proves, and what must not."""

from itertools import combinations

import numpy as np
import pytest

from hexopt.errors import RankDeficientError
from hexopt.selection.certificate import lower_bound
from hexopt.selection.criteria import AOptimal, DOptimal
from hexopt.selection.feasible import Feasible
from hexopt.selection.objective import Objective
from hexopt.selection.relaxation import relax

CRITERIA = [AOptimal(), DOptimal()]


def capped(n, total):
    return Feasible(np.ones(n), np.ones(n), float(total))


def some_weights(feasible, rng):
    """Allowed weights at random, that spend the budget."""
    return feasible.best(rng.uniform(0.1, 1.0, len(feasible.cap))) * 0.5 + 0.5 * (
        feasible.cap * feasible.total / float(feasible.cost @ feasible.cap)
    )


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize(("scenarios", "worst"), [(1, False), (3, False), (3, True)])
def test_no_design_goes_below_a_bound_from_any_weights(random_pool, criterion, scenarios, worst):
    objective = Objective(random_pool(1, n=9, scenarios=scenarios), criterion, worst)
    feasible = capped(9, 4)
    designs = np.zeros((126, 9))
    for row, chosen in zip(designs, combinations(range(9), 4), strict=True):
        row[list(chosen)] = 1.0
    least = min(objective.value(one) for one in designs)
    rng = np.random.default_rng(0)
    for _ in range(20):
        assert lower_bound(objective, feasible, some_weights(feasible, rng))[0] <= least
    assert relax(objective, feasible, goal=1e-8).bound <= least


@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize("worst", [False, True])
@pytest.mark.parametrize("seed", range(20))
def test_a_bound_is_below_any_allowed_weights(random_pool, seed, worst, criterion):
    rng = np.random.default_rng(seed)
    objective = Objective(random_pool(seed, n=20, scenarios=2, fixed=1e-3), criterion, worst)
    feasible = Feasible(rng.uniform(0.5, 2.0, 20), rng.uniform(0.5, 2.0, 20), 6.0)
    mix = rng.uniform(size=(2, 1))
    bound, gains = lower_bound(objective, feasible, some_weights(feasible, rng), mix)
    other = some_weights(feasible, rng)
    value = objective.value(other)
    assert bound <= value + 1e-12 * abs(value)
    # the gains bound every single design, too
    assert bound + gains @ (feasible.best(gains) - other) <= value + 1e-12 * abs(value)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_perturbed_weights_do_not_pass(random_pool, criterion):
    objective, feasible = Objective(random_pool(3, n=40), criterion), capped(40, 8)
    found = relax(objective, feasible, goal=1e-7)
    assert found.ok
    rng = np.random.default_rng(0)
    for size in (1e-3, 1e-2, 0.1):
        weights = (1 - size) * found.weights + size * some_weights(feasible, rng)
        assert feasible.holds(weights)
        bound, _ = lower_bound(objective, feasible, weights)
        value = objective.value(weights)
        assert bound < found.bound
        assert 1 - criterion.efficiency(bound, value, 3) > 10 * found.goal


def test_multipliers_are_not_taken_on_trust(random_pool):
    objective, feasible = Objective(random_pool(5, n=20, scenarios=3), AOptimal(), worst=True), capped(20, 6)
    found = relax(objective, feasible, goal=1e-7)
    for mix in (100 * found.mix, found.mix - 0.5 * (found.mix < 1e-3)):
        bound, _ = lower_bound(objective, feasible, found.weights, mix)
        assert bound == pytest.approx(found.bound, rel=1e-2)
        assert bound <= found.value


def test_weights_that_do_not_see_everything_prove_nothing(random_pool):
    objective = Objective(random_pool(0, n=12), AOptimal())
    with pytest.raises(RankDeficientError, match="these poses do not see") as error:
        lower_bound(objective, capped(12, 4), np.eye(12)[0])
    assert error.value.combinations
