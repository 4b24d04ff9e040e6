"""Exact maximum likelihood: its optimality conditions by NumPy, scipy in other unknowns, and the batched estimators."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import InputError
from hexopt.rotations import rotation_vector_jacobian, rotation_vector_to_matrix

symbolic = hx.symbolic
LOOPS = {
    "direction": hx.loops.FixedDirection,
    "leg": hx.loops.FixedLeg,
    "length": hx.loops.FixedLength,
    "none": hx.loops.LegLength,
}
#: Errors so large that a linearised answer is visibly not the exact one.
COARSE = hx.NormalNoise(0.1, 0.02, 0.1, coordinates="rotation_vector")


def noisy(robot, lock, noise=COARSE, n=9, **known):
    nominal = robot if lock == "length" else robot.perturbed(0.1, rng=0)
    return LOOPS[lock](hx.simulate_leg(robot, 3, lock, n, noise=noise, nominal=nominal, rng=1), **known)


def moved(data, error):
    """The measurements with errors (n, 7) or (n, 12) added."""
    length = data.length + (error[:, 6:] if data.length.ndim == 2 else error[:, 6])
    arrays = data.position + error[:, :3], rotation_vector_to_matrix(error[:, 3:6]) @ data.rotation, length
    return type(data)(*arrays, data.lock, nominal=data.nominal)


def scipys(loop, noise):
    """The same optimum in other unknowns: the turns of the poses, with positions and readings solved for."""
    data, n = loop.data, loop.data.n_poses
    known = {name: data.nominal.block(name) for name in ("offset", "gain")}

    def errors(y):
        p, turns = loop.parameters.split(y[: loop.parameters.size]), y[loop.parameters.size :].reshape(n, 3)
        p = {**known, **p}
        vectors = (rotation_vector_to_matrix(turns) @ data.rotation) @ p["platform_point"]
        if data.lock == "leg":
            return np.concatenate(
                [(p["fixed_point"] - vectors - data.position) / noise.position, turns / noise.angle], 1
            )
        gap = data.position + vectors - p["base_point"]
        if data.lock == "none":  # the least (δP, δρ) for ‖gap + δP‖ = ρ + δρ + δ moves along the leg
            miss = (np.linalg.norm(gap, axis=1) - data.length - p["offset"]) / np.hypot(noise.position, noise.length)
            return np.concatenate([miss[:, None], turns / noise.angle], 1)
        # Type I: gap + δP = (ρ + δρ + δ) n, ‖n‖ = 1, by the least δP and δρ along n, and δP across it
        unit = p["direction"] / np.linalg.norm(p["direction"])
        along = gap @ unit
        across = (gap - along[:, None] * unit) / noise.position
        miss = (along - data.length - p["offset"]) / np.hypot(noise.position, noise.length)
        return np.concatenate([miss[:, None], across, turns / noise.angle], 1)

    start = np.concatenate([loop.start(), np.zeros(3 * n)])
    return least_squares(lambda y: errors(y).ravel(), start, xtol=1e-15, ftol=1e-15, gtol=1e-15)


@pytest.mark.parametrize("lock", LOOPS)
class TestOptimality:
    def test_the_equations_hold_exactly(self, lock, left_hand):
        loop = noisy(left_hand, lock)
        found = symbolic.maximum_likelihood(loop)
        assert found.success
        rows = symbolic.residual(loop, found.values)
        data = moved(loop.data, found.errors[0])
        # Type III has the mean measured position as its origin, which moves: the sphere itself does not
        values = found.values if lock != "length" else found.values[:3]
        after = LOOPS[lock](data).residual(values)
        assert np.abs(after).max() < 1e-10
        assert np.abs(rows).max() > 1e-2

    def test_no_first_order_change_of_values_or_errors_helps(self, lock, left_hand):
        """Karush–Kuhn–Tucker, with NumPy's derivatives at the moved measurements."""
        loop = noisy(left_hand, lock)
        found = symbolic.maximum_likelihood(loop)
        error, data = found.errors[0], moved(loop.data, found.errors[0])
        force = found.multipliers["equations"].reshape(loop.data.n_poses, loop.rows)
        x = found.values
        if lock == "length":  # the same sphere about the moved origin
            x = np.concatenate([x[:3], LOOPS[lock](data).values(x[:3])[3:]])
            origin = loop.origin - data.position.mean(axis=0)
        else:
            origin = np.zeros(3)
        there = LOOPS[lock](data)
        gradient = np.einsum("ndp,nd->p", there.jacobian(x), force)
        if lock == "length":
            gradient[:3] -= origin * force.sum()
        scale = np.einsum("ndp,nd->p", np.abs(there.jacobian(x)), np.abs(force))
        if lock == "direction":
            gradient[6:] += 2 * found.multipliers["direction"] * x[6:]
            np.testing.assert_allclose(np.linalg.norm(x[6:]), 1, rtol=1e-12)
        assert (np.abs(gradient) < 1e-9 * scale).all()
        by_error = there.noise_jacobian(x)
        by_error[..., 3:6] = by_error[..., 3:6] @ rotation_vector_jacobian(error[:, 3:6])
        precision = np.array([0.1] * 3 + [0.02] * 3 + [0.1]) ** -2.0
        balance = precision * error + np.einsum("nde,nd->ne", by_error, force)
        assert (np.abs(balance) < 1e-8 * np.abs(precision * error).max(axis=0).max()).all()
        np.testing.assert_allclose(found.objective, 0.5 * (precision * error**2).sum(), rtol=1e-10)


