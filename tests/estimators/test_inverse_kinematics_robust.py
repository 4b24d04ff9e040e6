"""Leg lengths under losses, priors and bounds: against SciPy and IPOPT, and its honesty."""

import numpy as np
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError
from hexopt.estimators.leg_rows import LegRows
from hexopt.loops import LegLength
from hexopt.testing import check_estimator

NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
NAMES = LegLength.involved


def simulated(robot, *, leg=3, n=14, n_sets=30, lock="none", bad=0.0, seed=0, off=0.5):
    """Noisy sets with a nominal that is off, and a share of poses that is bad by half a centimetre."""
    nominal = robot.perturbed(off, offsets=off, rng=seed).leg(leg)
    data = hx.simulate_leg(robot, leg, lock, n, n_sets, noise=NOISE, nominal=nominal, rng=seed)
    rng = np.random.default_rng(seed)
    error = np.zeros((*data.batch_shape, n, 7))
    error[..., :3] = 0.5 * rng.standard_normal((*data.batch_shape, n, 3))
    error *= (rng.uniform(size=(*data.batch_shape, n)) < bad)[..., None]
    return data.shifted(error)


def settings(name, data):
    nominal = data.nominal
    size = 0.02 * np.linalg.norm(nominal.base_point)
    return {
        "plain": {},
        "weighted": {"weights": "model"},
        "huber": {"loss": hx.Huber(), "weights": "model"},
        "mad": {"loss": hx.Huber(), "scale": "mad"},
        "box": {"bounds": hx.Box.around(nominal, size)},
        "prior": {"prior": hx.GaussianPrior.around(nominal, 0.3), "weights": "model"},
        "all": {
            "loss": hx.Huber(2.0),
            "prior": [hx.GaussianPrior.around(nominal, 0.3), hx.Ridge.around(nominal, 3.0)],
            "bounds": hx.Box.around(nominal, size),
            "weights": "model",
        },
    }[name]


CASES = ("plain", "weighted", "huber", "mad", "box", "prior", "all")


class TestAgainstIpopt:
    @pytest.mark.parametrize("bad", [0.0, 0.1])
    @pytest.mark.parametrize("case", CASES)
    def test_both_backends_agree(self, left_hand, case, bad):
        data = simulated(left_hand, n_sets=3, n=20, bad=bad)
        self.agree(LegLength(data), settings(case, data))

    @pytest.mark.parametrize("name", ["linuxcnc", "jugglebot"])
    @pytest.mark.parametrize("leg", [1, 5])
    def test_on_other_robots_and_legs(self, name, leg):
        robot = hx.robots.BUILT_IN[name]()
        nominal = robot.perturbed(0.02 * robot.size, rng=leg).leg(leg)
        noise = hx.UniformNoise(5e-4 * robot.size, 2e-4, 5e-4 * robot.size)
        data = hx.simulate_leg(robot, leg, "none", 20, 2, noise=noise, nominal=nominal, rng=leg)
        for case in ("huber", "box"):
            self.agree(LegLength(data, unknown=NAMES[:2]), settings(case, data))

    @pytest.mark.parametrize("model", [2, 4])
    def test_on_other_models(self, left_hand, model):
        data = simulated(left_hand, n_sets=2, n=20, bad=0.1)
        self.agree(LegLength(data, unknown=NAMES[:model]), settings("all", data))

    def agree(self, loop, chosen):
        found = hx.estimate(loop, hx.InverseKinematics(**chosen))
        expected = hx.estimate(loop, hx.InverseKinematics(**chosen, backend="ipopt"))
        assert found.ok.all()
        assert expected.ok.all()
        sigma = np.where(found.standard_errors > 0, found.standard_errors, np.inf)  # at a bound: the distance itself
        at_bound = np.isinf(sigma)
        assert (np.abs(found.values - expected.values) <= 1e-6 * np.where(at_bound, 1.0, sigma)).all()
        np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-4, atol=1e-9)
        np.testing.assert_allclose(found.objective, expected.objective, rtol=1e-8, atol=1e-12)

    @pytest.mark.parametrize(
        "wrong",
        [
            {"loss": hx.L1()},
            {"bounds": hx.Ball({"base_point": ([0, 0, 0], 30.0)})},
            {"prior": hx.Lasso({"offset": 15.0}, 1.0), "weights": "model"},
        ],
        ids=repr,
    )
    def test_what_it_does_not_take(self, wrong):
        with pytest.raises(InputError, match="backend='ipopt' takes Quadratic and Huber"):
            hx.InverseKinematics(**wrong, backend="ipopt")

    def test_it_fails_set_by_set(self, left_hand):
        data = simulated(left_hand, n_sets=2)
        found = hx.estimate(LegLength(data), hx.InverseKinematics(backend="ipopt", max_iterations=1))
        assert [str(status) for status in found.status] == ["Status.NOT_CONVERGED"] * 2 or (found.codes == 3).all()
        assert np.isnan(found.values).all()


