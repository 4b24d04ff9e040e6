"""Several sets as one problem: what is shared, what is not, and what the covariance says of it."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError, UnitError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength, join
from hexopt.problem import ConstantRowNoise, LinearProblem, RowCovariance

LEAST_SQUARES = [hx.LeastSquares(), hx.LeastSquares(weights="model")]
WEIGHTED = hx.LeastSquares(weights="model")
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
COMMON = hx.NormalNoise(0.005, 1e-4, 0.005, common_covariance=np.diag([0.02] * 3 + [2e-4] * 3 + [0.02]) ** 2)


def simulated(lock, seed, *, leg=3, n=7, n_sets=None, noise=NOISE):
    return hx.simulate_leg(hx.robots.left_hand(), leg, lock, n, n_sets, noise=noise, rng=seed)


def spread_of(found):
    """Standard deviation over the batch beside the mean predicted one."""
    predicted = np.sqrt(np.einsum("sii->si", found.covariance).mean(axis=0))
    return found.values.std(axis=0, ddof=1), predicted


class TestOneLeg:
    def test_two_directions_are_the_stacked_equations(self):
        """(b, a, n₁, n₂), built by hand with plain loops."""
        sets = [simulated("direction", seed) for seed in (0, 1)]
        joined = join(*map(FixedDirection, sets))
        assert joined.parameters.names == ("platform_point", "base_point", "direction.1", "direction.2")
        assert [block.nuisance for block in joined.parameters] == [False, False, True, True]
        assert joined.parameters.labels[6] == "direction.1.x"
        rows, rhs = [], []
        for k, data in enumerate(sets):
            true = data.nominal.true_length(data.length)
            for i in range(7):
                own = np.zeros((3, 6))
                own[:, 3 * k : 3 * k + 3] = -true[i] * np.eye(3)
                rows.append(np.hstack([data.rotation[i], -np.eye(3), own]))
                rhs.append(-data.position[i])
        np.testing.assert_allclose(joined.matrix, np.vstack(rows), atol=1e-14)
        np.testing.assert_allclose(joined.rhs, np.concatenate(rhs), atol=1e-14)
        expected = np.linalg.lstsq(np.vstack(rows), np.concatenate(rhs))[0]
        np.testing.assert_allclose(hx.estimate(joined, hx.LeastSquares()).values, expected, atol=1e-10)

    def test_the_covariance_is_that_of_every_set_at_its_own_values(self):
        loops = [FixedDirection(simulated("direction", seed)) for seed in (0, 1)]
        joined = join(*loops)
        x = np.random.default_rng(0).standard_normal(12)
        found = joined.noise.covariance(x)
        blocks = [
            loop.covariance(x[[0, 1, 2, 3, 4, 5, *own]]).blocks
            for loop, own in zip(loops, ([6, 7, 8], [9, 10, 11]), strict=True)
        ]
        np.testing.assert_array_equal(found.blocks, np.concatenate(blocks))
        assert found.common is None

    @pytest.mark.parametrize("estimator", LEAST_SQUARES, ids=repr)
    def test_exact_without_noise(self, estimator, left_hand):
        loops = [
            FixedDirection(replace(simulated("direction", seed, n_sets=4, noise=None), noise=NOISE)) for seed in (0, 1)
        ]
        found = hx.estimate(join(*loops, FixedLeg(replace(simulated("leg", 2, noise=None), noise=NOISE))), estimator)
        assert found.ok.all()
        for error in found.error(left_hand.leg(3)).values():
            assert error.max() < 1e-10

    def test_direction_and_leg_share_b(self):
        """Both are surer together than alone."""
        one, two = FixedDirection(simulated("direction", 0)), FixedLeg(simulated("leg", 1))
        joined = join(two, one)
        assert joined.parameters.names == ("platform_point", "base_point", "fixed_point", "direction")
        assert joined.name == "join of FixedLeg, FixedDirection"
        both = hx.estimate(joined, WEIGHTED)
        for loop in (one, two):
            alone = hx.estimate(loop.linear(), WEIGHTED)
            for name in loop.unknown:
                variance = [np.diag(found.covariance_of(name)) for found in (both, alone)]
                assert (variance[0] < variance[1]).all()

    def test_information_adds_up(self):
        """The inverse covariance of b is the sum over the sets, their nuisances eliminated; here at equal weights."""
        loops = [FixedLeg(simulated("leg", seed)) for seed in (0, 1, 2)]
        both = hx.estimate(join(*loops), WEIGHTED)
        at = both.params["platform_point"]
        alone = [hx.estimate(loop.linear(at=at), WEIGHTED).covariance_of("platform_point") for loop in loops]
        joined = hx.estimate(join(*loops, at=both), WEIGHTED).covariance_of("platform_point")
        np.testing.assert_allclose(np.linalg.inv(joined), sum(map(np.linalg.inv, alone)), rtol=1e-8)

    def test_a_loop_or_its_linear_problem(self):
        loops = [FixedDirection(simulated("direction", 0)), FixedLeg(simulated("leg", 1))]
        one, two = (hx.estimate(join(*parts), WEIGHTED) for parts in (loops, [loop.linear() for loop in loops]))
        np.testing.assert_array_equal(one.values, two.values)
        np.testing.assert_array_equal(one.covariance, two.covariance)

    def test_a_joined_problem_can_be_joined_again(self):
        loops = [FixedDirection(simulated("direction", seed, noise=COMMON)) for seed in range(3)]
        flat, nested = join(*loops), join(join(*loops[:2]), loops[2])
        assert nested.parameters.names[2:] == ("direction.1", "direction.2", "direction")
        one, two = (hx.estimate(problem, WEIGHTED) for problem in (flat, nested))
        np.testing.assert_allclose(one.values, two.values, atol=1e-10)
        np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-8, atol=1e-14)

    def test_one_set_is_itself(self):
        loop = FixedLeg(simulated("leg", 0))
        one, two = (hx.estimate(problem, WEIGHTED) for problem in (join(loop), loop.linear()))
        np.testing.assert_array_equal(one.values, two.values)

    def test_the_blocks_of_a_leg_are_in_its_order(self):
        data = [simulated("none", seed) for seed in (0, 1)]
        gains = join(LegLength(data[0], unknown=("gain",)), LegLength(data[1], unknown=("offset", "gain")))
        assert gains.parameters.names == ("offset", "gain")
        assert gains.rows_per_block == 1
        found = hx.estimate(gains, hx.LeastSquares())
        leg = data[0].nominal
        np.testing.assert_allclose(found.values, [leg.offset, leg.gain], atol=0.1)

    def test_an_estimate_of_a_join_serves_the_loops(self):
        """Names are a leg's, so a loop takes it as a known value or a place."""
        loops = [FixedDirection(simulated("direction", seed)) for seed in (0, 1)]
        found = hx.estimate(join(*loops), WEIGHTED)
        np.testing.assert_array_equal(loops[0].values(found)[:6], found.values[:6])
        assert FixedLength(simulated("length", 2), platform_point=found).linear().uncarried == ""