@pytest.mark.parametrize("lock", ["direction", "leg", "none"])
def test_it_is_what_scipy_finds_in_other_unknowns(lock, left_hand):
    loop = noisy(left_hand, lock)
    found, expected = symbolic.maximum_likelihood(loop), scipys(loop, COARSE)
    size = loop.parameters.size
    assert expected.cost > 0.01
    np.testing.assert_allclose(found.objective, expected.cost, rtol=1e-8)
    other = expected.x[:size].copy()
    if lock == "direction":
        other[6:] /= np.linalg.norm(other[6:])
    np.testing.assert_allclose(found.values, other, atol=1e-4)


@pytest.mark.parametrize("lock", LOOPS)
@pytest.mark.parametrize("noise", ["coarse", "paper", "no reading", "correlated"])
def test_the_batched_estimator_agrees(lock, noise, left_hand, paper_noise):
    root = np.random.default_rng(0).standard_normal((7, 7)) * np.array([0.01] * 3 + [1e-3] * 3 + [0.01])[:, None]
    model = {
        "coarse": COARSE,
        "paper": paper_noise,
        "no reading": hx.NormalNoise(0.01, 2e-4, 0.0),
        "correlated": hx.NormalNoise(pose_covariance=root @ root.T),
    }[noise]
    loop = noisy(left_hand, lock, model)
    expected = hx.estimate(loop, hx.MaximumLikelihood())
    found = symbolic.maximum_likelihood(loop)
    assert found.success
    np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-8, atol=1e-10)
    assert (np.abs(found.values - expected.values) < 1e-6 * expected.standard_errors).all()
    if noise == "no reading":
        assert not found.errors[0][:, 6].any()