class TestAgainstScipy:
    def rows(self, data, i, weights):
        single = LegLength(data[i])
        return single, np.ones(data.n_poses) if weights is None else weights

    def test_huber(self, left_hand):
        """SciPy's soft threshold: ρ(z²) with z = r / f_scale; its cost is ours times nothing."""
        data = simulated(left_hand, bad=0.1, n_sets=8, n=20)
        found = hx.estimate(LegLength(data), hx.InverseKinematics(loss=hx.Huber(1.345), scale=0.01))
        for i in range(8):
            single = LegLength(data[i])
            expected = least_squares(
                lambda x, single=single: single.residual(x)[:, 0] / 0.01,
                found.values[i] + 1e-3,
                lambda x, single=single: single.jacobian(x)[:, 0] / 0.01,
                loss="huber",
                f_scale=1.345,
                xtol=1e-15,
                ftol=1e-15,
                gtol=1e-12,
                x_scale="jac",
                max_nfev=2000,
            )
            assert found.objective[i] == pytest.approx(expected.cost, rel=1e-9)
            assert (np.abs(found.values[i] - expected.x) <= 1e-4 * found.standard_errors[i]).all()

    def test_bounds(self, left_hand):
        data = simulated(left_hand, n_sets=8, n=20)
        box = hx.Box.around(data.nominal, 0.45)
        found = hx.estimate(LegLength(data), hx.InverseKinematics(bounds=box))
        low = np.concatenate([box.bounds["platform_point"][0], box.bounds["base_point"][0], [-np.inf]])
        high = np.concatenate([box.bounds["platform_point"][1], box.bounds["base_point"][1], [np.inf]])
        assert ((found.values[:, :6] == low[:6]) | (found.values[:, :6] == high[:6])).any(axis=1).all()
        for i in range(8):
            single = LegLength(data[i])
            expected = least_squares(
                lambda x, single=single: single.residual(x)[:, 0],
                np.clip(found.values[i], low + 1e-3, high - 1e-3),
                lambda x, single=single: single.jacobian(x)[:, 0],
                bounds=(low, high),
                xtol=1e-15,
                ftol=1e-15,
                gtol=1e-15,
                x_scale="jac",
            )
            assert found.objective[i] <= expected.cost * (1 + 1e-9)
            np.testing.assert_allclose(found.values[i], expected.x, atol=1e-4)


