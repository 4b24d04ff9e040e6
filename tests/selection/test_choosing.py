"""select_poses: from candidates to a design, by the rules that a user can ask for."""

from itertools import combinations

import numpy as np
import pytest

import hexopt as hx
from hexopt.information import pose_information

ROBOT = hx.robots.left_hand()
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
ALL = ("A", "D", "E", "kappa", "O1", "O2", "O3", "O4", "O5")


@pytest.fixture(scope="module")
def direction():
    """Type I over 200 candidates."""
    return hx.loops.FixedDirection(hx.candidates(ROBOT, 3, "direction", 200, NOISE, rng=0).leg(3))


@pytest.fixture(scope="module")
def length():
    """Type III over 60 candidates."""
    return hx.loops.FixedLength(hx.candidates(ROBOT, 3, "length", 60, NOISE, rng=0).leg(3))


@pytest.mark.parametrize("criterion", ALL)
class TestEveryCriterion:
    def test_the_design_is_what_it_says(self, direction, criterion):
        design = hx.select_poses(direction, 6, criterion)
        assert len(set(design.indices)) == 6
        np.testing.assert_array_equal(design.poses.position, direction.data.position[design.indices])
        alone = pose_information(direction.over(design.poses))
        np.testing.assert_allclose(design.covariance, alone.covariance(np.ones(6))[0], rtol=1e-8)
        assert design.summary().count("±") == 7

    def test_it_beats_random_designs(self, direction, criterion):
        design = hx.select_poses(direction, 6, criterion)
        objective = design.question.objective()
        rng = np.random.default_rng(0)
        for _ in range(200):
            counts = np.zeros(200)
            counts[rng.choice(200, 6, replace=False)] = 1.0
            assert objective.value(counts) > design.value
            assert not objective.value(counts) < design.bound

    def test_it_is_the_same_every_time(self, direction, criterion):
        one, two = (hx.select_poses(direction, 6, criterion) for _ in range(2))
        np.testing.assert_array_equal(one.indices, two.indices)


class TestTwins:
    @pytest.mark.parametrize(
        ("index", "twin", "root"), [("O1", "D", lambda v: np.exp(np.divide(v, 12))), ("O3", "E", np.sqrt)]
    )
    def test_an_index_is_proven_as_its_twin_is(self, direction, index, twin, root):
        one, two = hx.select_poses(direction, 6, index), hx.select_poses(direction, 6, twin)
        np.testing.assert_array_equal(one.indices, two.indices)
        np.testing.assert_allclose([one.value, one.bound, one.relaxed], root([two.value, two.bound, two.relaxed]))
        assert one.criterion == index
        assert one.efficiency == pytest.approx(two.efficiency)
        assert one.value == pytest.approx(one.question.objective().value(np.bincount(one.indices, minlength=200)))

    def test_the_average_of_scenarios_is_another_matter(self, direction):
        nominals = [ROBOT.perturbed(0.5, rng=k).leg(3) for k in range(2)]
        average = hx.select_poses(direction, 6, "O1", at=nominals)
        assert average.bound <= average.value
        assert hx.select_poses(direction, 6, "O1", at=nominals, worst=True).efficiency > 0.9


class TestProof:
    @pytest.mark.parametrize("criterion", ["A", "D", "E"])
    def test_it_is_the_best_of_all(self, length, criterion):
        few = length.over(length.data.poses(slice(0, 16)))
        design = hx.select_poses(few, 5, criterion, prove=60.0)
        objective = design.question.objective()
        totals = np.stack(
            [objective.information.take(list(some)).total(np.ones(5)) for some in combinations(range(16), 5)]
        )
        assert design.proven
        np.testing.assert_allclose(design.value, objective.of_totals(totals).min(), rtol=1e-9)
        assert "proven" in design.stopped

    def test_without_a_bound_there_is_no_proof(self, direction):
        with pytest.raises(hx.errors.InputError, match="O2 is not convex"):
            hx.select_poses(direction, 6, "O2", prove=1.0)
        assert np.isnan(hx.select_poses(direction, 6, "O2").bound)


