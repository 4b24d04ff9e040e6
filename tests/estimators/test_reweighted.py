"""Re-weighting: a fixed point, the one that hand iteration finds, honest about sets that do not settle."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import stats

import hexopt as hx
from hexopt.errors import EstimationError, InputError, RankDeficientError
from hexopt.estimators.reweighted import Reweighted
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength, join
from hexopt.problem import LinearProblem
from hexopt.result import Status
from hexopt.testing import CLAIMS, check_estimator

WEIGHTED = hx.LeastSquares(weights="model")
SETTLED = Reweighted(WEIGHTED)
#: Unequal in all directions, and large: the weights then matter, and so does where they are taken.
NOISE = hx.NormalNoise(pose_covariance=np.diag([0.03, 0.01, 0.02, 2e-3, 1e-3, 3e-3, 0.1]) ** 2)
LOOPS = {"direction": FixedDirection, "leg": FixedLeg, "length": FixedLength}
FORMS = [(lock, form) for lock, loop in LOOPS.items() for form in loop.forms]


def loop_of(lock, *, n=8, n_sets=6, seed=0, noise=NOISE):
    return LOOPS[lock](hx.simulate_leg(hx.robots.left_hand(), 3, lock, n, n_sets, noise=noise, rng=seed))


def apart(one, two):
    """The largest difference of two estimates, in standard errors."""
    return float((np.abs(one.values - two.values) / two.standard_errors).max())


@dataclass(frozen=True)
class Scripted:
    """An estimator whose answers are told: for each member, values and statuses pass by pass; it counts the passes."""

    values: tuple[tuple[float, ...], ...]
    codes: tuple[tuple[int, ...], ...] = ()
    covariance: float | None = 1.0
    weights = "model"
    accepts = (LinearProblem,)
    hint = "for tests"

    def fit(self, target):
        k = 0 if target.at is None else self.passes
        object.__setattr__(self, "passes", k + 1)
        values = np.array([member[min(k, len(member) - 1)] for member in self.values])[:, None]
        codes = np.array(
            [member[min(k, len(member) - 1)] for member in self.codes or [(0,)] * len(values)], dtype=np.int8
        )
        cov = None if self.covariance is None else np.full((len(values), 1, 1), self.covariance**2)
        nan = np.full(len(values), np.nan)
        return hx.Estimate(
            np.where(codes[:, None] == 0, values, np.nan), target.parameters, codes, cov, "model", nan, nan, nan, 1,
            duals={"bound": values},
        )  # fmt: skip


def scalar(members):
    return LinearProblem(np.ones((members, 2, 1)), np.ones((members, 2)), hx.Parameters((hx.Block("level", 1, "cm"),)))


class TestFixedPoint:
    @pytest.mark.parametrize(("lock", "form"), FORMS)
    def test_another_pass_changes_nothing(self, lock, form):
        loop = loop_of(lock)
        found = hx.estimate(loop, Reweighted(WEIGHTED, form=form))
        assert found.ok.all()
        again = hx.estimate(loop.linear(form, at=found), WEIGHTED)
        assert apart(again, found) < 1e-6
        np.testing.assert_allclose(again.covariance, found.covariance, rtol=1e-5)
        assert found.covariance_kind == "model"
        first = hx.estimate(loop.linear(form), WEIGHTED)
        assert apart(first, found) > 1e-5  # which the first pass alone does not reach

    @pytest.mark.parametrize(("lock", "form"), FORMS)
    def test_it_is_the_iteration_by_hand(self, lock, form):
        loop = loop_of(lock)
        found = hx.estimate(loop, Reweighted(WEIGHTED, form=form))
        for i in range(6):
            single = LOOPS[lock](loop.data[i])
            x, passes, change = hx.estimate(single.linear(form), WEIGHTED), 0, np.inf
            while change > 1e-6:
                following = hx.estimate(single.linear(form, at=x), WEIGHTED)
                change, x, passes = apart(x, following), following, passes + 1
            np.testing.assert_allclose(found.values[i], x.values, atol=1e-9 * np.abs(x.values).max())
            np.testing.assert_allclose(found.covariance[i], x.covariance, rtol=1e-6, atol=1e-12)
            np.testing.assert_allclose(found.chi2[i], x.chi2, rtol=1e-6)
            assert found.iterations[i] == passes

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_from_scratch(self, lock):
        """Weights in plain loops, S_i = B_i Σ B_iᵀ written out, and normal equations: the same fixed point."""
        loop = loop_of(lock, n_sets=2)
        found = hx.estimate(loop, SETTLED)
        for i in range(2):
            data, x = loop.data[i], np.array(found.values[i]) * (1 + 1e-3)
            for _ in range(20):
                gram, right = np.zeros((len(x), len(x))), np.zeros(len(x))
                for k in range(data.n_poses):
                    arm = data.rotation[k] @ x[:3]
                    noise = np.hstack([np.eye(3), -hx.rotations.skew(arm), np.zeros((3, 1))])
                    rows = np.hstack([data.rotation[k], -np.eye(3)])
                    if lock == "direction":
                        noise[:, 6] = -x[6:9]
                        rows = np.hstack([rows, -data.nominal.true_length(data.length)[k] * np.eye(3)])
                    weight = np.linalg.inv(noise @ NOISE.pose_covariance @ noise.T)
                    gram += rows.T @ weight @ rows
                    right -= rows.T @ weight @ data.position[k]
                x = np.linalg.solve(gram, right)
            np.testing.assert_allclose(found.values[i], x, atol=1e-6 * found.standard_errors[i].min())
            np.testing.assert_allclose(found.covariance[i], np.linalg.inv(gram), rtol=1e-5, atol=1e-10)

    def test_fully_weighted_all_forms_agree(self):
        """METHODS 2; but for n, which the consecutive form leaves to the loop to fill in, unweighted."""
        for lock, loop in LOOPS.items():
            allowed = 5e-3 if lock == "direction" else 1e-5
            direct, *others = (hx.estimate(loop_of(lock), Reweighted(WEIGHTED, form=form)) for form in loop.forms)
            for other in others:
                for name in other.parameters.names:
                    error = np.sqrt(np.einsum("sii->si", direct.covariance_of(name)))
                    assert (np.abs(other.params[name] - direct.params[name]) / error).max() < allowed

    def test_noise_that_depends_on_nothing_settles_at_once(self):
        loop = loop_of("leg", noise=hx.NormalNoise(0.01))
        found, first = (hx.estimate(target, way) for target, way in ((loop, SETTLED), (loop.linear(), WEIGHTED)))
        np.testing.assert_allclose(found.values, first.values, atol=1e-12)
        assert (found.iterations == 1).all()

    def test_few_passes_do(self):
        assert hx.estimate(loop_of("direction", n_sets=200), SETTLED).iterations.max() <= 12
        paper = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
        assert hx.estimate(loop_of("direction", n_sets=200, noise=paper), SETTLED).iterations.max() <= 4

    def test_a_linear_problem(self):
        """Of several sets, say: with the weights at all parameters of the joined problem."""
        loops = [loop_of("direction"), loop_of("leg", seed=1)]
        found = hx.estimate(join(*loops), SETTLED)
        assert found.ok.all()
        assert apart(hx.estimate(join(*loops, at=found), WEIGHTED), found) < 1e-6
        one, two = (hx.estimate(target, SETTLED) for target in (loops[0], loops[0].linear()))
        np.testing.assert_array_equal(one.values, two.values)

    def test_a_known_offset_alone(self, left_hand):
        leg = left_hand.leg(3)
        data = hx.simulate_leg(left_hand, 3, "none", 5, 3, noise=NOISE, rng=0)
        known = {"platform_point": leg.platform_point, "base_point": leg.base_point}
        found = hx.estimate(LegLength(data, unknown="offset", **known), SETTLED)
        assert found.ok.all()

    def test_without_a_covariance(self):
        """It settles by the size of the values, to the same answer."""
        quick = Reweighted(hx.LeastSquares(weights="model", covariance=False))
        for lock in LOOPS:
            found, whole = (hx.estimate(loop_of(lock), way) for way in (quick, SETTLED))
            assert found.covariance is None
            assert found.ok.all()
            np.testing.assert_allclose(found.values, whole.values, rtol=1e-6, atol=1e-6)

    def test_its_text(self):
        text = hx.estimate(loop_of("leg"), SETTLED).estimator
        assert text.startswith("FixedLeg by Reweighted(estimator=LeastSquares(method='auto', weights='model'")


class TestStatuses:
    def test_too_few_passes(self):
        loop = loop_of("direction")
        found = hx.estimate(loop, Reweighted(WEIGHTED, tolerance=1e-14, max_iterations=1))
        assert (found.codes == Status.NOT_CONVERGED).all()
        assert np.isnan(found.values).all()
        assert (found.iterations == 1).all()
        with pytest.raises(EstimationError, match=r"^FixedDirection by Reweighted: ended with status NOT_CONVERGED"):
            hx.estimate(FixedDirection(loop.data[0]), Reweighted(WEIGHTED, tolerance=1e-14, max_iterations=1))

    def test_only_those_that_do_not_settle(self):
        loop = loop_of("direction", n_sets=40)
        passes = hx.estimate(loop, SETTLED).iterations
        limit = int(np.median(passes))
        assert passes.min() < passes.max()
        found = hx.estimate(loop, Reweighted(WEIGHTED, max_iterations=limit))
        np.testing.assert_array_equal(found.ok, passes <= limit)
        assert set(found.codes[~found.ok]) <= {Status.NOT_CONVERGED}

    def test_a_member_that_fails_keeps_its_status(self):
        data = loop_of("direction").data
        position, rotation, length = (np.array(part) for part in (data.position, data.rotation, data.length))
        for part in (position, rotation, length):
            part[2] = part[2, :1]
        bad = FixedDirection(replace(data, position=position, rotation=rotation, length=length))
        found, whole = hx.estimate(bad, SETTLED), hx.estimate(FixedDirection(data), SETTLED)
        good = [0, 1, 3, 4, 5]
        assert [status.name for status in found.status[[2, 3]]] == ["RANK_DEFICIENT", "OPTIMAL"]
        assert np.isnan(found.values[2]).all()
        assert found.iterations[2] == 0
        assert found.unseen
        np.testing.assert_allclose(found.values[good], whole.values[good], atol=1e-11)
        np.testing.assert_array_equal(found.iterations[good], whole.iterations[good])
        with pytest.raises(RankDeficientError, match="unseen: "):
            hx.estimate(FixedDirection(bad.data[2]), SETTLED)

    def test_a_known_value_that_failed(self):
        b = hx.estimate(loop_of("leg").linear(), WEIGHTED)
        values, covariance = np.array(b.values), np.array(b.covariance)
        values[1], covariance[1] = np.nan, np.nan
        known = replace(b, values=values, covariance=covariance)
        found = hx.estimate(FixedLength(loop_of("length").data, platform_point=known), SETTLED)
        assert [int(code) for code in found.codes] == [0, Status.RANK_DEFICIENT, 0, 0, 0, 0]

    def test_pass_by_pass(self):
        """One settles, is then left alone, one fails on the way, one never settles, one failed at first."""
        inner = Scripted(
            values=((1.0, 2.0, 2.0, 9.0), (1.0, 2.0, 3.0), (0.0, 1.0, 2.0, 3.0, 4.0, 5.0), (1.0, 1.0), (5.0, 6.0, 6.5)),
            codes=((0,), (0, 0, 1), (0,), (4, 0), (0,)),
        )
        found = Reweighted(inner, tolerance=0.1, max_iterations=4).fit(scalar(5))
        expected = [Status.OPTIMAL, Status.INACCURATE, Status.NOT_CONVERGED, Status.INFEASIBLE, Status.OPTIMAL]
        assert list(found.status) == expected
        np.testing.assert_array_equal(found.values[:, 0], [2.0, np.nan, np.nan, np.nan, 6.5])
        np.testing.assert_array_equal(found.iterations, [2, 2, 4, 0, 3])
        np.testing.assert_array_equal(found.duals["bound"][[0, 3, 4], 0], [2.0, 1.0, 6.5])

    def test_it_stops_when_all_have_settled(self):
        inner = Scripted(values=((1.0, 1.05), (2.0, 2.05)))
        found = Reweighted(inner, tolerance=0.1).fit(scalar(2))
        assert inner.passes == 2
        np.testing.assert_array_equal(found.values[:, 0], [1.05, 2.05])

    @pytest.mark.parametrize(("covariance", "ok"), [(10.0, True), (0.1, False), (None, False)])
    def test_the_tolerance_is_in_standard_errors(self, covariance, ok):
        inner = Scripted(values=((1.0, 1.05) * 20,), covariance=covariance)
        assert bool(Reweighted(inner, tolerance=0.1, max_iterations=5).fit(scalar(1)).ok[0]) is ok

    def test_no_sets(self):
        loop = FixedLeg(loop_of("leg").data[:0])
        assert hx.estimate(loop, SETTLED).values.shape == (0, 6)


class TestBatches:
    @pytest.mark.parametrize("lock", LOOPS)
    def test_members_are_what_they_are_alone(self, lock):
        loop = loop_of(lock)
        found = hx.estimate(loop, SETTLED)
        for i in range(6):
            alone = hx.estimate(LOOPS[lock](loop.data[i]), SETTLED)
            np.testing.assert_allclose(found.values[i], alone.values, atol=1e-10 * np.abs(alone.values).max())
            assert found.iterations[i] == alone.iterations

    def test_neighbours_do_not_matter(self):
        """A set that needs many passes beside it changes no bit of one that has settled."""
        data = loop_of("direction", n_sets=40).data
        order = np.argsort(hx.estimate(FixedDirection(data), SETTLED).iterations)
        few, all_ = (hx.estimate(FixedDirection(data[part]), SETTLED) for part in (order[:2], order))
        assert few.iterations.max() < all_.iterations.max()
        np.testing.assert_allclose(few.values, all_.values[:2], rtol=1e-13)

    @pytest.mark.parametrize("lock", LOOPS)
    def test_the_order_of_the_poses(self, lock):
        loop = loop_of(lock)
        order = np.random.default_rng(0).permutation(8)
        one, two = (hx.estimate(LOOPS[lock](data), SETTLED) for data in (loop.data, loop.data.poses(order)))
        assert apart(one, two) < 1e-6


class TestContract:
    @pytest.mark.parametrize("lock", LOOPS)
    def test_on_loops(self, lock):
        check_estimator(SETTLED, LOOPS[lock], lock=lock, tolerance=1e-5)

    @pytest.mark.parametrize(("lock", "form"), [(lock, form) for lock, form in FORMS if form != "direct"])
    def test_in_other_forms(self, lock, form):
        """At the fixed point not even the consecutive form depends on the order of the poses."""
        check_estimator(Reweighted(WEIGHTED, form=form), LOOPS[lock], lock=lock, tolerance=1e-4, exactness=1e-7)

    def test_on_joined_sets(self):
        def joined(data):
            return join(FixedLeg(data.poses([0, 1, 2, 3, 4])), FixedLeg(data.poses(slice(5, None))))

        claims = [claim for claim in CLAIMS if claim != "order"]  # which would mix the two sets, at other points c
        with pytest.raises(AssertionError, match="breaks 'few'"):  # one pose cannot be split
            check_estimator(SETTLED, joined, lock="leg", claims=claims, tolerance=1e-5)


class TestStatistics:
    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_intervals_cover(self, lock):
        """95 % intervals, 1500 sets of 12 poses: within 1.5 % for every parameter; and χ² has its mean."""
        noise = hx.NormalNoise(pose_covariance=NOISE.pose_covariance / 25)
        loop = loop_of(lock, n=12, n_sets=1500, noise=noise, seed=3)
        found = hx.estimate(loop, SETTLED)
        assert found.ok.all()
        true = hx.robots.left_hand().leg(3)
        error = np.concatenate([found.params[name] - true.block(name) for name in loop.unknown], axis=-1)
        inside = np.abs(error) <= stats.norm.ppf(0.975) * found.standard_errors[:, : error.shape[1]]
        np.testing.assert_allclose(inside.mean(axis=0), 0.95, atol=0.02)
        assert abs(inside.mean() - 0.95) < 0.012
        spread = np.sqrt(2 * found.degrees_of_freedom / 1500)
        assert abs(found.chi2.mean() - found.degrees_of_freedom) < 5 * spread


class TestErrors:
    def test_what_there_is_to_weigh(self):
        with pytest.raises(InputError, match=r'has no weights to take anew; write LeastSquares\(weights="model"\)'):
            Reweighted(hx.LeastSquares())

    @pytest.mark.parametrize("inner", [None, hx.LeastSquares, hx.InverseKinematics(weights="model"), "model"])
    def test_an_estimator_of_linear_problems(self, inner):
        with pytest.raises(
            InputError, match=r"estimator: expected one of linear problems, such as LeastSquares\(weights"
        ):
            Reweighted(inner)

    @pytest.mark.parametrize(
        ("settings", "message"),
        [
            ({"tolerance": 0.0}, "tolerance: expected a number > 0 of standard errors, got 0.0"),
            ({"tolerance": np.nan}, "tolerance: .* got nan"),
            ({"max_iterations": 0}, "max_iterations: expected an integer >= 1, got 0"),
            ({"max_iterations": 2.5}, "max_iterations: expected an integer >= 1, got 2.5"),
        ],
    )
    def test_settings(self, settings, message):
        with pytest.raises(InputError, match=message):
            Reweighted(WEIGHTED, **settings)

    def test_the_form_is_the_loops(self):
        with pytest.raises(InputError, match="form: FixedDirection offers direct, consecutive; got 'centred'"):
            hx.estimate(loop_of("direction"), Reweighted(WEIGHTED, form="centred"))

    def test_another_target(self):
        with pytest.raises(InputError, match=r"Reweighted takes a Loop or LinearProblem, got float: write estimate\("):
            hx.estimate(1.0, SETTLED)

    def test_unknown_noise(self):
        with pytest.raises(InputError, match="FixedLeg: the noise is unknown"):
            hx.estimate(loop_of("leg", noise=None), SETTLED)