class TestWhatItIsFor:
    def test_outliers_do_little_harm(self, left_hand):
        data, clean = simulated(left_hand, bad=0.1, n=30), simulated(left_hand, n=30)
        truth = left_hand.leg(3)

        def error(sets, **chosen):
            found = hx.estimate(LegLength(sets), hx.InverseKinematics(weights="model", **chosen))
            assert found.ok.all()
            return np.median(found.error(truth)["base_point"])

        assert error(data, loss=hx.Huber()) < 2.5 * error(clean)
        assert error(data) > 5 * error(clean)

    def test_of_a_quadratic_loss_in_wide_bounds_it_is_the_plain_fit(self, left_hand):
        data = simulated(left_hand)
        for weights in (None, "model"):
            plain = hx.estimate(LegLength(data), hx.InverseKinematics(weights=weights))
            found = hx.estimate(
                LegLength(data), hx.InverseKinematics(weights=weights, bounds=hx.Box.around(data.nominal, 5.0))
            )
            assert (np.abs(found.values - plain.values) <= 1e-6 * plain.standard_errors).all()
            np.testing.assert_allclose(found.covariance, plain.covariance, rtol=1e-5, atol=1e-12)
            np.testing.assert_allclose(found.influence, plain.influence, rtol=1e-4, atol=1e-7)
            np.testing.assert_allclose(found.objective, plain.objective, rtol=1e-9)
            assert found.covariance_kind == plain.covariance_kind
            assert found.degrees_of_freedom == plain.degrees_of_freedom
            assert (found.chi2 is None) == (plain.chi2 is None)

    def test_a_posterior_is_shorter_than_prior_and_data(self, left_hand):
        data = simulated(left_hand)
        prior = hx.GaussianPrior.around(data.nominal, 0.3)
        free = hx.estimate(LegLength(data), hx.InverseKinematics(weights="model"))
        found = hx.estimate(LegLength(data), hx.InverseKinematics(weights="model", prior=prior))
        assert found.covariance_kind == "posterior"
        assert (found.standard_errors[:, :6] < np.minimum(free.standard_errors[:, :6], 0.3)).all()
        assert not found.undetermined.any()

    @pytest.mark.parametrize(
        "bounds",
        [
            hx.Ball.around(hx.robots.left_hand().leg(3).replaced(base_point=[12.9, 3.9, 0.0]), 0.1),
            hx.Linear({"platform_point": [1.0, 1.0, 0.0]}, equal=6.77),
        ],
        ids=repr,
    )
    def test_balls_and_equations_hold(self, left_hand, bounds):
        data = simulated(left_hand, n_sets=10)
        found = hx.estimate(LegLength(data), hx.InverseKinematics(weights="model", bounds=bounds))
        assert found.ok.all()
        if isinstance(bounds, hx.Linear):
            np.testing.assert_allclose(found.params["platform_point"][:, :2].sum(axis=1), 6.77, atol=1e-8)
        else:
            distance = np.linalg.norm(found.params["base_point"] - [12.9, 3.9, 0.0], axis=1)
            assert (distance <= 0.1 + 1e-8).all()
            np.testing.assert_allclose(distance, 0.1, atol=1e-6)

    @pytest.mark.parametrize("loss", [hx.L1(), hx.Chebyshev()], ids=repr)
    def test_no_step_lowers_a_nonsmooth_loss(self, left_hand, loss):
        data = simulated(left_hand, n_sets=5)
        loop = LegLength(data)
        found = hx.estimate(loop, hx.InverseKinematics(loss=loss))
        assert found.ok.all()
        rng = np.random.default_rng(0)
        for size in (1e-2, 1e-4):
            near = found.values[:, None] + size * rng.standard_normal((5, 200, 7))
            others = np.stack([loss.total(loop.residual(near[:, k])) for k in range(200)], axis=1)
            assert (others >= found.objective[:, None] * (1 - 1e-7)).all()


