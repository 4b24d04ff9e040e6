"""Maximum likelihood: exact, as IPOPT finds it with all errors as unknowns, honest where it fails."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError, UnitError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength, PlatformPose, Sets, WholeRobot
from hexopt.result import Status
from hexopt.testing import check_estimator

ML = hx.MaximumLikelihood()
NAMES = ("platform_point", "base_point", "offset", "gain")
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
SEVEN = np.random.default_rng(3).standard_normal((7, 7)) * [*[0.005] * 3, *[1e-4] * 3, 0.005]
COMMON = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=SEVEN.T @ SEVEN)
#: By name: the lock, the poses that determine it, and the loop of its data.
LOOPS = {
    "I": ("direction", 3, FixedDirection),
    "II": ("leg", 3, FixedLeg),
    "III, b known": ("length", 4, FixedLength),
    "III": ("length", 7, lambda data: FixedLength(data, unknown=NAMES[:2])),
    "Model 36": ("none", 6, lambda data: LegLength(data, unknown=NAMES[:2])),
    "Model 42": ("none", 7, LegLength),
    "Model 48": ("none", 8, lambda data: LegLength(data, unknown=NAMES)),
}
FREE = replace(
    hx.robots.left_hand(),
    limits=hx.Limits(),
    ranges=replace(hx.robots.left_hand().ranges, lock_cone=np.deg2rad(40)),
)


def simulated(name, *, robot=None, leg=3, more=3, n_sets=None, noise=NOISE, seed=0, off=0.03, exact=False):
    """As many poses as determine the leg and some more; what is not known of the nominal is off, in robot sizes."""
    robot = robot or hx.robots.left_hand()
    lock, least, _ = LOOPS[name]
    nominal = robot.perturbed(
        off * robot.size, offsets=off * robot.size if "8" in name or "2" in name else 0.0, rng=seed
    ).leg(leg)
    if name == "III, b known":
        nominal = nominal.replaced(platform_point=robot.leg(leg).platform_point)
    if name == "Model 48":
        nominal = nominal.replaced(gain=1.02 * nominal.gain)
    drawn = None if exact else noise
    data = hx.simulate_leg(robot, leg, lock, least + more, n_sets, drawn, nominal=nominal, rng=seed)
    return replace(data, noise=noise)


def made(name, **settings):
    return LOOPS[name][2](simulated(name, **settings))


def in_sigmas(found, expected):
    """The largest difference of values, in standard errors."""
    return np.abs((found.values - expected) / found.standard_errors).max()


def noise_of(robot):
    """The paper's errors, for a robot of any size."""
    return hx.UniformNoise(6e-4 * robot.size, np.deg2rad(0.01), 6e-4 * robot.size)


class TestExact:
    @pytest.mark.parametrize("name", LOOPS)
    def test_every_leg_of_every_robot(self, name, robot):
        """From a nominal off by half a centimetre (of a robot of 16) where one is needed; linear loops need none."""
        half = {"cm": 0.5, "mm": 5.0, "um": 5000.0}.get(robot.length_unit, 0.03 * robot.size) / robot.size
        ok = []
        for leg in range(1, 7):
            loop = made(name, robot=robot, leg=leg, n_sets=20, noise=noise_of(robot), off=half, exact=True)
            found = hx.estimate(loop, hx.MaximumLikelihood(max_iterations=1000))
            truth = robot.leg(leg)
            error = np.max([e / robot.size for key, e in found.error(truth).items() if key != "gain"], axis=0)
            ok.append(found.ok)
            assert np.isnan(found.values[~found.ok]).all()
            allowed = 100 * np.finfo(float).eps * found.condition[found.ok]
            assert (error[found.ok] <= allowed).all(), (error[found.ok] / allowed).max()
        assert np.mean(ok) >= 0.99

    def test_a_set_of_least_poses(self):
        for name, (_, _, kind) in LOOPS.items():
            found = hx.estimate(kind(simulated(name, more=0, n_sets=30, exact=True)), ML)
            good = found.ok & (found.condition < 1e4)
            assert good.mean() > 0.3
            for key, error in found.error(hx.robots.left_hand().leg(3)).items():
                assert error[good].max() < 1e-8, (name, key)

    def test_one_step_of_known_values_after_the_other(self):
        """The three steps, each with the estimate before as known."""
        truth = hx.robots.left_hand().leg(3)
        b = hx.estimate(made("II", exact=True), ML)
        a = hx.estimate(FixedLength(simulated("III, b known", exact=True), platform_point=b), ML)
        data = simulated("Model 42", exact=True)
        offset = hx.estimate(LegLength(data, unknown="offset", platform_point=b, base_point=a), ML)
        for found in (b, a, offset):
            for error in found.error(truth).values():
                assert error < 1e-10