class TestSeveralLegs:
    def test_six_legs_are_six_estimates(self):
        """Different sets: nothing is shared, the covariance is block-diagonal."""
        loops = [FixedDirection(simulated("direction", k, leg=k, n_sets=3)) for k in range(1, 7)]
        joined = join(*loops)
        assert joined.parameters.size == 54
        assert joined.parameters.names[:3] == ("leg1.platform_point", "leg1.base_point", "leg2.platform_point")
        assert joined.parameters.names[-1] == "leg6.direction"
        assert joined.name == "join of 6 FixedDirection"
        for estimator in LEAST_SQUARES:
            found = hx.estimate(joined, estimator)
            for k, loop in enumerate(loops, start=1):
                alone = hx.estimate(loop.linear(), estimator)
                names = [f"leg{k}.{name}" for name in loop.parameters.names]
                for name, own in zip(names, loop.parameters.names, strict=True):
                    np.testing.assert_allclose(found.params[name], alone.params[own], atol=1e-8)
                np.testing.assert_allclose(found.covariance_of(*names), alone.covariance, rtol=1e-6, atol=1e-12)
            cross = found.covariance[..., joined.parameters["leg1.base_point"], joined.parameters["leg2.base_point"]]
            assert np.abs(cross).max() < 1e-12

    def test_several_sets_of_several_legs(self):
        loops = [FixedDirection(simulated("direction", 10 * k + j, leg=k)) for k in (5, 2) for j in (0, 1)]
        names = join(*loops).parameters.names
        assert names == (
            *("leg5.platform_point", "leg5.base_point", "leg2.platform_point", "leg2.base_point"),
            *("leg5.direction.1", "leg5.direction.2", "leg2.direction.1", "leg2.direction.2"),
        )

    def test_two_parts_of_one_set(self):
        """Poses of one set, split, are different poses; its batch may be shifted too."""
        data = simulated("leg", 0, n=9, n_sets=4)
        whole = hx.estimate(join(FixedLeg(data.poses([0, 1, 2, 3])), FixedLeg(data.poses(slice(4, 9)))), WEIGHTED)
        assert whole.ok.all()
        join(FixedLeg(data[1:]), FixedLeg(data[:-1]))
        join(FixedLeg(data[0]), FixedLeg(data[1]))


