"""What poses see: against brute force, the Cramér–Rao bound, and null spaces that are known."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import InputError
from hexopt.information import pose_information
from hexopt.observing import observability_indices

ROBOT = hx.robots.left_hand()
LEG = ROBOT.leg(3)
NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
COMMON = hx.NormalNoise(0.005, 1e-4, 0.005, common_covariance=np.diag([0.02] * 3 + [2e-4] * 3 + [0.02]) ** 2)
KINDS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}
MODEL_48 = ("platform_point", "base_point", "offset", "gain")


def measured(lock, n=7, *, noise=NOISE, exact=False, rng=0, **given):
    """Poses of leg 3; `exact` ones are assumed to be noisy."""
    data = hx.simulate_leg(ROBOT, 3, lock, n, noise=None if exact else noise, rng=rng, **given)
    return replace(data, noise=noise)


def loop_of(lock, n=7, **given):
    return KINDS[lock](measured(lock, n, **given))


def one_axis(**given):
    return measured("leg", ranges=replace(ROBOT.ranges, angles=(np.deg2rad(35), 0, 0)), **given)


def whole_robot(n=7, noise=NOISE, **given):
    sets = [hx.simulate(ROBOT, "direction", n_poses=n, leg=k, rng=k, noise=noise) for k in range(1, 7)]
    return hx.loops.WholeRobot(*sets, **given)


def four_ways():
    """A loop of every kind, at the truth, all of which see everything."""
    sets = (hx.loops.FixedDirection(measured("direction", 6, rng=k), unknown=MODEL_48[:3]) for k in range(3))
    return {
        "direction": (loop_of("direction"), LEG),
        "leg": (loop_of("leg"), LEG),
        "length": (loop_of("length"), LEG),
        "lengths": (hx.loops.LegLength(measured("none", 15)), LEG),
        "gain": (hx.loops.LegLength(measured("none", 15), unknown=MODEL_48), LEG),
        "common": (loop_of("direction", noise=COMMON), LEG),
        "sets": (hx.loops.Sets(*sets), LEG),
        "robot": (whole_robot(), ROBOT),
        "pose": (hx.loops.PlatformPose(hx.simulate(ROBOT, n_poses=12, rng=0, noise=NOISE)), ROBOT),
    }


WAYS = four_ways()


@pytest.fixture(params=WAYS)
def way(request):
    """A loop and a point."""
    return WAYS[request.param]


# --- where everything is seen


def test_the_covariance_is_the_cramer_rao_bound(way):
    loop, at = way
    seen, bound = hx.observability(loop, at), loop.crlb(at)
    size = np.sqrt(np.diag(bound))
    assert np.abs((seen.covariance - bound) / size / size[:, None]).max() < 1e-7
    assert seen.standard_errors == pytest.approx(size, rel=1e-7)
    assert seen.determined.all()
    assert seen.unseen == ()
    assert seen.caveat == ""


def test_brute_force(way):
    """Information matrix, its inverse, its Schur complement and its eigenvalues, in scaled coordinates."""
    loop, at = way
    spread = {loop.parameters.names[0]: 0.5}
    seen, info = hx.observability(loop, at, spread=spread), pose_information(loop, at, spread=spread)
    total, k = info.total(np.ones(info.n_poses))[0], info.main
    inverse = np.linalg.inv(total)
    schur = total[:k, :k] - total[:k, k:] @ np.linalg.solve(total[k:, k:], total[k:, :k]) if k < info.size else total
    assert seen.labels == info.labels
    assert seen.units == info.units
    assert seen.spread == pytest.approx(info.spread)
    assert seen.rank == info.size == len(seen.singular_values)
    largest = seen.singular_values[0]
    assert seen.singular_values**2 == pytest.approx(np.linalg.eigvalsh(total)[::-1], abs=1e-10 * largest**2)
    assert seen.main_singular_values == pytest.approx(np.sqrt(np.linalg.eigvalsh(schur)[::-1]), rel=1e-6)
    scaled = seen.covariance / np.outer(seen.spread, seen.spread)
    errors = np.sqrt(np.diag(scaled))
    assert np.abs((scaled - inverse[:k, :k]) / errors / errors[:, None]).max() < 1e-6
    leverage = np.einsum("ij,nji->n", inverse, info.blocks[0])
    assert seen.leverage == pytest.approx(leverage, abs=1e-5)
    fixed = np.einsum("ij,ji", inverse, info.fixed[0])
    assert seen.leverage.sum() == pytest.approx(seen.rank - fixed, abs=1e-5)


def test_directions_diagonalise_the_covariance(way):
    loop, at = way
    seen = hx.observability(loop, at, spread={loop.parameters.names[0]: 0.2})
    assert seen.directions @ seen.directions.T == pytest.approx(np.eye(len(seen.labels)), abs=1e-10)
    scaled = seen.covariance / np.outer(seen.spread, seen.spread)
    rotated = seen.directions @ scaled @ seen.directions.T * np.outer(*[seen.main_singular_values] * 2)
    assert rotated == pytest.approx(np.eye(len(rotated)), abs=1e-7)


def test_derived_numbers():
    loop = loop_of("direction")
    seen = hx.observability(loop, LEG, spread={"base_point": 0.5})
    errors = seen.standard_errors
    assert seen.block_errors["base_point"] == pytest.approx(np.linalg.norm(errors[3:]))
    assert seen.block_errors["platform_point"] == pytest.approx(np.linalg.norm(errors[:3]))
    assert seen.correlation == pytest.approx(seen.covariance / np.outer(errors, errors))
    assert seen.condition == pytest.approx(seen.singular_values[0] / seen.singular_values[-1])
    assert seen.main_condition == pytest.approx(seen.main_singular_values[0] / seen.main_singular_values[-1])
    assert seen.condition_raw == pytest.approx(np.linalg.cond(loop.linear().matrix), rel=1e-3)  # n at the truth
    assert seen.indices["O1"] == pytest.approx(np.prod(seen.main_singular_values) ** (1 / 6) / np.sqrt(7))
    assert seen.indices["O2"] == pytest.approx(1 / seen.main_condition)
    assert not seen.covariance.flags.writeable


def test_the_raw_condition_number_is_that_of_the_papers_matrix():
    problem = loop_of("direction").linear("consecutive")
    assert hx.observability(problem).condition_raw == pytest.approx(np.linalg.cond(problem.matrix))


def test_the_spread_scales_coordinates_and_leaves_errors():
    one, other = (hx.observability(loop_of("direction"), LEG, spread={"base_point": s}) for s in (1.0, 0.01))
    assert one.standard_errors == pytest.approx(other.standard_errors)
    assert one.leverage == pytest.approx(other.leverage)
    assert one.condition_raw == pytest.approx(other.condition_raw)
    assert other.main_condition > 10 * one.main_condition


def test_units_scale_errors():
    """The same poses in millimetres."""
    data = measured("direction")
    leg = hx.Leg(3, LEG.platform_point * 10, LEG.base_point * 10, LEG.offset * 10, length_unit="mm")
    noise = hx.UniformNoise(0.1, np.deg2rad(0.01), 0.1)
    scaled = hx.LegMeasurements(
        data.position * 10, data.rotation, data.length * 10, "direction", noise, nominal=leg, length_unit="mm"
    )
    one, ten = hx.observability(hx.loops.FixedDirection(data)), hx.observability(hx.loops.FixedDirection(scaled))
    assert ten.standard_errors == pytest.approx(10 * one.standard_errors)
    assert ten.leverage == pytest.approx(one.leverage)
    assert ten.main_condition == pytest.approx(one.main_condition)
    assert ten.limits == pytest.approx(10 * one.limits)
    assert set(ten.units) == {"mm"}


def test_what_is_of_interest_does_not_change_its_errors():
    loop = WAYS["robot"][0]
    whole = hx.observability(loop, ROBOT)
    part = hx.observability(loop, ROBOT, of=("base_point",))
    index = [whole.labels.index(label) for label in part.labels]
    assert part.labels[:3] == ("leg1.base_point.x", "leg1.base_point.y", "leg1.base_point.z")
    assert len(index) == 18
    assert part.standard_errors == pytest.approx(whole.standard_errors[index])
    assert part.leverage == pytest.approx(whole.leverage)
    assert list(part.block_errors) == [f"leg{k}.base_point" for k in range(1, 7)]


def test_twice_the_poses_see_more():
    data = measured("direction", 14)
    one = hx.observability(hx.loops.FixedDirection(data.poses(slice(0, 7))), LEG)
    two = hx.observability(hx.loops.FixedDirection(data), LEG)
    assert (two.standard_errors < one.standard_errors).all()
    assert (two.main_singular_values > one.main_singular_values).all()


# --- linear problems


@pytest.mark.parametrize("lock", ["leg", "length"])
@pytest.mark.parametrize("noise", [NOISE, COMMON], ids=["own", "common"])
def test_a_direct_problem_sees_what_its_loop_sees(lock, noise):
    """With the weights at the same point, shared errors included."""
    loop = loop_of(lock, 9, noise=noise)
    of_loop = hx.observability(loop, LEG)
    for of_problem in (hx.observability(loop.linear(at=LEG)), hx.observability(loop.linear(), at=LEG)):
        assert of_problem.covariance == pytest.approx(of_loop.covariance)
        assert of_problem.singular_values == pytest.approx(of_loop.singular_values)
        assert of_problem.leverage == pytest.approx(of_loop.leverage)
        assert of_problem.rank == of_loop.rank


@pytest.mark.parametrize("lock", KINDS)
def test_every_form_says_the_same_of_the_parameters(lock):
    loop = loop_of(lock, 9)
    seen = {form: hx.observability(loop.linear(form, at=LEG)) for form in loop.forms}
    for form, found in seen.items():
        assert found.standard_errors == pytest.approx(seen["direct"].standard_errors, rel=1e-6)
        assert found.main_singular_values == pytest.approx(seen["direct"].main_singular_values, rel=1e-6)
        assert found.leverage.sum() == pytest.approx(found.rank)
        assert (found.per, found.n_poses) == (("difference", 8) if form == "consecutive" else ("pose", 9))


def test_rows_of_unknown_noise_are_taken_as_they_are():
    data = hx.simulate_leg(ROBOT, 3, "leg", 7, rng=0)
    problem = hx.loops.FixedLeg(data).linear()
    seen = hx.observability(problem, spread={"platform_point": 1e-6})
    inverse = np.linalg.inv(problem.matrix.T @ problem.matrix)
    assert seen.covariance == pytest.approx(inverse[:3, :3])
    assert "noise is unknown" in seen.caveat
    assert seen.doubtful == ()
    assert seen.caveat in seen.summary()


def test_rows_that_do_not_say_where_their_noise_is_are_taken_as_they_are():
    problem = hx.loops.FixedLeg(one_axis(exact=True)).linear()
    lost, found = hx.observability(problem), hx.observability(problem, at=LEG)
    assert "give at=" in lost.caveat
    assert found.caveat == ""
    assert lost.unseen == found.unseen == ("platform_point.z + fixed_point.z",)


def test_a_plain_problem():
    matrix = np.array([[1, 0, 2], [1, 1, 2], [1, 2, 2.0]])
    parameters = hx.Parameters((hx.Block("level", 1, "cm"), hx.Block("slope", 1, "cm/s"), hx.Block("other", 1, "cm")))
    seen = hx.observability(hx.LinearProblem(matrix, np.zeros(3), parameters))
    assert seen.rank == 2
    assert seen.unseen == ("level − 0.5·other",)
    assert seen.determined.tolist() == [False, True, False]
    assert seen.standard_errors[1] == pytest.approx(np.sqrt(1 / 2))
    assert seen.leverage == pytest.approx([5 / 6, 1 / 3, 5 / 6])
    assert seen.title == "the problem"


# --- what is not seen


def test_the_sets_of_the_gallery():
    ranges = ROBOT.ranges
    direction = measured("direction", exact=True, ranges=replace(ranges, length=(18, 18)))
    seen = hx.observability(hx.loops.FixedDirection(direction), LEG)
    assert seen.determined.tolist() == [True] * 3 + [False] * 3
    assert seen.rank == 6  # a goes with the direction, which turns two ways
    assert len(seen.unseen) == 2
    assert np.count_nonzero(seen.main_singular_values == 0) == 2

    seen = hx.observability(hx.loops.FixedLeg(one_axis(exact=True)), LEG)
    assert seen.unseen == ("platform_point.z + fixed_point.z",)
    assert seen.determined.tolist() == [True, True, False]

    length = measured("length", exact=True, ranges=replace(ranges, cone=0.0))
    seen = hx.observability(hx.loops.FixedLength(length), LEG)
    assert not seen.determined.any()
    assert seen.rank == 1

    lengths = hx.loops.LegLength(measured("direction", 12, exact=True))
    seen = hx.observability(lengths, LEG)
    assert seen.unseen[: len(lengths.blind_spots)] == lengths.blind_spots
    assert seen.determined.tolist() == [True] * 3 + [False] * 4
    assert seen.rank == 4


def test_what_is_determined_beside_what_is_not_keeps_its_error():
    """Where all is turned about z alone, b in x and y is as well known as if b.z were given."""
    data = one_axis(exact=True)
    seen = hx.observability(hx.loops.FixedLeg(data), LEG)
    rows = hx.loops.FixedLeg(data).linear(at=LEG).whitened()[0]
    inverse = np.linalg.inv((rows.T @ rows)[np.ix_([0, 1, 3, 4, 5], [0, 1, 3, 4, 5])])
    assert seen.standard_errors[:2] == pytest.approx(np.sqrt(np.diag(inverse)[:2]))
    assert np.isinf(seen.standard_errors[2])
    assert np.isnan(seen.correlation[2]).all()
    assert seen.correlation[0, 1] == pytest.approx(inverse[0, 1] / np.sqrt(inverse[0, 0] * inverse[1, 1]))
    assert np.isinf(seen.block_errors["platform_point"])
    assert all(value == 0 for value in seen.indices.values())
    assert np.isinf([seen.condition, seen.main_condition, seen.condition_raw]).all()
    assert seen.leverage.sum() == pytest.approx(seen.rank) == 5


@given(st.integers(0, 10_000), st.integers(1, 4), st.integers(1, 3))
def test_determined_is_orthogonal_to_the_null_space(seed, rank, hidden):
    """Rows of random rank, some columns of which are free of it: estimable by brute force, or not."""
    rng = np.random.default_rng(seed)
    mixed = rng.normal(size=(12, rank)) @ rng.normal(size=(rank, rank + hidden))
    matrix = np.concatenate([mixed, rng.normal(size=(12, 2))], axis=1) * 10.0 ** rng.uniform(-3, 3, rank + hidden + 2)
    size = matrix.shape[1]
    problem = hx.LinearProblem(matrix, np.zeros(12), hx.Parameters((hx.Block("x", size, "cm"),)))
    seen = hx.observability(problem)
    unit = matrix / np.linalg.norm(matrix, axis=0)
    known = [np.linalg.matrix_rank(np.delete(unit, j, axis=1)) < rank + 2 for j in range(size)]
    assert seen.rank == rank + 2
    assert len(seen.unseen) == hidden
    assert seen.determined.tolist() == known == [False] * (rank + hidden) + [True] * 2
    assert seen.leverage.sum() == pytest.approx(seen.rank)
    assert np.count_nonzero(seen.main_singular_values) == seen.rank
    assert np.linalg.norm(matrix @ seen.directions[seen.rank :].T) < 1e-9 * np.linalg.norm(matrix)


def test_nuisances_that_are_not_seen_may_leave_what_is_of_interest():
    """With c alone of no interest, only b.z is lost; with b.z too, nothing of interest is."""
    matrix = np.concatenate([np.eye(3), np.ones((3, 2))], axis=1)[[0, 1, 2, 0, 1]] + 0.0
    matrix[:, 0] = np.arange(5)
    matrix[:, 1:3] = 0.0
    blocks = (hx.Block("slope", 1, "cm"), hx.Block("lost", 2, "cm"), hx.Block("twins", 2, "cm", nuisance=True))
    problem = hx.LinearProblem(matrix, np.zeros(5), hx.Parameters(blocks))
    seen = hx.observability(problem, of=("slope",))
    assert seen.rank == 2
    assert len(seen.unseen) == 3
    assert seen.determined.all()
    assert seen.standard_errors[0] == pytest.approx(1 / np.sqrt(10))
    assert seen.main_singular_values == pytest.approx([np.sqrt(10)])


def test_too_few_poses_are_reported():
    seen = hx.observability(hx.loops.PlatformPose(hx.simulate(ROBOT, n_poses=6, rng=0, noise=NOISE)), ROBOT)
    assert seen.rank == 36
    assert len(seen.unseen) == 6
    assert not seen.determined.any()
    assert seen.leverage == pytest.approx(np.full(6, 6.0))
    one = hx.observability(loop_of("direction", 1), LEG)
    assert one.rank == 3
    assert len(one.unseen) == 5


def test_blind_spots_are_never_determined():
    """Six legs that keep their lengths' readings: noise makes offset and gain of the locked one look seen."""
    data = hx.simulate(ROBOT, "leg", n_poses=30, leg=3, rng=0, noise=NOISE)
    loop = hx.loops.WholeRobot(data, unknown=MODEL_48)
    seen = hx.observability(loop, ROBOT)
    known = dict(zip(seen.labels, seen.determined, strict=True))
    assert loop.blind_spots[0] in seen.unseen
    assert not known["leg3.offset"]
    assert not known["leg3.gain"]
    assert known["leg3.platform_point.x"]
    assert known["leg1.offset"]
    assert known["leg1.gain"]
    noisy = hx.observability(hx.loops.LegLength(measured("direction", 12)), LEG)
    assert noisy.rank == 7
    assert np.isinf(noisy.standard_errors[3:6]).all()
    assert "not determined" in noisy.summary()


