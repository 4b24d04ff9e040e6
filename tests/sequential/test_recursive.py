"""Pose by pose is the same as all at once: values, covariances, innovations, weights, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.sequential.linear_run import Gate, empty_run
from hexopt.testing import check_estimator

LOOPS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}
FILTERS = ["kalman", "information", "square_root"]
GLS = hx.LeastSquares(weights="model")
BAD = 11


def noise_of(robot, **kind):
    size = robot.size / 20
    return hx.NormalNoise(1e-3 * size, 1e-5, 1e-3 * size / robot.gains[2], coordinates="rotation_vector", **kind)


def loop_of(robot, lock, n_poses=20, n_sets=None, noise=None, rng=0):
    return LOOPS[lock](hx.simulate_leg(robot, 3, lock, n_poses, n_sets, noise=noise or noise_of(robot), rng=rng))


def same(found, expected):
    """Values to 1e-9 of their size and a millionth of their standard errors, and what goes with them."""
    assert np.abs(found.values - expected.values).max() <= 1e-9 * np.abs(expected.values).max()
    assert (np.abs(found.values - expected.values) <= 1e-6 * expected.standard_errors).all()
    scale = expected.standard_errors[..., :, None] * expected.standard_errors[..., None, :]
    assert np.abs((found.covariance - expected.covariance) / scale).max() < 1e-5
    np.testing.assert_allclose(found.chi2, expected.chi2, rtol=1e-6, atol=1e-6)
    assert found.degrees_of_freedom == expected.degrees_of_freedom
    assert np.array_equal(found.codes, expected.codes)


def stepped(filter_, loop, at=None):
    state = filter_.start(loop, at)
    for i in range(loop.data.n_poses):
        state = filter_.step(state, loop.data.poses([i]))
    return state


@pytest.mark.parametrize("kind", FILTERS)
@pytest.mark.parametrize("lock", LOOPS)
def test_ends_where_batch_least_squares_does(left_hand, lock, kind):
    loop = loop_of(left_hand, lock, n_sets=10)
    same(hx.estimate(loop, hx.Recursive(kind)), hx.estimate(loop.linear(), GLS))


@pytest.mark.parametrize("kind", FILTERS)
def test_on_every_robot(robot, kind):
    loop = loop_of(robot, "direction", n_sets=5)
    state = hx.Recursive(kind).scan(loop)
    same(state.estimate, hx.estimate(loop.linear(), GLS))
    assert all(run.filter is not None for run in state.runs)  # filterpy did take over


@pytest.mark.parametrize("kind", FILTERS)
def test_offset_and_gain(left_hand, kind):
    leg = left_hand.leg(3)
    data = hx.simulate_leg(left_hand, 3, "none", 10, 4, noise=noise_of(left_hand), rng=1)
    points = {"platform_point": leg.platform_point, "base_point": leg.base_point}
    loop = hx.loops.LegLength(data, unknown=("offset", "gain"), **points)
    same(hx.estimate(loop, hx.Recursive(kind)), hx.estimate(loop.linear(), GLS))


def test_shared_errors_are_carried(left_hand):
    """A common error of the poses, the error of a known estimate, and both through joined sets."""
    common = np.diag([0.05] * 3 + [1e-4] * 3 + [0.02]) ** 2
    noise = noise_of(left_hand, common_covariance=common)
    one, two, three = (loop_of(left_hand, lock, 12, 5, noise, rng) for rng, lock in enumerate(LOOPS))
    b = hx.estimate(two.linear(), GLS)
    carried = hx.loops.FixedLength(three.data, platform_point=b)
    for problem in (one.linear(), carried.linear(), hx.join(one, two)):
        expected = hx.estimate(problem, GLS)
        same(hx.estimate(problem, hx.Recursive()), expected)
        alone = hx.estimate(problem, hx.ConvexEstimator(hx.GroupHuber(1e6)))  # which does not see the shared part
        assert np.abs(expected.values - alone.values).max() > 1e-6
    fixed = hx.estimate(one.linear(), hx.LeastSquares())
    same(stepped(hx.Recursive(), one, at=fixed.values).estimate, hx.estimate(one.linear(), GLS))


@pytest.mark.parametrize("lock", LOOPS)
def test_history_is_batch_least_squares_of_the_poses_so_far(left_hand, lock):
    loop = loop_of(left_hand, lock, 9, 4)
    at = hx.estimate(loop.linear(), hx.LeastSquares())
    state = hx.Recursive().scan(loop)
    assert state.history.values.shape == (4, 9, loop.parameters.size)
    before = None
    for n in range(1, 10):
        now = state.history[:, n - 1]
        matrix, rhs = loop.linear(at=at).whitened()
        rows = n * loop.rows
        assert np.isnan(now.values).all() == (n < loop.minimum_poses)
        if n >= loop.minimum_poses:
            answers = [np.linalg.lstsq(matrix[i, :rows], rhs[i, :rows]) for i in range(4)]
            np.testing.assert_allclose(now.values, [answer[0] for answer in answers], rtol=1e-8, atol=1e-9)
            chi2 = np.array([((matrix[i, :rows] @ x[0] - rhs[i, :rows]) ** 2).sum() for i, x in enumerate(answers)])
            np.testing.assert_allclose(now.chi2, chi2, rtol=1e-5, atol=1e-6)
            if before is not None:  # what a pose adds to χ² is its innovation
                np.testing.assert_allclose(state.nis[:, n - 1], chi2 - before, rtol=1e-4, atol=1e-5)
            before = chi2
    assert np.isnan(state.nis[:, : loop.minimum_poses]).all()


@pytest.mark.parametrize("lock", LOOPS)
def test_poses_that_arrive_one_by_one(left_hand, lock):
    """With `at` it is the batch answer exactly; without, weights come from the running estimate."""
    loop = loop_of(left_hand, lock, 20, 30, hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01))
    fixed = hx.estimate(loop.linear(), hx.LeastSquares())
    batch = hx.estimate(loop.linear(), GLS)
    same(stepped(hx.Recursive(), loop, at=fixed.values).estimate, batch)
    live = stepped(hx.Recursive(), loop).estimate
    apart = (live.values - batch.values) / batch.standard_errors
    assert 0 < np.sqrt((apart**2).mean()) < 0.2


def test_a_scan_goes_on(left_hand):
    """Ten poses at once and ten more one by one are twenty, for given weights."""
    loop = loop_of(left_hand, "direction", 20, 3)
    half = hx.loops.FixedDirection(loop.data.poses(slice(0, 10)))
    state = hx.Recursive().scan(half)
    for i in range(10, 20):
        state = hx.Recursive().step(state, loop.data.poses([i]))
    at = hx.estimate(half.linear(), hx.LeastSquares())
    same(state.estimate, hx.estimate(loop.linear(at=at), GLS))
    assert state.history.batch_shape == (3, 20)


def test_shared_errors_of_poses_that_arrive(left_hand):
    """Without a place for the weights the shared errors are unknowns all the same."""
    noise = noise_of(left_hand, common_covariance=np.diag([0.05] * 3 + [1e-4] * 3 + [0.02]) ** 2)
    loop = loop_of(left_hand, "direction", 15, 20, noise)
    live, batch = stepped(hx.Recursive(), loop).estimate, hx.estimate(loop.linear(), GLS)
    apart = (live.values - batch.values) / batch.standard_errors
    assert np.sqrt((apart**2).mean()) < 0.2
    assert (live.standard_errors[:, 3:6] > 0.05).all()  # a shift of all poses moves the base point in full


def test_live_weights_take_nothing_from_the_nominal(left_hand):
    loop = loop_of(left_hand, "leg", 8)
    other = hx.loops.FixedLeg(replace(loop.data, nominal=left_hand.perturbed(3.0, rng=0).leg(3)))
    one, two = stepped(hx.Recursive(), loop), stepped(hx.Recursive(), other)
    assert np.array_equal(one.history.values, two.history.values, equal_nan=True)


def test_before_the_poses_determine_everything(left_hand):
    loop = loop_of(left_hand, "direction", 6)
    state = hx.Recursive().start(loop)
    assert state.n_poses == 0
    assert state.history.values.shape == (0, 9)
    assert not state.moments[0].values.flags.writeable
    assert state.estimate.status is hx.Status.RANK_DEFICIENT
    assert len(state.estimate.unseen) == 9
    assert state.nis.shape == (0,)
    assert not state.enough(base_point=10.0)
    assert state.enough_after(base_point=10.0) == 0
    for i in range(2):
        state = hx.Recursive().step(state, loop.data.poses([i]))
        assert state.estimate.status is hx.Status.RANK_DEFICIENT
        assert "base_point" in " ".join(state.estimate.unseen)
        assert np.isnan(state.estimate.values).all()
    state = hx.Recursive().step(state, loop.data.poses([2]))
    assert state.estimate.ok
    assert state.estimate.unseen == ()
    assert not np.isfinite(state.nis).any()


def test_a_set_that_stands_still_waits_alone(left_hand):
    loop = loop_of(left_hand, "leg", 8, 3)
    position, rotation = np.array(loop.data.position), np.array(loop.data.rotation)
    position[1], rotation[1] = position[1, :1], rotation[1, :1]
    mixed = hx.loops.FixedLeg(replace(loop.data, position=position, rotation=rotation))
    live, clean = stepped(hx.Recursive(), mixed), stepped(hx.Recursive(), loop)
    assert list(live.estimate.ok) == [True, False, True]
    assert len(live.waiting) == 8
    for i in (0, 2):
        np.testing.assert_allclose(live.estimate.values[i], clean.estimate.values[i], rtol=1e-12)
    with pytest.raises(hx.RankDeficientError, match="unseen: platform_point"):
        hx.estimate(mixed, hx.Recursive(), throw=True)


# --- innovations, bad poses, enough poses


def spoilt(loop):
    position = np.array(loop.data.position)
    position[..., BAD, :] += 0.05  # 50 standard deviations
    return type(loop)(replace(loop.data, position=position))


@pytest.mark.parametrize("lock", LOOPS)
def test_a_bad_pose_is_flagged_and_left_out(left_hand, lock):
    loop = loop_of(left_hand, lock, 20, 5)
    bad = spoilt(loop)
    at = hx.estimate(loop.linear(), hx.LeastSquares()).values
    seen = stepped(hx.Recursive(level=0.99999), bad, at)
    assert seen.flagged[:, BAD].all()
    assert not seen.rejected.any()
    left_out = stepped(hx.Recursive(level=0.99999, reject=True), bad, at)
    assert left_out.flagged.sum() == left_out.flagged[:, BAD].sum() == 5
    assert np.array_equal(left_out.rejected, left_out.flagged)
    others = np.delete(np.arange(20), BAD)
    without = type(loop)(loop.data.poses(others))
    if lock == "length":
        vars(without)["origin"] = bad.origin
    same(left_out.estimate, stepped(hx.Recursive(), without, at).estimate)
    assert left_out.consistent.all()
    assert not seen.consistent.any()
    assert seen.overconfident.all()


def test_innovations_are_chi_squared(left_hand):
    """Of normal errors 1 % is flagged at the level 0.99, the mean of ε is d, and 1 % of the sets is inconsistent."""
    loop = loop_of(left_hand, "direction", 20, 250)
    state = hx.Recursive("information", level=0.99).scan(hx.loops.FixedDirection(loop.data).linear(at=left_hand.leg(3)))
    tested = np.isfinite(state.nis)
    count = tested.sum()
    assert abs(state.flagged.sum() / count - 0.01) < 4 * np.sqrt(0.01 / count)
    assert abs(state.nis[tested].mean() - 3) < 4 * np.sqrt(6 / count)
    assert state.consistent.mean() > 0.96
    nees = state.nees(left_hand.leg(3))
    assert np.isnan(nees[:, :2]).all()
    assert abs(nees[:, -1].mean() - 6) < 4 * np.sqrt(12 / 250)


def test_enough_poses(left_hand):
    loop = loop_of(left_hand, "direction", 20, 3)
    state = hx.Recursive().scan(loop)
    error = state.predicted_error["base_point"]
    expected = np.sqrt(np.trace(state.estimate.covariance_of("base_point"), axis1=-2, axis2=-1))
    np.testing.assert_allclose(error[:, -1], expected)
    tolerance = float(error[1, 8])
    assert state.enough_after(base_point=tolerance)[1] == 9
    assert state.enough(base_point=tolerance)[1]
    assert list(state.enough(base_point=1e-9)) == [False] * 3
    assert list(state.enough_after(base_point=1e-9, platform_point=10.0)) == [0, 0, 0]
    one = hx.Recursive().scan(hx.loops.FixedDirection(loop.data[1]))
    assert one.enough(base_point=tolerance * (1 + 1e-9)) is True
    assert one.enough_after(base_point=tolerance * (1 + 1e-9)) == 9
    assert isinstance(one.consistent, bool)
    assert isinstance(one.overconfident, bool)
    with pytest.raises(hx.InputError, match="base_point: expected a tolerance > 0, got -1"):
        one.enough(base_point=-1)


def test_states_never_change(left_hand):
    loop = loop_of(left_hand, "leg", 8)
    for kind in FILTERS:
        filter_ = hx.Recursive(kind)
        state = filter_.start(loop)
        for i in range(6):
            state = filter_.step(state, loop.data.poses([i]))
        before = state.estimate.values.copy(), state.estimate.covariance.copy()
        one, two = (filter_.step(state, loop.data.poses([i])) for i in (6, 7))
        again = filter_.step(state, loop.data.poses([6]))
        assert np.array_equal(before[0], state.estimate.values)
        assert np.array_equal(before[1], state.estimate.covariance)
        assert np.array_equal(one.estimate.values, again.estimate.values)
        assert not np.array_equal(one.estimate.values, two.estimate.values)


# --- contract and failures


@pytest.mark.parametrize("kind", FILTERS)
def test_contract(kind):
    check_estimator(hx.Recursive(kind))


def test_contract_on_an_ill_conditioned_robot():
    check_estimator(hx.Recursive(level=0.99999, reject=True), robot=hx.robots.rubin(), tolerance=1e-5)


def test_a_covariance_that_is_none_is_a_failure(left_hand):
    loop = loop_of(left_hand, "leg", 8)
    matrix, rhs = (part.reshape(8, 3, *part.shape[1:]) for part in loop.linear().whitened())
    gate, run = Gate(np.inf, False), empty_run(6)
    for i in range(6):
        run = run.after(matrix[i], rhs[i], "kalman", gate)
    assert run.code is hx.Status.OPTIMAL
    run.filter.P = -run.filter.P
    broken = run.after(matrix[6], rhs[6], "kalman", gate)
    assert broken.code is hx.Status.FAILED
    assert broken.after(matrix[7], rhs[7], "kalman", gate).code is hx.Status.FAILED


def spoilt_estimate(robot, member):
    """A platform point from Type II, of which one set of six has failed."""
    b = hx.estimate(loop_of(robot, "leg", 10, 6).linear(), hx.LeastSquares())
    bad = (np.arange(6) == member)[:, None]
    return b, replace(
        b,
        values=np.where(bad, np.nan, b.values),
        codes=np.where(bad[:, 0], hx.Status.NOT_CONVERGED, b.codes),
        covariance=np.where(bad[..., None], np.nan, b.covariance),
    )


@pytest.mark.parametrize("kind", FILTERS)
def test_a_known_value_that_failed_fails_alone(left_hand, kind):
    b, bad = spoilt_estimate(left_hand, 2)
    data = loop_of(left_hand, "length", 15, 6, rng=1).data
    loop, clean = (hx.loops.FixedLength(data, platform_point=known) for known in (bad, b))
    expected = hx.estimate(clean, hx.Recursive(kind))
    for found in (hx.estimate(loop, hx.Recursive(kind)), stepped(hx.Recursive(kind), loop, clean.start()).estimate):
        assert found.ok.tolist() == [True, True, False, True, True, True]
        assert found.codes[2] == hx.Status.RANK_DEFICIENT
        assert found.unseen == tuple(loop.parameters.labels)
        assert found.degrees_of_freedom == expected.degrees_of_freedom
    found = hx.estimate(loop, hx.Recursive(kind))
    np.testing.assert_array_equal(found.values[found.ok], expected.values[found.ok])


def test_degrees_of_freedom_are_those_of_the_successes(left_hand):
    """Not of a member that failed with fewer rows that count; where none is good, the least of all."""
    state = hx.Recursive().scan(loop_of(left_hand, "length", 15, 6))
    last, bad = state.moments[-1], np.arange(6) == 2
    for failed, rows in ((bad, 15), (bad | True, 5)):
        codes = np.where(failed, hx.Status.FAILED, last.codes)
        now = replace(last, codes=codes, rows=np.where(bad, 5, last.rows))
        assert replace(state, moments=(*state.moments[:-1], now)).estimate.degrees_of_freedom == rows - 4
    assert state.freedom.shape == (6, 15)
    np.testing.assert_array_equal(state.freedom[0], np.maximum(np.arange(1, 16) - 4, 0))


def test_history_says_what_early_poses_did_not_see(left_hand):
    loop = loop_of(left_hand, "direction", 8)
    state = hx.Recursive().start(loop)
    early = []
    for i in range(8):
        state = hx.Recursive().step(state, loop.data.poses([i]))
        early.append(state.estimate)
    assert early[0].unseen
    assert state.estimate.unseen == ()
    assert state.history.unseen == early[0].unseen == state.history[0].unseen
    assert state.history[7].unseen == ()
    assert state.history.degrees_of_freedom == state.estimate.degrees_of_freedom == state.freedom[-1]
    assert [one.degrees_of_freedom for one in early[3:]] == state.freedom[3:].tolist()


def test_bad_calls(left_hand):
    loop = loop_of(left_hand, "direction", 6, 2)
    filter_ = hx.Recursive()
    state = filter_.start(loop)
    silent = replace(loop.data, noise=None)
    with pytest.raises(hx.InputError, match="filter: expected 'kalman'"):
        hx.Recursive("extended")
    for level in (3.0, "a", None, np.nan):
        with pytest.raises(hx.InputError, match="level: expected a probability"):
            hx.Recursive(level=level)
    other = hx.Unscented().start(loop)
    for wrong in (3, other):
        with pytest.raises(hx.InputError, match=r"state: expected a RecursiveState, from start\(\) or scan\(\); got"):
            filter_.step(wrong, loop.data.poses([0]))
    with pytest.raises(hx.InputError, match="leg 3 was measured, and leg 4 is given"):
        filter_.step(state, replace(loop.data, nominal=left_hand.leg(4)).poses([0]))
    with pytest.raises(hx.InputError, match="reject: expected True or False"):
        hx.Recursive(reject=0.99)
    with pytest.raises(hx.InputError, match=r'consecutive form mixes poses: write loop.linear\(form="direct"\)'):
        hx.estimate(loop.linear("consecutive"), filter_)
    with pytest.raises(hx.InputError, match="needs a noise model"):
        hx.estimate(hx.loops.FixedDirection(silent), filter_)
    with pytest.raises(hx.InputError, match="needs a noise model"):
        filter_.step(state, silent.poses([0]))
    with pytest.raises(hx.InputError, match="expected one pose, got 2"):
        filter_.step(state, loop.data.poses([0, 1]))
    with pytest.raises(hx.InputError, match=r"runs over \(2,\) sets"):
        filter_.step(state, loop.data[0].poses([0]))
    with pytest.raises(hx.LockError, match="runs under the lock 'direction'"):
        filter_.step(state, replace(loop.data, lock="none").poses([0]))
    with pytest.raises(hx.UnitError, match="runs in cm"):
        filter_.step(state, replace(loop.data, nominal=None, length_unit="mm").poses([0]))
    with pytest.raises(hx.InputError, match="expected LegMeasurements of one pose, got int"):
        filter_.step(state, 1)
    with pytest.raises(hx.InputError, match="start: expected a loop"):
        filter_.start(loop.linear())
    with pytest.raises(hx.InputError, match=r"from start\(loop\) or scan\(loop\)"):
        filter_.step(filter_.scan(loop.linear()), loop.data.poses([0]))
    with pytest.raises(hx.InputError, match="unknown parameter 'offset'"):
        state.enough(offset=0.1)
    with pytest.raises(hx.InputError, match=r"enough\(base_point=0.05\)"):
        state.enough()
    with pytest.raises(hx.InputError, match="nees: expected a Leg"):
        filter_.scan(loop).nees(left_hand)
    with pytest.raises(hx.InputError, match="is linear in"):
        filter_.start(hx.loops.LegLength(replace(loop.data, lock="none")))