class TestStatistics:
    """By Monte Carlo, 400 sets: the predicted covariance is the spread of the estimates, within 15 %."""

    @pytest.mark.parametrize("noise", [NOISE, COMMON], ids=["own", "common"])
    @pytest.mark.parametrize("estimator", LEAST_SQUARES, ids=repr)
    def test_the_covariance_is_the_spread(self, estimator, noise):
        robot, true = hx.robots.left_hand(), hx.robots.left_hand().leg(3)
        exact = [simulated(lock, seed, noise=None, n=8) for seed, lock in enumerate(("direction", "direction", "leg"))]
        rng, loops = np.random.default_rng(0), []
        for data, kind in zip(exact, (FixedDirection, FixedDirection, FixedLeg), strict=True):
            wide = [np.broadcast_to(part, (400, *part.shape)) for part in (data.position, data.rotation, data.length)]
            read = noise.apply(*wide, rng)
            loops.append(kind(hx.LegMeasurements(*read, data.lock, noise, robot.leg(3))))
        found = hx.estimate(join(*loops), estimator)
        spread, predicted = spread_of(found)
        np.testing.assert_allclose(spread, predicted, rtol=0.15)
        error = np.concatenate([found.params[n] - true.block(n) for n in ("platform_point", "base_point")], axis=-1)
        assert (np.abs(error.mean(axis=0)) < 5 * predicted[:6] / 20).all()

    def known_b(self, n_sets=400):
        """Two LENGTH sets that take their b from one rough estimate, and the same from a copy."""
        b = hx.estimate(FixedLeg(simulated("leg", 0, n=4, n_sets=n_sets)).linear(), WEIGHTED)
        return b, [simulated("length", seed, n=12, n_sets=n_sets) for seed in (1, 2)]

    def test_a_known_estimate_of_two_sets_has_one_error(self, left_hand):
        """A wrong offset moves a along the leg in both sets at once: with an error each it would be too sure."""
        rough = hx.UniformNoise(0.5, np.deg2rad(0.1), 0.5)
        known = LegLength(
            simulated("none", 0, n=4, n_sets=400, noise=rough),
            unknown=("offset",),
            platform_point=left_hand.leg(3).platform_point,
            base_point=left_hand.leg(3).base_point,
        )
        offset = hx.estimate(known.linear(), WEIGHTED)
        sets, ratio = [simulated("direction", seed, n=12, n_sets=400) for seed in (1, 2)], {}
        for name, other in (("shared", offset), ("copied", replace(offset))):
            loops = (FixedDirection(sets[0], offset=offset), FixedDirection(sets[1], offset=other))
            found = hx.estimate(join(*loops), WEIGHTED)
            spread, predicted = spread_of(found)
            ratio[name] = spread[:6] / predicted[:6]
        np.testing.assert_allclose(ratio["shared"], 1, atol=0.15)
        assert ratio["copied"][5] > 1.2 * ratio["shared"][5]

    def test_the_columns_of_a_known_estimate(self):
        b, sets = self.known_b(3)
        loops = [FixedLength(data, platform_point=b) for data in sets]
        joined = join(*loops)
        x = np.broadcast_to([1.0, 2.0, 3.0, 4.0, 5.0], (3, 5))
        common = joined.noise.covariance(x).common
        assert common.shape == (3, 24, 1, 3)
        jacobian = np.concatenate(
            [
                loop.known_jacobian(x[..., [0, 1, 2, own]], "platform_point")
                for loop, own in zip(loops, (3, 4), strict=True)
            ],
            axis=-3,
        )[..., 0, :]
        expected = jacobian @ b.covariance_of("platform_point") @ np.swapaxes(jacobian, -1, -2)
        np.testing.assert_allclose(common[..., 0, :] @ np.swapaxes(common[..., 0, :], -1, -2), expected, rtol=1e-9)

    def test_two_blocks_of_one_estimate_keep_their_correlation(self):
        """Within one loop too: b and a of one estimate, in the offset."""
        known = hx.estimate(FixedDirection(simulated("direction", 0, n_sets=2)).linear(), WEIGHTED)
        loop = LegLength(simulated("none", 1, n_sets=2), unknown=("offset",), platform_point=known, base_point=known)
        x = np.full((2, 1), 15.25)
        names = ("platform_point", "base_point")
        jacobian = np.concatenate([loop.known_jacobian(x, name)[..., 0, :] for name in names], axis=-1)
        expected = jacobian @ known.covariance_of(*names) @ np.swapaxes(jacobian, -1, -2)
        common = loop.covariance(x).common[..., 0, :]
        np.testing.assert_allclose(common @ np.swapaxes(common, -1, -2), expected, rtol=1e-8, atol=1e-14)

    def test_common_errors_of_sets_are_independent(self):
        joined = join(*(FixedLeg(simulated("leg", seed, noise=COMMON)) for seed in (0, 1)))
        common = joined.noise.covariance(np.ones(9)).common
        assert common.shape == (14, 3, 14)
        assert not common[:7, :, 7:].any()
        assert not common[7:, :, :7].any()