# --- what noise makes look seen


def test_noise_does_not_show_what_one_axis_hides():
    loop = hx.loops.FixedLeg(one_axis())
    seen = hx.observability(loop, LEG)
    assert seen.determined.all()
    assert seen.standard_errors[2] > 1
    assert seen.doubtful == ("platform_point.z",)
    assert seen.weak[0].words == "platform_point.z"
    assert seen.weak[0].error == pytest.approx(seen.standard_errors[2], rel=1e-3)
    (line,) = [line for line in seen.summary().splitlines() if "not seen in practice" in line]
    assert "platform_point.z" in line
    assert hx.observability(loop, LEG, spread={"platform_point": 100}).doubtful == ()
    assert hx.observability(loop, LEG, spread={"platform_point": 1e-3}).doubtful == seen.labels


def test_weak_directions():
    matrix = np.diag([10.0, 1.0, 2.0])
    parameters = hx.Parameters((hx.Block("a", 2, "cm"), hx.Block("turn", 1, "rad")))
    seen = hx.observability(hx.LinearProblem(matrix, np.zeros(3), parameters), spread={"turn": 0.01})
    assert [(one.words, one.unit) for one in seen.weak] == [("turn", "rad"), ("a.2", "cm"), ("a.1", "cm")]
    assert [one.error for one in seen.weak] == pytest.approx([0.5, 1.0, 0.1])
    rotation = np.array([[1, 1], [1, -1]]) / np.sqrt(2)
    turned = hx.LinearProblem(np.diag([4.0, 1.0]) @ rotation, np.zeros(2), hx.Parameters((hx.Block("a", 2, "cm"),)))
    first = hx.observability(turned).weak[0]
    assert first.words == "a.1 − a.2"
    assert first.error == pytest.approx(1 / np.sqrt(2))
    many = hx.LinearProblem(np.ones((1, 9)), np.zeros(1), hx.Parameters((hx.Block("x", 9, "cm"),)))
    assert hx.observability(many).weak[0].words.count("x.") <= 9


