"""Predicted covariances against Monte Carlo: every loop, form and weighting; coverage of 95 % intervals.

Standardised errors z = C^(−1/2)(x̂ − x), one a simulated set, must have the covariance I. Its entries are checked within
five Monte-Carlo errors, and the share of |error| ≤ 1.96 σ̂ must be 95 ± 1 %.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import hexopt as hx

SETS = 6000
LEVELS = {"position": 1e-3, "angle": np.deg2rad(1e-3), "length": 1e-3}
RNG = np.random.default_rng(11)
SEVEN = RNG.standard_normal((7, 7)) * 1e-4
NOISES = {
    "uniform ZXZ": hx.UniformNoise(**LEVELS),
    "normal xyz": hx.NormalNoise(**LEVELS, coordinates="xyz"),
    "correlated": hx.NormalNoise(pose_covariance=SEVEN @ SEVEN.T + 1e-10 * np.eye(7)),
    "common": hx.NormalNoise(**LEVELS, coordinates="rotation_vector", common_covariance=SEVEN.T @ SEVEN),
}
LOOPS = {
    "FixedDirection": ("direction", 10, ("direct", "consecutive")),
    "FixedLeg": ("leg", 10, ("direct", "consecutive", "centred")),
    "FixedLength": ("length", 10, ("direct", "consecutive", "centred")),
    "LegLength": ("none", 10, ("direct",)),
}
CASES = [(name, form) for name, (_, _, forms) in LOOPS.items() for form in forms]


def truth():
    return hx.robots.left_hand().leg(3)


def loop_of(name, noise, n_sets=SETS, seed=0, n_poses=None):
    lock, n, _ = LOOPS[name]
    data = hx.simulate_leg(
        hx.robots.left_hand(), 3, lock, n_poses or n, n_sets, noise=NOISES.get(noise, noise), rng=seed
    )
    known = {"unknown": ("offset", "gain")} if name == "LegLength" else {}
    return getattr(hx.loops, name)(data, **known)


def main_part(found):
    """Return values and covariance of the leg's own parameters, and the true ones."""
    names = found.parameters.main.names
    values = np.concatenate([found.params[name] for name in names], axis=-1)
    true = np.concatenate([truth().block(name) for name in names])
    return values - true, found.covariance_of(*names)


def assert_honest(error, covariance, *, coverage=0.01, level=0.95, normal=True):
    """Check standardised errors against I, and the coverage of intervals."""
    assert np.isfinite(covariance).all()
    n = len(error)
    root = np.linalg.cholesky(covariance)
    z = np.linalg.solve(root, error[..., None])[..., 0]
    found = z.T @ z / n
    fourth = (z**2).T @ (z**2) / n
    spread = np.sqrt(np.maximum(fourth - found**2, 0.2) / n)
    deviation = (found - np.eye(z.shape[1])) / spread
    assert np.abs(deviation).max() < 5, f"covariance of standardised errors:\n{found.round(3)}"
    assert np.abs(z.mean(axis=0) * np.sqrt(n)).max() < 5
    if normal:
        sigma = np.sqrt(np.einsum("...ii->...i", covariance))
        inside = (np.abs(error) <= stats.norm.ppf(0.5 + level / 2) * sigma).mean(axis=0)
        assert np.abs(inside - level).max() <= coverage, inside


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize(("name", "form"), CASES)
class TestCovariance:
    def test_sandwich_of_unweighted_estimates(self, name, form, noise):
        found = hx.estimate(loop_of(name, noise).linear(form), hx.LeastSquares())
        assert found.covariance_kind == "sandwich"
        assert_honest(*main_part(found))

    def test_model_covariance_of_weighted_estimates(self, name, form, noise):
        n_sets = SETS if form == "direct" and noise != "common" else 1500  # dense whitening is dearer
        found = hx.estimate(loop_of(name, noise, n_sets).linear(form), hx.LeastSquares(weights="model"))
        assert found.covariance_kind == "model"
        assert_honest(*main_part(found), coverage=0.01 if n_sets == SETS else 0.02)
        freedom = found.degrees_of_freedom
        assert abs(found.chi2.mean() / freedom - 1) < 5 * np.sqrt(2 / freedom / n_sets)


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("name", LOOPS)
def test_entry_by_entry_at_fixed_poses(name, noise):
    """The same poses measured again and again: the sample covariance is the predicted one, entry by entry."""
    lock, n, _ = LOOPS[name]
    robot = hx.robots.left_hand()
    exact = hx.simulate_leg(robot, 3, lock, n, rng=4)
    model = NOISES[noise]
    repeated = [np.broadcast_to(part, (SETS, *part.shape)) for part in (exact.position, exact.rotation, exact.length)]
    noisy = hx.LegMeasurements(*model.apply(*repeated, np.random.default_rng(5)), lock, model, robot.leg(3))
    known = {"unknown": ("offset", "gain")} if name == "LegLength" else {}
    told = hx.LegMeasurements(exact.position, exact.rotation, exact.length, lock, model, robot.leg(3))
    for estimator in (hx.LeastSquares(), hx.LeastSquares(weights="model")):
        found, predicted = (
            hx.estimate(getattr(hx.loops, name)(d, **known).linear(at=truth()), estimator) for d in (noisy, told)
        )
        error, _ = main_part(found)
        expected = predicted.covariance_of(*predicted.parameters.main.names)
        sample = error.T @ error / SETS
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        assert (np.abs(sample - expected) / scale).max() < 5 * np.sqrt(2 / SETS)


