"""Consecutive, centred and direct: fully weighted they are one estimator, unweighted they are three."""

import numpy as np
import pytest

import hexopt as hx

KINDS = {
    "direction": (hx.loops.FixedDirection, ("consecutive",)),
    "leg": (hx.loops.FixedLeg, ("consecutive", "centred")),
    "length": (hx.loops.FixedLength, ("consecutive", "centred")),
}
CASES = [(lock, form) for lock, (_, forms) in KINDS.items() for form in forms]
NOISES = {
    "uniform": hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01),
    "correlated": hx.NormalNoise(pose_covariance=1e-6 * (np.eye(7) + np.ones((7, 7)))),
    "common": hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=np.diag([1e-3] * 3 + [1e-8] * 3 + [1e-4])),
}
WEIGHTED, UNWEIGHTED = hx.LeastSquares(weights="model"), hx.LeastSquares()


def loop_of(lock, n=8, n_sets=20, noise="uniform", seed=0, **known):
    data = hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=NOISES[noise], rng=seed)
    return KINDS[lock][0](data, **known)


def main(found):
    """Return values and covariance without the nuisance."""
    names = found.parameters.main.names
    return np.concatenate([found.params[name] for name in names], axis=-1), found.covariance_of(*names)


@pytest.mark.parametrize(("lock", "form"), CASES)
class TestForms:
    @pytest.mark.parametrize("noise", NOISES)
    @pytest.mark.parametrize("n", [5, 8, 20])
    def test_fully_weighted_at_the_same_point_they_are_equal(self, lock, form, noise, n):
        loop, leg = loop_of(lock, n, noise=noise), hx.robots.left_hand().leg(3)
        at = leg.replaced(base_point=leg.base_point + 0.1, platform_point=leg.platform_point - 0.1)
        direct, other = (hx.estimate(loop.linear(f, at=at), WEIGHTED) for f in ("direct", form))
        (x, c), (y, e) = main(direct), main(other)
        errors = np.sqrt(np.einsum("...ii->...i", c))
        size = np.abs(x).max(axis=-1, keepdims=True)
        np.testing.assert_allclose((x - y) / size, 0, atol=1e-9)
        np.testing.assert_allclose((x - y) / errors, 0, atol=1e-6)
        np.testing.assert_allclose(e, c, rtol=1e-6, atol=1e-6 * np.abs(c).max())
        np.testing.assert_allclose(other.chi2, direct.chi2, rtol=1e-6)
        assert other.degrees_of_freedom == direct.degrees_of_freedom

    def test_at_values_with_the_nuisance_serves_every_form(self, lock, form):
        loop = loop_of(lock)
        at = hx.estimate(loop.linear(), UNWEIGHTED)
        direct, other = (hx.estimate(loop.linear(f, at=at), WEIGHTED) for f in ("direct", form))
        np.testing.assert_allclose(main(direct)[0], main(other)[0], rtol=1e-9, atol=1e-8)

    def test_unweighted_they_differ(self, lock, form):
        loop = loop_of(lock)
        x, y = (main(hx.estimate(loop.linear(f), UNWEIGHTED))[0] for f in ("direct", form))
        if (lock, form) in (("leg", "centred"), ("length", "centred")):  # elimination by projection: the same problem
            np.testing.assert_allclose(x, y, atol=1e-9)
        else:
            assert (np.abs(x - y).max(axis=-1) > 1e-5).all()

    def test_the_order_of_poses(self, lock, form):
        data = loop_of(lock).data
        order = np.random.default_rng(1).permutation(8)
        for f, estimator, matters in (
            ("direct", UNWEIGHTED, False),
            ("direct", WEIGHTED, False),
            ("consecutive", UNWEIGHTED, True),
            ("centred", UNWEIGHTED, False),
            ("consecutive", WEIGHTED, False),
        ):
            if f != "direct" and f != form:
                continue
            at = hx.robots.left_hand().leg(3) if estimator is WEIGHTED else None
            one, two = (
                main(hx.estimate(KINDS[lock][0](d).linear(f, at=at), estimator))[0] for d in (data, data.poses(order))
            )
            if matters:
                assert (np.abs(one - two).max(axis=-1) > 1e-5).all()
            else:
                np.testing.assert_allclose(one, two, atol=1e-9)

    def test_a_form_is_a_left_multiplier_of_the_direct_rows(self, lock, form):
        loop = loop_of(lock)
        direct, formed = loop.linear("direct"), loop.linear(form)
        p = formed.parameters.size
        blocks = direct.matrix.reshape(20, 8, loop.rows, -1)
        np.testing.assert_allclose(
            formed.matrix, formed.form.apply(blocks[..., :p]).reshape(formed.matrix.shape), atol=1e-13
        )
        nuisance = formed.form.apply(blocks[..., p:])
        np.testing.assert_allclose(nuisance, 0, atol=1e-12)

    def test_cancellation_is_at_least_one(self, lock, form):
        loop = loop_of(lock)
        assert (loop.linear("direct").cancellation == 1.0).all()
        assert (loop.linear(form).cancellation >= 1.0).all()


def test_cancellation_says_how_many_digits_a_difference_lost():
    """Rotations of 1e-6 rad: R₂ − R₁ has lost six digits, and the condition number says so."""
    rng = np.random.default_rng(0)
    robot = hx.robots.left_hand()
    small = hx.PoseRanges(angles=(1e-6,) * 3, length=(18, 20), cone=1.0, lock_cone=0.1)
    data = hx.simulate_leg(robot, 3, "leg", 6, ranges=small, rng=rng)
    problem = hx.loops.FixedLeg(data).linear("consecutive")
    assert 1e5 < problem.worst_cancellation < 1e7
    found = hx.estimate(problem, UNWEIGHTED)
    own = np.linalg.cond(problem.matrix / np.linalg.norm(problem.matrix, axis=0))
    assert own < 100
    assert 0.5e5 * own < found.condition < 2e7 * own


def test_unweighted_efficiency_orders_the_forms(left_hand, paper_noise):
    """METHODS 2: at N = 7, Type I, direct beats consecutive in a and in b; weights beat both."""
    data = hx.simulate_leg(left_hand, 3, "direction", 7, 4000, noise=paper_noise, rng=3)
    loop, leg = hx.loops.FixedDirection(data), left_hand.leg(3)
    error = {
        name: {key: np.sqrt(np.mean(e**2)) for key, e in hx.estimate(problem, estimator).error(leg).items()}
        for name, problem, estimator in (
            ("consecutive", loop.linear("consecutive"), UNWEIGHTED),
            ("direct", loop.linear("direct"), UNWEIGHTED),
            ("weighted", loop.linear("direct"), WEIGHTED),
        )
    }
    for key in ("base_point", "platform_point"):
        assert error["weighted"][key] < error["direct"][key] < error["consecutive"][key]