# --- indices


def test_indices_of_a_diagonal_matrix():
    values = observability_indices(np.array([4.0, 2.0, 1.0]), 4)
    assert values == pytest.approx([1.0, 0.25, 1.0, 0.25, 1 / 1.75])
    assert (observability_indices(np.array([[4.0, 1.0], [4.0, 0.0]]))[1] == 0).all()


@given(st.lists(st.floats(0.1, 10), min_size=2, max_size=6), st.floats(1.01, 3))
def test_indices_grow_with_information(values, factor):
    singular = np.sort(values)[::-1]
    before, after = observability_indices(singular), observability_indices(factor * singular)
    assert after == pytest.approx(before * np.array([factor, 1, factor, factor, factor]))


# --- report


def test_the_summary_says_it_all():
    text = hx.observability(loop_of("direction"), LEG).summary()
    for part in ("FixedDirection: 7 poses see 8 of 8 unknowns", "base_point.z", "in all", "condition numbers", "O5"):
        assert part in text


def test_one_pose_sees():
    assert "FixedLeg: 1 pose sees 3 of" in hx.observability(loop_of("leg", 1), LEG).summary()


@pytest.mark.parametrize("way", WAYS)
def test_a_summary_fits_a_screen(way):
    loop, at = WAYS[way]
    for line in hx.observability(loop, at).summary().splitlines():
        assert len(line) <= 120


