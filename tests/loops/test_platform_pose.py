"""Computed against measured poses: the misclosure, its derivatives, its noise, honest failures."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError, UnitError
from hexopt.loops import PlatformPose
from hexopt.rotations import rotation_vector_to_matrix

NAMES = ("platform_point", "base_point", "offset", "gain")
NOISE = hx.NormalNoise(0.01, 1e-4, 0.01, coordinates="rotation_vector")


def simulated(robot, n=4, n_sets=None, noise=NOISE, **settings):
    return hx.simulate(robot, n_poses=n, n_sets=n_sets, noise=noise, rng=0, **settings)


def test_the_truth_closes(robot):
    loop = PlatformPose(simulated(robot, n_sets=3, noise=None))
    assert loop.residual(robot).shape == (3, 4, 6)
    assert np.abs(loop.residual(robot)[..., :3]).max() < 1e-12 * robot.size
    assert np.abs(loop.residual(robot)[..., 3:]).max() < 1e-12


def test_what_the_rows_are(left_hand):
    """The pose that forward kinematics gives, minus the measured one."""
    data = simulated(left_hand)
    loop = PlatformPose(data)
    off = left_hand.perturbed(0.1, offsets=0.1, rng=1)
    found = hx.forward_kinematics(off, data.length, data.position, data.rotation)
    residual = loop.residual(off)
    np.testing.assert_allclose(residual[:, :3], found.position - data.position, atol=1e-12)
    np.testing.assert_allclose(rotation_vector_to_matrix(residual[:, 3:]) @ data.rotation, found.rotation, atol=1e-12)
    np.testing.assert_array_equal(loop.poses(off).position, found.position)


@pytest.mark.parametrize("unknown", [NAMES[:2], NAMES[:3], NAMES, ("offset",)])
def test_jacobian(unknown, central_difference):
    robot = hx.robots.jugglebot()
    loop = PlatformPose(simulated(robot), unknown=unknown)
    x = loop.values(robot.perturbed(1.0, rng=2))
    expected = central_difference(loop.residual, x, 1e-2)
    jacobian = loop.jacobian(x)
    assert jacobian.shape == (4, 6, loop.parameters.size)
    scale = np.abs(expected).max(axis=(0, 2), keepdims=True)
    np.testing.assert_allclose(jacobian / scale, expected / scale, atol=1e-6)
    residual, again = loop.rows(x)
    np.testing.assert_array_equal(residual, loop.residual(x))
    np.testing.assert_array_equal(again, jacobian)


def test_noise_jacobian(left_hand, central_difference):
    data = simulated(left_hand)
    loop = PlatformPose(data)
    x = loop.values(left_hand.perturbed(0.3, rng=2))

    def residual(error):
        return loop.on(data.shifted(np.broadcast_to(error, (4, 12)))).residual(x)

    expected = central_difference(residual, np.zeros(12), 1e-3)
    np.testing.assert_allclose(loop.noise_jacobian(x), expected, atol=1e-8)


def test_covariance_of_the_rows_is_that_of_many_simulations(left_hand):
    exact = simulated(left_hand, n=2, noise=None)
    noise = hx.NormalNoise(1e-3, 1e-4, 2e-3, coordinates="rotation_vector")
    rng = np.random.default_rng(1)
    shape = (4000, 2)
    position, rotation, length = noise.apply(
        np.broadcast_to(exact.position, (*shape, 3)),
        np.broadcast_to(exact.rotation, (*shape, 3, 3)),
        np.broadcast_to(exact.length, (*shape, 6)),
        rng,
    )
    loop = PlatformPose(hx.Measurements(position, rotation, length, noise=noise, nominal=left_hand))
    residual = loop.residual(left_hand)
    jacobian = PlatformPose(exact).noise_jacobian(left_hand)
    covariance = noise.covariance(exact.position, exact.rotation, 6)
    model = jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)
    for i in range(2):
        root = np.linalg.inv(np.linalg.cholesky(model[i]))
        found = root @ np.cov(residual[:, i].T) @ root.T
        np.testing.assert_allclose(found, np.eye(6), atol=5 * np.sqrt(2 / 4000))


def test_information_equals_that_of_the_readings(left_hand):
    """To first order the poses say what all readings together say: the bounds are one."""
    exact = simulated(left_hand, n=12, noise=None)
    data = hx.Measurements(exact.position, exact.rotation, exact.length, noise=NOISE, nominal=left_hand)
    loop, whole = PlatformPose(data), hx.loops.WholeRobot(data)
    assert loop.parameters.names == whole.parameters.main.names
    np.testing.assert_allclose(loop.crlb(left_hand), whole.crlb(left_hand), rtol=1e-6, atol=1e-9)


def test_common_errors(left_hand):
    common = np.diag([1e-4] * 3 + [1e-8] * 3 + [1e-4] * 6)
    noise = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=common)
    loop = PlatformPose(simulated(left_hand, noise=noise))
    by_noise = loop.noise_jacobian(left_hand)
    ((source, columns),) = loop.shared(left_hand, by_noise)
    assert source is None
    np.testing.assert_allclose(
        columns @ np.swapaxes(columns, -1, -2), by_noise @ common @ np.swapaxes(by_noise, -1, -2), atol=1e-12
    )
    plain = PlatformPose(simulated(left_hand))
    assert plain.shared(left_hand, by_noise) == []


def test_a_batch_equals_its_members(left_hand):
    data = simulated(left_hand, n_sets=3)
    loop = PlatformPose(data)
    x = loop.values(left_hand) + np.linspace(-0.1, 0.1, 3)[:, None]
    for name in ("residual", "jacobian", "noise_jacobian"):
        together = getattr(loop, name)(x)
        for i in range(3):
            np.testing.assert_allclose(together[i], getattr(PlatformPose(data[i]), name)(x[i]), atol=1e-12)


class TestFailures:
    def test_a_pose_out_of_reach_is_marked_alone(self, left_hand):
        data = simulated(left_hand, n_sets=2)
        length = np.array(data.length)
        length[1, 2, 4] += 100.0
        loop = PlatformPose(hx.Measurements(data.position, data.rotation, length, noise=NOISE, nominal=left_hand))
        lost = np.isnan(loop.residual(left_hand)).any(axis=-1)
        assert np.argwhere(lost).tolist() == [[1, 2]]
        assert np.isnan(loop.jacobian(left_hand)[1, 2]).all()
        assert (loop.poses(left_hand).ok == ~lost).all()
        problem = loop.linearised(left_hand)
        assert (problem.matrix[1] == 0).all()
        assert (problem.matrix[0] != 0).any()

    def test_poses_that_stand_still_have_no_bound(self, left_hand):
        still = simulated(left_hand, noise=None).poses([0] * 8)
        data = hx.Measurements(still.position, still.rotation, still.length, noise=NOISE, nominal=left_hand)
        with pytest.raises(RankDeficientError, match="the poses do not see"):
            PlatformPose(data).crlb(left_hand)

    def test_wrong_calls(self, left_hand):
        data = simulated(left_hand)
        with pytest.raises(InputError, match="expected Measurements, with six readings a pose, got LegMeasurements"):
            PlatformPose(data.leg(3))
        with pytest.raises(InputError, match="unknown: PlatformPose can estimate platform_point"):
            PlatformPose(data, unknown=("direction",))
        bare = hx.Measurements(data.position, data.rotation, data.length)
        with pytest.raises(InputError, match="gain: neither unknown nor known"):
            PlatformPose(bare)
        with pytest.raises(InputError, match="needs an initial guess"):
            PlatformPose(bare, unknown=NAMES).start()
        with pytest.raises(InputError, match="no noise model"):
            PlatformPose(bare, unknown=NAMES).error_covariance  # noqa: B018
        with pytest.raises(UnitError):
            PlatformPose(data).values(hx.robots.jugglebot())
        with pytest.raises(InputError, match="there are no poses"):
            PlatformPose(data.poses(slice(0, 0)))


def test_minimum_poses(left_hand):
    data = simulated(left_hand)
    assert [PlatformPose(data, unknown=NAMES[:k]).minimum_poses for k in (2, 3, 4)] == [6, 7, 8]


@pytest.mark.parametrize("lock", ["direction", "leg", "length", "none"])
def test_what_a_lock_hides(left_hand, lock):
    loop = PlatformPose(simulated(left_hand, lock=lock, leg=None if lock == "none" else 3))
    assert bool(loop.blind_spots) == (lock in ("direction", "leg"))
