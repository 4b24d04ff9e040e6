"""Several sets of a leg as one model: shared points, a nuisance each, rows below each other."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, UnitError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength, Sets


def simulated(lock, n=6, n_sets=None, *, leg=3, seed=0, noise=None, nominal=None):
    return hx.simulate_leg(hx.robots.left_hand(), leg, lock, n, n_sets, noise=noise, nominal=nominal, rng=seed)


@pytest.fixture
def mixed():
    """Type I twice, and Type III with both points unknown, in a batch of 4; offset estimated."""
    unknown = ("platform_point", "base_point", "offset")
    return Sets(
        FixedDirection(simulated("direction", 5, 4), unknown=unknown),
        FixedLength(simulated("length", 7, 4, seed=1), unknown=unknown[:2]),
        FixedDirection(simulated("direction", 4, seed=2), unknown=unknown),
    )


def test_names_and_shapes(mixed):
    names = ("platform_point", "base_point", "offset", "direction.1", "sphere", "direction.2")
    assert mixed.parameters.names == names
    assert mixed.unit_vectors == ("direction.1", "direction.2")
    assert mixed.batch_shape == (4,)
    assert mixed.minimum_poses == 3
    assert mixed.residual(hx.robots.left_hand().leg(3)).shape == (4, 15 + 7 + 12)
    assert mixed.jacobian(hx.robots.left_hand().leg(3)).shape == (4, 34, 14)
    assert Sets(mixed.loops[0]).parameters == mixed.loops[0].parameters


def test_rows_are_those_of_the_loops(mixed, central_difference):
    leg = hx.robots.left_hand().leg(3)
    values = mixed.values(leg)
    assert np.abs(mixed.residual(values)).max() < 1e-10
    near = values[0] + 0.1
    blocks = mixed.parameters.split(near)
    own = np.concatenate([*(blocks[k] for k in ("platform_point", "base_point", "offset", "direction.2"))])
    np.testing.assert_allclose(mixed.residual(near)[2, 22:], mixed.loops[2].residual(own).ravel(), atol=1e-12)
    jacobian = mixed.jacobian(near)
    numeric = central_difference(lambda x: mixed.residual(x)[2], near)
    np.testing.assert_allclose(jacobian[2], numeric, atol=1e-7)
    for loop, place in mixed.parts:
        assert len(place) == loop.parameters.size


def test_values_from_everything_that_says_them():
    one, two = (FixedDirection(simulated("direction", 6, seed=k)) for k in (0, 1))
    sets, leg = Sets(one, two), hx.robots.left_hand().leg(3)
    values = sets.values(leg)
    directions = [values[sets.parameters[f"direction.{k}"]] for k in (1, 2)]
    for direction, loop in zip(directions, (one, two), strict=True):
        np.testing.assert_allclose(direction, loop.values(leg)[6:], atol=1e-14)
    np.testing.assert_allclose(sets.values(values[:6]), values, atol=1e-12)
    np.testing.assert_array_equal(sets.values(values), values)
    np.testing.assert_array_equal(sets.start(), values)
    found = hx.estimate(hx.join(one, two), hx.LeastSquares())
    np.testing.assert_array_equal(sets.values(replace(found, values=found.values + 1)), found.values + 1)
    alone = hx.estimate(one.linear("consecutive"), hx.LeastSquares())
    np.testing.assert_allclose(sets.values(alone), values, atol=1e-9)
    with pytest.raises(InputError, match=r"expected 12 .* or 6 without the nuisances, got shape"):
        sets.values(np.zeros(7))


def test_the_bound_is_that_of_joined_rows(small_noise):
    """Without a unit vector among the nuisances, generalised least squares on exact rows reaches it."""
    parts = FixedLeg(simulated("leg", 6, noise=small_noise)), FixedLeg(simulated("leg", 9, seed=1, noise=small_noise))
    leg = hx.robots.left_hand().leg(3)
    joined = hx.join(*parts, at=Sets(*parts).values(leg))
    found = hx.estimate(joined, hx.LeastSquares(weights="model"))
    np.testing.assert_allclose(Sets(*parts).crlb(leg), found.covariance_of("platform_point"), rtol=1e-8)


@pytest.mark.parametrize("unknown", [("platform_point", "base_point"), ("platform_point", "base_point", "offset")])
def test_blind_spots(unknown):
    """A locked direction brings one equation for a and the offset, whatever noise makes of the rank."""
    leg = hx.robots.left_hand().leg(3)
    loops = [LegLength(simulated("direction", 12, seed=k), unknown=unknown) for k in range(4)]
    for count in range(1, 5):
        sets = Sets(*loops[:count])
        unseen = sets.parameters.size - np.linalg.matrix_rank(sets.jacobian(leg), tol=1e-9)
        assert unseen == max(sets.parameters.size - 3 - count, 0)
        assert bool(sets.blind_spots) == bool(unseen)
    assert Sets(loops[0], LegLength(simulated("none", 12), unknown=unknown)).blind_spots == ()


class TestErrors:
    def test_nothing_and_no_loops(self):
        with pytest.raises(InputError, match="got nothing; write Sets"):
            Sets()
        loop = FixedLeg(simulated("leg"))
        for wrong in ([loop], loop.linear(), loop.data):
            with pytest.raises(InputError, match="argument 2: expected a loop"):
                Sets(loop, wrong)

    def test_two_legs(self):
        with pytest.raises(InputError, match="of the legs 3, 4; give those of one leg"):
            Sets(FixedLeg(simulated("leg")), FixedLeg(simulated("leg", leg=4, seed=1)))

    def test_a_pose_twice(self):
        data = simulated("leg", 8)
        with pytest.raises(InputError, match="Sets is for different poses: argument 1"):
            Sets(FixedLeg(data.poses(range(5))), FixedLeg(data.poses(range(4, 8))))

    def test_noise_for_one_alone(self, paper_noise):
        with pytest.raises(InputError, match=r"Sets: argument 1 \(FixedLeg\): no noise model, the others have one"):
            Sets(FixedLeg(simulated("leg")), FixedLeg(simulated("leg", seed=1, noise=paper_noise)))

    def test_batches(self):
        with pytest.raises(InputError, match=r"the batches .* do not fit each other"):
            Sets(FixedLeg(simulated("leg", 6, 3)), FixedLeg(simulated("leg", 6, 4, seed=1)))

    def test_units(self):
        other = replace(simulated("leg", seed=1), nominal=None, length_unit="mm")
        with pytest.raises(UnitError, match="Sets: the sets are in cm and mm"):
            Sets(FixedLeg(simulated("leg")), FixedLeg(other))
