"""The inverse-kinematics calibration: exact, as scipy finds it, honest where it fails."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import EstimationError, InputError, UnitError
from hexopt.loops import LegLength

MODELS = {36: 2, 42: 3, 48: 4}
NAMES = ("platform_point", "base_point", "offset", "gain")


def simulated(robot, model, *, leg=3, n=14, n_sets=40, off=0.5, noise=None, seed=0):
    """Unlocked poses, and a nominal whose unknown blocks are off."""
    nominal = robot.perturbed(off, offsets=off if model > 36 else 0.0, rng=seed).leg(leg)
    if model == 48:
        nominal = nominal.replaced(gain=1.02 * nominal.gain)
    return hx.simulate_leg(robot, leg, "none", n, n_sets, noise=noise, nominal=nominal, rng=seed)


@pytest.mark.parametrize("model", MODELS)
def test_exact_without_noise(robot, model):
    """From a nominal 0.5 cm off (of a robot of 16 cm): every leg, every set, to rounding times the condition."""
    for leg in range(1, 7):
        for n in (MODELS[model] * 3 - 1 if model < 48 else 9, 20):
            data = simulated(robot, model, leg=leg, n=max(n, 8), off=0.03 * robot.size)
            found = hx.estimate(LegLength(data, unknown=NAMES[: MODELS[model]]), hx.InverseKinematics())
            error = np.max([e for key, e in found.error(robot.leg(leg)).items() if key != "gain"], axis=0) / robot.size
            assert found.ok.mean() > 0.97
            good = found.ok
            assert (error[good] <= 100 * np.finfo(float).eps * found.condition[good]).all()
            assert (error[good & (found.condition <= 1e4)] <= 1e-9).all()


def rubin(model, *, leg=2, off=500.0, noise=None, n=15):
    """Coordinates a million times the rows' last digits: rotations of 0.25° leave κ of 1e5."""
    robot = hx.robots.rubin()
    data = hx.simulate_leg(robot, leg, "none", n, 50, noise=noise, nominal=robot.perturbed(off, rng=2), rng=2)
    return LegLength(data, unknown=NAMES[: MODELS[model]])


@pytest.mark.parametrize("backend", ["auto", "ipopt"])
@pytest.mark.parametrize("make", [hx.robots.left_hand, hx.robots.rubin])
def test_both_backends_are_exact_without_noise(make, backend):
    robot = make()
    data = hx.simulate_leg(robot, 3, "none", 10, 20, nominal=robot.perturbed(0.006 * robot.size, rng=1), rng=1)
    assert hx.estimate(LegLength(data), hx.InverseKinematics(backend=backend)).ok.all()


@pytest.mark.parametrize("off", [500.0, 0.0])
@pytest.mark.parametrize("model", MODELS)
def test_what_is_left_of_rubin_without_noise_is_rounding(model, off):
    """Of the terms of the rows, which cancel to less: a success on every leg, also from the truth itself."""
    for leg in range(1, 7):
        found = hx.InverseKinematics().fit(rubin(model, leg=leg, off=off, n=10 if model < 48 else 12))
        assert found.ok.all()
        error = found.error(hx.robots.rubin().leg(leg))["base_point"]
        assert (error <= 1e6 * 100 * np.finfo(float).eps * found.condition).all()


@pytest.mark.parametrize("settings", [{}, {"weights": "model"}, {"covariance": False}], ids=str)
def test_a_batch_equals_its_members_on_rubin(settings):
    loop = rubin(42, noise=hx.NormalNoise(0.1, 1e-7, 0.1))
    together = hx.InverseKinematics(**settings).fit(loop)
    assert together.ok.all()
    sigma = hx.InverseKinematics().fit(loop).standard_errors
    for i in range(0, 50, 5):
        alone = hx.InverseKinematics(**settings).fit(LegLength(loop.data[i]))
        assert alone.ok
        assert (np.abs(together.values[i] - alone.values) <= 1e-5 * sigma[i]).all()


