"""The information of poses, in the coordinates of designs, against the bound of the loop itself."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.information import pose_information

ROBOT = hx.robots.left_hand()
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
LEG = ROBOT.leg(3)
KINDS = {
    "direction": hx.loops.FixedDirection,
    "leg": hx.loops.FixedLeg,
    "length": hx.loops.FixedLength,
    "none": hx.loops.LegLength,
}


def pool(lock, n=20, rng=0, robot=ROBOT, noise=NOISE):
    """Poses under a lock of leg 3, with all six readings."""
    return hx.candidates(robot, None if lock == "none" else 3, lock, n, noise, rng=rng)


def loop_of(lock, **settings):
    return KINDS[lock](pool(lock).leg(3), **settings)


def covariance(information, n):
    """In the units of the parameters."""
    return information.covariance(np.ones(n))[0] * np.outer(information.spread, information.spread)


def close(one, two):
    scale = np.sqrt(np.outer(np.diag(two), np.diag(two)))
    np.testing.assert_allclose(one / scale, two / scale, atol=1e-9)


@pytest.mark.parametrize("lock", list(KINDS))
class TestAgainstTheBound:
    def test_the_whole_set_is_the_bound(self, lock):
        loop = loop_of(lock)
        close(covariance(pose_information(loop), 20), loop.crlb(LEG))

    def test_so_it_is_elsewhere(self, lock):
        loop = loop_of(lock)
        other = ROBOT.perturbed(0.5, rng=1).leg(3)
        close(covariance(pose_information(loop, other), 20), loop.crlb(other))

    def test_a_spread_changes_units_only(self, lock):
        loop = loop_of(lock)
        name = loop.parameters.names[0]
        scaled = pose_information(loop, spread={name: 0.1})
        assert scaled.spread[0] == 0.1
        close(covariance(scaled, 20), loop.crlb(LEG))

    def test_some_blocks_are_of_interest(self, lock):
        loop = loop_of(lock)
        name = loop.parameters.main.names[-1]
        some = pose_information(loop, of=name)
        assert some.labels == tuple(label for label in loop.parameters.main.labels if label.startswith(name))
        close(covariance(some, 20), loop.crlb(LEG)[loop.parameters.main[name], loop.parameters.main[name]])

    def test_every_pose_adds_its_part(self, lock):
        loop = loop_of(lock)
        information = pose_information(loop)
        np.testing.assert_allclose(
            information.take([1, 4]).total(np.ones(2)),
            information.total(np.isin(np.arange(20), [1, 4]).astype(float)),
            rtol=1e-12,
        )

    def test_poses_measured_on_the_clamp_count_as_more_poses(self, lock):
        whole = loop_of(lock)
        before, after = (whole.over(whole.data.poses(part)) for part in (slice(0, 12), slice(12, 20)))
        information = pose_information(after, measured=before)
        close(covariance(information, 8), whole.crlb(LEG))
        twice = pose_information(after, measured=[before, after])
        assert np.trace(covariance(twice, 8)) < np.trace(covariance(information, 8))


class TestSharedErrors:
    def test_the_error_of_a_known_estimate_is_in_it(self):
        found = hx.estimate(hx.loops.FixedLeg(pool("leg").leg(3)).linear(), hx.LeastSquares(weights="model"))
        loop = loop_of("length", platform_point=found)
        ignored = loop_of("length", platform_point=found.params["platform_point"])
        information = pose_information(loop)
        assert information.size == 3 + 1 + 3
        close(covariance(information, 20), loop.crlb(LEG))
        assert np.trace(covariance(information, 20)) > 1.05 * np.trace(covariance(pose_information(ignored), 20))

    def test_a_common_error_is_in_it(self):
        common = np.diag([0.02**2] * 3 + [0.0] * 9)
        noise = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=common)
        loop = hx.loops.LegLength(pool("none", noise=noise).leg(3))
        close(covariance(pose_information(loop), 20), loop.crlb(LEG))


class TestWholeRobot:
    def test_it_is_the_bound(self):
        loop = hx.loops.WholeRobot(pool("none", 15), pool("direction", 8))
        information = pose_information(loop)
        assert information.size == 44
        assert information.n_poses == 23
        close(covariance(information, 23), loop.crlb(ROBOT))

    def test_a_block_of_all_legs(self):
        loop = hx.loops.WholeRobot(pool("none", 15))
        assert pose_information(loop, of=["base_point"]).main == 18
        assert pose_information(loop, of=["leg2.base_point"]).main == 3

    def test_measured_sets_are_those_of_the_candidates_in_order(self):
        one, two = pool("none", 20, rng=1), pool("direction", 20, rng=2)
        whole = hx.loops.WholeRobot(one, two)
        first = hx.loops.WholeRobot(one.poses(slice(0, 9)), two.poses(slice(0, 9)))
        rest = hx.loops.WholeRobot(one.poses(slice(9, 20)), two.poses(slice(9, 20)))
        close(covariance(pose_information(rest, measured=first), 22), whole.crlb(ROBOT))


class TestProblems:
    def test_a_weighted_problem_is_its_loop(self):
        loop = loop_of("leg")
        one, two = pose_information(loop), pose_information(loop.linear(at=LEG))
        close(covariance(two, 20), covariance(one, 20))

    def test_raw_rows_have_unit_errors(self):
        problem = replace(loop_of("leg").linear(), noise=None)
        information = pose_information(problem)
        close(covariance(information, 20), np.linalg.inv(problem.matrix.T @ problem.matrix)[:3, :3])

    def test_other_forms_have_no_rows_of_a_pose(self):
        with pytest.raises(hx.errors.InputError, match=r'loop.linear\("direct"\)'):
            pose_information(loop_of("leg").linear("consecutive"))


class TestScenarios:
    def test_a_list_of_nominals(self):
        loop = loop_of("direction")
        nominals = [ROBOT.perturbed(0.5, rng=k).leg(3) for k in range(3)]
        many = pose_information(loop, nominals)
        assert many.blocks.shape[:2] == (3, 20)
        for k, nominal in enumerate(nominals):
            close(many.covariance(np.ones(20))[k], loop.crlb(nominal))


class TestAnEstimateFromElsewhere:
    def test_it_adds_its_inverse_covariance(self):
        found = hx.estimate(hx.loops.FixedLeg(pool("leg", rng=3).leg(3)).linear(), hx.LeastSquares(weights="model"))
        loop = loop_of("direction")
        information = pose_information(loop, measured=found)
        prior = np.zeros((6, 6))
        prior[:3, :3] = np.linalg.inv(found.covariance_of("platform_point"))
        close(covariance(information, 20), np.linalg.inv(np.linalg.inv(loop.crlb(LEG)) + prior))

    def test_one_without_a_parameter_in_common(self):
        data = pool("none").leg(3)
        points = {"platform_point": LEG.platform_point, "base_point": LEG.base_point}
        offset = hx.estimate(
            hx.loops.LegLength(data, unknown=("offset",), **points).linear(), hx.LeastSquares(weights="model")
        )
        with pytest.raises(hx.errors.InputError, match="some of platform_point, base_point; got offset"):
            pose_information(loop_of("direction"), measured=offset)

    def test_of_another_unit(self):
        found = hx.estimate(hx.loops.FixedLeg(pool("leg").leg(3)).linear(), hx.LeastSquares(weights="model"))
        blocks = tuple(replace(block, unit="mm") for block in found.parameters)
        with pytest.raises(hx.errors.UnitError, match="platform_point is in mm, that of the candidates in cm"):
            pose_information(loop_of("direction"), measured=replace(found, parameters=hx.Parameters(blocks)))

    @pytest.mark.parametrize("value", [0.0, np.nan])
    def test_without_a_usable_covariance(self, value):
        found = hx.estimate(hx.loops.FixedLeg(pool("leg").leg(3)).linear(), hx.LeastSquares(weights="model"))
        with pytest.raises(hx.errors.InputError, match="singular or not finite"):
            pose_information(loop_of("direction"), measured=replace(found, covariance=np.full((6, 6), value)))


class TestBadInput:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"of": "offset"}, "of: unknown parameter 'offset'; this problem has platform_point, base_point"),
            ({"of": ()}, "of: no parameter is of interest"),
            ({"spread": {"offset": 1.0}}, "spread: unknown parameter 'offset'"),
            ({"spread": {"base_point": 0.0}}, "expected spread > 0, got 0"),
            ({"measured": 3}, "measured: expected a loop like that over the candidates"),
            ({"at": np.full(9, np.nan)}, "at: 9 value.* are NaN"),
            ({"at": "x"}, "at: expected values, a geometry or an Estimate, got 'x'"),
            ({"at": object()}, "at: expected values"),
        ],
    )
    def test_settings(self, settings, message):
        with pytest.raises(hx.errors.InputError, match=message):
            pose_information(loop_of("direction"), **settings)

    def test_a_batch(self):
        data = hx.simulate_leg(ROBOT, 3, "leg", 5, n_sets=4, noise=NOISE, rng=0)
        with pytest.raises(hx.errors.InputError, match=r"one set of poses, got a batch of \(4,\)"):
            pose_information(hx.loops.FixedLeg(data))

    def test_no_noise(self):
        with pytest.raises(hx.errors.InputError, match="no noise model"):
            pose_information(hx.loops.FixedLeg(pool("leg", noise=None).leg(3)))

    def test_what_the_lock_hides(self):
        with pytest.raises(hx.errors.RankDeficientError, match="no choice of poses under this lock sees"):
            pose_information(hx.loops.LegLength(pool("direction").leg(3)))

    @pytest.mark.parametrize(
        ("lock", "given", "message"),
        [
            ("direction", [0.0, 0.0, 1.0], r"another clamp than the candidates: directions .*° apart"),
            ("length", 23.0, "another clamp than the candidates: lengths of"),
        ],
    )
    def test_measured_on_another_clamp(self, lock, given, message):
        other = hx.candidates(ROBOT, 3, lock, 5, NOISE, given, rng=1)
        with pytest.raises(hx.errors.InputError, match=message):
            pose_information(loop_of(lock), measured=KINDS[lock](other.leg(3)))

    def test_measured_on_no_clamp(self):
        free = pool("none").leg(3)
        loose = hx.LegMeasurements(free.position, free.rotation, free.length, "length", NOISE, LEG)
        with pytest.raises(hx.errors.InputError, match="another clamp than the candidates: lengths of"):
            pose_information(loop_of("length"), measured=hx.loops.FixedLength(loose))

    def test_measured_with_another_common_error(self):
        common = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=np.diag([0.02**2] * 3 + [0.0] * 9))
        one, two = (hx.loops.FixedLeg(pool("leg", noise=noise).leg(3)) for noise in (NOISE, common))
        for candidates, measured in ((one, two), (two, one)):
            with pytest.raises(hx.errors.InputError, match="another common error of all poses"):
                pose_information(candidates, measured=measured)

    def test_a_problem_has_its_own_point(self):
        with pytest.raises(hx.errors.InputError, match=r"write loop.linear\(at=…\)"):
            pose_information(loop_of("leg").linear(), LEG)

    def test_measured_by_another_loop(self):
        with pytest.raises(
            hx.errors.InputError, match="expected FixedDirection of platform_point, base_point, direction"
        ):
            pose_information(loop_of("direction"), measured=loop_of("leg"))

    def test_measured_with_another_known_value(self):
        found = hx.estimate(hx.loops.FixedLeg(pool("leg").leg(3)).linear(), hx.LeastSquares(weights="model"))
        exact, estimated = loop_of("length"), loop_of("length", platform_point=found)
        other = loop_of("length", platform_point=LEG.platform_point + 0.1)
        for candidates, measured in ((exact, estimated), (estimated, exact), (exact, other)):
            with pytest.raises(hx.errors.InputError, match="measured: knows platform_point by other values"):
                pose_information(candidates, measured=measured)
        again = loop_of("length", platform_point=found)
        assert pose_information(estimated, measured=again).fixed[0, 0, 0] > 0

    def test_measured_with_another_number_of_sets(self):
        one, two = pool("none", 20, rng=1), pool("none", 20, rng=2)
        with pytest.raises(hx.errors.InputError, match="measured: has 1 sets, and the candidates 2"):
            pose_information(hx.loops.WholeRobot(one, two), measured=hx.loops.WholeRobot(one))