class TestBatches:
    def test_members_are_what_they_are_alone(self):
        one, two = simulated("direction", 0, n_sets=4), simulated("leg", 1, n_sets=4)
        for estimator in LEAST_SQUARES:
            found = hx.estimate(join(FixedDirection(one), FixedLeg(two)), estimator)
            for i in range(4):
                alone = hx.estimate(join(FixedDirection(one[i]), FixedLeg(two[i])), estimator)
                np.testing.assert_allclose(found.values[i], alone.values, atol=1e-9)
                np.testing.assert_allclose(found.covariance[i], alone.covariance, rtol=1e-6, atol=1e-12)

    @pytest.mark.parametrize("noise", [NOISE, COMMON], ids=["own", "common"])
    def test_one_set_beside_a_batch(self, noise):
        one, two = simulated("direction", 0, noise=noise), simulated("leg", 1, n_sets=5, noise=noise)
        found = hx.estimate(join(FixedDirection(one), FixedLeg(two)), WEIGHTED)
        assert found.batch_shape == (5,)
        alone = hx.estimate(join(FixedDirection(one), FixedLeg(two[3])), WEIGHTED)
        np.testing.assert_allclose(found.values[3], alone.values, atol=1e-9)
        np.testing.assert_allclose(found.covariance[3], alone.covariance, rtol=1e-6, atol=1e-12)

    def test_no_sets(self):
        data = [simulated("leg", seed, n_sets=2)[:0] for seed in (0, 1)]
        assert hx.estimate(join(*map(FixedLeg, data)), WEIGHTED).values.shape == (0, 9)

    def test_without_noise_there_is_a_residual_covariance(self):
        loops = [FixedLeg(simulated("leg", seed, noise=None)) for seed in (0, 1)]
        problem = join(*loops)
        assert problem.noise is None
        assert hx.estimate(problem, hx.LeastSquares()).covariance_kind == "residual"
        with pytest.raises(InputError, match="join of 2 FixedLeg: the noise is unknown"):
            hx.estimate(problem, WEIGHTED)

    def test_a_known_value_that_failed_fails_its_members(self):
        b, sets = TestStatistics().known_b(3)
        values, covariance = np.array(b.values), np.array(b.covariance)
        values[1], covariance[1] = np.nan, np.nan
        bad = replace(b, values=values, covariance=covariance, codes=np.array([0, 2, 0], dtype=np.int8))
        for estimator in LEAST_SQUARES:
            found, whole = (
                hx.estimate(
                    join(FixedLength(sets[0], platform_point=known), FixedLength(sets[1], platform_point=known)),
                    estimator,
                )
                for known in (bad, b)
            )
            assert list(found.ok) == [True, False, True]
            np.testing.assert_allclose(found.values[[0, 2]], whole.values[[0, 2]], atol=1e-9)

    def test_what_cannot_be_carried_is_said(self):
        b, sets = TestStatistics().known_b(3)
        bare = replace(b, covariance=None, covariance_kind="lost")
        problem = join(FixedLength(sets[0], platform_point=b), FixedLength(sets[1], platform_point=bare))
        assert "platform_point cannot be carried" in problem.uncarried
        found = hx.estimate(problem, WEIGHTED)
        assert found.covariance is None
        assert found.covariance_kind == problem.uncarried


