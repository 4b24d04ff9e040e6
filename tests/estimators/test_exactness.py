"""Without noise every linear method is exact: each form, each leg of each built-in robot, from the fewest poses.

The bound: error ≤ 100·eps·κ relative to the robot's size on *every* set, and ≤ 1e-9 wherever κ ≤ 1e4, where κ is
`Estimate.condition`: that of the column-scaled matrix, times what a form's differences lost by cancellation (without
this factor the bound holds for no algorithm: see `test_difference_forms_cannot_do_better`). Normal equations keep it,
or warn.
"""

import warnings
from fractions import Fraction

import numpy as np
import pytest

import hexopt as hx
from hexopt.robots import BUILT_IN

EPS = np.finfo(float).eps
LOOPS = {
    "FixedDirection": ("direction", 3, ("direct", "consecutive")),
    "FixedLeg": ("leg", 3, ("direct", "consecutive", "centred")),
    "FixedLength": ("length", 4, ("direct", "consecutive", "centred")),
    "LegLength": ("none", 1, ("direct",)),
}
CASES = [(name, form) for name, (_, _, forms) in LOOPS.items() for form in forms]


def simulated(robot, leg, name, extra, n_sets):
    lock, minimum, _ = LOOPS[name]
    # a nominal that is far off, but for what is known: nothing may leak from it
    nominal = robot.perturbed(0.1 * robot.size, rng=leg)
    return hx.simulate_leg(robot, leg, lock, minimum + extra, n_sets, nominal=nominal, rng=1000 * leg + extra)


def loop_of(robot, leg, name, extra, n_sets):
    data, truth = simulated(robot, leg, name, extra, n_sets), robot.leg(leg)
    known = {}
    if name == "FixedLength":
        known = {"platform_point": truth.platform_point}
    if name == "LegLength":
        known = {
            "unknown": ("offset",),
            "platform_point": truth.platform_point,
            "base_point": truth.base_point,
        }
    return getattr(hx.loops, name)(data, **known)


def relative_error(found, robot, leg):
    return np.max(list(found.error(robot.leg(leg)).values()), axis=0) / robot.size


def worst(robot, leg, name, form, extra, n_sets, estimator):
    found = hx.estimate(loop_of(robot, leg, name, extra, n_sets).linear(form), estimator)
    return relative_error(found, robot, leg), found


def check(error, found):
    assert found.ok.all()
    ratio = error / (EPS * found.condition)
    assert ratio.max() <= 100, f"error is {ratio.max():.0f}·eps·κ at κ = {found.condition[ratio.argmax()]:.1e}"
    assert error[found.condition <= 1e4].max(initial=0.0) <= 1e-9


@pytest.mark.parametrize("method", ["auto", "svd"])
@pytest.mark.parametrize(("name", "form"), CASES)
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_every_leg_from_the_fewest_poses(robot, name, form, method):
    model = BUILT_IN[robot]()
    for leg in range(1, 7):
        for extra in (0, 1, 4):
            check(*worst(model, leg, name, form, extra, 100, hx.LeastSquares(method=method, covariance=False)))


@pytest.mark.parametrize("method", ["auto", "svd"])
@pytest.mark.parametrize(("name", "form"), CASES)
def test_a_thousand_sets_of_the_left_hand(left_hand, name, form, method):
    for leg in range(1, 7):
        for extra in (0, 1, 4, 20):
            check(*worst(left_hand, leg, name, form, extra, 1000, hx.LeastSquares(method=method, covariance=False)))


@pytest.mark.parametrize(("name", "form"), CASES)
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_normal_equations_keep_the_bound_or_warn(robot, name, form):
    model = BUILT_IN[robot]()
    for leg in range(1, 7):
        for extra in (0, 1, 4):
            problem = loop_of(model, leg, name, extra, 100).linear(form)
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                found = hx.estimate(problem, hx.LeastSquares(method="normal", covariance=False))
            error = relative_error(found, model, leg)
            kept = error <= 100 * EPS * found.condition
            kept &= (error <= 1e-9) | (found.condition > 1e4)
            assert kept.all() or [w.category for w in caught] == [hx.NumericalWarning]
            # the warning names every set that lost digits, or the set says itself that it failed
            own = found.condition / problem.worst_cancellation
            assert (kept | (own**2 > 100 * found.condition) | ~found.ok).all()


def test_normal_equations_that_are_fine_do_not_warn(left_hand):
    found = hx.estimate(loop_of(left_hand, 3, "FixedLeg", 10, 50).linear(), hx.LeastSquares(method="normal"))
    assert found.condition.max() < 100


@pytest.mark.parametrize("weights", [None, "model"])
@pytest.mark.parametrize(("name", "form"), CASES)
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_weighted_estimates_of_exact_data_are_exact(robot, name, form, weights):
    """Exact readings with an assumed noise: weights change which rows count, and exact rows agree anyway."""
    model = BUILT_IN[robot]()
    size = model.size
    noise = hx.UniformNoise(1e-3 * size, 1e-3, 1e-3 * size / model.gains[2])
    data = simulated(model, 3, name, 4, 100)
    told = hx.LegMeasurements(data.position, data.rotation, data.length, data.lock, noise, data.nominal)
    truth = model.leg(3)
    known = {}
    if name == "FixedLength":
        known = {"platform_point": truth.platform_point}
    if name == "LegLength":
        known = {"unknown": "offset", "platform_point": truth.platform_point, "base_point": truth.base_point}
    found = hx.estimate(getattr(hx.loops, name)(told, **known).linear(form), hx.LeastSquares(weights=weights))
    error = relative_error(found, model, 3)
    assert found.ok.all()
    assert (error <= 100 * EPS * found.condition).all()


