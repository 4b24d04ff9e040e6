"""Poses in turn: the end is the batch fit, the choice is as good as a design at the truth, nothing measured is lost."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.arrays import matvec, norm
from hexopt.errors import InputError, LockError, MeasuringError, RankDeficientError, UnitError
from hexopt.kinematics import leg_vector

LOOPS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}
NOISE = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)


class Lab:
    """A true robot that goes where the nominal sends it, on the same clamp, and is measured with noise."""

    def __init__(self, robot, nominal, noise=NOISE, seed=0):
        self.true, self.nominal, self.noise = robot.leg(3), nominal.leg(3), noise
        self.rng, self.asked = np.random.default_rng(seed), []

    def exact(self, pose):
        leg, true = self.nominal, self.true
        vectors = leg_vector(leg.platform_point, leg.base_point, pose.position, pose.rotation)
        position = true.base_point + vectors - matvec(pose.rotation, true.platform_point)
        return pose.moved_to(position, pose.rotation, true.reading(norm(vectors)))

    def __call__(self, pose):
        self.asked.append(pose)
        there = self.exact(pose)
        return there.moved_to(*self.noise.apply(there.position, there.rotation, there.length, self.rng))


def study(robot, lock, n=150, error=0.1, seed=0):
    """A loop over candidates of a nominal that is wrong, and a lab with the robot."""
    nominal = robot.perturbed(error, rng=seed)
    pool = hx.candidates(nominal, 3, lock, n, NOISE, rng=seed)
    known = {"platform_point": robot.leg(3).platform_point} if lock == "length" else {}
    return LOOPS[lock](pool.leg(3), **known), Lab(robot, nominal, seed=seed), known


@pytest.mark.parametrize("lock", LOOPS)
def test_ends_where_the_weighted_fit_of_the_same_poses_does(left_hand, lock):
    loop, lab, known = study(left_hand, lock)
    state = hx.SequentialDesign(8).run(loop, lab)
    assert state.done
    assert state.n_poses == 8
    assert len(set(state.order)) == 8
    assert state.measurements.n_poses == len(lab.asked) == 8
    batch = LOOPS[lock](state.measurements, **known)
    at = hx.estimate(batch.linear(), hx.LeastSquares(weights="model"))
    main = loop.parameters.main.size  # poses are weighed at the running estimate: a small share of an error
    assert (np.abs(state.estimate.values - at.values)[:main] < 0.3 * at.standard_errors[:main]).all()
    same = hx.Recursive().scan(batch)
    assert (np.abs(same.estimate.values - at.values) <= 1e-6 * at.standard_errors).all()


@pytest.mark.parametrize("lock", LOOPS)
def test_weighed_at_one_point_the_end_is_that_fit_to_rounding(left_hand, lock):
    loop, lab, known = study(left_hand, lock)
    state = hx.SequentialDesign(8).run(loop, lab)
    here = state.estimate.values
    batch = LOOPS[lock](state.measurements, **known)
    stepped = hx.Recursive().start(batch, at=here)
    for i in range(8):
        stepped = hx.Recursive().step(stepped, state.measurements.poses([i]))
    fit = hx.estimate(batch.linear(at=here), hx.LeastSquares(weights="model"))
    assert (np.abs(stepped.estimate.values - fit.values) <= 1e-6 * fit.standard_errors).all()


@pytest.mark.parametrize("lock", LOOPS)
@pytest.mark.parametrize("error", [0.1, 0.5])
def test_as_good_as_the_design_that_knows_the_truth(left_hand, lock, error):
    loop, lab, known = study(left_hand, lock, error=error)
    state = hx.SequentialDesign(8).run(loop, lab)
    truth = LOOPS[lock](lab.exact(loop.data), **known)
    best = hx.select_poses(truth, 8, at=left_hand.leg(3))
    counts = np.bincount(state.order, minlength=150)
    assert best.question.objective().value(counts) < 1.03 * best.value


def test_every_state_knows_what_it_promises(left_hand):
    loop, lab, _ = study(left_hand, "direction")
    plan = hx.SequentialDesign(6)
    state = plan.start(loop)
    assert state.measurements is None
    assert state.values == ()
    assert state.n_poses == 0
    while not state.done:
        before = state
        state = plan.step(state, lab(state.pose))
        assert state.order[:-1] == before.order
        assert state.order[-1] == before.next
    values = np.array(state.values)
    assert np.isinf(values[0])
    assert np.isfinite(values[-1])
    assert (np.diff(values[np.isfinite(values)]) < 0).all()
    np.testing.assert_allclose(values[-1], np.trace(state.seen.crlb(state.estimate)), rtol=0.01)
    assert "6 of at most 6 poses" in state.summary()
    assert "± base_point" in state.summary()
    with pytest.raises(InputError, match="all 6 poses are measured"):
        plan.step(state, lab.asked[0])
    with pytest.raises(InputError, match="all 6 poses are measured"):
        _ = state.pose


def test_stops_when_it_is_enough(left_hand):
    loop, lab, _ = study(left_hand, "direction")
    state = hx.SequentialDesign(20).run(loop, lab, {"base_point": 0.06})
    errors = state.running.predicted_error["base_point"]
    assert state.n_poses < 20
    assert errors[-1] <= 0.06
    assert not (errors[:-1] <= 0.06).any()
    with pytest.raises(InputError, match="depth"):
        hx.SequentialDesign(5).run(loop, lab, {"depth": 0.1})
    with pytest.raises(InputError, match=r"tolerances: expected a dict such as {'base_point': 0\.05}, got 0\.1"):
        hx.SequentialDesign(5).run(loop, lab, 0.1)


def test_a_state_with_more_poses_than_the_plan_has(left_hand):
    loop, lab, _ = study(left_hand, "leg", n=20)
    state = hx.SequentialDesign(5).start(loop)
    for _ in range(4):
        state = hx.SequentialDesign(5).step(state, lab(state.pose))
    with pytest.raises(InputError, match="step: all 4 poses are measured"):
        hx.SequentialDesign(4).step(state, lab(state.pose))


def test_a_candidate_may_be_measured_again(left_hand):
    loop, lab, _ = study(left_hand, "leg", n=6)
    state = hx.SequentialDesign(9, repeat=True).run(loop, lab)
    assert state.n_poses == 9
    assert len(set(state.order)) < 9
    with pytest.raises(InputError, match="6 candidates"):
        hx.SequentialDesign(9).start(loop)


def test_a_bad_pose_is_told(left_hand):
    loop, lab, _ = study(left_hand, "direction")

    def measure(pose):
        got = lab(pose)
        return got.moved_to(got.position + 0.5, got.rotation, got.length) if len(lab.asked) == 6 else got

    state = hx.SequentialDesign(8, filter=hx.Recursive(reject=True)).run(loop, measure)
    assert state.running.flagged[5]
    assert "do not fit those before them: pose 6" in state.summary()


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [
        (lambda pose: None, InputError),
        (lambda pose: replace(pose, lock="leg"), LockError),
        (lambda pose: replace(pose, nominal=None, length_unit="mm"), UnitError),
        (lambda pose: replace(pose, noise=None), InputError),
        (lambda pose: pose.poses([0, 0]), InputError),
        (lambda pose: 1 / 0, ZeroDivisionError),
    ],
)
def test_what_was_measured_is_not_lost(left_hand, spoil, cause):
    loop, lab, _ = study(left_hand, "direction")
    plan = hx.SequentialDesign(6)

    def measure(pose):
        return spoil(lab(pose)) if len(lab.asked) == 4 else lab(pose)

    with pytest.raises(MeasuringError, match=r"pose 5 \(candidate \d+\).*the 4 poses before it") as caught:
        plan.run(loop, measure)
    assert isinstance(caught.value.__cause__, cause)
    state = caught.value.state
    assert state.n_poses == 4
    assert state.running.estimate.ok
    assert plan.step(state, lab(state.pose)).n_poses == 5
    plain = pickle.loads(pickle.dumps(MeasuringError("gone", 3)))
    assert (str(plain), plain.state) == ("gone", 3)


def test_loops_that_are_refused(left_hand):
    plan = hx.SequentialDesign(8)
    free = hx.candidates(left_hand, 3, "none", 20, NOISE, rng=0)
    with pytest.raises(InputError, match="LegLength is linear in"):
        plan.start(hx.loops.LegLength(free.leg(3)))
    with pytest.raises(InputError, match="expected a loop such as"):
        plan.start(hx.loops.WholeRobot(free))
    data = hx.candidates(left_hand, 3, "leg", 20, NOISE, rng=0).leg(3)
    with pytest.raises(InputError, match="noise model"):
        plan.start(hx.loops.FixedLeg(replace(data, noise=None)))
    with pytest.raises(InputError, match="nominal leg"):
        plan.start(hx.loops.FixedLeg(replace(data, nominal=None)))
    with pytest.raises(RankDeficientError, match="fewer poses than parameters"):
        hx.SequentialDesign(1).start(hx.loops.FixedLeg(data))


@pytest.mark.parametrize("settings", [{"n": 0}, {"criterion": "B"}, {"repeat": 2}, {"filter": "kalman"}])
def test_wrong_settings(settings):
    with pytest.raises(InputError, match=next(iter(settings))):
        hx.SequentialDesign(**({"n": 5} | settings))
    with pytest.raises(InputError, match="expected a SequentialState"):
        hx.SequentialDesign(5).step(None, None)