def test_the_table():
    frame = hx.observability(hx.loops.FixedLeg(one_axis(exact=True)), LEG).to_frame()
    assert frame["parameter"].tolist() == ["platform_point.x", "platform_point.y", "platform_point.z"]
    assert frame["determined"].tolist() == [True, True, False]
    assert np.isinf(frame["standard_error"][2])


# --- wrong calls


def batch():
    return hx.simulate_leg(ROBOT, 3, "leg", 5, n_sets=2, noise=NOISE, rng=0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: hx.observability(hx.loops.FixedLeg(batch())), "take one, such as"),
        (lambda: hx.observability(hx.loops.FixedLeg(batch()).linear()), "take one, such as"),
        (lambda: hx.observability(measured("leg")), "expected a loop"),
        (lambda: hx.observability(hx.loops.FixedLeg(hx.simulate_leg(ROBOT, 3, "leg", 5, rng=0))), "no noise model"),
        (lambda: hx.observability(loop_of("leg"), at=np.full(6, np.nan)), "at: 6 value"),
        (lambda: hx.observability(loop_of("leg"), at=[LEG, LEG]), "at: expected values"),
        (lambda: hx.observability(loop_of("leg"), at=np.zeros((2, 6))), "at: expected shape"),
        (lambda: hx.observability(loop_of("leg").linear(), at=np.full(6, np.nan)), "at: 6 value"),
        (lambda: hx.observability(loop_of("leg").linear(), at="there"), "at: expected values"),
        (lambda: hx.observability(loop_of("leg"), of=("base_point",)), "of: unknown parameter"),
        (lambda: hx.observability(loop_of("leg"), of=()), "of: no parameter"),
        (lambda: hx.observability(loop_of("leg"), spread={"platform_point": 0.0}), "spread"),
        (lambda: hx.observability(loop_of("leg"), spread={"elbow": 1.0}), "spread: unknown parameter"),
    ],
)
def test_wrong_calls(call, words):
    with pytest.raises(InputError, match=words):
        call()


def test_an_error_that_cannot_be_carried_is_a_wrong_call():
    known = hx.estimate(hx.loops.FixedLeg(measured("leg")).linear(), hx.LeastSquares(covariance=False))
    loop = hx.loops.FixedLength(measured("length"), platform_point=known)
    with pytest.raises(InputError, match="cannot be carried"):
        hx.observability(loop)
