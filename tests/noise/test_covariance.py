"""The covariance that a noise model states is the one of the errors that it adds."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hexopt as hx
from hexopt.errors import InputError
from hexopt.noise import NormalNoise, Outliers, UniformNoise
from hexopt.rotations import euler_to_matrix, matrix_to_euler, matrix_to_rotation_vector

N = 40_000
SMALL = {"position": 0.02, "angle": 1e-3, "length": 0.05}
TURN = Rotation.from_rotvec([0.3, -0.8, 0.4]).as_matrix()


def errors(noise, n_readings=1, rotation=TURN, sets=N, poses=1, rng=0):
    """Return e = (δP, δω, δρ) of many noisy copies of one pose, (sets, poses, 6 + n_readings)."""
    position = np.broadcast_to([1.0, 2.0, 3.0], (sets, poses, 3))
    rotations = np.broadcast_to(rotation, (sets, poses, 3, 3))
    length = np.full((sets, poses) if n_readings == 1 else (sets, poses, n_readings), 7.0)
    p, r, rho = noise.apply(position, rotations, length, np.random.default_rng(rng))
    assert (p.shape, r.shape, rho.shape) == (position.shape, rotations.shape, length.shape)
    omega = matrix_to_rotation_vector(r @ rotation.T)
    reading = (rho - length)[..., None] if n_readings == 1 else rho - length
    return np.concatenate([p - position, omega, reading], axis=-1)


def assert_covariance(sample, expected, sigmas=5.0):
    """Check a sample covariance entry by entry, within Monte-Carlo errors (kurtosis ≤ 3)."""
    n = len(sample)
    found = sample.T @ sample / n
    spread = np.sqrt((expected**2 + np.outer(np.diag(expected), np.diag(expected))) / n)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected))) + 1e-300
    assert (np.abs(found - expected) <= sigmas * spread + 2e-3 * scale).all(), (found - expected) / (spread + 1e-300)
    mean = np.abs(sample.mean(axis=0)) / (np.sqrt(np.diag(expected) / n) + 1e-300)
    assert mean.max() < sigmas


def correlated(size, seed=3):
    """A covariance with a lever arm: δP depends on δω, and readings on each other."""
    root = np.random.default_rng(seed).standard_normal((size, size)) * 1e-3
    root[:3] += 8.0 * root[[4, 5, 3]]
    return root @ root.T


@pytest.mark.parametrize("coordinates", ["ZXZ", "xyz", "rotation_vector"])
@pytest.mark.parametrize("kind", [UniformNoise, NormalNoise])
@pytest.mark.parametrize("n_readings", [1, 6])
def test_structured_noise(kind, coordinates, n_readings):
    noise = kind(**SMALL, coordinates=coordinates)
    expected = noise.covariance(np.zeros((1, 3)), TURN[None], n_readings)[0]
    assert_covariance(errors(noise, n_readings)[:, 0], expected)


@pytest.mark.parametrize("n_readings", [1, 6])
def test_correlated_noise(n_readings):
    covariance = correlated(6 + n_readings)
    noise = NormalNoise(pose_covariance=covariance)
    np.testing.assert_array_equal(
        noise.covariance(np.zeros((2, 3)), np.stack([TURN] * 2), n_readings), np.stack([covariance] * 2)
    )
    assert_covariance(errors(noise, n_readings)[:, 0], covariance)


def test_one_covariance_a_pose():
    each = np.stack([correlated(7, seed) for seed in (1, 2, 3)])
    sample = errors(NormalNoise(pose_covariance=each), poses=3)
    for i in range(3):
        assert_covariance(sample[:, i], each[i])


def test_a_common_error_is_shared_by_all_poses_of_a_set_and_by_no_other_set():
    own, common = 0.1 * correlated(7, 4), correlated(7, 5)
    noise = NormalNoise(pose_covariance=own, common_covariance=common)
    np.testing.assert_array_equal(noise.common(), common)
    np.testing.assert_array_equal(noise.covariance(np.zeros((1, 3)), TURN[None])[0], own)
    sample = errors(noise, poses=2)
    assert_covariance(sample[:, 0], own + common)
    cross = sample[:, 0].T @ sample[:, 1] / N
    scale = np.sqrt(np.outer(np.diag(own + common), np.diag(own + common)))
    assert (np.abs(cross - common) < 6 * scale / np.sqrt(N)).all()
    apart = sample[1:, 0].T @ sample[:-1, 1] / N
    assert (np.abs(apart) < 6 * scale / np.sqrt(N)).all()


@pytest.mark.parametrize("coordinates", ["ZXZ", "xyz"])
def test_angle_errors_are_on_the_named_angles(coordinates):
    noise = UniformNoise(angle=1e-2, coordinates=coordinates)
    start = np.array([0.2, 0.7, -0.4])
    rotation = np.broadcast_to(euler_to_matrix(start, coordinates), (2000, 1, 3, 3))
    _, turned, _ = noise.apply(np.zeros((2000, 1, 3)), rotation, np.zeros((2000, 1)), np.random.default_rng(0))
    change = matrix_to_euler(turned, coordinates) - start
    assert 0.0099 < np.abs(change).max() <= 0.01 * (1 + 1e-9)
    np.testing.assert_allclose(change.std(axis=(0, 1)), 1e-2 / np.sqrt(3), rtol=0.05)


def test_uniform_errors_fill_their_interval():
    sample = errors(UniformNoise(**SMALL, coordinates="rotation_vector"))[:, 0]
    assert (np.abs(sample[:, :3]).max(axis=0) <= 0.02).all()
    assert (np.abs(sample[:, :3]).max(axis=0) > 0.0199).all()
    assert 0.0499 < np.abs(sample[:, 6]).max() <= 0.05


def test_noise_of_zero_changes_nothing():
    for noise in (UniformNoise(), NormalNoise()):
        assert np.abs(errors(noise, sets=10)).max() < 1e-15


def test_rotated_poses_stay_rotations():
    for noise in (UniformNoise(**SMALL), NormalNoise(**SMALL), NormalNoise(pose_covariance=correlated(7))):
        rotation = np.broadcast_to(TURN, (100, 1, 3, 3))
        _, turned, _ = noise.apply(np.zeros((100, 1, 3)), rotation, np.zeros((100, 1)), np.random.default_rng(0))
        np.testing.assert_allclose(turned @ np.swapaxes(turned, -1, -2) - np.eye(3), 0, atol=2e-15)


class TestOutliers:
    NOISE = Outliers(UniformNoise(0.01), fraction=0.2, shift=(1.0, 2.0))

    def test_a_share_of_poses_jumps_in_a_random_direction(self):
        sample = errors(self.NOISE)[:, 0, :3]
        distance = np.linalg.norm(sample, axis=1)
        bad = distance > 0.5
        assert abs(bad.mean() - 0.2) < 5 * np.sqrt(0.16 / N)
        assert distance[bad].min() > 0.98
        assert distance[bad].max() < 2.02
        assert abs(distance[bad].mean() - 1.5) < 0.02
        direction = sample[bad] / distance[bad, None]
        np.testing.assert_allclose(direction.mean(axis=0), 0, atol=5 / np.sqrt(3 * bad.sum()))
        np.testing.assert_allclose(direction.T @ direction / bad.sum(), np.eye(3) / 3, atol=0.02)
        assert np.abs(sample[~bad]).max() <= 0.01

    def test_estimators_are_told_of_the_good_poses_alone(self):
        rotations = TURN[None]
        np.testing.assert_array_equal(
            self.NOISE.covariance(rotations[..., 0], rotations),
            self.NOISE.noise.covariance(rotations[..., 0], rotations),
        )
        assert self.NOISE.common() is None
        base = NormalNoise(pose_covariance=correlated(12), common_covariance=correlated(12, 9))
        leg = Outliers(base, 0.1, (1, 2)).for_leg(2)
        np.testing.assert_array_equal(leg.common(), base.for_leg(2).common())

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"fraction": 1.1}, "fraction"),
            ({"fraction": -0.1}, "fraction"),
            ({"shift": (2, 1)}, "shift"),
            ({"shift": (-1, 1)}, "shift"),
            ({"shift": 1.0}, "shift"),
            ({"noise": None}, "noise"),
        ],
    )
    def test_wrong_settings(self, settings, message):
        with pytest.raises(InputError, match=message):
            Outliers(**{"noise": UniformNoise(0.01), "fraction": 0.1, "shift": (1, 2), **settings})


@pytest.mark.parametrize("leg", range(1, 7))
def test_a_leg_sees_its_own_rows_of_twelve(leg):
    own, common = correlated(12), correlated(12, 8)
    seen = NormalNoise(pose_covariance=np.stack([own, 2 * own]), common_covariance=common).for_leg(leg)
    rows = [0, 1, 2, 3, 4, 5, 5 + leg]
    np.testing.assert_array_equal(
        seen.covariance(np.zeros((2, 3)), np.stack([TURN] * 2))[1], 2 * own[np.ix_(rows, rows)]
    )
    np.testing.assert_array_equal(seen.common(), common[np.ix_(rows, rows)])


def test_what_one_leg_needs_stays_as_it_is():
    noise = NormalNoise(pose_covariance=correlated(7))
    np.testing.assert_array_equal(noise.for_leg(4).pose_covariance, noise.pose_covariance)
    assert UniformNoise(**SMALL).for_leg(4) == UniformNoise(**SMALL)


def test_the_same_seed_gives_the_same_errors():
    for noise in (UniformNoise(**SMALL), NormalNoise(**SMALL), TestOutliers.NOISE):
        np.testing.assert_array_equal(errors(noise, sets=5, rng=1), errors(noise, sets=5, rng=1))
        assert (errors(noise, sets=5, rng=1)[..., :3] != errors(noise, sets=5, rng=2)[..., :3]).all()


@pytest.mark.parametrize("kind", [UniformNoise, NormalNoise])
@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"position": -1}, "position: expected a noise level >= 0"),
        ({"length": np.nan}, "length: .*NaN"),
        ({"angle": 5.0}, "angle: .*radians"),
        ({"position": [1, 2, 3]}, "position: expected shape"),
        ({"coordinates": "ZZX"}, "Euler sequence"),
    ],
)
def test_wrong_levels(kind, settings, message):
    with pytest.raises(InputError, match=message):
        kind(**settings)


ASYMMETRIC = np.eye(7) + np.eye(7, k=1) * 0.5


@pytest.mark.parametrize("name", ["pose_covariance", "common_covariance"])
@pytest.mark.parametrize(
    ("value", "message"),
    [
        (np.eye(6), r"expected shape \(\.\.\., 7, 7\)"),
        (np.ones(7), "expected shape"),
        ([[1, 2], [3]], "expected"),
        (ASYMMETRIC, "symmetric"),
        (np.diag([1, 1, 1, 1, 1, 1, -1e-3]), "positive semidefinite"),
        (np.eye(7) + 2 * (np.eye(7, k=1) + np.eye(7, k=-1)), "positive semidefinite"),
        (np.full((7, 7), np.nan), "NaN"),
    ],
)
def test_wrong_covariances(name, value, message):
    with pytest.raises(InputError, match=rf"{name}: .*{message}"):
        NormalNoise(**{name: value})


def test_a_common_covariance_is_one_matrix():
    with pytest.raises(InputError, match="common_covariance: expected shape"):
        NormalNoise(common_covariance=np.stack([np.eye(7)] * 3))


def test_a_covariance_of_rank_one_is_fine():
    line = np.outer(np.arange(1, 8), np.arange(1, 8)) * 1e-8
    sample = errors(NormalNoise(pose_covariance=line), sets=500)[:, 0]
    np.testing.assert_allclose(sample, sample[:, :1] * np.arange(1, 8), atol=1e-9)


def test_both_kinds_at_once_is_an_error():
    with pytest.raises(InputError, match="not both"):
        NormalNoise(position=0.1, pose_covariance=np.eye(7))


def test_a_covariance_of_one_reading_is_no_good_for_six(left_hand):
    with pytest.raises(InputError, match="the data has 6"):
        hx.simulate(left_hand, noise=NormalNoise(pose_covariance=1e-6 * np.eye(7)), n_poses=3, rng=0)
    with pytest.raises(InputError, match=r"6 reading\(s\), but the data has 1"):
        hx.simulate_leg(left_hand, 3, "leg", 3, noise=NormalNoise(pose_covariance=1e-6 * np.eye(12)), rng=0)