def by_ipopt(loop, **settings):
    """The likelihood with every error as an unknown, from where the least-squares start is."""
    linear = getattr(loop, "is_linear", False)
    start = hx.LeastSquares().fit(loop.linear()).values if linear else loop.start()
    found = hx.symbolic.maximum_likelihood(loop, start, **settings)
    assert found.success
    return found


class TestAgainstAllErrorsAsUnknowns:
    @pytest.mark.parametrize("size", [1, 50])
    @pytest.mark.parametrize("name", LOOPS)
    def test_ipopt(self, name, size):
        """Errors of 0.01 cm and degrees, and of 0.5."""
        noise = hx.UniformNoise(0.01 * size, np.deg2rad(0.01 * size), 0.01 * size)
        loop = made(name, noise=noise, seed=2, off=0.01, more=5)
        found, expected = hx.estimate(loop, ML), by_ipopt(loop)
        assert in_sigmas(found, expected.values) < 1e-6
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-8)

    def test_ipopt_without_the_unit_norm(self):
        loop = made("I", seed=2)
        found = hx.estimate(loop, hx.MaximumLikelihood(unit_norm=False))
        expected = by_ipopt(loop, unit_norm=False)
        assert in_sigmas(found, expected.values) < 1e-6
        n = found.params["direction"]
        assert abs(np.linalg.norm(n) - 1) > 1e-6

    @pytest.mark.parametrize("name", ["I", "II", "III, b known", "Model 42"])
    def test_ipopt_with_a_common_error(self, name):
        """A shared error enters to first order: the answers agree to what that leaves."""
        noise = hx.NormalNoise(1e-4, 1e-6, 1e-4, common_covariance=1e-4 * SEVEN.T @ SEVEN)
        loop = made(name, noise=noise, seed=1)
        assert in_sigmas(hx.estimate(loop, ML), by_ipopt(loop).values) < 1e-4

    def test_ipopt_with_the_error_of_a_known_value(self):
        small = hx.UniformNoise(1e-4, np.deg2rad(1e-4), 1e-4)
        b = hx.estimate(made("II", noise=small), ML)
        loop = FixedLength(simulated("III, b known", noise=small, seed=5, more=10), platform_point=b)
        assert in_sigmas(hx.estimate(loop, ML), by_ipopt(loop).values) < 1e-4

    def test_ipopt_on_several_sets(self):
        loops = [
            FixedDirection(simulated("I", seed=1)),
            FixedLeg(simulated("II", seed=2)),
            FixedLength(simulated("III", seed=3), unknown=NAMES[:2]),
        ]
        model = Sets(*loops)
        assert in_sigmas(hx.estimate(model, ML), by_ipopt(model).values) < 1e-6

    def test_ipopt_on_a_whole_robot(self):
        sets = [
            hx.simulate(FREE, lock, 7, noise=NOISE, ranges=FREE.ranges, leg=leg, rng=seed)
            for seed, (lock, leg) in enumerate([("direction", 2), ("direction", 5), ("length", 3), ("none", None)])
        ]
        model = WholeRobot(*sets, nominal=FREE.perturbed(0.05, offsets=0.05, rng=0))
        assert in_sigmas(hx.estimate(model, ML), by_ipopt(model).values) < 1e-6


