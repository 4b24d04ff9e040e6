"""Known and unknown, locks, and what a wrong loop says."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, LockError, UnitError
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength

LOOPS = [FixedDirection, FixedLeg, FixedLength, LegLength]


def simulated(lock, n=8, n_sets=None, noise=None, seed=0):
    return hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=noise, rng=seed)


def stripped(data):
    """The data without its nominal."""
    return hx.LegMeasurements(data.position, data.rotation, data.length, data.lock, data.noise, length_unit="cm")


@pytest.mark.parametrize("kind", LOOPS)
@pytest.mark.parametrize("lock", list(hx.Lock))
def test_a_loop_takes_the_locks_it_holds_under(kind, lock):
    data = simulated(lock)
    if lock in kind.locks:
        assert kind(data).data is data
    else:
        with pytest.raises(LockError, match=rf"{kind.__name__} holds under the lock '.*', the data has '{lock}'"):
            kind(data)


def test_which_locks():
    assert FixedDirection.locks == (hx.Lock.DIRECTION,)
    assert FixedLeg.locks == (hx.Lock.LEG,)
    assert FixedLength.locks == (hx.Lock.LENGTH,)
    assert set(LegLength.locks) == set(hx.Lock)


@pytest.mark.parametrize("kind", LOOPS)
class TestWrongCalls:
    def data(self, kind):
        return simulated(kind.locks[0])

    def test_six_readings_at_once(self, kind):
        with pytest.raises(InputError, match=r"for six readings write data\.leg\(k\)"):
            kind(hx.simulate(hx.robots.left_hand(), n_poses=3, rng=0))

    def test_an_unknown_that_it_does_not_contain(self, kind):
        for unknown in (("colour",), (), ("platform_point", "colour")):
            with pytest.raises(InputError, match=f"unknown: {kind.__name__} can estimate"):
                kind(self.data(kind), unknown=unknown)

    def test_a_known_value_that_it_does_not_contain(self, kind):
        for name in {"platform_point", "base_point", "offset", "gain"} - set(kind.involved):
            with pytest.raises(InputError, match=f"does not contain {name}"):
                kind(self.data(kind), **{name: np.zeros(3) if "point" in name else 1.0})

    def test_known_and_unknown_at_once(self, kind):
        with pytest.raises(InputError, match="platform_point: both given and unknown"):
            kind(self.data(kind), unknown=("platform_point",), platform_point=np.zeros(3))

    def test_known_values_are_checked(self, kind):
        for name in set(kind.involved) - {"platform_point"}:
            for wrong in ([1.0, np.nan], "1", [[1.0, 2.0]] * 4 if name == "base_point" else [[1.0], [2.0, 3.0]]):
                with pytest.raises(InputError, match=rf"{name}: "):
                    kind(self.data(kind), unknown=("platform_point",), **{name: wrong})

    def test_known_values_fit_the_batch(self, kind):
        data = simulated(kind.locks[0], n_sets=5)
        for name in set(kind.involved) - {"platform_point"}:
            value = np.ones((7, 3)) if name == "base_point" else np.ones(7)
            with pytest.raises(InputError, match=rf"{name}: \(7,\) values do not fit a batch of \(5,\) sets"):
                kind(data, unknown=("platform_point",), **{name: value})

    def test_a_missing_value_says_how_to_give_it(self, kind):
        missing = set(kind.involved) - {"platform_point"}
        if not missing:
            assert kind(stripped(self.data(kind))).parameters.names[0] == "platform_point"
            return
        with pytest.raises(InputError, match=r"needs it; give .*=…, or measurements with nominal=robot\.leg\(k\)"):
            kind(stripped(self.data(kind)), unknown=("platform_point",))

    def test_a_form_that_it_does_not_offer(self, kind):
        loop = kind(self.data(kind), unknown=("offset",)) if kind is LegLength else kind(self.data(kind))
        for form in {"Direct", "sideways", "centred", "consecutive"} - set(loop.forms):
            with pytest.raises(InputError, match=f"form: {kind.__name__} offers direct.*got '{form}'"):
                loop.linear(form)

    def test_values_of_a_wrong_size(self, kind):
        loop = kind(self.data(kind))
        for size in (0, loop.parameters.size + 1):
            with pytest.raises(InputError, match="values: expected"):
                loop.residual(np.zeros(size))

    def test_no_poses(self, kind):
        with pytest.raises(InputError, match="there are no poses"):
            kind(self.data(kind).poses(slice(0, 0)))

    def test_one_pose_has_no_difference(self, kind):
        if "consecutive" in kind.forms:
            with pytest.raises(InputError, match="there is no equation; are there any poses"):
                kind(self.data(kind).poses([0])).linear("consecutive")


@pytest.mark.parametrize(
    ("kind", "unknown"),
    [
        (FixedDirection, ("platform_point", "offset")),
        (FixedDirection, ("gain",)),
        (FixedLength, ("platform_point", "base_point")),
        (LegLength, ("platform_point",)),
        (LegLength, ("base_point", "offset")),
    ],
)
def test_what_is_not_linear_says_in_what_it_is(kind, unknown):
    loop = kind(simulated(kind.locks[0]), unknown=unknown)
    with pytest.raises(InputError, match=r"is linear in \{.*\}, not in \{.*\} together; give some of them as known"):
        loop.linear()


@pytest.mark.parametrize("kind", [FixedDirection, LegLength])
def test_readings_are_asked_for_where_they_are_needed(kind):
    data = simulated(kind.locks[0])
    blind = hx.LegMeasurements(data.position, data.rotation, None, data.lock, nominal=data.nominal)
    loop = kind(blind, unknown=("offset",)) if kind is LegLength else kind(blind)
    with pytest.raises(InputError, match="needs the leg's readings"):
        loop.linear()


@pytest.mark.parametrize("kind", [FixedLeg, FixedLength])
def test_readings_are_not_asked_for_where_they_are_not(kind):
    data = simulated(kind.locks[0])
    blind = hx.LegMeasurements(data.position, data.rotation, None, data.lock, nominal=data.nominal)
    found, other = (hx.estimate(kind(d).linear(), hx.LeastSquares()) for d in (blind, data))
    np.testing.assert_array_equal(found.values, other.values)


MINIMA = [
    (FixedDirection, ("platform_point", "base_point")),
    (FixedDirection, ("base_point",)),
    (FixedDirection, ("platform_point",)),
    (FixedLeg, ("platform_point",)),
    (FixedLength, ("base_point",)),
    (LegLength, ("offset",)),
    (LegLength, ("offset", "gain")),
]


@pytest.mark.parametrize(("kind", "unknown"), MINIMA)
def test_the_minimal_number_of_poses_is_what_rank_says(kind, unknown):
    """From it on every form determines the unknowns in general position; one pose less, none does."""
    n = kind(simulated(kind.locks[0]), unknown=unknown).minimum_poses
    for count in (n - 1, n):
        data = simulated(kind.locks[0], n=max(count, 1), n_sets=20, seed=1).poses(slice(0, count))
        for form in kind.forms:
            if count == 0 or (count == 1 and form == "consecutive"):
                continue
            problem = kind(data, unknown=unknown).linear(form)
            if count == n:
                assert hx.estimate(problem, hx.LeastSquares()).ok.all()
            else:
                rank = np.linalg.matrix_rank(problem.matrix, rtol=1e-11)
                assert (rank < problem.parameters.size).all()


@pytest.mark.parametrize(("unknown", "n"), [(2, 6), (3, 7), (4, 8)])
def test_the_minimal_number_of_unlocked_poses(unknown, n):
    loop = LegLength(simulated("none", n=n), unknown=LegLength.involved[:unknown])
    assert loop.minimum_poses == n
    assert np.linalg.matrix_rank(loop.linearised(hx.robots.left_hand().leg(3)).matrix) == n


@pytest.mark.parametrize("lock", ["direction", "leg"])
def test_a_legs_own_locked_set_leaves_rank_4_of_7(lock):
    """METHODS 4: a leg's DIRECTION or LEG set alone does not determine Model 42 by inverse kinematics."""
    loop = LegLength(simulated(lock, n=20))
    values = np.linalg.svd(loop.linearised(hx.robots.left_hand().leg(3)).matrix, compute_uv=False)
    assert values[3] > 1e-3
    assert values[4] < 1e-13