@pytest.mark.parametrize("name", ["FixedDirection", "FixedLeg", "FixedLength"])
def test_weights_make_better_estimates(name, paper_noise):
    """Generalised least squares is no worse anywhere, and better by what its covariance says."""
    loop = loop_of(name, paper_noise, 4000, n_poses=7)
    plain, weighted = (
        hx.estimate(loop.linear(form), hx.LeastSquares(weights=weights))
        for form, weights in (("consecutive", None), ("direct", "model"))
    )
    for key in plain.parameters.main.names:
        rms = [np.sqrt(np.mean(found.error(truth())[key] ** 2)) for found in (plain, weighted)]
        assert rms[1] < 0.97 * rms[0], key
        variance = [np.einsum("...ii->...", found.covariance_of(key)).mean() for found in (plain, weighted)]
        np.testing.assert_allclose(rms[1] / rms[0], np.sqrt(variance[1] / variance[0]), rtol=0.1)


class TestWithoutANoiseModel:
    """Independent rows of one unknown variance: the residuals tell it, with Student's t."""

    def problem(self, n_sets=20_000, m=7):
        rng = np.random.default_rng(0)
        matrix = rng.standard_normal((n_sets, m, 3)) * [1.0, 10.0, 0.1]
        rhs = matrix @ [1.0, -2.0, 3.0] + 0.3 * rng.standard_normal((n_sets, m))
        return hx.LinearProblem(matrix, rhs, hx.Parameters((hx.Block("base_point", 3, "cm"),)))

    @pytest.mark.parametrize("method", ["auto", "svd", "normal"])
    @pytest.mark.filterwarnings("ignore:normal equations")
    def test_residual_covariance(self, method):
        found = hx.estimate(self.problem(), hx.LeastSquares(method=method))
        assert found.covariance_kind == "residual"
        assert found.degrees_of_freedom == 4
        t = (found.values - [1.0, -2.0, 3.0]) / found.standard_errors
        for column in t.T:
            assert stats.kstest(column, stats.t(4).cdf).pvalue > 1e-3
        inside = (np.abs(t) < stats.t(4).ppf(0.975)).mean(axis=0)
        assert np.abs(inside - 0.95).max() < 0.01

    @pytest.mark.parametrize(("name", "form"), CASES)
    def test_every_form_of_independent_direct_rows(self, name, form):
        """Errors of position alone make the direct rows independent; differences of them stay honest all the same."""
        loop = loop_of(name, hx.NormalNoise(1e-3), n_sets=8000)
        silent = replace(loop.data, noise=None)
        known = {"unknown": ("offset", "gain")} if name == "LegLength" else {}
        found = hx.estimate(type(loop)(silent, **known).linear(form), hx.LeastSquares())
        assert found.covariance_kind == "residual"
        error, covariance = main_part(found)
        sigma = np.sqrt(np.einsum("...ii->...i", covariance))
        inside = (np.abs(error) <= stats.t(found.degrees_of_freedom).ppf(0.975) * sigma).mean(axis=0)
        assert np.abs(inside - 0.95).max() < 0.012, inside

    def test_a_loop_without_noise_model(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "leg", 7, 10, noise=hx.UniformNoise(0.01), rng=0)
        silent = hx.LegMeasurements(data.position, data.rotation, data.length, "leg", None, data.nominal)
        found = hx.estimate(hx.loops.FixedLeg(silent).linear(), hx.LeastSquares())
        assert found.covariance_kind == "residual"
        assert found.degrees_of_freedom == 21 - 6
        sigma = np.sqrt(2 * found.objective.mean() / 15)
        assert 0.8 < sigma / (0.01 / np.sqrt(3)) < 1.2

    def test_no_freedom_no_covariance(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "direction", 3, 10, rng=0)
        found = hx.estimate(hx.loops.FixedDirection(data).linear(), hx.LeastSquares())
        assert found.covariance is None
        assert "no residual is left" in found.covariance_kind


class TestInverseKinematics:
    def fitted(self, noise, weights, n_sets=4000):
        robot = hx.robots.left_hand()
        data = hx.simulate_leg(
            robot, 3, "none", 14, n_sets, noise=NOISES[noise], nominal=robot.perturbed(0.3, rng=0), rng=1
        )
        return hx.estimate(hx.loops.LegLength(data), hx.InverseKinematics(weights=weights))

    @pytest.mark.parametrize("noise", NOISES)
    @pytest.mark.parametrize("weights", [None, "model"])
    def test_covariance(self, noise, weights):
        found = self.fitted(noise, weights)
        assert found.ok.all()
        assert found.covariance_kind == ("model" if weights else "sandwich")
        assert_honest(*main_part(found), coverage=0.012)

    def test_weights_make_better_estimates(self):
        plain, weighted = (self.fitted("correlated", weights) for weights in (None, "model"))
        error = [main_part(found)[0] for found in (plain, weighted)]
        ratio = np.sqrt((error[1] ** 2).mean(axis=0) / (error[0] ** 2).mean(axis=0))
        predicted = [np.einsum("...ii->...i", found.covariance).mean(axis=0) for found in (plain, weighted)]
        np.testing.assert_allclose(ratio, np.sqrt(predicted[1] / predicted[0]), rtol=0.1)
        assert (ratio < 1.0).all()