class TestUncertainty:
    @pytest.mark.parametrize("name", LOOPS)
    def test_the_covariance_is_the_bound_at_the_answer(self, name):
        """For small errors it is that of the truth."""
        small = hx.NormalNoise(1e-5, 1e-7, 1e-5)
        loop = made(name, noise=small, n_sets=3)
        found = hx.estimate(loop, ML)
        main = found.parameters.main.names
        expected = loop.crlb(hx.robots.left_hand().leg(3))
        scale = np.sqrt(np.einsum("...ii,...jj->...ij", expected, expected))
        assert found.covariance_kind == "model"
        np.testing.assert_allclose(found.covariance_of(*main) / scale, expected / scale, atol=2e-3)

    @pytest.mark.parametrize(
        ("name", "noise"), [*itertools.product(["I", "II", "III, b known"], ["common", "carried"])]
    )
    def test_with_shared_errors_too(self, name, noise):
        truth = hx.robots.left_hand().leg(3)
        data = simulated(name, noise=COMMON if noise == "common" else NOISE, n_sets=3, more=6)
        known = {}
        if noise == "carried":
            b = hx.estimate(made("II", seed=7), ML)
            known = {"platform_point": b} if name != "II" else {}
        kind = LOOPS[name][2]
        unknown = {"unknown": ("base_point",)} if known else {}
        loop = kind(data, **unknown, **known)
        found = hx.estimate(loop, ML)
        expected = loop.crlb(truth)
        scale = np.sqrt(np.einsum("...ii,...jj->...ij", expected, expected))
        np.testing.assert_allclose(found.covariance_of(*loop.unknown) / scale, expected / scale, atol=0.05)

    def test_nothing_is_uncertain_along_a_direction(self):
        found = hx.estimate(made("I", n_sets=4), ML)
        n, covariance = found.params["direction"], found.covariance_of("direction")
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, rtol=1e-14)
        along = np.einsum("sij,sj->si", covariance, n)
        assert np.abs(along).max() < 1e-12 * np.abs(covariance).max()
        assert (np.linalg.matrix_rank(covariance, tol=1e-9 * np.abs(covariance).max()) == 2).all()

    @pytest.mark.parametrize(
        ("name", "freedom"), [("I", 18 - 8), ("II", 18 - 6), ("III, b known", 7 - 4), ("Model 42", 10 - 7)]
    )
    def test_degrees_of_freedom(self, name, freedom):
        found = hx.estimate(made(name), ML)
        assert found.degrees_of_freedom == freedom
        np.testing.assert_allclose(found.chi2, 2 * found.objective)
        plain = hx.estimate(made(name, noise=COMMON), ML)
        assert plain.degrees_of_freedom == freedom  # a shared error brings a row of its own

    def test_without_the_unit_norm_one_less(self):
        assert hx.estimate(made("I"), hx.MaximumLikelihood(unit_norm=False)).degrees_of_freedom == 18 - 9

    @pytest.mark.parametrize("name", LOOPS)
    def test_influence_is_what_a_moved_pose_does(self, name, central_difference):
        small = hx.NormalNoise(1e-6, 1e-8, 1e-6)
        loop = made(name, noise=small)
        found = hx.estimate(loop, ML)
        data = loop.data

        def moved(step):
            position = np.array(data.position)
            position[[0, -1]] += 1e-6 * step
            return ML.fit(LOOPS[name][2](replace(data, position=position))).values

        change = central_difference(moved, np.zeros((2, 3)), step=1.0).reshape(-1, 2, 3) / 1e-6
        rows = loop.noise_jacobian(found.values)[..., :3]  # of the rows, by the position
        expected = -np.einsum("pnd,nde->pne", found.influence, rows)[:, [0, -1]]
        main = loop.parameters.main.size  # the nuisance of Type III is about the mean position, which moves
        np.testing.assert_allclose(change[:main], expected[:main], atol=1e-3 * np.abs(expected[:main]).max())