@pytest.mark.parametrize("weights", [None, "model"])
def test_values_alone_come_with_the_same_verdict(left_hand, weights):
    """They take it from the last step of the iteration, where that leaves no doubt."""
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    for loop in (
        LegLength(simulated(left_hand, 42, n=9, n_sets=300, off=3.0, noise=noise)),
        LegLength(simulated(left_hand, 42, n=9, n_sets=100, off=30.0)),
        rubin(42, noise=hx.NormalNoise(1e2, 1e-7, 1e2), n=10),
    ):
        if weights and not loop.data.noise:
            continue
        full = hx.InverseKinematics(weights=weights).fit(loop)
        values = hx.InverseKinematics(weights=weights, covariance=False).fit(loop)
        np.testing.assert_array_equal(values.codes, full.codes)
        np.testing.assert_array_equal(values.values, full.values)
        np.testing.assert_allclose(
            values.objective, full.objective, rtol=1e-9, atol=1e-20 * loop.data.position.max() ** 2
        )
        good = full.ok & (full.condition < 1e3)
        np.testing.assert_allclose(values.condition[good], full.condition[good], rtol=1e-4)


@pytest.mark.parametrize("model", MODELS)
def test_from_a_nominal_half_a_centimetre_off(left_hand, model):
    data = simulated(left_hand, model, n=12, n_sets=200, off=0.5)
    found = hx.estimate(LegLength(data, unknown=NAMES[: MODELS[model]]), hx.InverseKinematics())
    assert found.ok.all()
    for error in found.error(left_hand.leg(3)).values():
        assert error.max() < 1e-9


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("weights", [None, "model"])
def test_it_is_what_scipy_finds(left_hand, model, weights):
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    data = simulated(left_hand, model, n=15, n_sets=10, noise=noise)
    loop = LegLength(data, unknown=NAMES[: MODELS[model]])
    found = hx.estimate(loop, hx.InverseKinematics(weights=weights))
    plain = hx.estimate(loop, hx.InverseKinematics())
    for i in range(10):
        single = LegLength(data[i], unknown=NAMES[: MODELS[model]])
        weight = np.ones(15)
        if weights:  # METHODS 4, written out: row variance nᵀ(σ_P² I + σ_E² J Jᵀ) n + γ² σ_ρ²
            leg = {**{name: single.data.nominal.block(name) for name in NAMES}, **plain[i].params}
            for k in range(15):
                arm = data.rotation[i, k] @ leg["platform_point"]
                vector = data.position[i, k] + arm - leg["base_point"]
                unit = vector / np.linalg.norm(vector)
                angles = hx.rotations.matrix_to_euler(data.rotation[i, k], "ZXZ")
                turn = -hx.rotations.skew(arm) @ hx.rotations.euler_jacobian(angles, "ZXZ")
                variance = unit @ (noise.position**2 * np.eye(3) + noise.angle**2 * turn @ turn.T) @ unit
                variance += (leg["gain"][0] * noise.length) ** 2
                weight[k] = 1 / np.sqrt(variance / 3)
        expected = least_squares(
            lambda x, single=single, weight=weight: weight * single.residual(x)[:, 0],
            single.values(data.nominal),
            xtol=1e-15,
            ftol=1e-15,
            gtol=1e-15,
            x_scale="jac",
        )
        np.testing.assert_allclose(
            found.values[i], expected.x, atol=1e-6 * np.abs(found.standard_errors[i]).max() + 1e-7
        )
        assert found.objective[i] <= expected.cost * (1 + 1e-9)
        gradient = single.jacobian(found.values[i])[:, 0].T @ (weight**2 * single.residual(found.values[i])[:, 0])
        scale = np.linalg.norm(weight[:, None] * single.jacobian(found.values[i])[:, 0], axis=0)
        assert np.abs(gradient / scale).max() < 1e-8 * np.sqrt(2 * expected.cost)