def test_convex_estimates_are_exact_to_the_solvers_tolerance(left_hand):
    for name, form in CASES:
        error, found = worst(left_hand, 3, name, form, 4, 5, hx.ConvexEstimator(weights=None))
        assert found.ok.all()
        assert error.max() < 1e-6


def exact_solution(data, length):
    """Least squares of the consecutive rows in rational arithmetic: what the rounded *data* say."""

    def fractions(array):
        return [[Fraction(float(v)) for v in row] for row in array]

    position, rotation = fractions(data.position), [fractions(r) for r in data.rotation]
    rows = []
    for i in range(data.n_poses - 1):
        for k in range(3):
            a = [length[i] * rotation[i + 1][k][j] - length[i + 1] * rotation[i][k][j] for j in range(3)]
            rows.append([*a, length[i + 1] * position[i][k] - length[i] * position[i + 1][k]])
    gram = [[sum(row[i] * row[j] for row in rows) for j in range(4)] for i in range(3)]
    for i in range(3):
        for k in range(3):
            if k != i:
                factor = gram[k][i] / gram[i][i]
                gram[k] = [p - factor * q for p, q in zip(gram[k], gram[i], strict=True)]
    return np.array([float(gram[i][3] / gram[i][i]) for i in range(3)])


def test_difference_forms_cannot_do_better():
    """Rubin's rotations of 0.25° leave R₂ − R₁ with two digits less than R: where κ of the differenced matrix alone
    is 2, even rational arithmetic on the (rounded) poses is off by more than 100·eps·κ. The data ask for the factor."""
    robot = hx.robots.rubin()
    data = hx.simulate_leg(robot, 3, "leg", 3, 2000, rng=5)
    loop = hx.loops.FixedLeg(data)
    problem = loop.linear("consecutive")
    found = hx.estimate(problem, hx.LeastSquares(method="svd"))
    own = found.condition / problem.worst_cancellation
    error = relative_error(found, robot, 3)
    beyond = np.flatnonzero(error > 100 * EPS * own)
    assert len(beyond) > 10
    for i in beyond[:5]:
        exact = exact_solution(data[i], [Fraction(1)] * 3)
        unavoidable = np.linalg.norm(exact - robot.platform_points[2]) / robot.size
        assert unavoidable > 50 * EPS * own[i]
        assert unavoidable > 0.5 * error[i]
    direct = hx.estimate(loop.linear("direct"), hx.LeastSquares(method="svd")).condition
    assert (found.condition > 0.02 * direct).all()
    assert (found.condition < 2 * direct).all()


# --- three steps in a row ----------------------------------------------------------------------------


@pytest.mark.parametrize("form", ["direct", "consecutive", "centred"])
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_three_steps(robot, form):
    """The error of b enters step two as an error of its matrix: κ of both steps multiply. The offset sees both."""
    model = BUILT_IN[robot]()
    for leg in range(1, 7):
        for extra in (0, 1, 4):
            nominal = model.perturbed(0.1 * model.size, rng=leg)
            sets = {
                hx.Lock(lock): hx.simulate_leg(model, leg, lock, n + extra, 60, nominal=nominal, rng=leg)
                for lock, n in (("leg", 3), ("length", 4))
            }
            result = hx.ThreeStep(form=form).calibrate_leg(sets)
            steps, truth = result.steps, model.leg(leg)
            assert all(step.ok.all() for step in steps.values())
            b, a = steps["platform_point"], steps["base_point"]
            error_b = relative_error(b, model, leg)
            assert (error_b <= 100 * EPS * b.condition).all()
            together = b.condition * a.condition
            error_a = relative_error(a, model, leg)
            assert (error_a <= 100 * EPS * together).all()
            assert (error_a[together <= 1e4] <= 1e-9).all()
            error_offset = np.abs(result.leg.offset - truth.offset) / model.size
            assert (error_offset <= 100 * EPS * together).all()


@pytest.mark.parametrize("form", ["direct", "consecutive"])
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_one_step(robot, form):
    model = BUILT_IN[robot]()
    for leg in range(1, 7):
        nominal = model.perturbed(0.1 * model.size, rng=leg)
        data = hx.simulate_leg(model, leg, "direction", 3, 60, nominal=nominal, rng=leg)
        result = hx.OneStep(form=form).calibrate_leg({hx.Lock.DIRECTION: data})
        truth, kappa = model.leg(leg), result.steps["direction"].condition
        for name in ("base_point", "platform_point"):
            error = np.linalg.norm(getattr(result.leg, name) - getattr(truth, name), axis=-1) / model.size
            assert (error <= 100 * EPS * kappa).all()
        np.testing.assert_array_equal(result.leg.offset, truth.offset)