class TestMeasuredBefore:
    def test_the_next_five_know_of_the_first(self, direction):
        first = hx.select_poses(direction, 5)
        rest = np.setdiff1d(np.arange(200), first.indices)
        candidates = direction.over(direction.data.poses(rest))
        after = hx.select_poses(candidates, 5, measured=direction.over(first.poses))
        ignorant = hx.select_poses(candidates, 5)
        both = pose_information(direction).take(np.concatenate([first.indices, rest[ignorant.indices]]))
        assert after.value < np.trace(both.covariance(np.ones(10))[0])
        whole = pose_information(direction).take(np.concatenate([first.indices, rest[after.indices]]))
        np.testing.assert_allclose(after.value, np.trace(whole.covariance(np.ones(10))[0]), rtol=1e-9)

    def test_what_was_measured_is_not_chosen_again(self, direction):
        first = hx.select_poses(direction, 5)
        after = hx.select_poses(direction, 5, measured=direction.over(first.poses))
        assert not set(after.indices) & set(first.indices)
        assert (after.weights[first.indices] == 0).all()
        np.testing.assert_array_equal(after.poses.position, direction.data.position[after.indices])
        rest = np.setdiff1d(np.arange(200), first.indices)
        apart = hx.select_poses(direction.over(direction.data.poses(rest)), 5, measured=direction.over(first.poses))
        np.testing.assert_array_equal(after.indices, rest[apart.indices])
        again = hx.select_poses(direction, 5, measured=direction.over(first.poses), repeat=True)
        assert again.bound <= after.bound + 1e-12
        with pytest.raises(
            hx.errors.InputError, match="196 poses asked for, and 5 of the 200 candidates are measured already"
        ):
            hx.select_poses(direction, 196, measured=direction.over(first.poses))

    def test_nor_is_it_as_a_tracker_saw_it(self, direction):
        first = hx.select_poses(direction, 5)
        noisy = NOISE.apply(first.poses.position, first.poses.rotation, first.poses.length, np.random.default_rng(0))
        seen = direction.over(first.poses.moved_to(*noisy))
        assert not set(hx.select_poses(direction, 5, measured=seen).indices) & set(first.indices)
        assert hx.select_poses(direction, 195, measured=seen).efficiency == pytest.approx(1.0)

    def test_then_one_pose_is_enough(self, direction):
        first = direction.over(direction.data.poses(slice(0, 5)))
        assert len(hx.select_poses(direction.over(direction.data.poses(slice(5, 200))), 1, measured=first).indices) == 1

    def test_an_estimate_from_elsewhere_moves_the_choice(self, direction):
        data = hx.candidates(ROBOT, 3, "leg", 30, NOISE, rng=1)
        found = hx.estimate(hx.loops.FixedLeg(data.leg(3)).linear(), hx.LeastSquares(weights="model"))
        alone, informed = hx.select_poses(direction, 6), hx.select_poses(direction, 6, measured=found)
        assert informed.value < alone.value
        assert set(informed.indices) != set(alone.indices)


class TestRepeatsAndCosts:
    def test_repeats_never_hurt(self, direction):
        once, again = hx.select_poses(direction, 12), hx.select_poses(direction, 12, repeat=True)
        twice = hx.select_poses(direction, 12, repeat=2)
        assert again.bound <= twice.bound + 1e-9 <= once.bound + 2e-9
        assert again.value <= once.value * 1.001
        assert np.bincount(twice.indices).max() <= 2
        assert len(again.indices) == 12

    def test_the_budget_holds(self, direction):
        cost = 1.0 + np.linalg.norm(direction.data.position - ROBOT.home_position, axis=1)
        design = hx.select_poses(direction, cost=cost, budget=25.0)
        assert cost[design.indices].sum() <= 25.0
        assert design.bound <= design.value
        plain = hx.select_poses(direction, len(design.indices))
        assert cost[design.indices].sum() < cost[plain.indices].sum()

    def test_what_costs_too_much_is_left_out(self, direction):
        cost = np.ones(200)
        cost[hx.select_poses(direction, 6).indices] = 6.5
        design = hx.select_poses(direction, cost=cost, budget=6.0)
        assert len(design.indices) == 6
        assert (cost[design.indices] == 1).all()
        assert design.weights[cost > 6].max() == 0

    def test_a_budget_may_buy_them_all(self, length):
        design = hx.select_poses(length, cost=np.ones(60), budget=100.0)
        np.testing.assert_array_equal(design.indices, np.arange(60))
        assert design.efficiency == pytest.approx(1.0)

    def test_equal_costs_are_a_number_of_poses(self, direction):
        one = hx.select_poses(direction, 6)
        two = hx.select_poses(direction, cost=np.full(200, 2.0), budget=12.5)
        np.testing.assert_array_equal(one.indices, two.indices)


