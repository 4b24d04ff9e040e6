"""Moved poses keep the clamp and the limits, are never worse, and say by how much they are better."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.arrays import norm
from hexopt.kinematics import leg_vector
from hexopt.measurements import Lock
from hexopt.selection.refinement import moved

LOOPS = {
    "direction": hx.loops.FixedDirection,
    "leg": hx.loops.FixedLeg,
    "length": hx.loops.FixedLength,
    "none": hx.loops.LegLength,
}
NOISE = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)


def pool_of(robot, lock, n=150, **kind):
    return hx.candidates(robot, 3, lock, n, NOISE, rng=0, **kind)


def design_of(robot, lock, n=9, criterion="A", **kind):
    return hx.select_poses(LOOPS[lock](pool_of(robot, lock).leg(3)), n, criterion, **kind)


def vectors_of(robot, data):
    leg = robot.leg(3)
    return leg_vector(leg.platform_point, leg.base_point, data.position, data.rotation)


def held_spread(robot, lock, data, other):
    """By how much what the lock holds of a set differs from another set's."""
    one, two = vectors_of(robot, data), vectors_of(robot, other)[:1]
    if lock == "direction":
        one, two = one / norm(one)[:, None], two / norm(two)[:, None]
    return np.abs(norm(one) - norm(two) if lock == "length" else one - two).max()


@pytest.mark.parametrize("lock", LOOPS)
def test_better_on_the_clamp_within_the_limits_with_exact_readings(left_hand, lock):
    design = design_of(left_hand, lock)
    better = hx.refine_poses(design, left_hand, rounds=15, rng=0)
    assert better.value < 0.97 * design.value
    assert hx.reachable(left_hand, better.poses.position, better.poses.rotation).all()
    if lock != "none":
        assert held_spread(left_hand, lock, better.poses, design.poses) < 1e-12 * left_hand.size
    readings = hx.inverse_kinematics(left_hand, better.poses.position, better.poses.rotation)[:, 2]
    np.testing.assert_allclose(better.poses.length, readings, rtol=0, atol=1e-12)
    assert np.array_equal(better.indices, design.indices)
    assert np.isnan(better.bound)
    assert np.isnan(better.efficiency)
    assert not better.proven
    share = 1 - better.value / design.value
    assert f"makes A better by {share:.2%} of the variance" in better.summary()


@pytest.mark.parametrize("criterion", ["A", "D", "E", "kappa", "O2"])
def test_the_value_is_that_of_a_new_question_over_the_poses(left_hand, criterion):
    design = design_of(left_hand, "direction", criterion=criterion)
    better = hx.refine_poses(design, left_hand, rounds=5, rng=0)
    alone = design.question.over(better.poses).objective()
    before = design.question.over(design.poses).objective()
    ones = np.ones(9)
    if criterion != "kappa":  # its unit of a nuisance is that of all poses at hand
        assert np.isclose(alone.value(ones), better.value, rtol=1e-9)
        assert np.isclose(before.value(ones), design.value, rtol=1e-9)
        assert better.value < design.value
    np.testing.assert_allclose(
        better.covariance, hx.loops.FixedDirection(better.poses).crlb(left_hand.leg(3)), rtol=1e-6, atol=1e-12
    )


def test_a_user_condition_holds(left_hand):
    def low(position, rotation):
        return position[:, 2] < 21.0

    pool = pool_of(left_hand, "direction", accept=low)
    design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 7)
    better = hx.refine_poses(design, left_hand, accept=low, rounds=15, rng=0)
    assert better.value < design.value
    assert (better.poses.position[:, 2] < 21.0).all()
    free = hx.refine_poses(design, left_hand, rounds=15, rng=0)
    assert (free.poses.position[:, 2] >= 21.0).any()  # the condition did bind


def test_what_was_measured_counts_and_stays(left_hand):
    loop = hx.loops.FixedDirection(pool_of(left_hand, "direction").leg(3))
    known = hx.loops.FixedDirection(hx.candidates(left_hand, 3, "direction", 5, NOISE, rng=9).leg(3))
    design = hx.select_poses(loop, 3, measured=known)
    better = hx.refine_poses(design, left_hand, rounds=10, rng=0)
    assert better.value < design.value
    assert better.poses.n_poses == 3
    both = hx.select_poses(hx.loops.FixedDirection(better.poses), 3, measured=known)
    assert np.isclose(both.value, better.value, rtol=1e-9)


