"""Every loop's derivatives against central differences: for each set of unknowns, in batches and alone."""

import itertools

import numpy as np
import pytest

import hexopt as hx
from hexopt.rotations import euler_to_matrix, rotation_vector_to_matrix

LOOPS = {
    "FixedDirection": ("direction", hx.loops.FixedDirection),
    "FixedLeg": ("leg", hx.loops.FixedLeg),
    "FixedLength": ("length", hx.loops.FixedLength),
    "LegLength": ("none", hx.loops.LegLength),
    "ReadLeg": ("leg", hx.loops.ReadLeg),
    "ReadLength": ("length", hx.loops.ReadLength),
}
SIZES = {"platform_point": 3, "base_point": 3, "offset": 1, "gain": 1}
CASES = [
    (name, unknown)
    for name, (_, kind) in LOOPS.items()
    for count in range(1, len(kind.involved) + 1)
    for unknown in itertools.combinations(kind.involved, count)
]
N = 4


def random_data(lock, batch=(), seed=0):
    """Poses that satisfy no lock: derivatives must hold everywhere."""
    rng = np.random.default_rng(seed)
    return hx.LegMeasurements(
        rng.uniform(-3, 3, (*batch, N, 3)) + np.array([0, 0, 9]),
        euler_to_matrix(rng.uniform(-1, 1, (*batch, N, 3))),
        rng.uniform(2, 4, (*batch, N)),
        lock,
    )


def random_leg(seed=1, batch=()):
    rng = np.random.default_rng(seed)
    return {
        "platform_point": rng.uniform(-3, 3, (*batch, 3)),
        "base_point": rng.uniform(-3, 3, (*batch, 3)),
        "offset": rng.uniform(5, 6, batch),
        "gain": rng.uniform(0.8, 1.2, batch),
    }


def make(name, unknown, data, leg):
    kind = LOOPS[name][1]
    return kind(data, unknown=unknown, **{key: leg[key] for key in kind.involved if key not in unknown})


def random_values(loop, batch=(), seed=2):
    """Values whose fixed point, where there is one, is far from the base joint."""
    x = np.random.default_rng(seed).uniform(1, 2, (*batch, loop.parameters.size))
    if "fixed_point" in loop.parameters:
        x[..., loop.parameters["fixed_point"]] += 5.0
    return x


def changed(data, i, error):
    """The data with pose i in error by (δP, δω, δρ)."""
    position, rotation, length = np.array(data.position), np.array(data.rotation), np.array(data.length)
    position[i] += error[:3]
    rotation[i] = rotation_vector_to_matrix(error[3:6]) @ rotation[i]
    length[i] += error[6]
    return hx.LegMeasurements(position, rotation, length, data.lock)


@pytest.mark.parametrize(("name", "unknown"), CASES)
class TestDerivatives:
    def test_by_the_parameters(self, name, unknown, central_difference):
        loop = make(name, unknown, random_data(LOOPS[name][0]), random_leg())
        x = random_values(loop)
        expected = central_difference(loop.residual, x)
        assert loop.jacobian(x).shape == (N, loop.rows, loop.parameters.size)
        np.testing.assert_allclose(loop.jacobian(x), expected, atol=1e-9)

    def test_by_the_known_values(self, name, unknown, central_difference):
        data, leg = random_data(LOOPS[name][0]), random_leg()
        loop = make(name, unknown, data, leg)
        x = random_values(loop)
        for key in set(loop.involved) - set(unknown):
            expected = central_difference(
                lambda value, key=key: make(name, unknown, data, {**leg, key: value}).residual(x), leg[key]
            ).reshape(N, loop.rows, SIZES[key])
            found = np.broadcast_to(loop.known_jacobian(x, key), expected.shape)
            np.testing.assert_allclose(found, expected, atol=1e-9)

    def test_by_the_error_of_a_pose(self, name, unknown, central_difference):
        """What pose i's error does to its own rows, and to no other; a part that is common to all rows (Type III
        moves its origin with the mean position) is the nuisance's and counts for nothing."""
        data, leg = random_data(LOOPS[name][0]), random_leg()
        loop = make(name, unknown, data, leg)
        x = random_values(loop)
        found = loop.noise_jacobian(x)
        assert found.shape == (N, loop.rows, 7)
        for i in range(N):
            moved = central_difference(
                lambda e, i=i: make(name, unknown, changed(data, i, e), leg).residual(x), np.zeros(7)
            )
            other = moved[(i + 1) % N]
            np.testing.assert_allclose(np.delete(moved, i, axis=0) - other, 0, atol=1e-9)
            np.testing.assert_allclose(moved[i] - other, found[i], atol=1e-9)

    def test_a_batch_equals_its_members(self, name, unknown):
        data, leg = random_data(LOOPS[name][0], (2, 3)), random_leg(batch=(2, 3))
        loop = make(name, unknown, data, leg)
        x = random_values(loop, (2, 3))
        alone = make(name, unknown, random_member(data), {key: value[1, 2] for key, value in leg.items()})
        for ask in ("residual", "jacobian", "noise_jacobian"):
            together = getattr(loop, ask)(x)
            np.testing.assert_allclose(together[1, 2], getattr(alone, ask)(x[1, 2]), atol=1e-14)

    def test_many_values_on_one_set(self, name, unknown):
        """One set of measurements, a batch of parameter values: shapes broadcast."""
        data, leg = random_data(LOOPS[name][0]), random_leg()
        loop = make(name, unknown, data, leg)
        x = random_values(loop, (5,))
        for ask, shape in (("residual", ()), ("jacobian", (loop.parameters.size,)), ("noise_jacobian", (7,))):
            together = np.broadcast_to(getattr(loop, ask)(x), (5, N, loop.rows, *shape))
            np.testing.assert_allclose(together[3], getattr(loop, ask)(x[3]), atol=1e-14)

    def test_many_known_values_on_one_set(self, name, unknown):
        data, leg = random_data(LOOPS[name][0]), random_leg(batch=(5,))
        loop = make(name, unknown, data, leg)
        x = random_values(loop, (5,))
        alone = make(name, unknown, data, {key: value[3] for key, value in leg.items()})
        for ask, shape in (("residual", ()), ("jacobian", (loop.parameters.size,)), ("noise_jacobian", (7,))):
            together = np.broadcast_to(getattr(loop, ask)(x), (5, N, loop.rows, *shape))
            np.testing.assert_allclose(together[3], getattr(alone, ask)(x[3]), atol=1e-14)
        if any(set(unknown) <= names for names in loop.linear_in):
            for form in loop.forms:
                problem, single = loop.linear(form), alone.linear(form)
                matrix = np.broadcast_to(problem.matrix, (5, *problem.matrix.shape[-2:]))
                rhs = np.broadcast_to(problem.rhs, (5, problem.rhs.shape[-1]))
                np.testing.assert_allclose(matrix[3], single.matrix, atol=1e-14)
                np.testing.assert_allclose(rhs[3], single.rhs, atol=1e-14)


