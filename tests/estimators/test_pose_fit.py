"""The forward-kinematics calibration: exact, as scipy finds it, honest where it fails."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError, UnitError
from hexopt.loops import PlatformPose
from hexopt.testing import check_estimator

MODELS = {36: 2, 42: 3, 48: 4}
NAMES = ("platform_point", "base_point", "offset", "gain")


def simulated(robot, model=42, *, n=None, n_sets=20, off=0.5, noise=None, seed=0, **settings):
    """Poses that all legs reach, and a nominal whose unknown blocks are off."""
    nominal = robot.perturbed(off, offsets=off if model > 36 else 0.0, rng=seed + 100)
    if model == 48:
        nominal = replace(nominal, gains=1.02 * nominal.gains)
    n = model // 6 + 3 if n is None else n
    return hx.simulate(robot, n_poses=n, n_sets=n_sets, noise=noise, nominal=nominal, rng=seed, **settings)


@pytest.mark.parametrize("model", MODELS)
def test_exact_without_noise(robot, model):
    """From a nominal 0.5 cm off (of a robot of 19 cm), at three poses more than the least."""
    data = simulated(robot, model, off=0.5 * robot.size / hx.robots.left_hand().size)
    found = hx.estimate(PlatformPose(data, unknown=NAMES[: MODELS[model]]), hx.ForwardKinematics())
    assert found.ok.all()
    allowed = 100 * np.finfo(float).eps * found.condition
    for name, error in found.error(robot).items():
        unit = robot.gains[0] if name.endswith("gain") else robot.size
        assert (error / unit <= allowed).all(), name


@pytest.mark.parametrize("weights", [None, "model"])
def test_it_is_what_scipy_finds(left_hand, weights):
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    data = simulated(left_hand, n=12, n_sets=2, off=0.2, noise=noise)
    found = hx.estimate(PlatformPose(data), hx.ForwardKinematics(weights=weights))
    plain = hx.estimate(PlatformPose(data), hx.ForwardKinematics())
    radius = np.linalg.norm(data.nominal.platform_points, axis=1).max()
    for i in range(2):
        loop = PlatformPose(data[i])
        root = np.diag([1.0, 1.0, 1.0, radius, radius, radius])[None]
        if weights:  # S = Σ_pose + J_ρ Σ_ρ J_ρᵀ, written out, with Euler angles
            turn = noise.covariance(loop.data.position, loop.data.rotation)[:, 3:6, 3:6]
            by_reading = loop.noise_jacobian(plain.values[i])[..., 6:]
            spread = by_reading @ np.swapaxes(by_reading, -1, -2) * noise.length**2 / 3
            spread[:, :3, :3] += np.eye(3) * noise.position**2 / 3
            spread[:, 3:, 3:] += turn
            root = np.swapaxes(np.linalg.cholesky(np.linalg.inv(spread)), -1, -2)

        def cost(x, loop=loop, root=root):
            return np.einsum("nij,nj->ni", root, loop.residual(x)).ravel()

        def slope(x, loop=loop, root=root):
            return np.einsum("nij,njp->nip", root, loop.jacobian(x)).reshape(-1, 42)

        expected = least_squares(cost, loop.start(), slope, xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
        errors = found.standard_errors[i]
        tolerance = 1e-5 if weights is None else 1e-4  # a turn of the measured pose is one of the residual, to 1e-4
        assert (np.abs(found.values[i] - expected.x) <= tolerance * errors).all()
        np.testing.assert_allclose(found.objective[i], expected.cost, rtol=1e-5)


@pytest.mark.parametrize("weights", [None, "model"])
def test_standard_errors_are_true(left_hand, weights):
    noise = hx.NormalNoise(1e-3, 1e-5, 1e-3, coordinates="rotation_vector")
    data = simulated(left_hand, n=12, n_sets=150, noise=noise)
    found = hx.estimate(PlatformPose(data), hx.ForwardKinematics(weights=weights))
    assert found.ok.all()
    assert found.covariance_kind == ("model" if weights else "sandwich")
    error = found.values - PlatformPose(data).values(left_hand)
    root = np.linalg.cholesky(np.linalg.inv(found.covariance))
    square = (np.einsum("sij,si->sj", root, error) ** 2).mean()
    assert abs(square - 1) < 4 * np.sqrt(2 / error.size)
    if weights:
        assert abs(found.chi2.mean() / found.degrees_of_freedom - 1) < 4 * np.sqrt(2 / (150 * 30))


def test_the_weighted_fit_is_as_good_as_the_bound(left_hand):
    noise = hx.NormalNoise(1e-3, 1e-5, 1e-3, coordinates="rotation_vector")
    data = simulated(left_hand, n=12, n_sets=3, noise=noise)
    found = hx.estimate(PlatformPose(data), hx.ForwardKinematics(weights="model"))
    bound = np.sqrt(np.einsum("...ii->...i", PlatformPose(data).crlb(found.values)))
    np.testing.assert_allclose(found.standard_errors, bound, rtol=1e-2)
    plain = hx.estimate(PlatformPose(data), hx.ForwardKinematics())
    assert (plain.standard_errors > 0.99 * bound).all()
    assert plain.standard_errors.mean() > 1.05 * bound.mean()


def test_unknown_noise_comes_from_the_residuals(left_hand):
    noise = hx.NormalNoise(1e-3, 1e-5, 1e-3, coordinates="rotation_vector")
    data = replace(simulated(left_hand, n=12, n_sets=None, noise=noise), noise=None)
    found = hx.estimate(PlatformPose(data), hx.ForwardKinematics())
    assert found.covariance_kind == "residual"
    assert 1e-4 < found.standard_errors.max() < 1.0
    with pytest.raises(InputError, match="the noise is unknown"):
        hx.estimate(PlatformPose(data), hx.ForwardKinematics(weights="model"))


class TestHonesty:
    def test_the_plain_method_fails_more_often_and_says_so(self):
        """LinuxCNC's poses come near singular ones, where a nominal that is off has no solution, or another one."""
        robot = hx.robots.linuxcnc()
        data = simulated(robot, n_sets=15, off=0.7)
        plain = hx.estimate(PlatformPose(data), hx.ForwardKinematics(approach=False))
        assert 0 < plain.ok.sum() < 15
        assert set(plain.status) == {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED}
        assert np.isnan(plain.values[~plain.ok]).all()
        assert max(error[plain.ok].max() for error in plain.error(robot).values()) < 1e-8

    def test_a_wrong_reading_fails_its_set_alone(self, left_hand):
        data = simulated(left_hand, n_sets=3)
        length = np.array(data.length)
        length[1, 4] += 50.0
        found = hx.estimate(PlatformPose(replace(data, length=length)), hx.ForwardKinematics())
        assert found.ok.tolist() == [True, False, True]
        assert found.status[1] is hx.Status.NOT_CONVERGED
        assert np.isnan(found.values[1]).all()
        clean = hx.estimate(PlatformPose(data), hx.ForwardKinematics())
        np.testing.assert_allclose(found.values[[0, 2]], clean.values[[0, 2]], atol=1e-9)

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_a_locked_direction_hides_a_base_point(self, left_hand, lock):
        noise = hx.NormalNoise(1e-3, 1e-5, 1e-3)
        data = simulated(left_hand, n_sets=None, n=12, noise=noise, lock=lock, leg=3)
        with pytest.raises(RankDeficientError, match=r"leg3\.base_point across the leg's locked direction"):
            hx.estimate(PlatformPose(data), hx.ForwardKinematics())
        known = replace(data, nominal=left_hand)
        assert hx.estimate(PlatformPose(known, unknown=("offset",)), hx.ForwardKinematics()).ok

    def test_an_architecture_singular_robot(self):
        angles = np.arange(6) * np.pi / 3
        circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=1)
        robot = hx.Hexapod("singular", 10 * circle, 6 * circle, home_position=[0.0, 0.0, 12.0])
        data = hx.simulate(robot, n_poses=10, n_sets=2, rng=0)
        found = hx.estimate(PlatformPose(data), hx.ForwardKinematics())
        assert {*found.status} == {hx.Status.NOT_CONVERGED}
        assert {*PlatformPose(data).poses(robot).status.ravel()} == {hx.Status.RANK_DEFICIENT}

    def test_too_few_poses(self, left_hand):
        data = simulated(left_hand, n=6)
        with pytest.raises(RankDeficientError, match=r"36 equations for 42 unknowns .* needs at least 7 poses"):
            hx.estimate(PlatformPose(data), hx.ForwardKinematics())

    def test_no_certificate_is_claimed(self, left_hand):
        assert np.isnan(hx.estimate(PlatformPose(simulated(left_hand)), hx.ForwardKinematics()).gap).all()