class TestSharedErrors:
    def test_a_common_error_is_part_of_the_covariance(self, left_hand):
        """The objective is that of the whole covariance of all poses, written out."""
        root = 0.01 * np.random.default_rng(1).standard_normal((7, 7))
        loop = noisy(left_hand, "leg", hx.NormalNoise(0.01, 2e-3, 0.01, common_covariance=root @ root.T))
        found = symbolic.maximum_likelihood(loop)
        own = loop.data.noise.covariance(loop.data.position, loop.data.rotation)
        whole = np.kron(np.ones((9, 9)), root @ root.T)
        for i in range(9):
            whole[7 * i : 7 * i + 7, 7 * i : 7 * i + 7] += own[i]
        error = found.errors[0].ravel()
        np.testing.assert_allclose(found.objective, 0.5 * error @ np.linalg.solve(whole, error), rtol=1e-8)
        alone = symbolic.maximum_likelihood(noisy(left_hand, "leg", hx.NormalNoise(0.01, 2e-3, 0.01)))
        assert np.abs(found.errors[0] - alone.errors[0]).max() > 1e-3

    def test_a_known_estimate_counts_as_a_prior_of_an_unknown(self, left_hand, paper_noise):
        data = hx.simulate_leg(left_hand, 3, "leg", 7, noise=paper_noise, nominal=left_hand, rng=2)
        point = hx.estimate(hx.loops.FixedLeg(data).linear(), hx.LeastSquares(weights="model"))
        given = symbolic.maximum_likelihood(noisy(left_hand, "length", paper_noise, platform_point=point))
        loop = noisy(left_hand, "length", paper_noise, unknown=("platform_point", "base_point"))
        root = np.linalg.inv(np.linalg.cholesky(point.covariance_of("platform_point")))
        mean = np.concatenate([point.params["platform_point"], np.zeros(4)])
        both = symbolic.maximum_likelihood(loop, prior=(mean, np.hstack([root, np.zeros((3, 4))])))
        assert given.success
        assert both.success
        np.testing.assert_allclose(given.objective, both.objective, rtol=1e-8)
        np.testing.assert_allclose(given.values[:3], both.values[3:6], atol=1e-8)


class TestSeveralLegsAndSets:
    @pytest.fixture
    def data(self, left_hand, paper_noise):
        nominal = left_hand.perturbed(0.1, offsets=0.1, rng=0)
        return hx.simulate(left_hand, n_poses=8, noise=paper_noise, nominal=nominal, rng=1)

    def test_the_legs_of_a_pose_share_its_error(self, data):
        """PlatformPose has the equations of WholeRobot, solved for the pose: one optimum, and the batched one."""
        loop = hx.loops.PlatformPose(data)
        found = symbolic.maximum_likelihood(loop)
        expected = hx.estimate(hx.loops.WholeRobot(data), hx.MaximumLikelihood())
        assert found.success
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-9)
        assert (np.abs(found.values - expected.values) < 1e-6 * expected.standard_errors).all()
        there = moved(data, found.errors[0])
        assert np.abs(hx.loops.PlatformPose(there).residual(found.values)).max() < 1e-10

    @pytest.mark.parametrize("lock", ["direction", "leg", "length"])
    def test_a_locked_leg_among_free_ones(self, lock, left_hand, paper_noise):
        nominal = left_hand.perturbed(0.02, rng=0)
        data = hx.simulate(left_hand, lock, leg=3, n_poses=8, noise=paper_noise, nominal=nominal, rng=1)
        loop = hx.loops.WholeRobot(data, unknown=("platform_point",))
        found, expected = symbolic.maximum_likelihood(loop), hx.estimate(loop, hx.MaximumLikelihood())
        assert found.success
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-8)
        assert (np.abs(found.values - expected.values) < 1e-6 * expected.standard_errors).all()

    def test_several_sets_of_a_leg(self, left_hand, paper_noise):
        loops = [
            hx.loops.FixedDirection(
                hx.simulate_leg(left_hand, 3, "direction", 6, noise=paper_noise, nominal=left_hand, rng=k),
                unknown=("platform_point", "base_point", "offset"),
            )
            for k in range(2)
        ]
        sets = hx.loops.Sets(*loops)
        found, expected = symbolic.maximum_likelihood(sets), hx.estimate(sets, hx.MaximumLikelihood())
        assert [errors.shape for errors in found.errors] == [(6, 7), (6, 7)]
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-9)
        assert (np.abs(found.values - expected.values) < 1e-6 * expected.standard_errors).all()