class TestPlace:
    def problem(self):
        return [FixedDirection(simulated("direction", seed)) for seed in (0, 1)]

    def test_values_names_or_an_estimate(self):
        loops = self.problem()
        first = hx.estimate(join(*loops), WEIGHTED)
        for at in (first, first.values, first.params):
            np.testing.assert_array_equal(join(*loops, at=at).at, first.values)
        again = hx.estimate(join(*loops, at=first), WEIGHTED)
        assert 0 < np.abs((again.values - first.values) / first.standard_errors).max() < 0.2

    def test_scalars_by_name(self):
        data = [simulated("none", seed) for seed in (0, 1)]
        loops = [LegLength(part, unknown=("offset", "gain")) for part in data]
        np.testing.assert_array_equal(join(*loops, at={"offset": 15.0, "gain": 1.0}).at, [15, 1])

    @pytest.mark.parametrize(
        ("at", "message"),
        [
            (
                np.ones(6),
                r"at: expected 12 values \(platform_point, base_point, direction.1, direction.2\), got \(6,\)",
            ),
            (
                {"platform_point": np.ones(3)},
                "at: expected platform_point, base_point, direction.1.*got platform_point",
            ),
            (
                {"platform_point": 1.0, "base_point": 1.0, "direction.1": 1.0, "direction.2": 1.0},
                r"at: platform_point: expected shape \(\.\.\., 3\), got \(1,\)",
            ),
        ],
    )
    def test_wrong_places(self, at, message):
        with pytest.raises(InputError, match=message):
            join(*self.problem(), at=at)