@pytest.mark.parametrize("noise", ["own", "common"])
def test_a_batch_equals_its_members(left_hand, noise):
    model = hx.NormalNoise(0.01, 1e-4, 0.01, coordinates="rotation_vector")
    if noise == "common":
        model = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=np.diag([1e-4] * 3 + [1e-8] * 3 + [1e-4]))
    data = simulated(left_hand, 42, noise=model, n_sets=6)
    for weights in (None, "model"):
        together = hx.estimate(LegLength(data), hx.InverseKinematics(weights=weights))
        for i in range(6):
            alone = hx.estimate(LegLength(data[i]), hx.InverseKinematics(weights=weights))
            np.testing.assert_allclose(together.values[i], alone.values, atol=1e-9)
            np.testing.assert_allclose(together.covariance[i], alone.covariance, rtol=1e-6, atol=1e-12)


def test_weights_with_a_common_error_are_generalised_least_squares(left_hand):
    """A common error correlates the rows: the weighted gradient with the dense covariance vanishes."""
    noise = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=np.diag([1e-2] * 3 + [1e-6] * 3 + [1e-3]))
    data = simulated(left_hand, 42, noise=noise, n_sets=None, n=20)
    loop = LegLength(data)
    plain = hx.estimate(loop, hx.InverseKinematics())
    found = hx.estimate(loop, hx.InverseKinematics(weights="model"))
    rows = loop.covariance(plain.values)
    dense = np.diag(rows.blocks[:, 0, 0]) + rows.common[:, 0] @ rows.common[:, 0].T
    gradient = loop.jacobian(found.values)[:, 0].T @ np.linalg.solve(dense, loop.residual(found.values)[:, 0])
    assert np.abs(gradient * found.standard_errors).max() < 1e-5
    assert np.abs(found.values - plain.values).max() > 1e-4