class TestHonesty:
    @pytest.mark.parametrize("backend", ["auto", "ipopt"])
    def test_infeasible_bounds_stay_so(self, left_hand, backend):
        data = simulated(left_hand, n_sets=3)
        apart = [hx.Box({"offset": (0.0, 1.0)}), hx.Box({"offset": (2.0, 3.0)})]
        found = hx.estimate(LegLength(data), hx.InverseKinematics(bounds=apart, backend=backend))
        assert [status is hx.Status.INFEASIBLE for status in found.status] == [True] * 3
        assert np.isnan(found.values).all()

    def test_too_few_iterations_are_no_success(self, left_hand):
        data = simulated(left_hand, bad=0.1, n_sets=5)
        found = hx.estimate(LegLength(data), hx.InverseKinematics(loss=hx.Huber(), weights="model", max_iterations=1))
        assert [status is hx.Status.NOT_CONVERGED for status in found.status] == [True] * 5
        assert np.isnan(found.values).all()

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_a_locked_direction_is_not_seen(self, left_hand, lock):
        data = simulated(left_hand, lock=lock, n_sets=3, n=12)
        for chosen in ({"loss": hx.Huber(), "weights": "model"}, {"bounds": hx.Box({"offset": (10.0, 20.0)})}):
            found = hx.estimate(LegLength(data), hx.InverseKinematics(**chosen))
            assert [status is hx.Status.RANK_DEFICIENT for status in found.status] == [True] * 3
            if "bounds" not in chosen:
                assert found.unseen == ("base_point across the leg's locked direction",)
            assert any("base_point" in words for words in found.unseen)
            with pytest.raises(RankDeficientError, match="base_point"):
                hx.estimate(LegLength(data[0]), hx.InverseKinematics(**chosen))

    @pytest.mark.parametrize("lock", ["direction", "leg"])
    def test_a_prior_decides_what_a_locked_direction_hides(self, left_hand, lock):
        data = simulated(left_hand, lock=lock, n_sets=3, n=12)
        prior = [hx.GaussianPrior.around(data.nominal, 0.3), hx.GaussianPrior({"offset": 15.25}, {"offset": 0.01})]
        found = hx.estimate(LegLength(data), hx.InverseKinematics(weights="model", prior=prior))
        assert found.ok.all()
        assert found.undetermined.all()
        assert any("base_point" in words for words in found.decided)
        assert (found.standard_errors[:, 3:6].max(axis=1) > 0.25).all()  # across the direction: the prior's

    def test_a_locked_length_does_not_see_offset_against_gain(self, left_hand):
        data = simulated(left_hand, lock="length", n_sets=3, n=20, off=0.1)
        loop = LegLength(data, unknown=NAMES)
        found = hx.InverseKinematics(loss=hx.Huber(), weights="model").fit(loop)
        assert (found.codes == int(hx.Status.RANK_DEFICIENT)).all()
        assert found.unseen == ("offset against gain: a locked length has one reading",)
        prior = hx.GaussianPrior({"gain": 1.0}, {"gain": 1e-4})
        decided = hx.InverseKinematics(weights="model", prior=prior).fit(loop)
        assert decided.ok.all()
        assert decided.undetermined.all()
        assert any("offset" in words and "gain" in words for words in decided.decided)
        np.testing.assert_allclose(decided.standard_errors[:, -1], 0.01, rtol=1e-6)  # the prior's
        other = hx.GaussianPrior.around(data.nominal, 0.3)  # of the points alone: offset and gain stay unseen
        left = hx.InverseKinematics(weights="model", prior=other).fit(loop)
        assert (left.codes == int(hx.Status.RANK_DEFICIENT)).all()
        assert any("offset" in words and "gain" in words for words in left.unseen)

    def test_a_prior_makes_up_for_missing_poses(self, left_hand):
        data = simulated(left_hand, n=4, n_sets=3)
        prior = [hx.GaussianPrior.around(data.nominal, 0.3), hx.GaussianPrior({"offset": 15.25}, {"offset": 0.01})]
        found = hx.estimate(LegLength(data), hx.InverseKinematics(weights="model", prior=prior))
        assert found.ok.all()
        assert found.decided
        with pytest.raises(RankDeficientError, match="too few poses"):
            hx.estimate(LegLength(data), hx.InverseKinematics(loss=hx.Huber(), scale=0.01))

    def test_a_known_value_that_failed_fails_alone(self, left_hand):
        data = simulated(left_hand, n_sets=3)
        offset = np.array([15.25, np.nan, 15.25])[:, None]
        known = hx.estimate(LegLength(data), hx.InverseKinematics())
        spoilt = type(known)(**{**vars(known), "values": np.where(np.isnan(offset), np.nan, known.values)})
        loop = LegLength(data, unknown=NAMES[:2], offset=spoilt)
        for chosen in ({}, {"loss": hx.Huber(), "weights": "model"}):
            found = hx.estimate(loop, hx.InverseKinematics(**chosen))
            np.testing.assert_array_equal(found.ok, [True, False, True])
            assert np.isnan(found.values[1]).all()

    def test_no_covariance_when_not_asked(self, left_hand):
        data = simulated(left_hand, n_sets=3)
        for chosen in ({}, {"loss": hx.Huber(), "weights": "model"}):
            full = hx.estimate(LegLength(data), hx.InverseKinematics(**chosen))
            found = hx.estimate(LegLength(data), hx.InverseKinematics(**chosen, covariance=False))
            assert found.covariance is None
            assert "covariance=False" in found.covariance_kind
            np.testing.assert_allclose(found.values, full.values, rtol=1e-12)
            assert found.degrees_of_freedom == full.degrees_of_freedom


