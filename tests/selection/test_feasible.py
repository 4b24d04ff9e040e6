"""Which weights are allowed: the best of them against a linear programme, and the first few candidates only."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from hexopt.selection.feasible import Feasible


@given(seed=st.integers(0, 10_000), n=st.integers(1, 12), costs=st.booleans())
def test_best_solves_the_linear_programme(seed, n, costs):
    rng = np.random.default_rng(seed)
    cost = rng.uniform(0.5, 3, n) if costs else np.ones(n)
    feasible = Feasible(rng.choice([0.0, 0.3, 1.0, 2.0], n), cost, float(rng.uniform(0.1, n)))
    gain = np.round(rng.random(n), 1)  # with ties
    weights = feasible.best(gain)
    assert feasible.holds(weights)
    bounds = [(0, cap) for cap in feasible.cap]
    found = linprog(-gain, A_ub=cost[None], b_ub=[feasible.total], bounds=bounds)
    assert gain @ weights == pytest.approx(-found.fun, abs=1e-9)


@pytest.mark.parametrize("number", [1.0, 7.0, 299.5, 1000.0])
def test_best_of_many_candidates_takes_the_largest(number):
    gain = np.random.default_rng(0).permutation(1000).astype(float)
    weights = Feasible(np.ones(1000), np.ones(1000), number).best(gain)
    order = np.argsort(-gain)
    assert weights.sum() == number
    np.testing.assert_array_equal(weights[order[: int(number)]], 1.0)
    assert not weights[order[int(np.ceil(number)) :]].any()


def test_nothing_is_allowed_of_what_is_excluded():
    assert not Feasible(np.zeros(3), np.ones(3), 2.0).best(np.ones(3)).any()
    np.testing.assert_array_equal(
        Feasible(np.array([0.0, 1, 1]), np.ones(3), 1.0).best(np.array([9.0, 1, 2])), [0, 0, 1]
    )
