"""IPOPT's fits against other routes: scipy on nonlinear loops, the certified convex route on linear ones."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import InputError

symbolic = hx.symbolic
LINEAR = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}
TIGHT = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "x_scale": "jac"}


def lengths(robot, noise, unknown=("platform_point", "base_point", "offset"), n=15, seed=1):
    nominal = robot.perturbed(0.3, offsets=0.3, rng=0)
    data = hx.simulate_leg(robot, 3, "none", n, noise=noise, nominal=nominal, rng=seed)
    return hx.loops.LegLength(data, unknown=unknown)


def spoilt(robot, lock, noise, seed):
    """The direct problem of a locked leg with three bad poses, and its loop."""
    data = hx.simulate_leg(robot, 3, lock, 16, noise=noise, nominal=robot, rng=seed)
    position = np.array(data.position)
    position[:3] += 0.3
    loop = LINEAR[lock](hx.LegMeasurements(position, data.rotation, data.length, lock, noise, data.nominal))
    return loop, loop.linear()


class TestLeastSquares:
    @pytest.mark.parametrize("model", [2, 3, 4])
    @pytest.mark.parametrize("weighted", [False, True])
    def test_it_is_what_scipy_finds(self, model, weighted, left_hand, paper_noise):
        names = ("platform_point", "base_point", "offset", "gain")[:model]
        loop = lengths(left_hand, paper_noise, names)
        start = loop.values(loop.data.nominal)
        weights = loop.linearised(start).whitening().blocks if weighted else np.ones((15, 1, 1))
        found = symbolic.fit(loop, weights=weights if weighted else None)
        root = weights[:, 0, 0]
        expected = least_squares(
            lambda x: root * loop.residual(x)[:, 0], start, lambda x: root[:, None] * loop.jacobian(x)[:, 0], **TIGHT
        )
        assert (found.success, found.status) == (True, "Solve_Succeeded")
        assert found.errors == ()
        assert not found.values.flags.writeable
        assert abs(found.objective / expected.cost - 1) < 1e-10
        covariance = np.linalg.inv(expected.jac.T @ expected.jac) * 2 * expected.cost
        assert (np.abs(found.values - expected.x) < 1e-6 * np.sqrt(np.diag(covariance))).all()

    def test_exact_readings_give_the_truth(self, robot):
        data = hx.simulate_leg(robot, 3, "none", 15, nominal=robot.perturbed(0.02 * robot.size, rng=0), rng=1)
        loop = hx.loops.LegLength(data, unknown=("platform_point", "base_point"))
        found = symbolic.fit(loop)
        assert found.success
        error = np.abs(found.values - loop.values(robot.leg(3))).max() / robot.size
        assert error < 1e-9 if "Rubin" in robot.name else error < 1e-13

    def test_a_prior_counts_as_rows(self, left_hand, paper_noise):
        loop = lengths(left_hand, paper_noise)
        mean = loop.values(loop.data.nominal)
        root = np.diag([1.0, 2.0, 3.0, 0.5, 0.5, 0.5, 4.0])[:5]
        found = symbolic.fit(loop, prior=(mean, root))
        expected = least_squares(lambda x: np.concatenate([loop.residual(x)[:, 0], root @ (x - mean)]), mean, **TIGHT)
        assert found.success
        np.testing.assert_allclose(found.objective, expected.cost, rtol=1e-9)
        np.testing.assert_allclose(found.values, expected.x, atol=1e-6)

    def test_a_direction_of_unit_length(self, left_hand, paper_noise):
        """Against scipy in two angles; the multiplier balances the gradient along the direction."""
        data = hx.simulate_leg(left_hand, 3, "direction", 8, noise=paper_noise, nominal=left_hand, rng=1)
        loop = hx.loops.FixedDirection(data)
        found = symbolic.fit(loop, unit_norm=["direction"])

        def values(y):
            n = [np.sin(y[6]) * np.cos(y[7]), np.sin(y[6]) * np.sin(y[7]), np.cos(y[6])]
            return np.concatenate([y[:6], n])

        start = loop.values(left_hand.leg(3))
        n = start[6:]
        angles = [np.arccos(n[2] / np.linalg.norm(n)), np.arctan2(n[1], n[0])]
        expected = least_squares(
            lambda y: loop.residual(values(y)).ravel(), np.concatenate([start[:6], angles]), **TIGHT
        )
        np.testing.assert_allclose(np.linalg.norm(found.values[6:]), 1.0, rtol=1e-12)
        np.testing.assert_allclose(found.objective, expected.cost, rtol=1e-9)
        np.testing.assert_allclose(found.values, values(expected.x), atol=1e-6)
        gradient = np.einsum("ndp,nd->p", loop.jacobian(found.values), loop.residual(found.values))
        push = 2 * found.multipliers["direction"] * found.values[6:]
        np.testing.assert_allclose(gradient[6:] + push, 0, atol=1e-9)
        assert np.abs(found.multipliers["direction"]) > 1e-6


@pytest.mark.parametrize("lock", LINEAR)
class TestAgainstTheConvexRoute:
    @pytest.mark.parametrize("threshold", [0.5, 1.345, 3.0])
    def test_hubers_loss(self, lock, threshold, left_hand, paper_noise):
        for seed in range(2):
            loop, problem = spoilt(left_hand, lock, paper_noise, seed)
            expected = hx.estimate(problem, hx.ConvexEstimator(loss=hx.Huber(threshold)))
            found = symbolic.fit(loop, weights=problem.whitening().blocks, huber=threshold)
            assert found.success
            np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-10)
            assert (np.abs(found.values - expected.values) < 1e-9 * expected.standard_errors).all()

    def test_bounds_and_their_multipliers(self, lock, left_hand, paper_noise):
        loop, problem = spoilt(left_hand, lock, paper_noise, 0)
        box = hx.Box.around(left_hand.leg(3), 0.002)
        expected = hx.estimate(problem, hx.ConvexEstimator(bounds=box))
        x, main = loop.values(left_hand.leg(3)), loop.parameters.main.size
        reach = np.where(np.arange(x.size) < main, 0.002, np.inf)
        found = symbolic.fit(loop, weights=problem.whitening().blocks, lower=x - reach, upper=x + reach)
        assert found.success
        assert (x - reach <= found.values).all()
        assert (found.values <= x + reach).all()
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-9)
        np.testing.assert_allclose(found.values, expected.values, rtol=0, atol=1e-10)
        force = expected.duals["box"]
        np.testing.assert_allclose(found.multipliers["bounds"], force, atol=1e-6 * np.abs(force).max())
        assert np.abs(force[:main]).max() > 1


class TestFailures:
    def test_bounds_without_a_point_are_infeasible(self, left_hand, paper_noise, capfd):
        loop = hx.loops.FixedDirection(
            hx.simulate_leg(left_hand, 3, "direction", 8, noise=paper_noise, nominal=left_hand, rng=1)
        )
        reach = np.where(np.arange(9) < 6, np.inf, 0.1)  # a unit vector of entries below 0.1
        for ask in (
            lambda: symbolic.fit(loop, lower=-reach, upper=reach, unit_norm=["direction"]),
            lambda: symbolic.maximum_likelihood(loop, lower=-reach, upper=reach),
        ):
            found = ask()
            assert (found.success, found.status) == (False, "Infeasible_Problem_Detected")
            assert np.isnan(found.values).all()
            assert np.isnan(found.objective)
            assert all(np.isnan(errors).all() for errors in found.errors)
        assert capfd.readouterr() == ("", "")

    def test_too_few_iterations(self, left_hand, paper_noise, capfd):
        found = symbolic.fit(lengths(left_hand, paper_noise), max_iterations=1)
        assert (found.success, found.status) == (False, "Maximum_Iterations_Exceeded")
        assert np.isnan(found.values).all()
        assert capfd.readouterr() == ("", "")

    def test_a_start_far_away_ends_at_the_solution_or_admits_it(self, left_hand, paper_noise, capfd):
        loop = lengths(left_hand, paper_noise)
        near = symbolic.fit(loop)
        ends = set()
        for size in (1e2, 1e4, 1e8):
            start = size * np.random.default_rng(0).standard_normal(7)
            for ask, best in ((symbolic.fit, near), (symbolic.maximum_likelihood, symbolic.maximum_likelihood(loop))):
                found = ask(loop, start, max_iterations=60)
                ends.add(found.success)
                if found.success:
                    np.testing.assert_allclose(found.objective, best.objective, rtol=1e-9)
                else:
                    assert np.isnan(found.values).all()
        assert ends == {True, False}
        assert capfd.readouterr() == ("", "")

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"weights": np.ones((4, 1, 1))}, "weights: 4 blocks of 1 rows do not fit 15 rows"),
            ({"weights": np.ones((15, 1, 2))}, "weights: expected square blocks"),
            ({"huber": 0.0}, "huber: expected a threshold > 0, got 0.0"),
            ({"huber": "a"}, "huber: expected numbers, got 'a'"),
            ({"max_iterations": -1}, "max_iterations: expected a whole number >= 1, got -1"),
            ({"max_iterations": 2.5}, "max_iterations: expected a whole number >= 1, got 2.5"),
            ({"lower": "a"}, "lower: expected 7 values"),
            ({"prior": 3}, "prior: expected a pair of mean and root, got 3"),
            ({"prior": (1, 2, 3)}, "prior: expected a pair of mean and root"),
            ({"unit_norm": "base_point"}, "unit_norm: expected names of blocks"),
            ({"unit_norm": 3}, "unit_norm: expected names of blocks"),
            ({"start": "a"}, "start: expected numbers, got 'a'"),
            ({"lower": np.zeros(3)}, "lower: expected 7 values"),
            ({"upper": np.full(7, -np.inf)}, "upper: expected 7 values"),
            ({"lower": np.ones(7), "upper": np.zeros(7)}, r"lower is above upper for platform_point.x, platform_po"),
            ({"prior": (np.zeros(3), np.eye(7))}, r"prior mean: expected shape \(7\)"),
            ({"unit_norm": ["direction"]}, "unknown parameter 'direction'"),
            ({"start": np.zeros(4)}, "values: expected 7"),
        ],
    )
    def test_wrong_arguments(self, arguments, message, left_hand, paper_noise, capfd):
        with pytest.raises(InputError, match=message):
            symbolic.fit(lengths(left_hand, paper_noise), **arguments)
        assert capfd.readouterr() == ("", "")

    def test_a_robot_is_a_start(self, left_hand):
        loop = hx.loops.LegLength(hx.simulate_leg(left_hand, 3, "none", 10, nominal=left_hand, rng=1))
        found = [symbolic.fit(loop, start) for start in (left_hand, left_hand.leg(3))]
        np.testing.assert_array_equal(found[0].values, found[1].values)
        with pytest.raises(InputError, match="leg 3 was measured, and leg 5 is given"):
            symbolic.fit(loop, left_hand.leg(5))

    def test_a_batch_is_taken_set_by_set(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "none", 10, 2, nominal=left_hand, rng=1)
        with pytest.raises(InputError, match=r"expected one problem, got a batch of \(2,\); take one set: data\[i\]"):
            symbolic.fit(hx.loops.LegLength(data))
        assert symbolic.fit(hx.loops.LegLength(data[1])).success
        with pytest.raises(InputError, match=r"expected one problem, got a batch of \(2,\)"):
            symbolic.fit(hx.loops.LegLength(data[0], unknown=("base_point",), offset=[15.0, 16.0]))

    def test_no_start(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "none", 10, nominal=left_hand, rng=1)
        bare = hx.LegMeasurements(data.position, data.rotation, data.length, "none")
        with pytest.raises(InputError, match="needs an initial guess"):
            symbolic.fit(hx.loops.LegLength(bare, gain=1.0))