class TestWhatIsOfInterest:
    def test_a_block(self, direction):
        base = hx.select_poses(direction, 6, of=["base_point"])
        whole = hx.select_poses(direction, 6)
        assert base.labels == ("base_point.x", "base_point.y", "base_point.z")
        assert base.value <= np.trace(whole.covariance[3:, 3:]) * (1 + 1e-9)

    def test_a_spread_makes_a_block_count_more(self, direction):
        fine = hx.select_poses(direction, 6, spread={"platform_point": 0.01})
        whole = hx.select_poses(direction, 6)
        assert np.trace(fine.covariance[:3, :3]) < np.trace(whole.covariance[:3, :3])

    def test_d_does_not_care_for_spreads(self, direction):
        one, two = hx.select_poses(direction, 6, "D"), hx.select_poses(direction, 6, "D", spread={"base_point": 50.0})
        np.testing.assert_array_equal(one.indices, two.indices)


class TestScenarios:
    def test_worst_and_average(self, direction):
        nominals = [ROBOT.perturbed(0.5, rng=k).leg(3) for k in range(4)]
        average = hx.select_poses(direction, 6, at=nominals)
        worst = hx.select_poses(direction, 6, at=nominals, worst=True)
        assert average.bound <= average.value <= worst.value
        objective = worst.question.objective()
        assert objective.value(np.bincount(average.indices, minlength=200)) >= worst.value * 0.999
        assert average.efficiency > 0.9
        assert worst.efficiency > 0.9


class TestWholeRobot:
    def test_one_set_for_all_legs(self):
        pool = hx.candidates(ROBOT, None, "none", 80, NOISE, rng=0)
        design = hx.select_poses(hx.loops.WholeRobot(pool), 12)
        assert design.poses.length.shape == (12, 6)
        assert design.covariance.shape == (42, 42)
        assert design.efficiency > 0.8

    def test_several_clamps_at_once(self):
        pools = [hx.candidates(ROBOT, leg, "direction", 25, NOISE, rng=leg) for leg in range(1, 7)]
        design = hx.select_poses(hx.loops.WholeRobot(*pools), 24)
        assert len(design.poses) == 6
        assert sum(part.n_poses for part in design.poses) == 24
        assert [part.locked_leg for part in design.poses] == [1, 2, 3, 4, 5, 6]


class TestHardlySeen:
    @pytest.mark.parametrize(("seed", "criterion"), [(0, "D"), (3, "A"), (4, "A")])
    def test_as_few_poses_as_unknowns_of_a_robot_that_hardly_turns(self, seed, criterion):
        rubin = hx.robots.rubin()
        pool = hx.candidates(rubin, 3, "none", 300, hx.UniformNoise(1.0, 1e-6, 1.0), rng=np.random.default_rng(seed))
        design = hx.select_poses(hx.loops.LegLength(pool.leg(3)), 7, criterion)
        assert len(design.indices) == 7
        assert 0.85 < design.efficiency <= 1 + 1e-6

    def test_what_is_not_seen_in_practice_is_said(self, direction):
        near = hx.PoseRanges((1e-4, 1e-4, 1e-4), (20.0, 20.01), 0.0, 0.0)
        pool = hx.candidates(ROBOT, 3, "direction", 50, NOISE, ranges=near, rng=0)
        design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 10)
        assert design.doubtful.all()
        assert design.summary().count("not seen in practice") == 6
        assert not hx.select_poses(direction, 6).doubtful.any()