class TestThreeSteps:
    def calibrated(self, n1=7, n2=7, n_sets=SETS, noise=None, seed=0, form="consecutive", estimator=None):
        robot = hx.robots.left_hand()
        noise = noise or hx.UniformNoise(**LEVELS)
        sets = {
            hx.Lock.LEG: hx.simulate_leg(robot, 3, "leg", n1, n_sets, noise=noise, rng=seed),
            hx.Lock.LENGTH: hx.simulate_leg(robot, 3, "length", n2, n_sets, noise=noise, rng=seed + 1),
        }
        return sets, hx.ThreeStep(form=form).calibrate_leg(sets, estimator)

    def error(self, result):
        leg = result.leg
        values = np.concatenate([leg.platform_point, leg.base_point, leg.offset[..., None]], axis=-1)
        true = truth()
        return values - np.concatenate([true.platform_point, true.base_point, [true.offset]])

    @pytest.mark.parametrize("noise", NOISES)
    @pytest.mark.parametrize("form", ["consecutive", "direct", "centred"])
    def test_the_carried_covariance_of_all_seven_parameters(self, form, noise):
        _, result = self.calibrated(10, 10, noise=NOISES[noise], form=form)
        assert result.names == ("platform_point", "base_point", "offset")
        assert_honest(self.error(result), result.covariance, coverage=0.012)

    def test_with_weights(self):
        _, result = self.calibrated(10, 10, form="direct", estimator=hx.LeastSquares(weights="model"))
        assert_honest(self.error(result), result.covariance, coverage=0.012)

    @pytest.mark.parametrize(("n1", "n2", "ignored"), [(7, 7, 0.87), (7, 20, 0.74), (7, 50, 0.58)])
    def test_ignoring_the_error_of_b_under_covers(self, n1, n2, ignored):
        """METHODS 2: intervals for a that ignore the error of b cover 87 %, 74 %, 58 % instead of 95 %.

        Its figures are from a few seeds; over 4000 sets we find 86, 76 and 62 %.
        """
        sets, result = self.calibrated(n1, n2, 4000, hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01))
        error = self.error(result)[:, 3:6]
        sigma = np.sqrt(np.einsum("...ii->...i", result.covariance))[:, 3:6]
        covered = (np.abs(error) <= 1.959964 * sigma).mean()
        assert abs(covered - 0.95) < 0.01, covered
        known = hx.loops.FixedLength(sets[hx.Lock.LENGTH], platform_point=result.leg.platform_point)
        naive = hx.estimate(known.linear("consecutive"), hx.LeastSquares())
        np.testing.assert_allclose(naive.params["base_point"], result.leg.base_point, atol=1e-9)
        sigma = np.sqrt(np.einsum("...ii->...i", naive.covariance_of("base_point")))
        assert abs((np.abs(error) <= 1.959964 * sigma).mean() - ignored) < 0.05

    def test_the_step_itself_carries_b(self):
        """The second step's own covariance holds C_a + K C_b K', as METHODS 2 asks."""
        sets, result = self.calibrated(10, 10, n_sets=50)
        second = result.steps["base_point"]
        np.testing.assert_allclose(
            second.covariance_of("base_point"), result.covariance[:, 3:6, 3:6], rtol=1e-9, atol=1e-18
        )
        plain = hx.estimate(
            hx.loops.FixedLength(sets[hx.Lock.LENGTH], platform_point=result.leg.platform_point).linear("consecutive"),
            hx.LeastSquares(),
        )
        h, loop = (
            second.influence,
            hx.loops.FixedLength(sets[hx.Lock.LENGTH], platform_point=result.steps["platform_point"]),
        )
        k = np.einsum("spnd,sndj->spj", h[:, :3], loop.known_jacobian(second, "platform_point"))
        c_b = result.steps["platform_point"].covariance_of("platform_point")
        expected = plain.covariance_of("base_point") + k @ c_b @ np.swapaxes(k, -1, -2)
        np.testing.assert_allclose(second.covariance_of("base_point"), expected, rtol=1e-9, atol=1e-18)


def test_one_step_reports_the_estimates_covariance(paper_noise):
    data = hx.simulate_leg(hx.robots.left_hand(), 3, "direction", 10, 50, noise=paper_noise, rng=0)
    result = hx.OneStep().calibrate_leg({hx.Lock.DIRECTION: data})
    found = hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), hx.LeastSquares())
    np.testing.assert_array_equal(result.covariance, found.covariance)
    assert result.covariance_kind == "sandwich"