class TestHonesty:
    def starts(self, spread, n=150, seed=0):
        rng = np.random.default_rng(seed)
        leg = hx.robots.left_hand().leg(3)
        return hx.Leg(
            3,
            leg.platform_point + rng.uniform(-spread, spread, (n, 3)),
            leg.base_point + rng.uniform(-spread, spread, (n, 3)),
            leg.offset + rng.uniform(-spread, spread, n),
        )

    @pytest.mark.parametrize("spread", [3, 30, 300, 3000])
    def test_from_anywhere_a_success_is_a_stationary_point(self, left_hand, spread):
        data = simulated(left_hand, 42, n=12, n_sets=150)
        loop = LegLength(data)
        found = hx.estimate(loop, hx.InverseKinematics(start=self.starts(spread)))
        assert set(found.status) <= {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED, hx.Status.RANK_DEFICIENT}
        assert np.isnan(found.values[~found.ok]).all()
        assert np.isfinite(found.values[found.ok]).all()
        values = np.where(found.ok[:, None], found.values, loop.values(left_hand.leg(3)))
        residual, jacobian = loop.residual(values)[..., 0], loop.jacobian(values)[..., 0, :]
        size = np.linalg.norm(jacobian, axis=1) * np.linalg.norm(residual, axis=1)[:, None]
        gradient = np.abs(np.einsum("snp,sn->sp", jacobian, residual))
        assert (gradient <= 1e-6 * size + 1e-12)[found.ok].all()  # the residual's rounding is 1e-14
        if spread >= 300:
            assert not found.ok.all()
            assert found.error(left_hand.leg(3))["base_point"][found.ok].max() > 1  # other minima do exist

    def test_a_single_divergence_raises(self, left_hand):
        data = simulated(left_hand, 42, n=12, n_sets=150)
        start = self.starts(3000)
        found = hx.estimate(LegLength(data), hx.InverseKinematics(start=start))
        (bad,) = np.nonzero([status is hx.Status.NOT_CONVERGED for status in found.status])
        i = bad[0]
        one = hx.Leg(3, start.platform_point[i], start.base_point[i], start.offset[i])
        with pytest.raises(EstimationError, match="NOT_CONVERGED; no value can be trusted"):
            hx.estimate(LegLength(data[i]), hx.InverseKinematics(start=one))

    @pytest.mark.parametrize("lock", ["direction", "leg", "length"])
    @pytest.mark.parametrize("covariance", [True, False])
    def test_what_a_lock_hides_has_its_name(self, left_hand, lock, covariance):
        noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
        nominal = left_hand.perturbed(0.1, rng=1).leg(3)
        data = hx.simulate_leg(left_hand, 3, lock, 20, 3, noise=noise, nominal=nominal, rng=0)
        loop = LegLength(data, unknown=NAMES)
        found = hx.InverseKinematics(covariance=covariance).fit(loop)
        assert {str(status) for status in found.status} == {str(hx.Status.RANK_DEFICIENT)}
        assert np.isnan(found.values).all()
        assert found.unseen == loop.blind_spots
        assert any("base_point" in words for words in found.unseen) == (lock != "length")
        assert any("offset against gain" in words for words in found.unseen) == (lock != "direction")

    @pytest.mark.parametrize(
        "settings", [{}, {"weights": "model"}, {"loss": hx.Huber(), "weights": "model"}, {"covariance": False}], ids=str
    )
    def test_of_no_sets_it_is_an_empty_estimate(self, left_hand, settings):
        data = simulated(left_hand, 42, noise=hx.UniformNoise(0.01, 1e-4, 0.01))
        assert hx.InverseKinematics(**settings).fit(LegLength(data[[]])).values.shape == (0, 7)

    @pytest.mark.parametrize("bounds", [None, hx.Box({"platform_point": ([-50.0] * 3, [50.0] * 3)})], ids=str)
    def test_a_failure_has_no_objective(self, left_hand, bounds):
        noise = hx.UniformNoise(0.01, 1e-4, 0.01)
        data = hx.simulate_leg(left_hand, 3, "leg", 20, 3, noise=noise, nominal=left_hand.perturbed(0.1, rng=1), rng=0)
        found = hx.InverseKinematics(weights="model", bounds=bounds).fit(LegLength(data))
        assert not found.ok.any()
        assert np.isnan([found.objective, found.chi2]).all()

    def test_no_certificate_is_claimed(self, left_hand):
        found = hx.estimate(LegLength(simulated(left_hand, 42)), hx.InverseKinematics())
        assert np.isnan(found.gap).all()
        assert (found.iterations > 0).all()


class TestWrongCalls:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"start": [1, 2, 3]}, "start: expected a Leg"),
            ({"weights": "noise"}, "weights: expected None or 'model'"),
            ({"max_iterations": 0}, "max_iterations: expected"),
            ({"max_iterations": 2.5}, "max_iterations: expected"),
        ],
    )
    def test_wrong_settings(self, settings, message):
        with pytest.raises(InputError, match=message):
            hx.InverseKinematics(**settings)

    def test_a_start_of_another_leg(self, left_hand):
        with pytest.raises(InputError, match="leg"):
            hx.estimate(LegLength(simulated(left_hand, 42)), hx.InverseKinematics(start=left_hand.leg(5)))

    def test_no_start(self, left_hand):
        data = simulated(left_hand, 42)
        bare = hx.LegMeasurements(data.position, data.rotation, data.length, "none", length_unit="cm")
        with pytest.raises(InputError, match="needs an initial guess"):
            hx.estimate(LegLength(bare, gain=1.0), hx.InverseKinematics())
        assert hx.estimate(LegLength(bare, gain=1.0), hx.InverseKinematics(start=left_hand.leg(3))).ok.all()

    def test_a_start_in_another_unit(self, left_hand):
        with pytest.raises(UnitError):
            hx.estimate(LegLength(simulated(left_hand, 42)), hx.InverseKinematics(start=hx.robots.jugglebot().leg(3)))
