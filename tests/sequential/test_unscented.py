"""The unscented filter: near maximum likelihood where it may be, honest where it is not."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.testing import check_estimator

PAPER = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
CASES = {
    "none": (lambda data: hx.loops.LegLength(data), ("platform_point", "base_point", "offset")),
    "direction": (lambda data: hx.loops.FixedDirection(data), ("platform_point", "base_point")),
    "length": (
        lambda data: hx.loops.FixedLength(data, unknown=("platform_point", "base_point")),
        ("platform_point", "base_point"),
    ),
}


def loop_of(robot, lock, n_poses=20, n_sets=None, noise=PAPER, rng=0):
    nominal = robot.perturbed(0.1, rng=3).leg(3)
    if lock == "direction":  # which takes the offset as known
        nominal = robot.leg(3)
    return CASES[lock][0](hx.simulate_leg(robot, 3, lock, n_poses, n_sets, noise=noise, nominal=nominal, rng=rng))


def prior_of(robot, lock, width, n_sets, rng=5):
    """A prior that keeps what it says: its mean is off by its own width."""
    leg, generator = robot.leg(3), np.random.default_rng(rng)
    mean = {
        name: leg.block(name) + width * generator.standard_normal((n_sets, leg.block(name).size))
        for name in CASES[lock][1]
    }
    return hx.GaussianPrior(mean, dict.fromkeys(mean, width**2), unit="cm")


def rms(values, parameters, leg, name):
    return np.sqrt(((values[..., parameters[name]] - leg.block(name)) ** 2).sum(axis=-1).mean())


def ratios(robot, lock, state, loop):
    """RMS error of every block over that of maximum likelihood on the same data; inaccurate answers count too."""
    best, leg = hx.estimate(loop, hx.MaximumLikelihood()), robot.leg(3)
    values, parameters = state.moments[-1].values, loop.parameters
    return [rms(values, parameters, leg, name) / rms(best.values, parameters, leg, name) for name in CASES[lock][1]]


# --- against maximum likelihood


@pytest.mark.parametrize("lock", CASES)
def test_from_the_first_poses_it_is_maximum_likelihood(left_hand, lock):
    loop = loop_of(left_hand, lock, n_sets=100)
    state = hx.Unscented().scan(loop)
    assert state.estimate.ok.all()
    assert max(ratios(left_hand, lock, state, loop)) < 1.01
    assert abs(state.nees(left_hand.leg(3))[:, -1].mean() / (7 if lock == "none" else 6) - 1) < 0.25


@pytest.mark.parametrize("lock", CASES)
@pytest.mark.parametrize(("width", "most"), [(0.1, 1.10), (0.5, 1.25)])
def test_from_a_prior_and_the_first_poses(left_hand, lock, width, most):
    loop = loop_of(left_hand, lock, n_sets=100)
    state = hx.Unscented(prior_of(left_hand, lock, width, 100)).scan(loop)
    assert max(ratios(left_hand, lock, state, loop)) < most
    assert state.estimate.ok.mean() > 0.97
    assert state.estimate.covariance_kind == "posterior"


@pytest.mark.parametrize(("width", "most"), [(0.1, 1.10), (0.5, 1.25)])
def test_from_a_prior_alone(left_hand, width, most):
    """The plain filter, on leg lengths: from the first pose on there is an estimate, and little is lost at N = 20."""
    loop = loop_of(left_hand, "none", n_sets=200)
    state = hx.Unscented(prior_of(left_hand, "none", width, 200), first=0).scan(loop)
    assert np.isfinite(state.nis).all()
    assert max(ratios(left_hand, "none", state, loop)) < most


@pytest.mark.parametrize("lock", ["direction", "length"])
def test_a_wide_prior_alone_is_overconfident_and_found_out(left_hand, lock):
    loop = loop_of(left_hand, lock, n_sets=60)
    state = hx.Unscented(prior_of(left_hand, lock, 2.0, 60), first=0).scan(loop)
    assert max(ratios(left_hand, lock, state, loop)) > 5
    assert np.median(state.nees(left_hand.leg(3))[:, -1]) > 10 * 6
    assert state.overconfident.mean() > 0.75
    found = state.estimate
    assert (found.codes[state.overconfident] == hx.Status.INACCURATE).all()
    assert np.isnan(found.values[state.overconfident]).all()
    assert max(ratios(left_hand, lock, hx.Unscented(prior_of(left_hand, lock, 2.0, 60)).scan(loop), loop)) < 1.1


def test_a_linear_equation_is_solved_exactly(left_hand):
    """An unknown offset only: the posterior of the Gaussian linear model."""
    leg = left_hand.leg(3)
    data = hx.simulate_leg(left_hand, 3, "none", 6, noise=PAPER, rng=1)
    points = {"platform_point": leg.platform_point, "base_point": leg.base_point}
    loop = hx.loops.LegLength(data, unknown="offset", **points)
    prior = hx.GaussianPrior({"offset": [15.2]}, {"offset": 0.02**2}, unit="cm")
    state = hx.Unscented(prior, first=0).scan(loop)
    matrix, rhs = loop.linear().whitened()
    information = 1 / 0.02**2 + (matrix**2).cumsum()
    expected = (15.2 / 0.02**2 + (matrix[:, 0] * rhs).cumsum()) / information
    np.testing.assert_allclose(state.history.values[:, 0], expected, rtol=1e-10)
    np.testing.assert_allclose(state.history.covariance[:, 0, 0], 1 / information, rtol=1e-9)


# --- the running estimate


def test_an_estimate_as_soon_as_there_is_one(left_hand):
    loop = loop_of(left_hand, "none", 12)
    state = hx.Unscented().start(loop)
    assert state.estimate.status is hx.Status.RANK_DEFICIENT
    assert len(state.estimate.unseen) == 7
    for i in range(12):
        state = hx.Unscented().step(state, loop.data.poses([i]))
        assert state.estimate.ok == (i + 1 >= 7)
        assert bool(state.estimate.unseen) == (i + 1 < 7)
        if i + 1 == 9:
            best = hx.estimate(hx.loops.LegLength(loop.data.poses(slice(0, 9))), hx.MaximumLikelihood())
            np.testing.assert_allclose(state.estimate.values, best.values, rtol=1e-6)
            np.testing.assert_allclose(state.estimate.covariance, best.covariance, rtol=1e-3, atol=1e-9)
    assert list(np.isfinite(state.nis)) == [False] * 10 + [True] * 2
    assert state.history.values.shape == (12, 7)
    scanned = hx.Unscented().scan(loop)
    assert np.array_equal(scanned.estimate.values, state.estimate.values)


def test_the_direction_stays_a_unit_vector(left_hand):
    found = hx.estimate(loop_of(left_hand, "direction", n_sets=4), hx.Unscented())
    n = found.params["direction"]
    np.testing.assert_allclose(np.linalg.norm(n, axis=-1), 1.0, rtol=1e-14)
    assert found.degrees_of_freedom == 3 * 20 - 8
    variance = np.einsum("...i,...ij,...j->...", n, found.covariance_of("direction"), n)
    assert np.abs(variance).max() < 1e-14 * np.trace(found.covariance_of("direction"), axis1=-2, axis2=-1).min()


@pytest.mark.parametrize("lock", CASES)
def test_a_bad_pose_is_flagged_and_left_out(left_hand, lock):
    loop, leg = loop_of(left_hand, lock, n_sets=3), left_hand.leg(3)
    position = np.array(loop.data.position)
    vector = position[:, 15] + loop.data.rotation[:, 15] @ leg.platform_point - leg.base_point
    position[:, 15] += 0.5 * vector / np.linalg.norm(vector, axis=-1)[:, None]
    bad = CASES[lock][0](replace(loop.data, position=position))
    trusting, careful = (hx.Unscented(level=0.99999, reject=reject).scan(bad) for reject in (False, True))
    assert trusting.flagged[:, 15].all()
    assert (trusting.estimate.codes == hx.Status.INACCURATE).all()
    assert careful.rejected[:, 15].all()
    assert careful.rejected.sum() == 3
    assert careful.estimate.ok.all()
    assert careful.estimate.degrees_of_freedom == trusting.estimate.degrees_of_freedom - loop.rows
    assert (careful.history.values[:, 15] == careful.history.values[:, 14]).all()


# --- contract and failures


def test_contract():
    check_estimator(hx.Unscented(), n_poses=14, claims=("exact", "scale", "frame", "rank"), exactness=1e-6)


def test_what_a_prior_decides_is_said(left_hand):
    prior = hx.GaussianPrior.around(left_hand.leg(3), 0.1)
    loop = loop_of(left_hand, "direction", 2)
    found = hx.estimate(loop, hx.Unscented(prior))
    assert found.ok
    assert found.decided
    assert bool(found.undetermined)
    enough = hx.estimate(loop_of(left_hand, "direction", 6), hx.Unscented(prior))
    assert enough.decided == ()
    with pytest.raises(hx.RankDeficientError, match="too few poses"):
        hx.estimate(loop, hx.Unscented())


def test_a_locked_leg_hides_its_base_from_its_lengths(left_hand):
    data = hx.simulate_leg(left_hand, 3, "direction", 20, noise=PAPER, rng=0)
    with pytest.raises(hx.RankDeficientError, match="across the leg's locked direction"):
        hx.estimate(hx.loops.LegLength(data), hx.Unscented())


def test_a_covariance_that_is_none_fails_alone(left_hand):
    loop = loop_of(left_hand, "none", 13, 3)
    state = hx.Unscented().scan(hx.loops.LegLength(loop.data.poses(slice(0, 12))))
    spread = state.spread.copy()
    spread[1] *= -1
    after = hx.Unscented().step(replace(state, spread=spread), loop.data.poses([12]))
    whole = hx.Unscented().scan(loop)
    assert list(after.estimate.codes) == [hx.Status.OPTIMAL, hx.Status.FAILED, hx.Status.OPTIMAL]
    assert np.isnan(after.estimate.values[1]).all()
    for i in (0, 2):
        np.testing.assert_allclose(after.estimate.values[i], whole.estimate.values[i], rtol=1e-12)


def test_a_set_that_stands_still_does_not_lower_the_freedom_of_others(left_hand):
    data = loop_of(left_hand, "none", 15, 3).data
    position, rotation, length = (np.array(part) for part in (data.position, data.rotation, data.length))
    position[1], rotation[1], length[1] = position[1, :1], rotation[1, :1], length[1, :1]
    mixed = hx.loops.LegLength(replace(data, position=position, rotation=rotation, length=length))
    found = hx.estimate(mixed, hx.Unscented())
    assert found.ok.tolist() == [True, False, True]
    assert found.degrees_of_freedom == 15 - 7


def test_bad_calls(left_hand):
    loop = loop_of(left_hand, "none", 10)
    with pytest.raises(hx.InputError, match="prior: expected a GaussianPrior, got Lasso"):
        hx.Unscented(hx.Lasso.around(left_hand.leg(3), 1.0))
    with pytest.raises(hx.InputError, match="first: expected a number of poses"):
        hx.Unscented(first=-1)
    for alpha in (0.0, "a"):
        with pytest.raises(hx.InputError, match="alpha: expected a spread"):
            hx.Unscented(alpha=alpha)
    for name in ("beta", "kappa"):
        with pytest.raises(hx.InputError, match=f"{name}: 1 value.s. are NaN"):
            hx.Unscented(**{name: np.nan})
    with pytest.raises(hx.InputError, match="kappa: expected more than -7, of 7 unknowns; got -7"):
        hx.Unscented(kappa=-7).start(loop)
    wrong = hx.Recursive().start(loop_of(left_hand, "direction"))
    with pytest.raises(hx.InputError, match=r"state: expected a UnscentedState, from .*; got RecursiveState"):
        hx.Unscented().step(wrong, loop.data.poses([0]))
    with pytest.raises(hx.InputError, match="level: expected a probability"):
        hx.Unscented(level=1.0)
    with pytest.raises(hx.InputError, match="start: expected a loop"):
        hx.Unscented().start(loop.data)
    with pytest.raises(hx.InputError, match="on the loop itself"):
        hx.estimate(loop_of(left_hand, "direction").linear(), hx.Unscented())
    with pytest.raises(hx.InputError, match="needs a noise model"):
        hx.estimate(hx.loops.LegLength(replace(loop.data, noise=None)), hx.Unscented())
    with pytest.raises(hx.InputError, match="initial guess"):
        hx.estimate(hx.loops.LegLength(replace(loop.data, nominal=None), gain=1.0), hx.Unscented())
    shared = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=np.eye(7) * 1e-4)
    with pytest.raises(hx.InputError, match="the poses share an error"):
        hx.estimate(loop_of(left_hand, "direction", noise=shared), hx.Unscented())
    partial = hx.GaussianPrior({"base_point": [0.0, 0.0, 0.0]}, {"base_point": 1.0})
    with pytest.raises(hx.RankDeficientError, match="platform_point"):
        hx.estimate(loop, hx.Unscented(partial, first=0))