class TestValues:
    def test_a_leg_an_estimate_and_numbers_are_the_same(self, paper_noise):
        data = simulated("direction", n_sets=3, noise=paper_noise)
        loop = FixedDirection(data)
        found = hx.estimate(loop.linear(), hx.LeastSquares())
        consecutive = hx.estimate(loop.linear("consecutive"), hx.LeastSquares())
        np.testing.assert_array_equal(loop.values(found), found.values)
        np.testing.assert_array_equal(loop.values(found.values), found.values)
        np.testing.assert_array_equal(loop.values(consecutive), loop.values(consecutive.values))
        leg = data.nominal.replaced(**consecutive.params)
        np.testing.assert_array_equal(loop.values(leg), loop.values(consecutive))

    def test_a_leg_in_another_unit_is_an_error(self):
        loop = FixedDirection(simulated("direction"))
        inches = hx.Leg(3, [1, 2, 3], [4, 5, 6], length_unit="in")
        with pytest.raises(UnitError, match="the measurements are in cm, the leg in in"):
            loop.values(inches)
        with pytest.raises(UnitError, match="in cm, the leg in in"):
            hx.estimate(loop.linear(), hx.LeastSquares()).error(inches)

    def test_an_estimate_of_something_else_is_an_error(self):
        found = hx.estimate(FixedLeg(simulated("leg")).linear(), hx.LeastSquares())
        with pytest.raises(InputError, match="values: base_point missing"):
            FixedDirection(simulated("direction")).values(found)


