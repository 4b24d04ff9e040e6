"""The paper's equations (5), (10), (15) and (19), transcribed here row by row, against the library's."""

import numpy as np
import pytest

import hexopt as hx


def measured(robot, lock, n, noise=None, seed=0):
    return hx.simulate_leg(robot, 3, lock, n, noise=noise, rng=seed)


def equation_5(data, length, sign=+1):
    """Rows i = 1…N−1 of (5); sign −1 is the column of a as printed, which is the erratum."""
    matrix, rhs = [], []
    for i in range(data.n_poses - 1):
        p1, p2 = data.position[i], data.position[i + 1]
        r1, r2 = data.rotation[i], data.rotation[i + 1]
        rho1, rho2 = length[i], length[i + 1]
        for axis in range(3):
            column_b = [rho1 * r2[axis, j] - rho2 * r1[axis, j] for j in range(3)]
            column_a = [sign * (rho2 - rho1) if j == axis else 0.0 for j in range(3)]
            matrix.append(column_b + column_a)
            rhs.append(rho2 * p1[axis] - rho1 * p2[axis])
    return np.array(matrix), np.array(rhs)


def equation_10(data):
    matrix, rhs = [], []
    for i in range(data.n_poses - 1):
        for axis in range(3):
            matrix.append([data.rotation[i + 1][axis, j] - data.rotation[i][axis, j] for j in range(3)])
            rhs.append(data.position[i][axis] - data.position[i + 1][axis])
    return np.array(matrix), np.array(rhs)


def equation_15(data, b):
    matrix, rhs = [], []
    for i in range(data.n_poses - 1):
        v1 = data.position[i] + data.rotation[i] @ b
        v2 = data.position[i + 1] + data.rotation[i + 1] @ b
        matrix.append(v2 - v1)
        rhs.append(0.5 * (v2 @ v2 - v1 @ v1))
    return np.array(matrix), np.array(rhs)


@pytest.fixture(params=[None, "noisy"])
def noise(request, paper_noise):
    return paper_noise if request.param else None


class TestTypeI:
    def test_consecutive_rows_are_equation_5_with_the_sign_corrected(self, robot, noise):
        data = measured(robot, "direction", 7, noise)
        problem = hx.loops.FixedDirection(data).linear("consecutive")
        matrix, rhs = equation_5(data, robot.leg(3).true_length(data.length))
        scale = np.abs(data.length).max() * robot.gains[2] + abs(robot.offsets[2])
        np.testing.assert_allclose(problem.matrix, matrix, atol=1e-14 * scale)
        np.testing.assert_allclose(problem.rhs, rhs, atol=1e-14 * scale * robot.size)

    def test_the_printed_sign_returns_minus_a(self, left_hand, noise):
        """The erratum: b and the condition number do not notice, so no check of them can see it."""
        data = measured(left_hand, "direction", 7, noise)
        length = left_hand.leg(3).true_length(data.length)
        right, wrong = equation_5(data, length), equation_5(data, length, sign=-1)
        x = np.linalg.lstsq(*right)[0]
        printed = np.linalg.lstsq(*wrong)[0]
        np.testing.assert_allclose(printed[:3], x[:3], atol=1e-9)
        np.testing.assert_allclose(printed[3:], -x[3:], atol=1e-9)
        np.testing.assert_allclose(np.linalg.cond(wrong[0]), np.linalg.cond(right[0]), rtol=1e-12)
        found = hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), hx.LeastSquares())
        np.testing.assert_allclose(found.values, x, atol=1e-9)
        assert np.linalg.norm(found.params["base_point"] - left_hand.base_points[2]) < 2.0
        assert np.linalg.norm(printed[3:] - left_hand.base_points[2]) > 20.0

    def test_equation_7_is_the_normal_equations(self, left_hand, paper_noise):
        data = measured(left_hand, "direction", 12, paper_noise)
        m, n = equation_5(data, left_hand.leg(3).true_length(data.length))
        expected = np.linalg.inv(m.T @ m) @ m.T @ n
        loop = hx.loops.FixedDirection(data)
        found = hx.estimate(loop.linear("consecutive"), hx.LeastSquares(method="normal"))
        np.testing.assert_allclose(found.values, expected, rtol=1e-9)


