"""What maximum likelihood must not pretend: what a lock hides, errors of known values, too few poses."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError
from hexopt.loops import FixedLeg, FixedLength, LegLength, PlatformPose, ReadLeg, ReadLength, Sets, WholeRobot
from hexopt.testing import check_estimator

ML = hx.MaximumLikelihood()
NOISE = hx.NormalNoise(0.01, 1e-4, 0.01)
ALL = ("platform_point", "base_point", "offset", "gain")
GAIN = "offset against gain: a locked length has one reading"


def leg_set(robot, lock, n, rng, n_sets=None, **settings):
    return hx.simulate_leg(robot, 3, lock, n, n_sets, noise=NOISE, rng=rng, **settings)


class TestWhatALockHides:
    """Readings of a locked length are one number and noise; the noise must not make the gain look seen."""

    @pytest.mark.parametrize("lock", ["length", "leg"])
    def test_of_one_leg(self, left_hand, lock):
        leg, data = left_hand.leg(3), leg_set(left_hand, lock, 30, 1, nominal=left_hand)
        known = {"platform_point": leg.platform_point, "base_point": leg.base_point}
        loop = LegLength(data, unknown=("offset", "gain"), **known)
        assert loop.blind_spots == (GAIN,)
        with pytest.raises(RankDeficientError, match="offset against gain"):
            loop.linear()
        with pytest.raises(RankDeficientError, match="offset against gain"):
            loop.crlb(leg)
        assert LegLength(data, unknown=("gain",), **known).linear().rhs.shape == (30,)
        kind = ReadLength if lock == "length" else ReadLeg
        assert kind(data, unknown=("offset", "gain"), **known).blind_spots == (GAIN,)

    def test_of_a_whole_robot(self, left_hand):
        data = hx.simulate(left_hand, "length", 40, leg=3, noise=NOISE, rng=3)
        loop = WholeRobot(data, unknown=ALL)
        assert loop.blind_spots == (f"leg3.{GAIN}",)
        with pytest.raises(RankDeficientError, match=r"leg3\.offset against gain"):
            hx.estimate(loop, ML)
        with pytest.raises(RankDeficientError, match=r"leg3\.offset against gain"):
            loop.crlb(left_hand)
        assert PlatformPose(data, unknown=ALL).blind_spots == loop.blind_spots
        more = hx.simulate(left_hand, "length", 12, leg=3, noise=NOISE, rng=4)
        assert WholeRobot(data, more, unknown=ALL).blind_spots == ()
        assert WholeRobot(data, hx.simulate(left_hand, n_poses=12, noise=NOISE, rng=5), unknown=ALL).blind_spots == ()


class TestKnownEstimates:
    def test_two_sets_that_know_one_estimate_share_its_error(self, left_hand):
        """As in `join`: against the dense covariance, and in the error itself."""
        n_sets, leg = 600, left_hand.leg(3)
        b = hx.estimate(FixedLeg(leg_set(left_hand, "leg", 5, 1, n_sets)).linear(), hx.LeastSquares(weights="model"))
        loops = [FixedLength(leg_set(left_hand, "length", 20, k, n_sets), platform_point=b) for k in (2, 3)]
        sets, joined = Sets(*loops), hx.join(*loops)
        found = hx.estimate(sets, ML)
        linear = hx.estimate(joined, hx.LeastSquares(weights="model"))
        ratio = found.standard_errors[:, :3] / linear.standard_errors[:, :3]
        assert np.abs(np.log(ratio)).max() < 0.1
        error = found.params["base_point"] - leg.base_point
        precision = np.linalg.inv(found.covariance_of("base_point"))
        nees = np.einsum("ki,kij,kj->k", error, precision, error).mean() / 3
        assert abs(nees - 1) < 4 * np.sqrt(2 / (3 * n_sets))
        np.testing.assert_allclose(
            np.sqrt(np.einsum("kii->ki", sets.crlb(leg))), linear.standard_errors[:, :3], rtol=0.1
        )

    def test_an_estimate_without_covariance_leaves_none(self, left_hand):
        b = hx.estimate(FixedLeg(leg_set(left_hand, "leg", 5, 1)).linear(), hx.LeastSquares())
        loop = FixedLength(leg_set(left_hand, "length", 20, 2), platform_point=replace(b, covariance=None))
        found = hx.estimate(loop, ML)
        assert found.covariance is None
        assert "platform_point cannot be carried" in found.covariance_kind
        with pytest.raises(InputError, match="platform_point cannot be carried"):
            loop.crlb(left_hand.leg(3))


def test_too_few_poses_promise_no_number_where_locks_decide(left_hand):
    loop = WholeRobot(leg_set(left_hand, "direction", 2, 1), unknown=("platform_point", "base_point"))
    with pytest.raises(RankDeficientError, match=r"6 equations for 8 unknowns \(.*\)$"):
        hx.estimate(loop, ML)
    free = WholeRobot(hx.simulate(left_hand, n_poses=3, noise=NOISE, rng=1))
    with pytest.raises(RankDeficientError, match=r"18 equations for 42 unknowns .* at least 7 poses"):
        hx.estimate(free, ML)
    with pytest.raises(RankDeficientError, match="at least 7 poses"):
        free.crlb(left_hand)


def test_an_empty_batch_gives_an_empty_estimate(left_hand):
    for lock, kind in (("direction", hx.loops.FixedDirection), ("none", LegLength)):
        data = leg_set(left_hand, lock, 9, 1, 3)[[]]
        assert hx.estimate(kind(data), ML).values.shape[0] == 0


def test_wampler_is_maximum_likelihood_of_unlocked_poses(left_hand):
    data = leg_set(left_hand, "none", 15, 1, 4, nominal=left_hand.perturbed(0.2, rng=0))
    found, same = hx.estimate(LegLength(data), hx.WamplerImplicit()), hx.estimate(LegLength(data), ML)
    np.testing.assert_array_equal(found.values, same.values)
    with pytest.raises(InputError, match=r"WamplerImplicit\(\)"):
        hx.estimate(hx.loops.FixedDirection(leg_set(left_hand, "direction", 9, 1)), hx.WamplerImplicit())


def test_a_linear_start_made_of_noise_does_not_beat_a_good_nominal(left_hand):
    """A set called DIRECTION in which the length hardly moved, beside 30 unlocked poses."""
    nominal = left_hand.perturbed(0.1, offsets=0.05, rng=0)
    free = hx.simulate(left_hand, n_poses=30, n_sets=5, noise=NOISE, nominal=nominal, rng=3)
    still = replace(leg_set(left_hand, "leg", 12, 5, 5), lock="direction", nominal=nominal.leg(3))
    found = hx.estimate(WholeRobot(still, free, nominal=nominal), ML)
    assert found.ok.all()
    assert (found.chi2 < 1.5 * found.degrees_of_freedom).all()


def test_several_known_values_for_one_set(left_hand):
    leg, data = left_hand.leg(3), leg_set(left_hand, "length", 12, 2)
    known = leg.platform_point + 0.01 * np.random.default_rng(0).normal(size=(4, 3))
    together = hx.estimate(FixedLength(data, platform_point=known), ML)
    assert together.values.shape == (4, 4)
    for b, values in zip(known, together.values, strict=True):
        np.testing.assert_allclose(hx.estimate(FixedLength(data, platform_point=b), ML).values, values, rtol=1e-9)


@pytest.mark.parametrize("shape", [(6,), (2, 3)])
@pytest.mark.parametrize("known", [False, True])
def test_members_of_a_batch_are_the_same_alone(left_hand, shape, known):
    """What an equation of some members says is what the whole says of them."""
    data = leg_set(left_hand, "length", 9, 2, 6)
    data = data[np.arange(6).reshape(shape)]
    b = hx.estimate(
        FixedLeg(leg_set(left_hand, "leg", 6, 1, 6)[np.arange(6).reshape(shape)]).linear(), hx.LeastSquares()
    )
    one = FixedLength(data, platform_point=b) if known else FixedLength(data)
    two = ReadLength(leg_set(left_hand, "length", 8, 5))  # the same for all
    robot = WholeRobot(data, hx.simulate(left_hand, n_poses=9, noise=NOISE, rng=1))
    which = tuple(np.array(index) for index in ([1, 4],) if len(shape) == 1) or (np.array([0, 1]), np.array([1, 1]))
    for model in (one, Sets(one, two), robot, PlatformPose(hx.simulate(left_hand, n_poses=9, noise=NOISE, rng=1))):
        values = np.broadcast_to(model.values(left_hand), (*model.batch_shape, model.parameters.size))
        some = model.take(which, shape)
        assert some.batch_shape == (2,)
        picked = np.broadcast_to(values, (*shape, values.shape[-1]))[which]
        for (whole, place), (part, _) in zip(model.parts, some.parts, strict=True):
            expected = whole.whitened(values[..., place], adjust=5)
            found = part.whitened(picked[..., place], adjust=5)
            for name in ("misclosure", "jacobian", "error"):
                full = getattr(expected, name)
                core = getattr(found, name).shape[1:]
                np.testing.assert_allclose(
                    getattr(found, name), np.broadcast_to(full, (*shape, *core))[which], rtol=1e-9, atol=1e-9
                )


@pytest.mark.parametrize("lock", ["direction", "none"])
def test_the_contract_holds_through_a_whole_robot(lock):
    unknown = ("platform_point", "base_point") if lock == "direction" else ("platform_point", "base_point", "offset")
    check_estimator(
        ML,
        lambda data: WholeRobot(data, unknown=unknown),
        lock=lock,
        n_poses=12,
        claims=("exact", "order", "frame", "rank"),
    )
