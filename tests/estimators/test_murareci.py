"""Equal joint angles over two locked directions: exact, as scipy finds them; one direction is not enough."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError
from hexopt.estimators.murareci import _Angles, _angles, _axes
from hexopt.loops import FixedDirection, FixedLeg, Sets
from hexopt.rotations import rotation_vector_to_matrix
from hexopt.testing import check_estimator

BOTH = ("platform_point", "base_point")
EPS = np.finfo(float).eps


def simulated(robot, n=6, n_sets=200, *, leg=3, directions=2, noise=None, seed=0):
    """Sets of several locked directions, and a nominal that is 0.5 cm off, scaled to the robot."""
    nominal = robot.perturbed(0.5 * robot.size / hx.robots.left_hand().size, rng=leg)
    return [
        hx.simulate_leg(robot, leg, "direction", n, n_sets, noise=noise, nominal=nominal, rng=seed + k)
        for k in range(directions)
    ]


def loop_of(parts):
    return Sets(*map(FixedDirection, parts))


def turned(data):
    """The same leg in another direction, from the measurements of the Left Hand's leg 3."""
    truth = hx.robots.left_hand().leg(3)
    base_point = truth.base_point * (10 if data.length_unit == "mm" else 1)
    turn = rotation_vector_to_matrix([0.5, -0.3, 0.2])
    return replace(data, position=base_point + (data.position - base_point) @ turn.T, rotation=turn @ data.rotation)


def apart(n, n_sets, noise):
    """Two sets of the Left Hand whose directions are half a radian apart, each with errors of its own."""
    (both,) = simulated(hx.robots.left_hand(), 2 * n, n_sets, directions=1)
    rng, parts = np.random.default_rng(0), []
    for part in (both.poses(range(n)), turned(both.poses(range(n, 2 * n)))):
        position, rotation, length = noise.apply(part.position, part.rotation, part.length, rng)
        parts.append(replace(part, position=position, rotation=rotation, length=length, noise=noise))
    return parts


@pytest.mark.parametrize("n", [3, 6])
def test_exact_without_noise(robot, n):
    for leg in range(1, 7):
        found = hx.estimate(loop_of(simulated(robot, n, leg=leg)), hx.Murareci())
        assert found.ok.mean() >= 0.99
        assert np.isnan(found.values[~found.ok]).all()
        error = np.max(list(found.error(robot.leg(leg)).values()), axis=0) / robot.size
        assert (error <= 100 * EPS * found.condition)[found.ok].all()