class TestRelations:
    def test_a_common_error_is_a_dense_covariance(self):
        """To first order: the same answer as generalised least squares with all rows whitened together."""
        tiny = hx.NormalNoise(1e-6, 1e-8, 1e-6, common_covariance=1e-8 * SEVEN.T @ SEVEN)
        for name in ("II", "III, b known"):
            loop = made(name, noise=tiny, n_sets=5, more=5)
            found = hx.estimate(loop, ML)
            linear = loop.linear(at=hx.robots.left_hand().leg(3))
            expected = hx.estimate(linear, hx.LeastSquares(weights="model"))
            assert in_sigmas(found, expected.values) < 1e-3
            np.testing.assert_allclose(found.standard_errors, expected.standard_errors, rtol=1e-3)
            np.testing.assert_allclose(found.chi2, expected.chi2, rtol=1e-3)

    def test_type_ii_is_weighted_least_squares_to_first_order(self):
        loop = made("II", noise=hx.UniformNoise(1e-5, 1e-7, 1e-5), n_sets=5)
        expected = hx.estimate(loop.linear(), hx.LeastSquares(weights="model"))
        assert in_sigmas(hx.estimate(loop, ML), expected.values) < 1e-3

    def test_one_set_of_a_robot_is_its_loop(self):
        data = simulated("I", n_sets=4)
        alone = hx.estimate(FixedDirection(data), ML)
        joined = hx.estimate(WholeRobot(data, unknown=NAMES[:2]), ML)
        assert joined.parameters.names == ("leg3.platform_point", "leg3.base_point", "direction")
        assert in_sigmas(alone, joined.values) < 1e-6
        np.testing.assert_allclose(joined.covariance, alone.covariance, atol=1e-6 * alone.covariance.max())

    def test_two_and_three_of_a_robot_are_two_sets(self):
        """Without readings; with them the offset comes along, too."""
        two, three = simulated("II", seed=1, more=4), simulated("III", seed=2, more=4)
        sets = Sets(FixedLeg(two), FixedLength(three, unknown=NAMES[:2]))
        alone = hx.estimate(sets, ML)
        joined = hx.estimate(WholeRobot(replace(two, length=None), replace(three, length=None), unknown=NAMES[:2]), ML)
        for name in NAMES[:2]:
            scale = np.sqrt(np.diag(alone.covariance_of(name)))
            assert (np.abs(joined.params[f"leg3.{name}"] - alone.params[name]) < 1e-6 * scale).all()
        read = hx.estimate(WholeRobot(two, three), ML)
        assert read.standard_errors[read.parameters["leg3.offset"]] < 0.1
        assert abs(read.params["leg3.offset"][0] - 15.25) < 5 * read.standard_errors[read.parameters["leg3.offset"]]

    def test_unlocked_poses_by_forward_kinematics(self):
        robot = hx.robots.left_hand()
        data = hx.simulate(robot, n_poses=14, noise=NOISE, nominal=robot.perturbed(0.2, offsets=0.2, rng=1), rng=0)
        joined, posed = hx.estimate(WholeRobot(data), ML), hx.estimate(PlatformPose(data), ML)
        assert in_sigmas(joined, posed.values) < 1e-5
        np.testing.assert_allclose(joined.objective, posed.objective, rtol=1e-7)

    def test_an_estimate_serves_as_a_known_value(self):
        """Its error makes the next one's larger."""
        b = hx.estimate(made("II"), ML)
        data = simulated("III, b known", more=40)
        carried = hx.estimate(FixedLength(data, platform_point=b), ML)
        taken = hx.estimate(FixedLength(data, platform_point=b.params["platform_point"]), ML)
        ratio = carried.standard_errors[:3] / taken.standard_errors[:3]
        assert (ratio > 1.05).all()

    def test_a_start_elsewhere_gives_the_same(self):
        robot = hx.robots.left_hand()
        for name in ("I", "II", "III, b known", "Model 42"):
            loop = made(name, n_sets=4)
            start = hx.MaximumLikelihood(start=robot.perturbed(0.5, offsets=0.5, rng=9).leg(3))
            assert in_sigmas(hx.estimate(loop, ML), hx.estimate(loop, start).values) < 1e-5