@pytest.mark.parametrize("lock", ["none", "direction"])
def test_a_whole_robot(left_hand, lock):
    pool = pool_of(left_hand, lock)
    design = hx.select_poses(hx.loops.WholeRobot(pool, unknown=("platform_point", "base_point")), 8, starts=2)
    better = hx.refine_poses(design, left_hand, rounds=2, neighbours=8, rng=0)
    assert better.value < design.value
    readings = hx.inverse_kinematics(left_hand, better.poses.position, better.poses.rotation)
    np.testing.assert_allclose(better.poses.length, readings, rtol=0, atol=1e-12)
    again = hx.loops.WholeRobot(better.poses, unknown=("platform_point", "base_point"))
    assert np.isclose(np.trace(again.crlb(left_hand)), better.value, rtol=1e-6)


def test_repeated_poses_are_moved_each_for_itself(left_hand):
    design = hx.select_poses(hx.loops.FixedLeg(pool_of(left_hand, "leg", 6).leg(3)), 8, repeat=True)
    assert len(set(design.indices)) < 8
    better = hx.refine_poses(design, left_hand, rounds=10, rng=0)
    assert better.value < design.value
    assert len(np.unique(better.poses.position, axis=0)) == 8


def test_the_same_seed_gives_the_same_poses_and_a_refined_design_can_be_refined(left_hand):
    design = design_of(left_hand, "leg", 5)
    one, two = (hx.refine_poses(design, left_hand, rounds=3, rng=4) for _ in range(2))
    assert np.array_equal(one.poses.position, two.poses.position)
    assert one.value == two.value
    again = hx.refine_poses(one, left_hand, rounds=20, rng=5)
    assert again.value < one.value


def test_poses_that_cannot_move_stay(left_hand):
    design = design_of(left_hand, "leg", 5)
    home = design.poses

    def only_these(position, rotation):
        return (np.abs(position[:, None] - home.position).max(axis=-1) == 0).any(axis=1)

    same = hx.refine_poses(design, left_hand, accept=only_these, rounds=3, rng=0)
    assert same.value == design.value
    assert same.bound == design.bound
    assert "no pose that was moved is better" in same.stopped


@given(
    st.sampled_from(list(Lock)),
    st.lists(st.floats(-0.5, 0.5), min_size=6, max_size=6),
    st.integers(0, 2**31),
)
def test_steps_keep_what_the_lock_holds(lock, step, seed):
    robot = hx.robots.left_hand()
    data = hx.candidates(robot, 3, "none", 1, rng=seed).leg(3)
    position, rotation = moved(robot.leg(3), lock, data.position, data.rotation, np.array([step]))
    before = vectors_of(robot, data)[0]
    after = vectors_of(robot, data.moved_to(position, rotation, None))[0]
    np.testing.assert_allclose(rotation[0] @ rotation[0].T, np.eye(3), atol=1e-14)
    if lock is Lock.LEG:
        np.testing.assert_allclose(after, before, atol=1e-12)
    if lock is Lock.DIRECTION:
        np.testing.assert_allclose(np.cross(after, before), 0, atol=1e-10)
        assert after @ before > 0
    if lock is Lock.LENGTH:
        assert np.isclose(norm(after), norm(before), rtol=1e-13)
    if lock is Lock.NONE:
        np.testing.assert_allclose(after - before, norm(before) * np.array(step[:3]), atol=1e-12)


def test_what_is_refused(left_hand):
    design = design_of(left_hand, "leg", 4)
    with pytest.raises(hx.errors.InputError, match="expected a Design"):
        hx.refine_poses(design.poses, left_hand, rng=0)
    with pytest.raises(hx.errors.InputError, match="rounds"):
        hx.refine_poses(design, left_hand, rounds=0, rng=0)
    with pytest.raises(hx.errors.InputError, match="rng"):
        hx.refine_poses(design, left_hand, rng=None)
    with pytest.raises(hx.errors.InputError, match="robot"):
        hx.refine_poses(design, left_hand.leg(3), rng=0)
    with pytest.raises(hx.errors.InputError, match="off one clamp of"):
        hx.refine_poses(design, left_hand.perturbed(0.5, rng=0), rng=0)
    narrow = replace(left_hand, limits=replace(left_hand.limits, angles=(0.01, 0.01, 0.01)))
    with pytest.raises(hx.errors.InputError, match="outside the limits of this robot"):
        hx.refine_poses(design, narrow, rng=0)
    with pytest.raises(hx.errors.InputError, match="expected a mask"):
        hx.refine_poses(design, left_hand, accept=lambda position, rotation: True, rng=0)
    with pytest.raises(hx.errors.InputError, match="has no limits on leg lengths and angles"):
        hx.refine_poses(design, replace(left_hand, limits=hx.Limits()), rng=0)
    bare = replace(design, poses=None)
    with pytest.raises(hx.errors.InputError, match="bare information"):
        hx.refine_poses(bare, left_hand, rng=0)
    problem = hx.loops.FixedLeg(pool_of(left_hand, "leg", 50).leg(3)).linear()
    with pytest.raises(hx.errors.InputError, match="bare information"):
        hx.refine_poses(hx.select_poses(problem, 4), left_hand, rng=0)
