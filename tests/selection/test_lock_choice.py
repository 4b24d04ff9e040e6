"""The best direction, point or length: the bounds prove the others beaten, and what is hopeless is told."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.pools import Clamp

LOOPS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}
NOISE = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
SMALL = {"n_locks": 6, "n_candidates": 150, "rng": 0}
HOPELESS = [1.0, 0.0, 0.3]


@pytest.mark.parametrize("lock", LOOPS)
def test_the_best_is_below_the_bounds_of_the_others_and_no_worse_than_home(left_hand, lock):
    choice = hx.select_lock(left_hand, 3, lock, 7, NOISE, **SMALL)
    others = np.delete(np.arange(6), choice.best)
    assert choice.hopeless == 0
    assert np.isfinite(choice.bounds).all()
    unmade = others[np.isnan(choice.values[others])]
    assert unmade.size
    assert (choice.bounds[unmade] >= choice.design.value).all()
    assert choice.design.value == np.nanmin(choice.values) <= np.nanmax(choice.bounds)
    home = Clamp.at_home(left_hand, 3, choice.lock)
    np.testing.assert_allclose(choice.tried[0], home.value, rtol=1e-12)
    assert np.isfinite(choice.values[0]) or choice.design.value <= choice.bounds[0]
    again = hx.select_poses(LOOPS[lock](choice.pool.leg(3)), 7)
    assert np.isclose(again.value, choice.design.value, rtol=1e-12)
    assert np.isclose(again.bound, choice.bounds[choice.best], rtol=1e-9)
    assert hx.reachable(left_hand, choice.design.poses.position, choice.design.poses.rotation).all()


@pytest.mark.parametrize("lock", LOOPS)
def test_given_makes_candidates_on_the_same_clamp(left_hand, lock):
    choice = hx.select_lock(left_hand, 3, lock, 5, NOISE, **SMALL)
    clamp = Clamp.given(left_hand, 3, choice.lock, choice.given)
    assert clamp.distance(choice.pool.position, choice.pool.rotation).max() < 1e-10
    pool = hx.candidates(left_hand, 3, lock, 10, NOISE, choice.given, rng=0)
    assert clamp.distance(pool.position, pool.rotation).max() < 1e-10


def test_better_than_the_worst_choice_by_far(left_hand):
    choice = hx.select_lock(left_hand, 3, "direction", 7, NOISE, **SMALL)
    assert choice.design.value < 0.8 * np.nanmax(choice.bounds)


def test_all_designs_are_made_where_nothing_bounds_them(left_hand):
    choice = hx.select_lock(left_hand, 3, "leg", 5, NOISE, criterion="O2", **SMALL)
    assert np.isnan(choice.bounds).all()
    assert np.isfinite(choice.values).all()


def test_another_loop_what_is_known_and_what_is_of_interest(left_hand):
    def loop(data):
        return hx.loops.ReadLength(data, unknown=("base_point", "offset"))

    choice = hx.select_lock(
        left_hand, 3, "length", 6, NOISE, loop=loop, of=("base_point",), given=[19.0, 21.0], n_candidates=100, rng=0
    )
    assert choice.design.labels == ("base_point.x", "base_point.y", "base_point.z")
    assert type(choice.design.question.target) is hx.loops.ReadLength


def test_hopeless_values_are_counted_and_told(left_hand):
    choice = hx.select_lock(
        left_hand, 3, "direction", 5, NOISE, given=[HOPELESS, [0.0, -0.2, 1.0]], n_candidates=100, rng=0
    )
    assert choice.hopeless == 1
    assert choice.best == 1
    assert "leg_length refuses" in choice.reasons[0]
    assert not choice.reasons[1]
    assert np.isnan(choice.bounds[0])
    assert np.isnan(choice.values[0])
    assert "no design on 1, first: only 0 of" in choice.summary()
    frame = choice.to_frame()
    assert list(frame.columns) == ["x", "y", "z", "bound", "value", "reason"]
    assert len(frame) == 2
    with pytest.raises(hx.errors.SamplingError, match=r"no design on any of the 1 values tried.*leg_length refuses"):
        hx.select_lock(left_hand, 3, "direction", 5, NOISE, given=[HOPELESS], n_candidates=100, rng=0)


def test_the_summary_says_who_was_beaten(left_hand):
    text = hx.select_lock(left_hand, 3, "length", 7, NOISE, **SMALL).summary()
    assert "lock 'length' of leg 3: " in text
    assert "is the best of 6" in text
    assert "cannot win, by their bounds" in text


def test_the_same_seed_gives_the_same_choice(left_hand):
    one, two = (hx.select_lock(left_hand, 3, "leg", 5, NOISE, **SMALL) for _ in range(2))
    assert np.array_equal(one.tried, two.tried)
    assert np.array_equal(one.bounds, two.bounds)


def test_too_few_poses_are_told(left_hand):
    with pytest.raises(hx.errors.RankDeficientError, match="no design on any of the 2 values"):
        hx.select_lock(left_hand, 3, "length", 2, NOISE, n_locks=2, n_candidates=50, rng=0)


def test_limits_that_nothing_respects(left_hand):
    nothing = replace(left_hand, limits=replace(left_hand.limits, leg_length=(1.0, 2.0)))
    with pytest.raises(hx.errors.SamplingError, match="leg_length"):
        hx.select_lock(nothing, 3, "direction", 5, NOISE, n_locks=2, n_candidates=20, rng=0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"lock": "none"}, "holds nothing to choose"),
        ({"lock": "stiff"}, "expected one of"),
        ({"noise": None}, "noise model"),
        ({"n_poses": 200}, "raise n_candidates"),
        ({"n_locks": 0}, "n_locks"),
        ({"starts": 0}, "starts"),
        ({"criterion": "B"}, "criterion"),
        ({"given": [0.0, 0.0, 1.0]}, "given: expected shape"),
        ({"given": np.empty((0, 3))}, "nothing to try"),
        ({"given": [[0.0, 0.0, np.nan]]}, "NaN"),
        ({"loop": 3}, "expected a loop equation"),
        ({"robot": None}, "robot"),
        ({"rng": None}, "rng"),
    ],
)
def test_wrong_settings(left_hand, change, words):
    right = {"robot": left_hand, "leg": 3, "lock": "direction", "n_poses": 5, "noise": NOISE, **SMALL}
    with pytest.raises(hx.errors.InputError, match=words):
        hx.select_lock(**(right | change))