def test_it_is_what_scipy_finds(paper_noise):
    """About the same axes, with the angles written out: sin β along e1, tan α in the plane of e2 and e3."""
    parts = apart(8, 6, paper_noise)
    found = hx.estimate(loop_of(parts), hx.Murareci())
    assert found.parameters.names == BOTH
    assert found.covariance_kind == "sandwich"
    assert found.degrees_of_freedom == 2 * (8 + 8 - 2) - 6
    start = np.concatenate([parts[0].nominal.block(name) for name in BOTH])

    def vectors(x, data, i):
        return data.position[i] + data.rotation[i] @ x[:3] - x[3:]

    for i in range(6):
        axes = [_axes(vectors(start, data, i))[0] for data in parts]

        def changes(x, i=i, axes=axes):
            rows = []
            for data, frame in zip(parts, axes, strict=True):
                local = vectors(x, data, i) @ frame.T
                local /= np.linalg.norm(local, axis=-1)[:, None]
                angles = np.stack([np.arctan(-local[:, 1] / local[:, 2]), np.arcsin(local[:, 0])], axis=-1)
                rows.append((angles[1:] - angles[0]).ravel())
            return np.concatenate(rows)

        expected = least_squares(changes, start, "3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale="jac")
        np.testing.assert_allclose(found.values[i], expected.x, atol=1e-6 * found.standard_errors[i].max())
        assert found.objective[i] == pytest.approx(expected.cost, rel=1e-6)


def test_the_angles_are_those_of_the_joint(central_difference):
    """Turning e3 by α about e1, then by β about the turned e2, gives the direction; and the derivatives are exact."""
    rng = np.random.default_rng(0)
    mean = rng.normal(size=3)
    vectors = 5 * (mean / np.linalg.norm(mean) + 0.4 * rng.normal(size=(20, 3)))
    axes = _axes(vectors)
    e1, e2, e3 = axes[0]
    angles, derivative = _angles(vectors, axes)
    handed = np.linalg.det(axes[0])
    for vector, (alpha, beta) in zip(vectors, angles, strict=True):
        first = rotation_vector_to_matrix(handed * alpha * e1)
        both = rotation_vector_to_matrix(handed * beta * (first @ e2)) @ first
        np.testing.assert_allclose(both @ e3, vector / np.linalg.norm(vector), atol=1e-12)
    numeric = central_difference(lambda x: _angles(x[None], axes)[0][0], vectors[3])
    np.testing.assert_allclose(derivative[3], numeric, atol=1e-9)


def assert_covers(found, leg):
    """In the mean e'C⁻¹e/p is 1."""
    assert found.ok.all()
    error = found.values - np.concatenate([leg.block(name) for name in BOTH])
    square = np.einsum("ni,ni->n", error, np.linalg.solve(found.covariance, error[..., None])[..., 0]) / 6
    assert abs(square.mean() - 1) < 5 * square.std() / np.sqrt(square.size)


def test_the_covariance_is_that_of_the_errors(left_hand, small_noise):
    assert_covers(hx.estimate(loop_of(apart(7, 2000, small_noise)), hx.Murareci()), left_hand.leg(3))


def test_a_common_error_is_carried(left_hand):
    """What is common to the poses of a set moves a, and each set has its own."""
    own = {"position": 1e-4, "angle": 1e-6, "length": 1e-4, "coordinates": "rotation_vector"}
    parts = apart(7, 1500, hx.NormalNoise(**own, common_covariance=np.diag([1e-6] * 3 + [0.0] * 4)))
    found = hx.estimate(loop_of(parts), hx.Murareci())
    assert_covers(found, left_hand.leg(3))
    plain = hx.estimate(loop_of([replace(part, noise=hx.NormalNoise(**own)) for part in parts]), hx.Murareci())
    np.testing.assert_array_equal(plain.values, found.values)
    larger = np.linalg.norm(found.standard_errors[:, 3:], axis=1) / np.linalg.norm(plain.standard_errors[:, 3:], axis=1)
    assert larger.min() > 1
    assert np.median(larger) > 1.2


def test_noise_makes_nearly_parallel_directions_run_away(left_hand, paper_noise):
    """Angles get smaller as a goes away, errors and all; the other sets keep their answer, and these say so."""
    parts = simulated(left_hand, 7, 300, noise=paper_noise)
    found = hx.estimate(loop_of(parts), hx.Murareci())
    exact = [part.position + part.rotation @ left_hand.leg(3).platform_point for part in parts]
    one, two = (points[:, 0] - left_hand.leg(3).base_point for points in exact)
    sine = np.linalg.norm(np.cross(one, two), axis=-1) / np.linalg.norm(one, axis=-1) / np.linalg.norm(two, axis=-1)
    assert set(found.status) == {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED}
    assert found.ok[sine > 0.3].all()
    assert np.median(sine[~found.ok]) < 0.5 * np.median(sine)


@pytest.mark.parametrize("lengths", ["none", "wrong"])
def test_no_reading_and_no_offset_is_used(paper_noise, lengths):
    parts = apart(6, 5, paper_noise)
    reading = None if lengths == "none" else 100.0 - parts[0].length
    blind = [replace(part, length=reading) for part in parts]
    loop = Sets(*(FixedDirection(part, offset=-3.0, gain=2.0) for part in blind))
    found, expected = hx.estimate(loop, hx.Murareci()), hx.estimate(loop_of(parts), hx.Murareci())
    np.testing.assert_array_equal(found.values, expected.values)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-2)  # the reading drops out to first order


def test_contract():
    check_estimator(
        hx.Murareci(max_iterations=100),
        lambda data: loop_of([data, turned(data)]),
        lock="direction",
        n_poses=7,
        tolerance=1e-5,
        claims=("exact", "scale", "rank"),
    )


class TestRank:
    @pytest.mark.parametrize("noisy", [True, False])
    @pytest.mark.parametrize("wrap", [FixedDirection, lambda data: Sets(FixedDirection(data))])
    def test_one_direction(self, left_hand, paper_noise, noisy, wrap):
        data = simulated(left_hand, 10, None, directions=1, noise=paper_noise if noisy else None)[0]
        with pytest.raises(RankDeficientError, match="unseen: base_point along the leg's locked direction") as caught:
            hx.estimate(wrap(data), hx.Murareci())
        assert caught.value.combinations == ("base_point along the leg's locked direction",)

    def test_two_sets_of_one_direction(self, left_hand):
        """The unseen combination is a along n."""
        data = simulated(left_hand, 12, None, directions=1)[0]
        with pytest.raises(RankDeficientError) as caught:
            hx.estimate(loop_of([data.poses(range(6)), data.poses(range(6, 12))]), hx.Murareci())
        (combination,) = caught.value.combinations
        leg = left_hand.leg(3)
        along = data.position[0] + data.rotation[0] @ leg.platform_point - leg.base_point
        expected = hx.Parameters((hx.Block("base_point", 3, "cm"),)).combination(along, threshold=0.0)
        assert combination == expected

    def test_too_few_poses(self, left_hand):
        with pytest.raises(RankDeficientError, match="4 equations for 6 unknowns"):
            hx.estimate(loop_of(simulated(left_hand, 2)), hx.Murareci(), throw=False)
        with pytest.raises(RankDeficientError, match="needs at least 5 poses"):
            hx.estimate(loop_of(simulated(left_hand, 2)), hx.Murareci())
        with pytest.raises(InputError, match="give every set two poses or more"):
            hx.estimate(loop_of(simulated(left_hand, 1)), hx.Murareci(), throw=False)

    def test_five_poses_are_enough(self, left_hand):
        few, more = simulated(left_hand, 2)[0], simulated(left_hand, 3)[1]
        found = hx.estimate(loop_of([few, more]), hx.Murareci())
        assert found.ok.mean() > 0.95
        assert (found.error(left_hand.leg(3))["base_point"] <= 2e3 * EPS * found.condition)[found.ok].mean() > 0.95

    def test_three_directions_of_two_poses(self, left_hand):
        found = hx.estimate(loop_of(simulated(left_hand, 2, directions=3)), hx.Murareci())
        assert found.ok.mean() > 0.95
        assert (found.error(left_hand.leg(3))["base_point"] <= 2e3 * EPS * found.condition)[found.ok].mean() > 0.95


