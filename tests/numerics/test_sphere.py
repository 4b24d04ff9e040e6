"""A quadratic on the unit sphere: against a semidefinite programme, a dense grid of starts, and in the hard case."""

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexopt.numerics.sphere import minimise_on_sphere


def solved(hessian, linear, **settings):
    """The minimum for a matrix and a linear term."""
    curvature, axes = np.linalg.eigh(hessian)
    return minimise_on_sphere(curvature, axes, np.einsum("...ij,...i->...j", axes, linear), **settings)


def objective(hessian, linear, n):
    quadratic = 0.5 * np.einsum("...i,...ij,...j->...", n, hessian, n)
    return quadratic - np.einsum("...i,...i->...", linear, n)


def problems(rng, count, size=3, shift=0.0):
    """Symmetric matrices, with `shift` added to their eigenvalues, and linear terms of several magnitudes."""
    root = rng.standard_normal((count, size, size))
    linear = rng.standard_normal((count, size)) * 10.0 ** rng.uniform(-4, 4, (count, 1))
    return 0.5 * (root + np.swapaxes(root, -1, -2)) + shift * np.eye(size), linear


def relaxation(hessian, linear):
    """The optimum of the semidefinite relaxation, min ½⟨H, X⟩ − gᵀn with tr X = 1 and [X n; nᵀ 1] ⪰ 0."""
    size = len(linear)
    scale = np.abs(hessian).max() + np.abs(linear).max()
    lifted = cp.Variable((size + 1, size + 1), PSD=True)
    value = 0.5 * cp.trace(hessian / scale @ lifted[:size, :size]) - linear / scale @ lifted[:size, size]
    held = [cp.trace(lifted[:size, :size]) == 1, lifted[size, size] == 1]
    problem = cp.Problem(cp.Minimize(value), held)
    problem.solve(solver="CLARABEL", tol_gap_abs=1e-10, tol_gap_rel=1e-10, tol_feas=1e-10)
    assert problem.status == "optimal"
    return scale * problem.value, scale


@pytest.mark.parametrize("shift", [-3.0, 0.0, 10.0])
def test_it_is_the_semidefinite_relaxation(shift):
    hessian, linear = problems(np.random.default_rng(0), 8, shift=shift)
    found = solved(hessian, linear)
    for i in range(8):
        value, scale = relaxation(hessian[i], linear[i])
        assert abs(objective(hessian[i], linear[i], found.values[i]) - value) < 1e-9 * scale
        assert abs(found.bound[i] - value) < 1e-9 * scale


@pytest.mark.parametrize("size", [1, 2, 3, 5])
@pytest.mark.parametrize("shift", [-3.0, 0.0, 10.0])
def test_the_proof_is_one(size, shift):
    """A unit vector, a multiplier that makes the Lagrangian convex, stationarity, and so no gap."""
    hessian, linear = problems(np.random.default_rng(size), 500, size, shift)
    found = solved(hessian, linear)
    scale = np.abs(np.linalg.eigvalsh(hessian)).max(axis=-1) + np.linalg.norm(linear, axis=-1)
    assert np.abs(np.linalg.norm(found.values, axis=-1) - 1).max() < 1e-15 * size + 1e-15
    convex = hessian + found.multiplier[:, None, None] * np.eye(size)
    assert (np.linalg.eigvalsh(convex)[:, 0] > -1e-14 * scale).all()
    stationary = np.einsum("bij,bj->bi", convex, found.values) - linear
    assert (np.linalg.norm(stationary, axis=-1) < 1e-13 * scale).all()
    assert (found.gap >= 0).all()
    assert (found.gap < 1e-14 * scale).all()
    np.testing.assert_allclose(
        found.bound + found.gap, objective(hessian, linear, found.values), atol=1e-13, rtol=1e-13
    )


def test_the_bound_is_the_dual_value():
    hessian, linear = problems(np.random.default_rng(3), 200)
    found = solved(hessian, linear)
    convex = hessian + found.multiplier[:, None, None] * np.eye(3)
    dual = -0.5 * np.einsum("bi,bi->b", linear, np.linalg.solve(convex, linear[..., None])[..., 0])
    dual -= 0.5 * found.multiplier
    np.testing.assert_allclose(found.bound, dual, rtol=1e-9, atol=1e-9)


@given(st.integers(0, 10**6), st.sampled_from([-5.0, 0.0, 5.0]))
def test_no_point_of_the_sphere_is_better(seed, shift):
    rng = np.random.default_rng(seed)
    hessian, linear = problems(rng, 1, shift=shift)
    found = solved(hessian, linear)
    points = rng.standard_normal((2000, 3))
    points[:1000] = found.values + 10.0 ** rng.uniform(-6, 0, (1000, 1)) * points[:1000]
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    slack = 1e-14 * (np.abs(hessian).max() + np.abs(linear).max())
    assert objective(hessian, linear, points).min() >= found.bound[0] - slack