class TestErrors:
    def test_rank_deficiency_names_the_joined_parameters(self):
        """A direction set that stands still sees neither b nor a; a LEG set then brings b alone."""
        still = simulated("direction", 0)
        data = replace(
            still,
            position=np.repeat(still.position[:1], 7, axis=0),
            rotation=np.repeat(still.rotation[:1], 7, axis=0),
            length=np.repeat(still.length[:1], 7),
        )
        with pytest.raises(RankDeficientError, match=r"base_point\.x") as caught:
            hx.estimate(join(FixedDirection(data), FixedLeg(simulated("leg", 1))), hx.LeastSquares())
        assert caught.value.combinations
        assert not any("platform_point" in text for text in caught.value.combinations)

    def test_too_few_poses(self):
        loops = [FixedDirection(simulated("direction", seed, n=1)) for seed in (0, 1)]
        message = (
            r"too few poses: 6 equations for 12 unknowns \(platform_point, base_point, direction.1, direction.2\)$"
        )
        with pytest.raises(RankDeficientError, match=message):
            hx.estimate(join(*loops), hx.LeastSquares())

    @pytest.mark.parametrize(
        ("targets", "message"),
        [
            ((), "join: expected loops or direct linear problems, got nothing"),
            (([1, 2],), r"join: argument 1 is a list; write join\(\*loops\)"),
            ((hx.LeastSquares(),), "join: argument 1: expected a loop or a LinearProblem, got LeastSquares"),
        ],
    )
    def test_wrong_arguments(self, targets, message):
        with pytest.raises(InputError, match=message):
            join(*targets)

    @pytest.mark.parametrize("form", ["consecutive", "centred"])
    def test_only_direct_forms(self, form):
        loops = [FixedLeg(simulated("leg", seed)) for seed in (0, 1)]
        with pytest.raises(InputError, match=rf"argument 2 \(FixedLeg\) has the form '{form}', expected 'direct'"):
            join(loops[0], loops[1].linear(form))

    def test_a_part_has_no_place_of_its_own(self):
        loop = FixedLeg(simulated("leg", 0))
        with pytest.raises(InputError, match=r"argument 1 \(FixedLeg\) has its own at="):
            join(loop.linear(at=np.ones(3)))

    def test_as_many_rows_a_pose(self):
        message = r"argument 1 \(FixedLeg\) has 3 rows a pose, argument 2 \(FixedLength\) has 1"
        with pytest.raises(InputError, match=message):
            join(FixedLeg(simulated("leg", 0)), FixedLength(simulated("length", 1)))

    def test_all_with_noise_or_none(self):
        with pytest.raises(InputError, match=r"argument 2 \(FixedLeg\): no noise model, the others have one"):
            join(FixedLeg(simulated("leg", 0)), FixedLeg(simulated("leg", 1, noise=None)))

    def test_batches_fit(self):
        with pytest.raises(InputError, match=r"the batches \(2,\), \(3,\) do not fit"):
            join(FixedLeg(simulated("leg", 0, n_sets=2)), FixedLeg(simulated("leg", 1, n_sets=3)))

    def test_units(self):
        data = simulated("leg", 1)
        other = hx.LegMeasurements(data.position, data.rotation, None, "leg", NOISE, length_unit="mm")
        with pytest.raises(UnitError, match="the sets are in cm and mm"):
            join(FixedLeg(simulated("leg", 0)), FixedLeg(other))

    def test_a_leg_without_a_number(self):
        data = simulated("leg", 1)
        bare = FixedLeg(hx.LegMeasurements(data.position, data.rotation, None, "leg", NOISE, length_unit="cm"))
        three, four = (FixedLeg(simulated("leg", leg, leg=leg)) for leg in (3, 4))
        assert join(bare, three).parameters.names[0] == "platform_point"  # as far as is known, one leg
        with pytest.raises(InputError, match=r"which leg is argument 2 \(FixedLeg\)\?.*nominal=robot\.leg\(k\)"):
            join(three, bare, four)

    def test_linear_problems_of_different_legs(self):
        """They would share b without a word."""
        three, four = (FixedLeg(simulated("leg", leg, leg=leg)) for leg in (3, 4))
        for parts in ((three, four.linear()), (three.linear(), four.linear())):
            with pytest.raises(
                InputError, match=r"is of leg \d beside other legs, but has the bare name platform_point"
            ):
                join(*parts)


class TestSamePoses:
    MESSAGE = r"join is for different poses: argument 1 .* and argument 2 .* have a pose in common.*WholeRobot"

    def test_the_same_set_twice(self):
        data = simulated("leg", 0)
        loop = FixedLeg(data)
        again = hx.LegMeasurements(np.array(data.position), np.array(data.rotation), None, "leg", NOISE, data.nominal)
        for other in (loop, FixedLeg(data), loop.linear(), FixedLeg(again)):
            with pytest.raises(InputError, match=self.MESSAGE):
                join(loop, other)

    def test_legs_of_the_same_poses(self, left_hand):
        data = hx.simulate(left_hand, n_poses=5, noise=NOISE, rng=0)
        loops = [LegLength(data.leg(k), unknown=("offset",)) for k in (1, 2)]
        with pytest.raises(InputError, match=self.MESSAGE):
            join(*loops)

    def test_one_pose_in_common(self):
        data = simulated("leg", 0, n=9, n_sets=3)
        with pytest.raises(InputError, match=self.MESSAGE):
            join(FixedLeg(data.poses([0, 1, 2, 3])), FixedLeg(data.poses([5, 6, 3])))

    def test_within_a_joined_problem(self):
        loops = [FixedLeg(simulated("leg", seed)) for seed in (0, 1)]
        with pytest.raises(InputError, match=self.MESSAGE):
            join(join(*loops), loops[1])

    def test_equal_equations_without_noise(self):
        problem = FixedLeg(simulated("leg", 0, noise=None)).linear()
        with pytest.raises(InputError, match=self.MESSAGE):
            join(problem, problem)

    def test_equal_positions_are_not_equal_poses(self):
        data = simulated("leg", 0)
        other = replace(simulated("leg", 1), position=data.position)
        assert join(FixedLeg(data), FixedLeg(other)).matrix.shape == (42, 9)