class TestBareInformation:
    def test_it_has_no_poses(self, direction):
        design = hx.select_poses(pose_information(direction), 6)
        assert design.poses is None
        np.testing.assert_array_equal(design.indices, hx.select_poses(direction, 6).indices)
        assert list(design.to_frame().columns) == ["candidate", "weight"]

    def test_settings_are_in_it_already(self, direction):
        with pytest.raises(hx.errors.InputError, match="bare information has them in it"):
            hx.select_poses(pose_information(direction), 6, of=["base_point"])


class TestBadInput:
    @pytest.mark.parametrize(
        ("n", "settings", "error", "message"),
        [
            (2, {}, "RankDeficientError", "fewer poses than parameters need: 2 bring at most 6 equations for 8"),
            (201, {}, "InputError", "201 poses asked for, and there are 200 candidates"),
            (0, {}, "InputError", "n: expected a whole number >= 1"),
            (None, {}, "InputError", "n: say how many poses, or give cost= and budget="),
            (7, {"cost": np.ones(200), "budget": 7.0}, "InputError", "n: say how many poses"),
            (None, {"cost": np.ones(3), "budget": 7.0}, "InputError", r"cost: expected shape \(200\)"),
            (None, {"cost": np.zeros(200), "budget": 7.0}, "InputError", "cost: expected costs > 0"),
            (None, {"cost": np.full(200, np.nan), "budget": 7.0}, "InputError", "cost: 200 value"),
            (None, {"cost": np.ones(200), "budget": 0.5}, "InputError", "buys no pose"),
            (7, {"criterion": "F"}, "InputError", "criterion: expected A, D, E"),
            (7, {"worst": 1}, "InputError", "worst: expected True or False"),
            (7, {"starts": 0}, "InputError", "starts: expected a whole number >= 1"),
            (7, {"prove": -1}, "InputError", "prove: expected seconds > 0"),
            (7, {"rng": "x"}, "InputError", "rng: expected a seed"),
            (7, {"repeat": 0}, "InputError", "repeat: expected a whole number >= 1"),
            (7, {"spread": 0.5}, "InputError", "spread: expected a size by block name"),
        ],
    )
    def test_settings(self, direction, n, settings, error, message):
        with pytest.raises(getattr(hx.errors, error), match=message):
            hx.select_poses(direction, n, **settings)

    def test_a_pose_that_stands_twice(self, direction):
        doubled = direction.over(direction.data.poses([*range(20), 3]))
        with pytest.raises(hx.errors.InputError, match="candidates: 3 and 20 are the same pose"):
            hx.select_poses(doubled, 7)
        assert len(hx.select_poses(doubled, 7, repeat=True).indices) == 7

    def test_candidates_that_do_not_see_a_parameter(self):
        data = hx.simulate_leg(
            ROBOT,
            3,
            "direction",
            30,
            noise=None,
            ranges=hx.PoseRanges((0.5, 0.5, 0.5), (18.0, 18.0), 1.0, 0.1),
            rng=0,
        )
        data = hx.LegMeasurements(data.position, data.rotation, data.length, "direction", NOISE, data.nominal)
        with pytest.raises(hx.errors.RankDeficientError, match="base_point"):
            hx.select_poses(hx.loops.FixedDirection(data), 7)

    def test_what_is_not_of_interest_must_be_seen_too(self):
        pool = hx.candidates(ROBOT, 3, "direction", 40, NOISE, rng=1)
        with pytest.raises(hx.errors.RankDeficientError, match=r"leg3\.base_point.*estimated on the way"):
            hx.select_poses(hx.loops.WholeRobot(pool), 12, of="leg1.base_point")

    def test_no_loop(self):
        with pytest.raises(hx.errors.InputError, match="expected a loop over the poses"):
            hx.select_poses("poses.csv", 7)