class TestWholeRobot:
    def sets(self, **settings):
        exact = settings.pop("exact", False)
        noise = None if exact else NOISE
        made = [
            hx.simulate(FREE, "direction", 7, noise=noise, ranges=FREE.ranges, leg=k, rng=k, **settings)
            for k in range(1, 7)
        ]
        return [replace(data, noise=NOISE) for data in made]

    def test_exact_from_a_nominal_far_off(self):
        """Six locked directions, five centimetres off: all joints and offsets."""
        nominal = FREE.perturbed(5.0, offsets=5.0, rng=0)
        found = hx.estimate(WholeRobot(*self.sets(exact=True), nominal=nominal), ML)
        for error in found.error(FREE).values():
            assert error < 1e-9

    def test_noisy_from_a_nominal_far_off(self):
        sets = self.sets(n_sets=3)
        near = hx.estimate(WholeRobot(*sets), ML)
        far = hx.estimate(WholeRobot(*sets, nominal=FREE.perturbed(5.0, offsets=5.0, rng=0)), ML)
        assert far.ok.all()
        assert in_sigmas(near, far.values) < 1e-5

    def test_a_batch_equals_its_members(self):
        sets = self.sets(n_sets=3)
        together = hx.estimate(WholeRobot(*sets), ML)
        alone = hx.estimate(WholeRobot(*(data[1] for data in sets)), ML)
        assert in_sigmas(alone, together.values[1]) < 1e-6

    @pytest.mark.parametrize("model", [2, 3, 4])
    def test_models_on_unlocked_poses(self, model):
        robot = hx.robots.left_hand()
        nominal = robot.perturbed(0.5, offsets=0.5 if model > 2 else 0.0, rng=1)
        data = replace(hx.simulate(robot, n_poses=16, nominal=nominal, n_sets=3, rng=0), noise=NOISE)
        found = hx.estimate(WholeRobot(data, unknown=NAMES[:model]), ML)
        assert found.ok.all()
        for error in found.error(robot).values():
            assert error.max() < 1e-9

    def test_one_direction_does_not_see_its_offset(self):
        with pytest.raises(RankDeficientError, match=r"leg3\.offset") as caught:
            hx.estimate(WholeRobot(simulated("I", more=6)), ML)
        assert any("leg3.base_point" in combination for combination in caught.value.combinations)


def standing(data, member=1):
    """The batch with one set whose poses are all the first."""
    parts = {name: np.array(getattr(data, name)) for name in ("position", "rotation", "length")}
    for part in parts.values():
        part[member] = part[member, :1]
    return replace(data, **parts)