def random_member(data):
    return hx.LegMeasurements(data.position[1, 2], data.rotation[1, 2], data.length[1, 2], data.lock)


@pytest.mark.parametrize("name", LOOPS)
def test_the_true_leg_closes_every_loop(name, robot):
    """At the true leg and the nuisance that fits, the misclosure is rounding."""
    lock, kind = LOOPS[name]
    for number in (1, 4):
        leg = robot.leg(number)
        data = hx.simulate_leg(robot, number, lock, 6, 20, rng=0)
        residual = kind(data).residual(leg)
        size = robot.size**2 if name == "FixedLength" else robot.size
        assert np.abs(residual).max() < 20 * np.finfo(float).eps * size


def test_the_nuisance_of_a_leg_is_the_physical_one(left_hand):
    leg = left_hand.leg(3)
    for lock, kind, name in (
        ("direction", hx.loops.FixedDirection, "direction"),
        ("leg", hx.loops.FixedLeg, "fixed_point"),
        ("length", hx.loops.FixedLength, "sphere"),
    ):
        data = hx.simulate_leg(left_hand, 3, lock, 6, rng=0)
        loop = kind(data)
        found = loop.parameters.split(loop.values(leg))[name]
        point = data.position[0] + data.rotation[0] @ leg.platform_point
        length = leg.true_length(data.length)[0]
        origin = data.position.mean(axis=0)
        expected = {
            "direction": (point - leg.base_point) / length,
            "fixed_point": point,
            "sphere": [(length**2 - ((leg.base_point - origin) ** 2).sum()) / 2],
        }[name]
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        if name == "direction":
            np.testing.assert_allclose(np.linalg.norm(found), 1.0, rtol=1e-13)


@pytest.mark.parametrize("name", LOOPS)
def test_the_covariance_of_the_rows_is_that_of_simulated_misclosures(name, left_hand):
    """By Monte Carlo: S at the truth, with errors of each pose, a common part, and an uncertain known value."""
    lock, kind = LOOPS[name]
    rng = np.random.default_rng(0)
    root = rng.standard_normal((7, 7)) * 1e-4
    noise = hx.NormalNoise(pose_covariance=root @ root.T, common_covariance=0.3 * root.T @ root)
    exact = hx.simulate_leg(left_hand, 3, lock, 3, rng=1)
    leg = left_hand.leg(3)
    x = kind(exact).values(leg)
    sets = 30_000
    noisy = noise.apply(
        *(np.broadcast_to(part, (sets, *part.shape)) for part in (exact.position, exact.rotation, exact.length)), rng
    )
    loop = kind(hx.LegMeasurements(*noisy, lock, noise, leg))
    if name == "FixedLength":  # its origin moves with the data; the physical misclosure does not
        origin = noisy[0].mean(axis=-2) - exact.position.mean(axis=-2)
        centre = leg.base_point - exact.position.mean(axis=-2)
        x = np.broadcast_to(x, (sets, 4)) + np.concatenate([np.zeros((sets, 3)), (origin @ centre)[:, None]], axis=1)
    misclosure = loop.residual(x).reshape(sets, -1)
    covariance = kind(hx.LegMeasurements(exact.position, exact.rotation, exact.length, lock, noise, leg)).covariance(
        x if x.ndim == 1 else kind(exact).values(leg)
    )
    n, d = covariance.blocks.shape[:2]
    expected = np.zeros((n * d, n * d))
    for i in range(n):
        expected[i * d : (i + 1) * d, i * d : (i + 1) * d] = covariance.blocks[i]
    common = covariance.common.reshape(n * d, -1)
    expected += common @ common.T
    found = np.cov(misclosure.T)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose((found - expected) / scale, 0, atol=5 / np.sqrt(sets))
