"""The criterion G: its rows by differences of the geometry, its value from the covariance, its relaxation by cvxpy."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, UnitError
from hexopt.information import PoseInformation, pose_information
from hexopt.selection.feasible import Feasible
from hexopt.selection.objective import Objective
from hexopt.selection.prediction import GOptimal
from hexopt.selection.reference import relaxed_by_cvxpy
from hexopt.selection.relaxation import relax

NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
ROBOT = hx.robots.left_hand()
BLOCKS = ("platform_point", "base_point", "offset", "gain")


def leg_loop(n_poses=60, unknown=BLOCKS, lock="none", nominal=None):
    data = hx.simulate_leg(ROBOT, 3, lock, n_poses, noise=NOISE, nominal=nominal, rng=1)
    return hx.loops.LegLength(data, unknown=unknown)


def bound_on(loop, task, at=None, **options):
    return GOptimal(task).on(loop, at, pose_information(loop, at=at, **options))


def misclosure(leg, position, rotation, reading):
    """The leg-length equation, written out."""
    return np.linalg.norm(position + rotation @ leg.platform_point - leg.base_point, axis=-1) - leg.true_length(reading)


# --- rows


def test_rows_are_derivatives_of_the_leg_length(central_difference):
    task = hx.simulate(ROBOT, n_poses=5, rng=0)
    leg = ROBOT.perturbed(0.3, rng=4).leg(3)
    rows = bound_on(leg_loop(), task, at=leg).rows
    exact = leg.reading(np.linalg.norm(task.position + task.rotation @ leg.platform_point - leg.base_point, axis=-1))

    def moved(x):
        other = leg.replaced(platform_point=x[:3], base_point=x[3:6], offset=x[6], gain=x[7])
        return misclosure(other, task.position, task.rotation, exact)

    x = np.concatenate([leg.block(name) for name in BLOCKS])
    np.testing.assert_allclose(rows[0], central_difference(moved, x), atol=1e-9)


def test_by_hand():
    """A leg that stands upright: its length errs by what b and a err by upwards, and by the offset."""
    leg = hx.Leg(3, platform_point=[0, 0, 0], base_point=[0, 0, 0], offset=1.0)
    task = hx.LegMeasurements([[0, 0, 10.0]], np.eye(3)[None], None, "none", None, leg)
    data = hx.simulate_leg(ROBOT, 3, "none", 20, noise=NOISE, nominal=leg, rng=1)
    criterion = bound_on(hx.loops.LegLength(data, unknown=BLOCKS), task)
    np.testing.assert_allclose(criterion.rows, [[[0, 0, 1, 0, 0, -1, -1, -9]]], atol=1e-12)
    covariance = np.diag([1.0, 2, 3, 4, 5, 6, 7, 8])
    np.testing.assert_allclose(criterion.value(covariance), 3 + 6 + 7 + 81 * 8)


def test_a_robot_has_a_row_for_each_leg_of_a_pose():
    task = hx.simulate(ROBOT, n_poses=4, rng=0)
    loop = hx.loops.WholeRobot(hx.simulate(ROBOT, n_poses=20, noise=NOISE, rng=1))
    rows = bound_on(loop, task).rows
    assert rows.shape == (1, 24, 42)
    for k in range(6):
        own = rows[0, 4 * k : 4 * k + 4]
        assert not np.delete(own, np.s_[7 * k : 7 * k + 7], axis=1).any()
        one = hx.loops.LegLength(loop.sets[0].leg(k + 1))
        np.testing.assert_allclose(own[:, 7 * k : 7 * k + 7], bound_on(one, task).rows[0], atol=1e-12)


def test_only_what_is_of_interest_counts():
    task = hx.simulate(ROBOT, n_poses=4, rng=0)
    loop = hx.loops.WholeRobot(hx.simulate(ROBOT, n_poses=20, noise=NOISE, rng=1))
    every, some = bound_on(loop, task).rows, bound_on(loop, task, of=["leg2.offset", "leg2.base_point"]).rows
    assert some.shape == (1, 4, 4)
    np.testing.assert_array_equal(some[0], every[0, 4:8, 10:14])


@pytest.mark.parametrize(
    ("lock", "loop", "names"),
    [
        ("direction", hx.loops.FixedDirection, ("platform_point", "base_point")),
        ("leg", hx.loops.FixedLeg, ("platform_point",)),
        ("length", hx.loops.ReadLength, ("platform_point", "base_point", "offset")),
    ],
)
def test_under_every_lock(lock, loop, names):
    task = hx.simulate(ROBOT, n_poses=4, rng=0)
    data = hx.simulate_leg(ROBOT, 3, lock, 30, noise=NOISE, rng=1)
    made = loop(data)
    rows = bound_on(made, task).rows
    expected = bound_on(leg_loop(unknown=tuple(n for n in names if n in made.parameters)), task).rows
    np.testing.assert_allclose(rows, expected, atol=1e-12)


def test_the_spread_is_only_a_unit():
    task = hx.simulate(ROBOT, n_poses=10, rng=0)
    loop = leg_loop()
    values = []
    for spread in (None, {"offset": 0.01, "platform_point": 7.0}):
        information = pose_information(loop, spread=spread)
        objective = Objective(information, GOptimal(task).on(loop, None, information))
        values.append(objective.value(np.ones(60)))
    assert values[0] == pytest.approx(values[1], rel=1e-9)


def test_value_is_the_worst_predicted_variance():
    task = hx.simulate(ROBOT, n_poses=10, rng=0)
    loop = leg_loop()
    information = pose_information(loop)
    objective = Objective(information, GOptimal(task).on(loop, None, information))
    jacobian = hx.loops.LegLength(task.leg(3), unknown=BLOCKS).jacobian(ROBOT.leg(3))[:, 0]
    variances = np.diag(jacobian @ loop.crlb(ROBOT.leg(3)) @ jacobian.T)
    assert objective.value(np.ones(60)) == pytest.approx(variances.max(), rel=1e-8)


def test_slopes_are_its_derivatives(central_difference):
    rng = np.random.default_rng(0)
    criterion = GOptimal(hx.simulate(ROBOT, n_poses=3, rng=0), rng.normal(size=(1, 3, 2)))
    covariance = np.array([[[2.0, 0.5], [0.5, 1.0]]])
    slopes = central_difference(lambda c: criterion.pieces(c)[0], covariance)
    np.testing.assert_allclose(criterion.slopes(covariance)[0], slopes.reshape(3, 2, 2), atol=1e-9)


def test_no_information_is_an_infinite_error():
    criterion = GOptimal(hx.simulate(ROBOT, n_poses=3, rng=0), np.array([[[1.0, 0.0], [1.0, 2.0]]]))
    covariance = np.stack([np.diag([np.inf, np.inf]), np.eye(2)])[:, None]
    np.testing.assert_array_equal(criterion.pieces(covariance), [[[np.inf, np.inf]], [[1.0, 5.0]]])


# --- the relaxation


@pytest.mark.parametrize("cap", [1, 9])
@pytest.mark.parametrize(("scenarios", "worst"), [(1, False), (2, False), (2, True)])
def test_relaxation_agrees_with_cvxpy(cap, scenarios, worst):
    task = hx.simulate(ROBOT, n_poses=8, rng=0)
    loop = leg_loop(40, unknown=("platform_point", "base_point", "offset"))
    at = [ROBOT.perturbed(0.3, rng=k) for k in range(scenarios)]
    information = pose_information(loop, at=at)
    criterion = GOptimal(task).on(loop, at, information)
    assert criterion.rows.shape == (scenarios, 8, 7)
    objective = Objective(information, criterion, worst)
    feasible = Feasible(np.full(40, float(cap)), np.ones(40), 9.0)
    found = relax(objective, feasible)
    assert found.ok
    assert found.value == pytest.approx(relaxed_by_cvxpy(objective, feasible), rel=3e-6)


def test_it_is_better_over_its_task_than_other_designs():
    task = hx.simulate(ROBOT, n_poses=50, rng=0)
    loop = leg_loop(300, unknown=("platform_point", "base_point", "offset"))
    information = pose_information(loop)
    objective = Objective(information, GOptimal(task).on(loop, None, information))
    feasible = Feasible(np.ones(300), np.ones(300), 12.0)
    found = relax(objective, feasible)
    other = relax(Objective(information, hx.AOptimal()), feasible)
    assert found.value < 0.95 * objective.value(other.weights)


# --- what cannot be


def test_a_task_is_one_set_of_poses():
    with pytest.raises(InputError, match="task: expected Measurements or LegMeasurements, got"):
        GOptimal("everywhere")
    with pytest.raises(InputError, match="expected one set of poses, got a batch of"):
        GOptimal(hx.simulate(ROBOT, n_poses=3, n_sets=2, rng=0))


def test_it_needs_a_loop_with_a_nominal_in_the_same_unit():
    task = GOptimal(hx.simulate(ROBOT, n_poses=3, rng=0))
    loop = leg_loop()
    information = pose_information(loop)
    with pytest.raises(InputError, match="GOptimal needs a loop"):
        task.on(information, None, information)
    with pytest.raises(UnitError, match="task: in mm, but the candidates are in cm"):
        GOptimal(hx.simulate(hx.robots.jugglebot(), n_poses=3, rng=0)).on(loop, None, information)
    data = hx.LegMeasurements(loop.data.position, loop.data.rotation, loop.data.length, "none", NOISE, None, "cm")
    bare = hx.loops.LegLength(data, unknown=BLOCKS, platform_point=None)
    with pytest.raises(InputError, match="the candidates need a nominal leg"):
        task.on(bare, ROBOT.leg(3), information)


def test_without_rows_it_has_no_value():
    task = GOptimal(hx.simulate(ROBOT, n_poses=3, rng=0))
    with pytest.raises(InputError, match=r"GOptimal has no rows yet: write GOptimal\(task\)\.on"):
        task.value(np.eye(2))


def test_the_information_may_be_of_other_coordinates():
    """Rows follow the labels of the information, in their order."""
    task = hx.simulate(ROBOT, n_poses=3, rng=0)
    loop = leg_loop()
    information = pose_information(loop)
    turned = PoseInformation(
        information.blocks, information.fixed, information.labels[::-1], information.units, 2 * information.spread
    )
    rows = GOptimal(task).on(loop, None, turned).rows
    np.testing.assert_allclose(rows, 2 * bound_on(loop, task).rows[..., ::-1])
