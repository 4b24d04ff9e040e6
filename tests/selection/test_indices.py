"""The condition number and O1…O5 as criteria: values, gradients, what is convex and what is not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import InputError
from hexopt.information import PoseInformation, pose_information
from hexopt.observing import observability_indices
from hexopt.selection.certificate import lower_bound
from hexopt.selection.criteria import DOptimal, EOptimal
from hexopt.selection.exchange import exchange
from hexopt.selection.feasible import Feasible
from hexopt.selection.objective import Objective

ALL = [hx.ConditionNumber(), *(hx.ObservabilityIndex(number) for number in range(1, 6))]
NAMES = ["κ", "O1", "O2", "O3", "O4", "O5"]
CONVEX = [criterion for criterion in ALL if criterion.convex]
seeds = st.integers(0, 10_000)


def random_information(seed, n=8, m=5, k=3, rows=2):
    """Poses of two rows each, by coordinates of uneven size."""
    rows = np.random.default_rng(seed).normal(size=(1, n, rows, m)) * np.geomspace(1, 20, m)
    labels = tuple(f"x.{i}" for i in range(k))
    return PoseInformation(np.swapaxes(rows, -1, -2) @ rows, np.zeros((1, m, m)), labels, ("cm",) * k, np.ones(k))


def weights_of(seed, n=8):
    return np.random.default_rng(seed).uniform(0.1, 1, n)


def test_names():
    assert [criterion.name for criterion in ALL] == NAMES
    assert [criterion.name for criterion in CONVEX] == ["O1", "O3", "O5"]
    assert [criterion.full for criterion in ALL] == [True] + [False] * 5


@given(st.lists(st.floats(0.1, 10), min_size=1, max_size=6), seeds)
def test_values_are_inverse_indices(deviations, seed):
    """Of a covariance with known standard deviations along random axes."""
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(deviations),) * 2))[0]
    covariance = axes @ np.diag(np.square(deviations)) @ axes.T
    singular = np.sort(1 / np.array(deviations))[::-1]
    values = [float(criterion.value(covariance)) for criterion in ALL]
    assert values[1:] == pytest.approx(list(1 / observability_indices(singular)))
    assert values[0] == pytest.approx(singular[0] / singular[-1])


@pytest.mark.parametrize("criterion", ALL, ids=NAMES)
def test_a_batch_and_what_is_not_seen(criterion):
    covariances = np.stack([np.diag([1.0, 4.0]), np.diag([np.inf, np.inf]), np.eye(2)])
    values = criterion.value(covariances)
    assert values[0] == criterion.value(covariances[0])
    assert np.isinf(values[1])
    assert values[2] == (2.0 if criterion.name == "O5" else 1.0)


@pytest.mark.parametrize("criterion", ALL, ids=NAMES)
def test_slopes_are_derivatives(criterion):
    rng = np.random.default_rng(0)
    root, change = rng.normal(size=(4, 4)), rng.normal(size=(4, 4))
    covariance, change = root @ root.T + np.eye(4), change + change.T
    slope = np.vdot(criterion.slopes(covariance)[0], change)
    ahead, behind = (float(criterion.value(covariance + step * change)) for step in (1e-6, -1e-6))
    assert slope == pytest.approx((ahead - behind) / 2e-6, rel=1e-6)


@pytest.mark.parametrize("criterion", ALL, ids=NAMES)
def test_gains_are_derivatives_by_the_weights(criterion):
    objective, weights = Objective(random_information(1), criterion), weights_of(1)
    local = objective.local(weights)
    gains = objective.gains(local.sensitivity(objective.mix(local.pieces)))
    numeric = [objective.value(weights - step) - objective.value(weights + step) for step in 5e-7 * np.eye(8)]
    assert gains == pytest.approx(np.array(numeric) / 1e-6, rel=1e-5, abs=1e-7)


def test_the_condition_number_is_of_all_unknowns():
    """As that of the report, of the same scaled rows; with nuisances eliminated it is another."""
    robot = hx.robots.left_hand()
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    data = hx.simulate_leg(robot, 3, "direction", 9, noise=noise, rng=0)
    loop, spread = hx.loops.FixedDirection(data), {"base_point": 0.5}
    info, seen = pose_information(loop, spread=spread), hx.observability(loop, spread=spread)
    found = [Objective(info, criterion).value(np.ones(9)) for criterion in ALL]
    assert found[0] == pytest.approx(seen.condition, rel=1e-6)
    assert found[0] ** 2 == pytest.approx(np.linalg.cond(info.total(np.ones(9))[0]), rel=1e-6)
    assert 1 / np.array(found[1:]) == pytest.approx(list(seen.indices.values()) * np.array([3, 1, 1, 1, 1]), rel=1e-6)
    assert found[0] > 1.5 * found[2]


@given(seeds, seeds)
def test_o1_chooses_as_d_and_o3_as_e(one, other):
    info = random_information(2)
    for index, twin in ((1, DOptimal()), (3, EOptimal())):
        by_index, by_twin = Objective(info, hx.ObservabilityIndex(index)), Objective(info, twin)
        better = by_index.value(weights_of(one)) <= by_index.value(weights_of(other))
        assert better == (by_twin.value(weights_of(one)) <= by_twin.value(weights_of(other)))


@given(seeds, seeds, st.sampled_from(CONVEX), st.floats(0.05, 0.95))
def test_what_is_called_convex_is(one, other, criterion, share):
    objective = Objective(random_information(one), criterion)
    start, end = weights_of(one), weights_of(other + 1)
    between = objective.value(share * start + (1 - share) * end)
    assert between <= (share * objective.value(start) + (1 - share) * objective.value(end)) * (1 + 1e-9)


@given(seeds, seeds, st.sampled_from(CONVEX))
def test_bounds_of_what_is_convex_hold(one, other, criterion):
    objective = Objective(random_information(one), criterion)
    feasible = Feasible(np.ones(8), np.ones(8), 5.0)
    bound, _ = lower_bound(objective, feasible, np.full(8, 5 / 8))
    weights = weights_of(other)
    weights = feasible.best(weights) if other % 2 else np.minimum(weights * 5 / weights.sum(), 1.0)
    assert bound <= objective.value(weights) * (1 + 1e-9)


@pytest.mark.parametrize(
    "criterion", [criterion for criterion in ALL if not criterion.convex], ids=lambda criterion: criterion.name
)
def test_what_is_called_not_convex_is_not(criterion):
    """A segment on which the value in the middle is above both ends: no bound can come from a gradient."""
    table = np.array([[1.0, 9.0], [9.0, 1.0], [0.0, 80.0]])  # two coordinates, each seen by itself
    blocks = (table[:, :, None] * np.eye(2))[None]
    info = PoseInformation(blocks, np.zeros((1, 2, 2)), ("x", "y"), ("cm", "cm"), np.ones(2))
    objective = Objective(info, criterion)
    ends = np.random.default_rng(0).uniform(1e-3, 1, size=(300, 2, 3))
    middle = [objective.value(pair.mean(axis=0)) for pair in ends]
    excess = np.array(middle) - [(objective.value(one) + objective.value(two)) / 2 for one, two in ends]
    assert excess.max() > 0.01


@pytest.mark.parametrize("criterion", ALL, ids=NAMES)
def test_exchange_ends_where_no_swap_helps(criterion):
    info = random_information(3, n=10)
    objective = Objective(info, criterion)
    feasible = Feasible(np.ones(10), np.ones(10), 5.0)
    start = np.repeat([1, 0], 5)
    counts, value = exchange(objective, feasible, start)
    assert counts.sum() == 5
    assert value <= objective.value(start.astype(float))
    assert value == pytest.approx(objective.value(counts.astype(float)))
    for old in np.flatnonzero(counts):
        for new in np.flatnonzero(counts == 0):
            swapped = counts.astype(float)
            swapped[[old, new]] = 0, 1
            assert objective.value(swapped) >= value * (1 - 1e-9)


def test_efficiency_is_of_variances():
    assert float(hx.ObservabilityIndex(3).efficiency(1.0, 2.0, 3)) == 0.25
    assert np.isnan(hx.ConditionNumber().efficiency(np.nan, 2.0, 3))


@pytest.mark.parametrize("number", [0, 6, True, 2.5, "O1"])
def test_other_numbers_are_wrong(number):
    with pytest.raises(InputError, match="number: expected"):
        hx.ObservabilityIndex(number)