class TestKnownEstimates:
    def test_a_known_estimate_brings_its_covariance(self, paper_noise):
        leg_set, length_set = (simulated(lock, n_sets=5, noise=paper_noise) for lock in ("leg", "length"))
        b = hx.estimate(FixedLeg(leg_set).linear(), hx.LeastSquares())
        with_error = FixedLength(length_set, platform_point=b)
        without = FixedLength(length_set, platform_point=b.params["platform_point"])
        x = with_error.values(length_set.nominal)
        np.testing.assert_array_equal(with_error.linear().matrix, without.linear().matrix)
        assert without.covariance(x).common is None
        own, plain = with_error.covariance(x), without.covariance(x)
        np.testing.assert_array_equal(own.blocks, plain.blocks)
        expected = with_error.known_jacobian(x, "platform_point")
        carried = np.einsum("snri,sij,smtj->snrmt", expected, b.covariance_of("platform_point"), expected)
        found = np.einsum("snri,smti->snrmt", own.common, own.common)
        np.testing.assert_allclose(found, carried, rtol=1e-9, atol=1e-16)

    def test_a_failed_member_fails_alone_in_the_next_step(self, paper_noise):
        leg_set, length_set = (simulated(lock, n_sets=4, noise=paper_noise) for lock in ("leg", "length"))
        rotation, position = np.array(leg_set.rotation), np.array(leg_set.position)
        rotation[2], position[2] = rotation[2, :1], position[2, :1]
        bad = hx.LegMeasurements(position, rotation, leg_set.length, "leg", leg_set.noise, leg_set.nominal)
        b_bad, b = (hx.estimate(FixedLeg(d).linear(), hx.LeastSquares()) for d in (bad, leg_set))
        assert list(b_bad.ok) == [True, True, False, True]
        for form in FixedLength.forms:
            for weights in (None, "model"):
                found, whole = (
                    hx.estimate(
                        FixedLength(length_set, platform_point=known).linear(form), hx.LeastSquares(weights=weights)
                    )
                    for known in (b_bad, b)
                )
                assert [status.name for status in found.status] == ["OPTIMAL"] * 2 + ["RANK_DEFICIENT", "OPTIMAL"]
                assert np.isnan(found.values[2]).all()
                np.testing.assert_allclose(found.values[[0, 1, 3]], whole.values[[0, 1, 3]], atol=1e-12)
                np.testing.assert_allclose(found.covariance[[0, 1, 3]], whole.covariance[[0, 1, 3]], rtol=1e-9)


def test_no_noise_model_says_so():
    loop = FixedDirection(simulated("direction"))
    with pytest.raises(InputError, match="no noise model"):
        loop.covariance(loop.values(hx.robots.left_hand().leg(3)))
    with pytest.raises(InputError, match="noise is unknown"):
        hx.estimate(loop.linear(), hx.LeastSquares(weights="model"))