class TestWrongCalls:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"start": [1, 2, 3]}, "start: expected a Hexapod"),
            ({"weights": "noise"}, "weights: expected None or 'model'"),
            ({"max_iterations": 0}, "max_iterations: expected at least 1"),
        ],
    )
    def test_wrong_settings(self, settings, message):
        with pytest.raises(InputError, match=message):
            hx.ForwardKinematics(**settings)

    def test_starts(self, left_hand):
        data = replace(simulated(left_hand, 48, n_sets=2), nominal=None, length_unit="cm")
        loop = PlatformPose(data, unknown=NAMES)
        with pytest.raises(InputError, match="needs an initial guess"):
            hx.estimate(loop, hx.ForwardKinematics())
        for approach in (True, False):
            near = left_hand.perturbed(0.1, rng=0)
            assert hx.estimate(loop, hx.ForwardKinematics(start=near, approach=approach)).ok.all()
        with pytest.raises(UnitError):
            hx.estimate(loop, hx.ForwardKinematics(start=hx.robots.jugglebot()))


def of_all_legs(data):
    """A target for the contract: all readings at a leg's poses, with its noise in all of them."""
    robot = hx.robots.left_hand()
    length = hx.inverse_kinematics(robot, data.position, data.rotation)
    length = length + (data.length - length[..., 2])[..., None] * [1.0, -0.7, 0.3, 0.5, -0.2, -0.9]
    rows = np.array([0, 1, 2, 3, 4, 5] + [6] * 6)
    covariance = data.noise.pose_covariance[rows[:, None], rows] * ((rows[:, None] < 6) | np.eye(12, dtype=bool))
    nominal = robot.perturbed(0.1, rng=0)
    return PlatformPose(
        hx.Measurements(
            data.position, data.rotation, length, noise=hx.NormalNoise(pose_covariance=covariance), nominal=nominal
        )
    )


@pytest.mark.parametrize("estimator", [hx.ForwardKinematics(), hx.ForwardKinematics(weights="model")], ids=repr)
def test_contract(estimator):
    check_estimator(estimator, of_all_legs, lock="none", claims=("order", "rank"), tolerance=1e-5)