class TestFailures:
    @pytest.mark.parametrize("name", LOOPS)
    def test_a_singular_set_fails_alone(self, name):
        data = simulated(name, n_sets=3)
        kind = LOOPS[name][2]
        good, found = hx.estimate(kind(data), ML), hx.estimate(kind(standing(data)), ML)
        assert [int(code) for code in found.codes] == [Status.OPTIMAL, Status.RANK_DEFICIENT, Status.OPTIMAL]
        assert found.unseen
        assert np.isnan(found.values[1]).all()
        for i in (0, 2):
            assert in_sigmas(good[i], found.values[i]) < 1e-6
        with pytest.raises(RankDeficientError, match="do not determine"):
            hx.estimate(kind(standing(data)[1]), ML)

    def test_a_known_estimate_that_failed_fails_alone(self):
        b = hx.estimate(FixedLeg(standing(simulated("II", n_sets=3))), ML)
        data, free = simulated("III, b known", n_sets=3), simulated("Model 42", n_sets=3)
        for loop in (
            FixedLength(data, platform_point=b),
            LegLength(free, unknown=("base_point", "offset"), platform_point=b),
        ):
            for estimator in (ML, hx.MaximumLikelihood(start=hx.robots.left_hand().leg(3))):
                found = hx.estimate(loop, estimator)
                assert found.ok.tolist() == [True, False, True]
                assert np.isnan(found.values[1]).all()
                with pytest.raises(EstimationError):
                    hx.estimate(loop, estimator, throw=True)

    @pytest.mark.parametrize(("name", "few"), [("I", 2), ("II", 1), ("III, b known", 3), ("Model 42", 6), ("III", 6)])
    def test_too_few_poses(self, name, few):
        with pytest.raises(RankDeficientError, match=r"at least|do not determine"):
            hx.estimate(LOOPS[name][2](simulated(name).poses(slice(0, few))), ML)

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_lengths_under_a_locked_direction_are_blind(self, lock):
        """Noise makes it look seen; it is not."""
        data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, 14, 3, noise=NOISE, rng=0)
        found = hx.estimate(LegLength(data), ML)
        assert (found.codes == Status.RANK_DEFICIENT).all()
        assert found.unseen == ("base_point across the leg's locked direction",)
        with pytest.raises(RankDeficientError, match="across"):
            hx.estimate(LegLength(data[0]), ML)

    def test_too_few_iterations(self):
        found = hx.estimate(made("Model 42", n_sets=3), hx.MaximumLikelihood(max_iterations=1))
        assert (found.codes == Status.NOT_CONVERGED).all()
        assert np.isnan(found.values).all()
        assert (found.iterations == 1).all()

    @pytest.mark.parametrize("far", [5.0, 50.0, 500.0])
    def test_bad_starts_are_another_minimum_or_say_so(self, far):
        """No answer is better than the best; none is called a success without being stationary."""
        robot = hx.robots.left_hand()
        loop = made("Model 42", n_sets=10, more=8)
        best = hx.estimate(loop, ML)
        start = hx.MaximumLikelihood(start=robot.perturbed(far, offsets=0.0, rng=3).leg(3))
        found = hx.estimate(loop, start)
        ok = found.ok
        assert np.isnan(found.values[~ok]).all()
        assert (found.objective[ok] >= best.objective[ok] - 1e-6).all()
        same = found.objective[ok] <= best.objective[ok] + 1e-6
        apart = np.abs((found.values - best.values) / best.standard_errors)[ok].max(axis=1)
        assert (apart[same] < 1e-3).all()
        if far == 5.0:
            assert ok.all()
            assert same.all()

    def test_a_single_set_whose_linear_start_is_far(self):
        """Four poses, errors of half a centimetre: with or without success, a set alone ends as in its batch."""
        noise = hx.UniformNoise(0.5, np.deg2rad(0.5), 0.5)
        data = hx.simulate_leg(hx.robots.left_hand(), 3, "direction", 4, 40, noise=noise, rng=3)
        together = hx.estimate(FixedDirection(data), ML)
        for i in range(40):
            alone = hx.estimate(FixedDirection(data[i]), ML, throw=False)
            assert alone.status == together.status[i]
            np.testing.assert_allclose(alone.values, together.values[i], rtol=1e-4, atol=1e-4)

    def test_no_noise_model(self):
        for name, (_, _, kind) in LOOPS.items():
            with pytest.raises(InputError, match="no noise model"):
                hx.estimate(kind(replace(simulated(name), noise=None)), ML)
        with pytest.raises(InputError, match="no noise model"):
            hx.estimate(WholeRobot(hx.simulate(hx.robots.left_hand(), n_poses=9, rng=0)), ML)

    @pytest.mark.parametrize(
        ("name", "noise"),
        [
            ("II", hx.NormalNoise(0, 1e-4, 0.01)),
            ("II", hx.NormalNoise(0, 0, 0.01)),
            ("I", hx.NormalNoise(0, 0, 0.01)),
            ("III, b known", hx.NormalNoise(0, 0, 0.01)),
        ],
    )
    def test_equations_without_any_error(self, name, noise):
        for n_sets in (None, 3):
            with pytest.raises(InputError, match="without any error"):
                hx.estimate(made(name, noise=noise, n_sets=n_sets), ML)

    @pytest.mark.parametrize(
        ("name", "noise"),
        [
            ("II", hx.NormalNoise(0.01, 0, 0)),
            ("I", hx.NormalNoise(0.01, 0, 0)),
            ("Model 42", hx.NormalNoise(0, 0, 0.01)),
            ("III, b known", hx.NormalNoise(0, 1e-4, 0)),
        ],
    )
    def test_measurements_without_error_may_stay(self, name, noise):
        """What is not in error is not moved."""
        loop = made(name, noise=noise, n_sets=5)
        found = hx.estimate(loop, ML)
        assert found.ok.all()
        still = np.diagonal(loop.error_covariance[0, 0]) == 0
        moved = loop.whitened(found.values, adjust=10).error
        assert not moved[..., still].any()
        assert moved[..., ~still].any()

    def test_a_nonlinear_loop_needs_a_nominal(self):
        data = simulated("III")
        with pytest.raises(InputError, match="initial guess"):
            hx.estimate(FixedLength(replace(data, nominal=None), unknown=NAMES[:2]), ML)
        start = hx.MaximumLikelihood(start=data.nominal)
        assert hx.estimate(FixedLength(replace(data, nominal=None), unknown=NAMES[:2]), start).ok

    def test_a_linear_loop_needs_none(self):
        data = simulated("II")
        assert hx.estimate(FixedLeg(replace(data, nominal=None)), ML).ok