class TestWrongCalls:
    @pytest.mark.parametrize(
        ("wrong", "message"),
        [
            ({"loss": "huber"}, "loss: expected a loss"),
            ({"loss": hx.Huber()}, "has a threshold in σ"),
            ({"prior": hx.Ridge({"offset": 15.0}, 1.0)}, "a prior is weighed against rows in σ"),
            ({"bounds": (0, 1)}, "bounds: expected"),
            ({"scale": -1.0}, "scale: expected"),
            ({"backend": "casadi"}, "backend: expected 'auto' or 'ipopt'"),
        ],
    )
    def test_wrong_settings(self, wrong, message):
        with pytest.raises(InputError, match=message):
            hx.InverseKinematics(**wrong)

    def test_unknown_names(self, left_hand):
        data = simulated(left_hand, n_sets=2)
        with pytest.raises(InputError, match="unknown parameter"):
            hx.estimate(LegLength(data), hx.InverseKinematics(bounds=hx.Box({"ofset": (0, 20)})))


@pytest.mark.parametrize(
    "chosen",
    [
        {"loss": hx.Huber(), "weights": "model"},
        {"loss": hx.Huber(), "scale": "mad"},
        {"loss": hx.Huber(), "scale": 1e-3},
    ],
    ids=lambda chosen: ",".join(chosen),
)
def test_the_contract_of_losses(chosen):
    claims = ("exact", "order", "frame", "rank") if chosen.get("scale") == 1e-3 else None
    extra = {} if claims is None else {"claims": claims}
    check_estimator(hx.InverseKinematics(**chosen), n_poses=16, tolerance=1e-4, exactness=1e-8, **extra)


@pytest.mark.parametrize(
    "chosen",
    [
        {"prior": hx.GaussianPrior.around(hx.robots.left_hand().leg(3), 0.1), "weights": "model"},
        {"bounds": hx.Box.around(hx.robots.left_hand().leg(3), 5e-4)},
        {"bounds": hx.Box.around(hx.robots.left_hand().leg(3), 5e-4), "loss": hx.Huber(), "weights": "model"},
    ],
    ids=lambda chosen: ",".join(chosen),
)
def test_the_contract_of_priors_and_bounds(chosen):
    """They stay where they are when frames and units move."""
    check_estimator(hx.InverseKinematics(**chosen), n_poses=16, tolerance=1e-4, claims=("order",))


@pytest.mark.parametrize("noise", ["own", "common"])
def test_a_batch_equals_its_members(left_hand, noise):
    data = simulated(left_hand, bad=0.1, n_sets=6)
    if noise == "common":
        model = hx.NormalNoise(0.01, 1e-4, 0.01, common_covariance=np.diag([1e-4] * 3 + [1e-8] * 3 + [1e-4]))
        data = hx.LegMeasurements(data.position, data.rotation, data.length, "none", model, data.nominal)
    for case in ("huber", "mad", "box", "prior", "all"):
        estimator = hx.InverseKinematics(**settings(case, data))
        together = hx.estimate(LegLength(data), estimator, throw=False)
        for i in range(6):
            alone = hx.estimate(LegLength(data[i]), estimator, throw=False)
            assert alone.status is together.status[i]
            np.testing.assert_allclose(together.values[i], alone.values, atol=1e-8)
            np.testing.assert_allclose(together.covariance[i], alone.covariance, rtol=1e-4, atol=1e-10)