class TestHardCase:
    hessian = np.diag([1.0, 4.0, 9.0])

    def test_two_minimisers(self):
        linear = np.array([0.0, 2.0, 3.0])  # beyond the first axis z = (2/3, 3/8): too short
        found = solved(self.hessian, linear)
        assert not found.unique
        np.testing.assert_allclose(np.abs(found.values), [np.sqrt(1 - 4 / 9 - 9 / 64), 2 / 3, 3 / 8], rtol=1e-13)
        np.testing.assert_allclose(found.mirror, found.values * [-1, 1, 1], rtol=1e-13)
        assert 0 <= found.multiplier + 1 < 1e-13  # H + λI stays definite beyond its rounding
        assert 0 <= found.gap < 1e-13

    def test_long_enough_without_the_first_axis(self):
        found = solved(self.hessian, np.array([0.0, 5.0, 3.0]))
        assert found.unique
        assert abs(found.values[0]) < 1e-15

    def test_either_side_is_told_by_the_smallest_pull(self):
        for pull in (1e-9, -1e-9):
            found = solved(self.hessian, np.array([pull, 2.0, 3.0]))
            assert found.unique
            assert np.sign(found.values[0]) == np.sign(pull)
            assert abs(np.abs(found.values[0]) - np.sqrt(1 - 4 / 9 - 9 / 64)) < 1e-8

    def test_a_pull_within_rounding_tells_nothing(self):
        assert not solved(self.hessian, np.array([1e-16, 2.0, 3.0])).unique
        assert not solved(self.hessian, np.array([1e-6, 2.0, 3.0]), rounding=np.array(1e-5)).unique

    @pytest.mark.parametrize("hessian", [np.zeros((3, 3)), np.eye(3), -np.eye(3)])
    def test_no_pull_at_all(self, hessian):
        found = solved(hessian, np.zeros(3))
        assert not found.unique
        assert abs(np.linalg.norm(found.values) - 1) < 1e-15
        assert 0 <= found.gap < 1e-14

    def test_equal_eigenvalues(self):
        found = solved(np.diag([2.0, 2.0, 7.0]), np.array([3.0, 4.0, 0.0]))
        assert found.unique
        np.testing.assert_allclose(found.values, [0.6, 0.8, 0.0], atol=1e-15)
        assert not solved(np.diag([2.0, 2.0, 7.0]), np.array([0.0, 0.0, 1.0])).unique


def test_extreme_magnitudes():
    rng = np.random.default_rng(4)
    curvature = np.sort(10.0 ** rng.uniform(-12, 12, (2000, 3)), axis=1)
    pull = rng.standard_normal((2000, 3)) * 10.0 ** rng.uniform(-20, 12, (2000, 3))
    found = minimise_on_sphere(curvature, np.broadcast_to(np.eye(3), (2000, 3, 3)), pull, 1e-15 * curvature[:, 0])
    assert np.isfinite(found.values).all()
    assert (found.gap <= 1e-12 * (curvature[:, 2] + np.abs(pull).max(axis=1))).all()
    assert found.unique.mean() > 0.5


def test_small_eigenvalues_keep_their_digits():
    """With the axes known the answer is exact to rounding, however large the other eigenvalues are."""
    n = np.array([0.6, 0.64, 0.48])
    curvature = np.array([1e-10, 1.0, 1e10])
    for multiplier in (0.0, 1e-11, -0.5e-10):
        found = minimise_on_sphere(curvature, np.eye(3), (curvature + multiplier) * n, 1e-20 * np.array(1.0))
        np.testing.assert_allclose(found.values, n, rtol=1e-14)
        np.testing.assert_allclose(found.multiplier, multiplier, atol=1e-24)


def test_a_batch_equals_its_members():
    hessian, linear = problems(np.random.default_rng(5), 12)
    hessian[3], linear[3] = np.diag([1.0, 4.0, 9.0]), [0.0, 2.0, 3.0]
    together = solved(hessian.reshape(3, 4, 3, 3), linear.reshape(3, 4, 3))
    for i in range(12):
        alone = solved(hessian[i], linear[i])
        place = np.unravel_index(i, (3, 4))
        np.testing.assert_allclose(together.values[place], alone.values, rtol=1e-13, atol=1e-15)
        assert together.unique[place] == alone.unique
        assert together.multiplier.shape == (3, 4)
    assert solved(np.empty((0, 3, 3)), np.empty((0, 3))).values.shape == (0, 3)
