"""What every implicit equation offers nonlinear estimators: whitened rows, information, the Cramér–Rao bound."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag, null_space

import hexopt as hx
from hexopt.arrays import matvec
from hexopt.errors import InputError, RankDeficientError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength, Sets, WholeRobot
from hexopt.loops.known import square_root
from hexopt.testing.motions import base_motion, platform_motion, unit_change

RNG = np.random.default_rng(3)
ROOT = RNG.standard_normal((7, 7)) * [*[0.01] * 3, *[2e-4] * 3, 0.01]
NOISES = {
    "uniform": hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01),
    "correlated": hx.NormalNoise(pose_covariance=ROOT.T @ ROOT),
    "common": hx.NormalNoise(0.005, 1e-4, 0.008, common_covariance=0.5 * ROOT.T @ ROOT),
}
#: By name: the lock, and the loop of its data.
LOOPS = {
    "FixedDirection": ("direction", FixedDirection),
    "FixedDirection, b known": ("direction", lambda data: FixedDirection(data, unknown="base_point")),
    "FixedLeg": ("leg", FixedLeg),
    "FixedLength": ("length", FixedLength),
    "FixedLength, both": ("length", lambda data: FixedLength(data, unknown=("platform_point", "base_point"))),
    "LegLength, 42": ("none", LegLength),
    "LegLength, 48": ("none", lambda data: LegLength(data, unknown=LegLength.involved)),
}
LEG = hx.robots.left_hand().leg(3)


def simulated(lock, noise="uniform", *, n=9, n_sets=None, seed=0, exact=False):
    """Leg 3 in some poses; exact ones know the noise all the same."""
    model = NOISES.get(noise, noise)
    data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=None if exact else model, rng=seed)
    return replace(data, noise=model)


def made(name, noise="uniform", **settings):
    lock, kind = LOOPS[name]
    return kind(simulated(lock, noise, n=12 if "8" in name or "both" in name else 9, **settings))


def bound(pieces, values, units, main):
    """The bound by the joint information of values, true measurements and shared errors, dense.

    Their errors z are standard normal; a constraint ``G dx + Σ F z = 0`` ties them to the values, one more each
    direction to its length. On the null space Z of all constraints the information is that of z alone: no S, no
    weight, no Schur complement of the library enters (Gorman and Hero, 1990).

    Parameters
    ----------
    pieces : list of (ndarray, ndarray), shapes (m, p) and (m, k)
        G and F of every set.
    """
    size = values.shape[0]
    rows = np.vstack([g for g, _ in pieces])
    errors = block_diag(*(f for _, f in pieces))
    lengths = np.zeros((len(units), size))
    for row, unit in zip(lengths, units, strict=True):
        row[unit] = values[unit]
    scale = 1 / np.sqrt((rows**2).sum(axis=0))
    constraints = np.block(
        [[rows * scale, errors / np.abs(errors).max()], [lengths * scale, np.zeros((len(units), errors.shape[1]))]]
    )
    z = null_space(constraints, rcond=1e-13)
    move, error = scale[:, None] * z[:size], z[size:] / np.abs(errors).max()
    _, s, right = np.linalg.svd(error, full_matrices=False)
    assert s[-1] > 1e-10 * s[0]
    root = move @ right.T / s
    return (root @ root.T)[:main, :main]


def numeric_piece(loop, x, derivative):
    """G and F of one loop by differences: of the residual by values, by errors of its poses, by what they share."""
    n, readings = loop.data.n_poses, 1 if loop.data.length is None or loop.data.length.ndim == 1 else 6
    by_value = derivative(loop.residual, x)
    by_error = derivative(
        lambda e: loop.shifted(np.broadcast_to(e, (n, 6 + readings))).residual(x), np.zeros(6 + readings)
    )
    own = by_error @ square_root(np.broadcast_to(loop.error_covariance, (n, 6 + readings, 6 + readings)))
    common = loop.data.noise.common(readings)
    shared = [] if common is None else [by_error @ square_root(common)]
    rows = loop.residual(x).shape[-1]
    each = block_diag(*own)
    return by_value.reshape(n * rows, -1), np.hstack([each, *(part.reshape(n * rows, -1) for part in shared)])


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("name", LOOPS)
class TestWhitenedRows:
    def test_they_have_unit_variance(self, name, noise):
        loop = made(name, noise, n_sets=3)
        x = loop.values(LEG)
        rows = loop.whitened(x)
        b = loop.noise_jacobian(x)
        covariance = b @ loop.error_covariance @ np.swapaxes(b, -1, -2)
        unit = rows.root @ covariance @ np.swapaxes(rows.root, -1, -2)
        np.testing.assert_allclose(unit, np.broadcast_to(np.eye(loop.rows), unit.shape), atol=1e-9)
        np.testing.assert_allclose(rows.misclosure, matvec(rows.root, loop.residual(x)), rtol=1e-12)
        np.testing.assert_allclose(rows.jacobian, rows.root @ loop.jacobian(x), rtol=1e-12)

    def test_moved_measurements_close_the_loop(self, name, noise):
        """Half the sum of squares is then that of the errors, and no smaller one is near."""
        loop = made(name, noise, n_sets=3)
        x = loop.values(LEG)
        rows = loop.whitened(x, adjust=10)
        deviation = 1 / np.abs(rows.root).max()
        assert np.abs(loop.shifted(rows.error).residual(x)).max() < 1e-8 * deviation
        root = np.linalg.inv(np.linalg.cholesky(loop.error_covariance))
        squares = (matvec(root, rows.error) ** 2).sum(axis=-1)
        np.testing.assert_allclose(squares, (rows.misclosure**2).sum(axis=-1), rtol=1e-8)
        # among the errors that close the loop, this one is stationary: it lies in the range of Σ B'
        moved = loop.shifted(rows.error)
        turn = np.broadcast_to(np.eye(7), (*rows.error.shape, 7)).copy()
        turn[..., 3:6, 3:6] = hx.rotations.rotation_vector_jacobian(rows.error[..., 3:6])
        b = moved.noise_jacobian(x) @ turn
        pull = matvec(root, rows.error)
        reach = np.swapaxes(root, -1, -2)
        wide = np.linalg.solve(reach, np.swapaxes(b, -1, -2))  # Σ^(1/2)' B'
        rest = pull - matvec(wide, matvec(np.linalg.pinv(wide), pull))
        assert np.abs(rest).max() < 1e-7

    def test_their_jacobian_gives_the_gradient_of_the_cost(self, name, noise, central_difference):
        """At settled errors the gradient of ½ Σ e'Σ⁻¹e by the values is J'r, exactly: nothing is linearised."""
        loop = made(name, noise, seed=1)
        x = loop.values(LEG)
        step = 1e-3 / np.sqrt((loop.whitened(x).jacobian ** 2).sum(axis=(0, 1)))

        def cost(change):
            return 0.5 * (loop.whitened(x + step * change, adjust=30).misclosure ** 2).sum()

        rows = loop.whitened(x, adjust=30)
        gradient = step * np.einsum("ndp,nd->p", rows.jacobian, rows.misclosure)
        np.testing.assert_allclose(central_difference(cost, np.zeros(len(x)), step=1.0), gradient, atol=1e-8)

    def test_a_batch_equals_its_members(self, name, noise):
        loop = made(name, noise, n_sets=4)
        x = loop.values(LEG)
        together = loop.whitened(x, adjust=10)
        alone = LOOPS[name][1](loop.data[2]).whitened(x[2] if x.ndim > 1 else x, adjust=10)
        for field in ("misclosure", "jacobian", "common", "root", "error"):
            whole, part = getattr(together, field), getattr(alone, field)
            np.testing.assert_allclose(whole[2], part, atol=1e-7 * max(np.abs(part).max(initial=0), 1e-300))


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("name", LOOPS)
class TestBound:
    def test_it_is_that_of_all_unknowns_together(self, name, noise, central_difference):
        loop = made(name, noise, exact=True)
        x = loop.values(LEG)
        units = [loop.parameters[name] for name in loop.unit_vectors]
        expected = bound([numeric_piece(loop, x, central_difference)], x, units, loop.parameters.main.size)
        found = loop.crlb(LEG)
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(found / scale, expected / scale, atol=1e-6)

    def test_values_legs_and_estimates_are_the_same_place(self, name, noise):
        loop = made(name, noise, exact=True)
        x = loop.values(LEG)
        main = x[: loop.parameters.main.size]
        for place in (x, main):
            np.testing.assert_allclose(loop.crlb(place), loop.crlb(LEG), rtol=1e-9)
        found = hx.Estimate(x, loop.parameters, np.array(0), None, "none", *(np.array(0.0),) * 3, 0)
        np.testing.assert_allclose(loop.crlb(found), loop.crlb(LEG), rtol=1e-9)

    def test_a_batch_equals_its_members(self, name, noise):
        loop = made(name, noise, exact=True, n_sets=6)
        together = loop.crlb(LEG)
        assert together.shape == (6, loop.parameters.main.size, loop.parameters.main.size)
        for i in (0, 5):
            alone = LOOPS[name][1](loop.data[i]).crlb(LEG)
            np.testing.assert_allclose(together[i], alone, atol=1e-9 * np.abs(alone).max())

    def test_the_inverse_information_of_all_poses(self, name, noise):
        """Additive over poses; what all poses share, no pose tells alone."""
        loop = made(name, noise, exact=True)
        information = loop.information(LEG)
        size = loop.parameters.size
        assert information.shape == (loop.data.n_poses, *2 * (size - len(loop.unit_vectors),))
        assert np.linalg.eigvalsh(information / np.abs(information).max()).min() > -1e-12
        halves = [LOOPS[name][1](loop.data.poses(part)) for part in (slice(0, 4), slice(4, None))]
        x = loop.values(LEG)
        if name.startswith("FixedLength"):  # its nuisance is about the mean position, which differs between halves
            return
        np.testing.assert_allclose(
            np.concatenate([half.information(x) for half in halves]), information, rtol=1e-9, atol=1e-9
        )
        basis = loop.chart().basis(x)
        scale = np.sqrt(np.diag(information.sum(axis=0)))
        inverse = np.linalg.inv(information.sum(axis=0) / np.outer(scale, scale)) / np.outer(scale, scale)
        m = loop.parameters.main.size
        total, found = (basis @ inverse @ basis.T)[:m, :m], loop.crlb(LEG)
        if noise == "common":
            assert (np.diag(found) > (1 + 1e-6) * np.diag(total)).any()
            assert np.linalg.eigvalsh(found - total).min() > -1e-9 * np.abs(found).max()
        else:
            np.testing.assert_allclose(found, total, atol=1e-8 * np.abs(found).max())


@pytest.mark.parametrize("noise", ["uniform", "correlated"])
@pytest.mark.parametrize("name", LOOPS)
def test_it_moves_with_the_frames_and_units(name, noise):
    loop = made(name, noise, exact=True)
    for motion in (base_motion("cm", 16), platform_motion("cm", 16), unit_change("cm")):
        moved = LOOPS[name][1](motion.data(loop.data)).crlb(motion.leg(LEG))
        turns = {
            "base_point": motion.factor * motion.turn,
            "platform_point": motion.factor * motion.platform_turn.T,
        }
        by = block_diag(*(turns.get(key, [[motion.factor if key == "offset" else 1.0]]) for key in loop.unknown))
        expected = by @ loop.crlb(LEG) @ by.T
        scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
        np.testing.assert_allclose(moved / scale, expected / scale, atol=1e-7)


class TestKnownEstimates:
    """The error of a known value counts, once, for all poses."""

    def known(self, noise="uniform"):
        return hx.estimate(FixedLeg(simulated("leg", noise, seed=5)), hx.MaximumLikelihood())

    @pytest.mark.parametrize("noise", NOISES)
    def test_the_bound_with_a_carried_error(self, noise, central_difference):
        data, b = simulated("length", noise, exact=True), self.known()
        x = FixedLength(data, platform_point=b).values(LEG)
        by_value, by_error = numeric_piece(FixedLength(data, platform_point=b), x, central_difference)
        point, covariance = b.params["platform_point"], b.covariance_of("platform_point")
        # the origin, and so the nuisance, stays where it is
        by_known = central_difference(lambda value: FixedLength(data, platform_point=value).residual(x), point)
        errors = np.hstack([by_error, by_known.reshape(len(by_value), 3) @ np.linalg.cholesky(covariance)])
        expected = bound([(by_value, errors)], x, [], 3)
        found = FixedLength(data, platform_point=b).crlb(LEG)
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
        without = FixedLength(data, platform_point=point).crlb(LEG)
        assert np.linalg.eigvalsh(found - without).min() > -1e-9 * np.abs(found).max()
        assert np.trace(found) > 1.001 * np.trace(without)

    def test_a_surer_known_value_makes_a_smaller_bound(self):
        data, b = simulated("length", exact=True, n=30), self.known()
        variances = []
        for factor in (1e-6, 1e-2, 1.0, 100.0):
            surer = replace(b, covariance=factor * b.covariance)
            variances.append(np.trace(FixedLength(data, platform_point=surer).crlb(LEG)))
        assert (np.diff(variances) > 0).all()
        alone = np.trace(FixedLength(data, platform_point=b.params["platform_point"]).crlb(LEG))
        np.testing.assert_allclose(variances[0], alone, rtol=1e-3)

    def test_one_estimate_of_two_known_values_has_one_error(self):
        """b and a of one estimate for an offset: their correlation counts."""
        both = hx.estimate(FixedDirection(simulated("direction", seed=6)), hx.MaximumLikelihood())
        data = simulated("none", exact=True, seed=7)
        loop = LegLength(data, unknown="offset", platform_point=both, base_point=both)
        x = loop.values(LEG)
        columns = np.concatenate(
            [loop.known_jacobian(x, name)[:, 0] for name in ("platform_point", "base_point")], axis=1
        )
        noise = loop.noise_jacobian(x)[:, 0]
        own = np.einsum("ni,nij,nj->n", noise, loop.error_covariance, noise)
        covariance = np.diag(own) + columns @ both.covariance_of("platform_point", "base_point") @ columns.T
        one = -np.ones(len(own))
        np.testing.assert_allclose(loop.crlb(LEG)[0, 0], 1 / (one @ np.linalg.solve(covariance, one)), rtol=1e-8)


class TestSeveralSets:
    def test_sets_of_one_leg(self, central_difference):
        """Dense again: b is shared, each set has its own nuisance and its own common error."""
        loops = [
            FixedDirection(simulated("direction", "common", exact=True)),
            FixedLeg(simulated("leg", exact=True, seed=1)),
        ]
        model = Sets(*loops)
        x = model.values(LEG)
        pieces = []
        for loop, (_, place) in zip(loops, model.parts, strict=True):
            by_value, by_error = numeric_piece(loop, x[place], central_difference)
            wide = np.zeros((len(by_value), model.parameters.size))
            wide[:, place] = by_value
            pieces.append((wide, by_error))
        expected = bound(pieces, x, [model.parameters["direction"]], 6)
        np.testing.assert_allclose(model.crlb(LEG), expected, atol=1e-6 * np.abs(expected).max())

    def test_information_of_a_leg_and_the_bound_of_sets_agree(self):
        """Without shared errors, the inverse bounds of b by single sets add up."""
        loops = [FixedLeg(simulated("leg", exact=True, seed=seed)) for seed in (0, 1, 2)]
        total = sum(np.linalg.inv(loop.crlb(LEG)) for loop in loops)
        np.testing.assert_allclose(np.linalg.inv(Sets(*loops).crlb(LEG)), total, rtol=1e-8)

    def test_batches_broadcast(self):
        one, many = FixedLeg(simulated("leg", exact=True)), FixedLeg(simulated("leg", exact=True, seed=1, n_sets=3))
        found = Sets(one, many).crlb(LEG)
        assert found.shape == (3, 3, 3)
        alone = Sets(one, FixedLeg(many.data[1])).crlb(LEG)
        np.testing.assert_allclose(found[1], alone, rtol=1e-9)
        assert Sets(one, many).information(LEG).shape == (3, 18, 9, 9)


class TestMistakes:
    def test_without_a_noise_model(self):
        data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", 6, rng=0)
        for ask in ("crlb", "information"):
            with pytest.raises(InputError, match="no noise model"):
                getattr(FixedLeg(data), ask)(LEG)

    @pytest.mark.parametrize(
        ("name", "noise"),
        [
            ("FixedLeg", hx.NormalNoise(0, 1e-4, 0.01)),
            ("FixedLeg", hx.NormalNoise(0, 0, 0.01)),
            ("FixedDirection", hx.NormalNoise(0, 0, 0.01)),
            ("FixedLength", hx.NormalNoise(0, 0, 0.01)),
        ],
    )
    def test_equations_without_any_error(self, name, noise):
        for ask in ("crlb", "information"):
            with pytest.raises(InputError, match="without any error"):
                getattr(made(name, noise, exact=True, n_sets=2), ask)(LEG)

    def test_what_the_poses_do_not_see_is_named(self):
        data = simulated("direction", exact=True)
        loop = FixedDirection(data, unknown=("platform_point", "base_point", "offset"))
        with pytest.raises(RankDeficientError, match="offset") as caught:
            loop.crlb(LEG)
        (combination,) = caught.value.combinations
        assert "base_point" in combination
        assert "platform_point" not in combination
        # a moves along n as the offset grows: the weights are those of n
        n = loop.parameters.split(loop.values(LEG))["direction"]
        unseen = np.array([*n, -1.0]) / np.abs([*n, 1.0]).max()
        for axis, weight in zip("xyz", unseen, strict=False):
            assert (f"base_point.{axis}" in combination) == (abs(weight) >= 0.05)

    def test_one_blind_set_in_a_batch_is_enough(self):
        data = simulated("leg", exact=True, n_sets=3)
        position, rotation = np.array(data.position), np.array(data.rotation)
        position[1], rotation[1] = position[1, :1], rotation[1, :1]
        with pytest.raises(RankDeficientError, match="platform_point"):
            FixedLeg(replace(data, position=position, rotation=rotation)).crlb(LEG)

    def test_a_direction_of_any_length_is_made_a_unit_vector(self):
        loop = made("FixedDirection", exact=True)
        x = loop.values(LEG)
        longer = x.copy()
        longer[loop.parameters["direction"]] *= 3
        np.testing.assert_allclose(loop.crlb(longer), loop.crlb(x), rtol=1e-9)


def test_readings_that_are_not_used_do_not_matter(left_hand):
    """Type II without its readings has the same bound."""
    data = simulated("leg", exact=True)
    np.testing.assert_allclose(FixedLeg(replace(data, length=None)).crlb(LEG), FixedLeg(data).crlb(LEG), rtol=1e-12)


def test_more_accurate_readings_make_the_bound_smaller_in_proportion():
    noise = NOISES["uniform"]
    half = hx.UniformNoise(noise.position / 2, noise.angle / 2, noise.length / 2)
    for name in LOOPS:
        one, two = made(name, exact=True).crlb(LEG), made(name, half, exact=True).crlb(LEG)
        np.testing.assert_allclose(two, one / 4, rtol=1e-8)


def test_a_robot_offers_the_same(left_hand):
    sets = [hx.simulate(left_hand, "direction", 7, leg=k, noise=NOISES["uniform"], rng=k) for k in (1, 2, 3)]
    model = WholeRobot(*sets)
    chart = model.chart()
    assert chart.free == model.parameters.size - 3
    assert model.information(left_hand).shape == (21, chart.free, chart.free)