@pytest.mark.parametrize("spread", [3, 30, 3000])
def test_what_runs_away_has_not_converged(left_hand, spread):
    """Infinitely far away all angles agree: the iteration ends there from bad starts, and no value comes back."""
    parts, leg = simulated(left_hand, 6, 100), left_hand.leg(3)
    shift = np.random.default_rng(0).uniform(-spread, spread, (2, 100, 3))
    start = hx.Leg(3, leg.platform_point + shift[0], leg.base_point + shift[1])
    found = hx.estimate(loop_of(parts), hx.Murareci(start))
    assert set(found.status) <= {hx.Status.OPTIMAL, hx.Status.NOT_CONVERGED}
    assert np.isnan(found.values[~found.ok]).all()
    assert (found.error(leg)["base_point"][found.ok] < 1e-8).all()
    assert 0.7 < found.ok.mean() < 1 if spread == 3 else found.ok.mean() < 0.1


def test_a_start_without_length_harms_no_other_set(left_hand):
    """B of the start on A in one pose of one set of the batch: there are no angles there."""
    parts, leg = simulated(left_hand, 6, 5), left_hand.leg(3)
    clean = hx.estimate(loop_of(parts), hx.Murareci(leg))
    position = np.array(parts[0].position)
    position[2, 1] = leg.base_point - parts[0].rotation[2, 1] @ leg.platform_point
    found = hx.estimate(loop_of([replace(parts[0], position=position), parts[1]]), hx.Murareci(leg))
    others = [0, 1, 3, 4]
    assert found.ok[others].all()
    np.testing.assert_allclose(found.values[others], clean.values[others], rtol=1e-12)
    assert found.ok[2] == bool(np.isfinite(found.values[2]).all())


@pytest.mark.parametrize("at", [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
def test_a_leg_on_the_first_axis_has_no_angles(left_hand, at):
    """And no derivative that could be taken for one: an iteration that ends there has not converged."""
    assert (_angles(np.array([at]), np.eye(3))[1] == 0).all()
    (data,) = simulated(left_hand, 6, None, directions=1)
    position = np.array(data.position)
    position[3] = at
    for part, there in ((data, True), (replace(data, position=position), False)):
        angles = _Angles(loop_of([part]), [np.eye(3)[None]])
        assert angles.exist(np.zeros(6)) == there
        assert np.isfinite(angles.linearised(np.zeros(6)).matrix).all()


def test_an_empty_batch(left_hand):
    found = hx.estimate(loop_of([part[[]] for part in simulated(left_hand, 6, 5)]), hx.Murareci())
    assert found.values.shape == (0, 6)


def test_what_failed_says_nothing(left_hand):
    found = hx.estimate(loop_of(simulated(left_hand, 6, 3)), hx.Murareci(max_iterations=1))
    assert not found.ok.any()
    assert np.isnan(found.covariance).all()
    assert np.isnan(found.objective).all()


class TestWrongCalls:
    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"start": [1, 2, 3]}, "start: expected a Leg"),
            ({"max_iterations": 0}, "max_iterations: expected a whole number >= 1, got 0"),
        ],
    )
    def test_wrong_settings(self, settings, message):
        with pytest.raises(InputError, match=message):
            hx.Murareci(**settings)

    def test_another_lock(self, left_hand):
        leg_set = hx.simulate_leg(left_hand, 3, "leg", 5, rng=0)
        one = FixedDirection(simulated(left_hand, 6, None)[0])
        with pytest.raises(InputError, match="under the lock 'direction', got FixedLeg: write estimate"):
            hx.estimate(Sets(one, FixedLeg(leg_set)), hx.Murareci())

    def test_other_unknowns(self, left_hand):
        one, two = simulated(left_hand, 6, None)
        loops = FixedDirection(one, unknown=("base_point",)), FixedDirection(two)
        with pytest.raises(InputError, match="a set has the unknown base_point: leave out unknown="):
            hx.estimate(Sets(*loops), hx.Murareci())

    def test_no_start(self, left_hand):
        bare = [replace(part, nominal=None) for part in simulated(left_hand, 6, 5)]
        loop = Sets(*(FixedDirection(part, offset=0.0, gain=1.0) for part in bare))
        with pytest.raises(InputError, match="Murareci needs an initial guess: give start="):
            hx.estimate(loop, hx.Murareci())
        assert hx.estimate(loop, hx.Murareci(left_hand.leg(3))).ok.all()
