"""What cannot be estimated: one member of a batch fails alone, a single problem says what it does not see."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import RankDeficientError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength
from hexopt.robots import BUILT_IN
from hexopt.rotations import rotation_vector_to_matrix

LOOPS = {"direction": FixedDirection, "leg": FixedLeg, "length": FixedLength}
ESTIMATORS = [
    hx.LeastSquares(),
    hx.LeastSquares(method="svd"),
    hx.LeastSquares(method="normal"),
    hx.LeastSquares(weights="model"),
    hx.ConvexEstimator(weights=None),
    hx.ConvexEstimator(),
]


def posed(robot, data, *, rotation=None, length=None, direction=None):
    """Exact measurements of leg 3 with some of rotation, true length and direction replaced."""
    leg = robot.leg(3)
    rotation = np.array(data.rotation if rotation is None else rotation)
    true = leg.true_length(data.length) if length is None else np.broadcast_to(length, data.length.shape)
    vectors = data.position + data.rotation @ leg.platform_point - leg.base_point
    unit = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True) if direction is None else direction
    position = leg.base_point + true[..., None] * unit - rotation @ leg.platform_point
    return replace(data, position=position, rotation=rotation, length=leg.reading(true))


def identical(robot, data):
    return replace(
        data,
        position=np.repeat(data.position[..., :1, :], data.n_poses, axis=-2),
        rotation=np.repeat(data.rotation[..., :1, :, :], data.n_poses, axis=-3),
        length=np.repeat(data.length[..., :1], data.n_poses, axis=-1),
    )


def equal_lengths(robot, data):
    return posed(robot, data, length=robot.leg(3).true_length(data.length)[..., :1])


def one_axis(robot, data, seed=0):
    rng = np.random.default_rng(seed)
    shape = data.rotation.shape[:-2]
    axis = rng.standard_normal((*shape[:-1], 1, 3))
    axis /= np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = rng.uniform(-1, 1, (*shape, 1)) * max(robot.ranges.angles)
    return posed(robot, data, rotation=rotation_vector_to_matrix(axis * angle) @ robot.home_rotation)


def coplanar(robot, data, seed=0):
    """All V on one plane: directions on a cone about the home direction, at the same length."""
    rng = np.random.default_rng(seed)
    third = robot.home_vectors[2] / robot.home_lengths[2]
    first = np.cross(third, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    around = rng.uniform(0, 2 * np.pi, data.length.shape)
    half = 0.7 * robot.ranges.cone
    direction = (
        np.sin(half) * (np.cos(around)[..., None] * first + np.sin(around)[..., None] * np.cross(third, first))
        + np.cos(half) * third
    )
    return posed(robot, data, direction=direction)


CASES = [
    ("direction", identical),
    ("direction", equal_lengths),
    ("direction", one_axis),
    ("leg", identical),
    ("leg", one_axis),
    ("length", identical),
    ("length", coplanar),
]


@pytest.mark.parametrize(("lock", "spoil"), CASES)
@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_no_form_misses_what_the_data_do_not_determine(robot, lock, spoil):
    """Differences of nearly equal numbers are rounding: no form may take them for information."""
    model = BUILT_IN[robot]()
    for n in (4, 5, 20):
        data = spoil(model, hx.simulate_leg(model, 3, lock, n, 200, rng=n))
        for form in LOOPS[lock].forms:
            for method in ("auto", "svd"):
                found = hx.estimate(LOOPS[lock](data).linear(form), hx.LeastSquares(method=method))
                assert set(found.status) == {hx.Status.RANK_DEFICIENT}, form
                assert np.isnan(found.values).all()


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
@pytest.mark.parametrize(("lock", "spoil"), CASES)
@pytest.mark.filterwarnings("ignore:normal equations")
def test_a_spoilt_member_fails_alone(left_hand, paper_noise, lock, spoil, estimator):
    good = hx.simulate_leg(left_hand, 3, lock, 6, 6, noise=paper_noise, rng=0)
    spoilt = spoil(left_hand, hx.simulate_leg(left_hand, 3, lock, 6, 6, rng=1))
    mixed = replace(
        good,
        **{
            name: np.where(
                np.isin(np.arange(6), [2, 5]).reshape(6, *[1] * (getattr(good, name).ndim - 1)),
                getattr(spoilt, name),
                getattr(good, name),
            )
            for name in ("position", "rotation", "length")
        },
    )
    for form in LOOPS[lock].forms:
        found, clean = (hx.estimate(LOOPS[lock](d).linear(form), estimator) for d in (mixed, good))
        bad = [status is hx.Status.RANK_DEFICIENT for status in found.status]
        assert bad == [False, False, True, False, False, True]
        assert np.isnan(found.values[bad]).all()
        rest = [0, 1, 3, 4]
        np.testing.assert_allclose(found.values[rest], clean.values[rest], atol=1e-10)
        np.testing.assert_allclose(found.covariance[rest], clean.covariance[rest], rtol=1e-7, atol=1e-14)
        assert found.unseen
        for i in (2, 5):
            with pytest.raises(RankDeficientError, match="do not determine all parameters; unseen: "):
                hx.estimate(LOOPS[lock](mixed[i]).linear(form), estimator)


def combinations(loop, form="direct", estimator=None):
    with pytest.raises(RankDeficientError) as caught:
        hx.estimate(loop.linear(form), estimator or hx.LeastSquares())
    assert "\n" not in str(caught.value)
    for words in caught.value.combinations:
        assert words in str(caught.value)
    return caught.value.combinations


class TestTheUnseenCombinationIsNamed:
    def test_identical_poses(self, left_hand):
        for lock, kind in LOOPS.items():
            data = identical(left_hand, hx.simulate_leg(left_hand, 3, lock, 6, rng=0))
            loop = kind(data)
            for form in set(kind.forms) - {"direct"}:
                unseen = combinations(loop, form)
                names = [f"{name}.{axis}" for name in loop.unknown for axis in "xyz"]
                assert list(unseen) == names

    def test_equal_lengths_in_type_one(self, left_hand):
        data = equal_lengths(left_hand, hx.simulate_leg(left_hand, 3, "direction", 6, rng=0))
        unseen = combinations(FixedDirection(data), "consecutive")
        assert list(unseen) == ["base_point.x", "base_point.y", "base_point.z"]
        length = left_hand.leg(3).true_length(data.length)[0]
        direct = combinations(FixedDirection(data))  # a moves, and ℓ n takes it back
        assert list(direct) == [f"base_point.{axis} − {1 / length:.2g}·direction.{axis}" for axis in "xyz"]

    @pytest.mark.parametrize("axis", ["x", "y", "z"])
    def test_rotations_about_one_axis(self, left_hand, axis):
        """What turns about one axis says nothing of b along it."""
        data = hx.simulate_leg(left_hand, 3, "leg", 6, rng=0)
        turn = rotation_vector_to_matrix(np.linspace(-0.5, 0.5, 6)[:, None] * np.eye(3)["xyz".index(axis)])
        data = posed(left_hand, data, rotation=turn)
        assert combinations(FixedLeg(data), "consecutive") == (f"platform_point.{axis}",)
        assert combinations(FixedLeg(data), "centred") == (f"platform_point.{axis}",)
        assert combinations(FixedLeg(data)) == (f"platform_point.{axis} + fixed_point.{axis}",)

    def test_coplanar_points_in_type_three(self, left_hand):
        robot = replace(left_hand, platform_points=left_hand.platform_points - [0, 0, 1.0])
        data = hx.simulate_leg(robot, 3, "length", 6, rng=0)
        leg = robot.leg(3)
        around = np.linspace(0, 5, 6)
        direction = np.stack([0.6 * np.cos(around), 0.6 * np.sin(around), np.full(6, 0.8)], axis=-1)
        unseen = combinations(FixedLength(posed(robot, data, direction=direction)), "consecutive")
        assert unseen == ("base_point.z",)
        (direct,) = combinations(FixedLength(posed(robot, data, direction=direction)))
        assert direct.startswith("base_point.z ")
        assert "sphere" in direct
        assert leg.number == 3

    def test_inverse_kinematics_about_one_axis(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "none", 20, rng=0)
        turn = rotation_vector_to_matrix(np.linspace(-0.5, 0.5, 20)[:, None] * [0, 0, 1.0])
        data = posed(left_hand, data, rotation=turn)
        with pytest.raises(RankDeficientError) as caught:
            hx.estimate(LegLength(data), hx.InverseKinematics())
        assert caught.value.combinations == ("platform_point.z + base_point.z",)

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_inverse_kinematics_on_the_legs_own_locked_set(self, left_hand, lock):
        data = hx.simulate_leg(left_hand, 3, lock, 20, rng=0)
        with pytest.raises(RankDeficientError) as caught:
            hx.estimate(LegLength(data), hx.InverseKinematics())
        assert len(caught.value.combinations) == 3
        assert {name for words in caught.value.combinations for name in ("base_point", "offset") if name in words} == {
            "base_point",
            "offset",
        }


class TestTooFewPoses:
    @pytest.mark.parametrize(
        ("lock", "n", "form"),
        [
            ("direction", 2, "direct"),
            ("direction", 2, "consecutive"),
            ("leg", 1, "direct"),
            ("length", 3, "direct"),
            ("length", 3, "consecutive"),
            ("length", 3, "centred"),
        ],
    )
    def test_fewer_equations_than_unknowns(self, left_hand, lock, n, form):
        for n_sets in (None, 5):
            loop = LOOPS[lock](hx.simulate_leg(left_hand, 3, lock, n, n_sets, rng=0))
            for estimator in (hx.LeastSquares(), hx.ConvexEstimator(weights=None)):
                with pytest.raises(
                    RankDeficientError, match=r"too few poses: \d+ equations for \d+ unknowns"
                ) as caught:
                    hx.estimate(loop.linear(form), estimator, throw=False)
                assert f"at least {loop.minimum_poses} poses" in str(caught.value)
                assert caught.value.combinations

    def test_two_poses_of_type_two_have_the_rows_but_not_the_rank(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "leg", 2, rng=0)
        for form in FixedLeg.forms:
            assert len(combinations(FixedLeg(data), form)) == 1

    def test_inverse_kinematics(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "none", 6, rng=0)
        with pytest.raises(RankDeficientError, match=r"6 equations for 7 unknowns.*LegLength needs at least 7 poses"):
            hx.estimate(LegLength(data), hx.InverseKinematics())


def test_digits_lost_by_a_difference_are_not_information():
    """Lengths that differ in the 14th digit: a is unseen, although the differenced matrix is well conditioned."""
    robot = hx.robots.left_hand()
    data = hx.simulate_leg(robot, 3, "direction", 6, rng=0)
    nearly = posed(robot, data, length=18.0 * (1 + 1e-14 * np.arange(6)))
    problem = FixedDirection(nearly).linear("consecutive")
    assert np.linalg.cond(problem.matrix / np.linalg.norm(problem.matrix, axis=0)) < 1e3
    assert combinations(FixedDirection(nearly), "consecutive") == ("base_point.x", "base_point.y", "base_point.z")


def test_normal_equations_that_square_themselves_to_death_say_so():
    """κ = 1e9 is full rank, but its square is not: the message must not invent an unseen combination."""
    rng = np.random.default_rng(0)
    u, v = np.linalg.qr(rng.standard_normal((9, 3))).Q, np.linalg.qr(rng.standard_normal((3, 3))).Q
    problem = hx.LinearProblem((u * [1, 1e-4, 1e-9]) @ v, np.ones(9), hx.Parameters((hx.Block("base_point", 3, "cm"),)))
    assert hx.estimate(problem, hx.LeastSquares()).ok
    with pytest.raises(
        RankDeficientError, match="unseen: nothing, but the normal equations square the condition number"
    ):
        hx.estimate(problem, hx.LeastSquares(method="normal"))


class TestBatchEqualsMembers:
    @pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
    @pytest.mark.parametrize("lock", LOOPS)
    @pytest.mark.filterwarnings("ignore:normal equations")
    def test_every_form(self, left_hand, paper_noise, lock, estimator):
        data = hx.simulate_leg(left_hand, 3, lock, 7, 6, noise=paper_noise, rng=0)
        for form in LOOPS[lock].forms:
            together = hx.estimate(LOOPS[lock](data).linear(form), estimator)
            for i in range(6):
                alone = hx.estimate(LOOPS[lock](data[i]).linear(form), estimator)
                size = np.abs(alone.values).max()
                np.testing.assert_allclose(together[i].values / size, alone.values / size, atol=1e-9)
                np.testing.assert_allclose(
                    together[i].covariance, alone.covariance, rtol=1e-6, atol=1e-9 * alone.covariance.max()
                )
                np.testing.assert_allclose(together[i].objective, alone.objective, rtol=1e-6)

    @pytest.mark.parametrize("estimator", ESTIMATORS[:5], ids=repr)
    @pytest.mark.parametrize("lock", LOOPS)
    def test_an_empty_batch(self, left_hand, paper_noise, lock, estimator):
        data = hx.simulate_leg(left_hand, 3, lock, 7, 2, noise=paper_noise, rng=0)[:0]
        for form in LOOPS[lock].forms:
            found = hx.estimate(LOOPS[lock](data).linear(form), estimator)
            assert found.batch_shape == (0,)
            assert found.covariance.shape == (0, found.parameters.size, found.parameters.size)
            assert len(found.to_frame()) == 0