@pytest.mark.parametrize("unknown", [2, 3, 4])
def test_the_fast_rows_are_those_of_the_loop(left_hand, unknown):
    loop = LegLength(simulated(left_hand, n_sets=5), unknown=NAMES[:unknown])
    x = loop.values(left_hand.leg(3)) + 0.1 * np.random.default_rng(0).standard_normal((5, loop.parameters.size))
    rows = LegRows.of(loop)
    residual, jacobian = rows.at(x)
    np.testing.assert_allclose(residual, loop.residual(x)[..., 0], atol=1e-13)
    np.testing.assert_allclose(jacobian, loop.jacobian(x)[..., 0, :], atol=1e-13)
    some = rows.take(np.array([3, 1])).at(x[[3, 1]])
    np.testing.assert_array_equal(some[1], jacobian[[3, 1]])


@pytest.mark.parametrize(
    "chosen",
    [
        {"loss": hx.Huber(), "weights": "model"},
        {"loss": hx.Huber(), "scale": 0.1},
        {"bounds": hx.Box.around(hx.robots.rubin().leg(2), 3000.0)},
    ],
    ids=lambda chosen: ",".join(chosen),
)
def test_on_ill_conditioned_rows_it_ends_and_a_batch_equals_its_members(chosen):
    """Rubin: rows of a millionth of the coordinates, and κ of 1e5; what is left of a step is rounding soon."""
    robot = hx.robots.rubin()
    noise = hx.NormalNoise(0.1, 1e-7, 0.1)
    data = hx.simulate_leg(robot, 2, "none", 15, 50, noise=noise, nominal=robot.perturbed(500, rng=2), rng=2)
    estimator = hx.InverseKinematics(**chosen)
    together = estimator.fit(LegLength(data))
    assert together.ok.all()
    assert together.iterations.max() < 40
    for i in (5, 8, 11, 33, 39):
        alone = estimator.fit(LegLength(data[i]))
        assert alone.ok
        sigma = np.where(together.standard_errors[i] > 0, together.standard_errors[i], np.inf)
        assert (np.abs(together.values[i] - alone.values) <= 1e-5 * sigma)[np.isfinite(sigma)].all()
        np.testing.assert_allclose(together.objective[i], alone.objective, rtol=1e-8)


def test_rows_are_uncertain_by_the_rounding_of_what_they_are_a_difference_of():
    """Rubin: the length of a vector of millions, minus a reading and an offset; against more digits."""
    robot = hx.robots.rubin()
    data = hx.simulate_leg(robot, 2, "none", 15, 200, nominal=robot.perturbed(500, rng=2), rng=2)
    loop = LegLength(data)
    x = loop.values(robot.leg(2)) + np.random.default_rng(0).standard_normal((200, 7))
    rows = LegRows.of(loop)
    b, a, offset = (x.astype(np.longdouble)[:, None, part] for part in (slice(0, 3), slice(3, 6), 6))
    turned = (data.rotation.astype(np.longdouble) * b[..., None, :]).sum(axis=-1)
    exact = np.sqrt(((data.position + turned - a) ** 2).sum(axis=-1)) - data.length - offset
    error = np.abs(rows.at(x)[0] - exact).astype(float)
    assert (error <= rows.rounding(x)).all()
    assert error.max() > 0.01 * rows.rounding(x).max()
    weighted = rows.weighted(None, np.full(200, 0.1))
    np.testing.assert_allclose(weighted.rounding(x), 10 * rows.rounding(x))