class TestSettings:
    @pytest.mark.parametrize(
        ("settings", "match"),
        [
            ({"start": [1.0, 2.0]}, "start: expected a Leg or a Hexapod, got list"),
            ({"unit_norm": "no"}, "unit_norm"),
            ({"unit_norm": None}, "unit_norm"),
            ({"max_iterations": 0}, "max_iterations"),
            ({"max_iterations": 2.5}, "max_iterations"),
            ({"max_iterations": True}, "max_iterations"),
        ],
    )
    def test_wrong_ones(self, settings, match):
        with pytest.raises(InputError, match=match):
            hx.MaximumLikelihood(**settings)

    def test_a_linear_problem_is_no_target(self):
        with pytest.raises(InputError, match=r"estimate\(loop, MaximumLikelihood\(\)\)"):
            hx.estimate(made("II").linear(), ML)

    def test_a_start_in_another_unit(self):
        with pytest.raises(UnitError, match="um"):
            hx.estimate(made("II"), hx.MaximumLikelihood(start=hx.robots.rubin().leg(3)))

    def test_a_robot_as_the_start_of_a_leg(self):
        robot = hx.robots.left_hand()
        loop = made("Model 42", off=0.0)
        one, two = (hx.estimate(loop, hx.MaximumLikelihood(start=start)) for start in (robot, robot.leg(3)))
        np.testing.assert_array_equal(one.values, two.values)


class TestContract:
    def test_all_loops(self):
        check_estimator(ML, n_poses=14, tolerance=1e-5)

    def test_without_the_unit_norm(self):
        estimator = hx.MaximumLikelihood(unit_norm=False)
        check_estimator(estimator, FixedDirection, lock="direction", tolerance=1e-5)

    @pytest.mark.parametrize("unknown", [NAMES[:2], NAMES])
    def test_other_models(self, unknown):
        check_estimator(ML, lambda data: LegLength(data, unknown=unknown), n_poses=14, tolerance=1e-5)

    def test_both_points_of_type_iii(self):
        check_estimator(
            ML, lambda data: FixedLength(data, unknown=NAMES[:2]), lock="length", n_poses=14, tolerance=1e-5
        )

    def test_a_start_of_its_own(self):
        """It stays where it is when frames and units move, so it claims no more."""
        leg = hx.robots.left_hand().leg(3)
        estimator = hx.MaximumLikelihood(start=leg.replaced(base_point=leg.base_point + 0.1))
        check_estimator(estimator, LegLength, n_poses=14, claims=("exact", "order", "rank"), tolerance=1e-5)