class TestTypeII:
    def test_consecutive_rows_are_equation_10(self, robot, noise):
        data = measured(robot, "leg", 6, noise)
        problem = hx.loops.FixedLeg(data).linear("consecutive")
        matrix, rhs = equation_10(data)
        np.testing.assert_allclose(problem.matrix, matrix, atol=1e-15)
        np.testing.assert_allclose(problem.rhs, rhs, atol=1e-15 * robot.size)

    def test_each_block_has_rank_two(self, left_hand):
        matrix = hx.loops.FixedLeg(measured(left_hand, "leg", 6)).linear("consecutive").matrix
        for block in matrix.reshape(5, 3, 3):
            assert np.linalg.matrix_rank(block, tol=1e-12) == 2


class TestTypeIII:
    def test_consecutive_rows_are_equation_15(self, robot, noise):
        data = measured(robot, "length", 6, noise)
        b = robot.leg(3).platform_point
        problem = hx.loops.FixedLength(data, platform_point=b).linear("consecutive")
        matrix, rhs = equation_15(data, b)
        np.testing.assert_allclose(problem.matrix, matrix, atol=4e-15 * robot.size)
        np.testing.assert_allclose(problem.rhs, rhs, atol=4e-15 * robot.size**2)

    def test_the_origin_changes_no_solution(self, left_hand, noise):
        data = measured(left_hand, "length", 8, noise)
        b = left_hand.leg(3).platform_point
        points = data.position + data.rotation @ b
        plain = np.linalg.lstsq(np.column_stack([points, np.ones(8)]), 0.5 * (points**2).sum(axis=1))[0]
        found = hx.estimate(hx.loops.FixedLength(data, platform_point=b).linear(), hx.LeastSquares())
        np.testing.assert_allclose(found.params["base_point"], plain[:3], atol=1e-9)


class TestOffset:
    @pytest.mark.parametrize("n", [1, 2, 9])
    def test_it_is_the_mean_of_equation_19(self, robot, noise, n):
        leg = robot.leg(3)
        data = measured(robot, "none", n, noise)
        each = [
            np.linalg.norm(data.position[i] + data.rotation[i] @ leg.platform_point - leg.base_point)
            - leg.gain * data.length[i]
            for i in range(n)
        ]
        loop = hx.loops.LegLength(
            data, unknown=("offset",), platform_point=leg.platform_point, base_point=leg.base_point
        )
        found = hx.estimate(loop.linear(), hx.LeastSquares())
        np.testing.assert_allclose(found.values, [np.mean(each)], atol=1e-14 * robot.size)

    def test_offset_and_gain_are_a_straight_line(self, left_hand, paper_noise):
        data = measured(left_hand, "none", 9, paper_noise)
        leg = left_hand.leg(3)
        true = np.linalg.norm(data.position + data.rotation @ leg.platform_point - leg.base_point, axis=1)
        slope, level = np.polyfit(data.length, true, 1)
        found = hx.estimate(hx.loops.LegLength(data, unknown=("gain", "offset")).linear(), hx.LeastSquares())
        np.testing.assert_allclose(found.values, [level, slope], rtol=1e-10)


def test_a_wrong_offset_moves_a_by_its_error_along_the_direction(left_hand):
    """METHODS 2: one DIRECTION set sees a + δ n alone."""
    data = measured(left_hand, "direction", 8)
    leg = left_hand.leg(3)
    vectors = data.position + data.rotation @ leg.platform_point - leg.base_point
    direction = vectors[0] / np.linalg.norm(vectors[0])
    for form in ("direct", "consecutive"):
        wrong = hx.loops.FixedDirection(data, offset=leg.offset + 0.1).linear(form)
        found = hx.estimate(wrong, hx.LeastSquares())
        np.testing.assert_allclose(found.params["base_point"], leg.base_point - 0.1 * direction, atol=1e-11)
        np.testing.assert_allclose(found.params["platform_point"], leg.platform_point, atol=1e-11)


def test_a_wrong_gain_shows_in_the_length_of_the_direction(left_hand):
    data = measured(left_hand, "direction", 8)
    found = hx.estimate(hx.loops.FixedDirection(data, gain=1.25).linear(), hx.LeastSquares())
    np.testing.assert_allclose(np.linalg.norm(found.params["direction"]), 1 / 1.25, rtol=1e-10)