class TestPoseFit:
    @pytest.fixture
    def loop(self, left_hand, paper_noise):
        nominal = left_hand.perturbed(0.1, rng=0)
        data = hx.simulate(left_hand, n_poses=8, noise=paper_noise, nominal=nominal, rng=1)
        return hx.loops.PlatformPose(data, unknown=("platform_point", "base_point"))

    def test_it_is_the_forward_kinematics_calibration(self, loop):
        radius = np.linalg.norm(loop.data.nominal.platform_points, axis=1).max()
        weights = np.diag(np.repeat([1.0, radius], 3))
        found, expected = symbolic.pose_fit(loop, weights=weights), hx.estimate(loop, hx.ForwardKinematics())
        assert found.success
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-9)
        assert (np.abs(found.values - expected.values) < 1e-6 * expected.standard_errors).all()
        rows = loop.residual(found.values)
        np.testing.assert_allclose(found.errors[0][:, :6], rows, atol=1e-10)
        np.testing.assert_allclose(found.objective, 0.5 * np.sum((rows @ weights) ** 2), rtol=1e-9)

    def test_the_noise_model_does_not_matter(self, loop):
        shared = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=1e-4 * np.eye(12))
        other = hx.loops.PlatformPose(replace(loop.data, noise=shared), unknown=loop.unknown)
        np.testing.assert_array_equal(symbolic.pose_fit(other).values, symbolic.pose_fit(loop).values)

    def test_bounds_and_priors(self, loop):
        start = loop.start()
        free = symbolic.pose_fit(loop, prior=(start, 0.1 * np.eye(36)))
        held = symbolic.pose_fit(loop, prior=(start, 0.1 * np.eye(36)), lower=start - 0.05, upper=start + 0.05)
        assert free.success
        assert held.success
        assert np.abs(free.values - start).max() > 0.05
        assert np.abs(held.values - start).max() <= 0.05
        assert held.objective > free.objective
        force, side = held.multipliers["bounds"], np.sign(held.values - start)
        tight = np.abs(held.values - start) > 0.05 - 1e-9
        assert tight.any()
        assert (force[tight] * side[tight] > 0).all()
        assert (np.abs(force[~tight]) < 1e-6 * np.abs(force).max()).all()

    @pytest.mark.parametrize("weights", [np.zeros((6, 6)), np.eye(5), np.ones((2, 2, 6, 6))])
    def test_wrong_weights(self, loop, weights):
        with pytest.raises(InputError, match="weights: expected"):
            symbolic.pose_fit(loop, weights=weights)


class TestFailures:
    def test_no_noise_model(self, left_hand):
        with pytest.raises(InputError, match="FixedLeg: the measurements have no noise model"):
            symbolic.maximum_likelihood(noisy(left_hand, "leg", None))

    def test_noise_that_no_equation_feels(self, left_hand):
        with pytest.raises(InputError, match="leaves all equations without any error"):
            symbolic.maximum_likelihood(noisy(left_hand, "leg", hx.NormalNoise(0.0, 0.0, 0.1)))

    def test_too_few_iterations(self, left_hand, capfd):
        found = symbolic.maximum_likelihood(noisy(left_hand, "none"), max_iterations=1)
        assert (found.success, found.status) == (False, "Maximum_Iterations_Exceeded")
        assert np.isnan(found.values).all()
        assert np.isnan(found.errors[0]).all()
        assert capfd.readouterr() == ("", "")

    def test_the_wrong_target_says_what_to_use(self, left_hand):
        poses = hx.loops.PlatformPose(hx.simulate(left_hand, n_poses=8, nominal=left_hand, rng=1))
        with pytest.raises(InputError, match="fit: expected a loop of one leg, got PlatformPose; use maximum"):
            symbolic.fit(poses)
        with pytest.raises(InputError, match="pose_fit: expected a PlatformPose, got LegLength; use fit"):
            symbolic.pose_fit(noisy(left_hand, "none"))
        with pytest.raises(InputError, match="expected a loop, Sets, WholeRobot or PlatformPose, got LegMeasurements"):
            symbolic.maximum_likelihood(noisy(left_hand, "none").data)

    def test_equations_of_no_symbolic_kind(self, left_hand):
        class Strange(hx.loops.PlatformPose):
            parts = ((None, np.arange(3)),)

        data = hx.simulate(left_hand, n_poses=8, nominal=left_hand, rng=1)
        with pytest.raises(InputError, match="NoneType has no symbolic equations; expected a loop"):
            symbolic.pose_fit(Strange(data))