class TestProblems:
    """Linear problems of one's own."""

    def problem(self, *blocks, rows=6, seed=0):
        parameters = hx.Parameters(blocks)
        rng = np.random.default_rng(seed)
        noise = ConstantRowNoise(RowCovariance(np.tile(np.eye(2), (rows // 2, 1, 1)), np.ones((rows // 2, 2, 1))))
        return LinearProblem(
            rng.standard_normal((rows, parameters.size)),
            rng.standard_normal(rows),
            parameters,
            rows_per_block=2,
            noise=noise,
            cancellation=np.linspace(1 + seed, 2, parameters.size),
        )

    def test_names_are_the_callers(self):
        level, slope, drift = hx.Block("level", 1, "cm"), hx.Block("slope", 1, "cm/s"), hx.Block("drift", 2, "1", 3.0)
        one, two = self.problem(level, slope), self.problem(drift, slope, seed=1)
        joined = join(one, two)
        assert joined.parameters == hx.Parameters((level, slope, drift))
        expected = np.block([[one.matrix, np.zeros((6, 2))], [np.zeros((6, 1)), two.matrix[:, 2:], two.matrix[:, :2]]])
        np.testing.assert_array_equal(joined.matrix, expected)
        np.testing.assert_allclose(joined.cancellation, [1, 2, 2, 2])
        common = joined.noise.covariance(np.ones(4)).common
        np.testing.assert_array_equal(common[:, 0], [[1, 0]] * 3 + [[0, 1]] * 3)

    def test_a_name_for_two_things(self):
        cm = hx.Block("level", 1, "cm")
        with pytest.raises(UnitError, match="level is in cm, and in mm in argument 2"):
            join(self.problem(cm), self.problem(hx.Block("level", 1, "mm"), seed=1))
        for other in (hx.Block("level", 2, "cm"), hx.Block("level", 1, "cm", nuisance=True)):
            with pytest.raises(InputError, match=r"level of argument 2 .* is not what another set calls so"):
                join(self.problem(cm), self.problem(other, seed=1))

    def test_a_nuisance_that_has_anothers_name(self):
        own = hx.Block("bias", 1, "cm", nuisance=True)
        taken = hx.Block("bias.1", 1, "cm", nuisance=True)
        with pytest.raises(InputError, match=r"bias\.1 of argument \d .* give one of them another name"):
            join(self.problem(taken), self.problem(own, seed=1), self.problem(own, seed=2))


def test_the_errors_of_several_legs_are_those_of_the_robot(left_hand):
    """Blocks "leg3.base_point" are compared with leg 3 of a robot, and with no leg alone."""
    sets = [hx.simulate_leg(left_hand, k, "direction", 7, nominal=left_hand.leg(k), rng=k) for k in (2, 5)]
    found = hx.estimate(hx.join(*(hx.loops.FixedDirection(one) for one in sets)), hx.LeastSquares())
    errors = found.error(left_hand)
    assert set(errors) == {f"leg{k}.{name}" for k in (2, 5) for name in ("platform_point", "base_point")}
    assert max(float(error) for error in errors.values()) < 1e-9
    with pytest.raises(hx.InputError, match="a leg for one leg, the robot for several"):
        found.error(left_hand.leg(2))


def test_a_known_estimate_must_have_the_block(left_hand):
    data = hx.simulate_leg(left_hand, 3, "leg", 7, nominal=left_hand.leg(3), rng=0)
    found = hx.estimate(hx.loops.FixedLeg(data).linear(), hx.LeastSquares())
    with pytest.raises(hx.InputError, match="base_point: the given estimate has no such block, it has platform_point"):
        hx.loops.LegLength(data, unknown="offset", base_point=found)
