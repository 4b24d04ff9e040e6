"""Estimates: names, statuses, views, reports; and `estimate`, which has no switch."""

import pickle
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, HexoptError, InputError, RankDeficientError


@pytest.fixture
def data(left_hand, paper_noise):
    return hx.simulate_leg(left_hand, 3, "direction", 6, 8, noise=paper_noise, rng=0)


@pytest.fixture
def found(data):
    return hx.estimate(hx.loops.FixedDirection(data).linear(), hx.LeastSquares())


def with_identical_poses(data, member):
    position, rotation, length = (np.array(part) for part in (data.position, data.rotation, data.length))
    for part in (position, rotation, length):
        part[member] = part[member, :1]
    return hx.LegMeasurements(position, rotation, length, data.lock, data.noise, data.nominal)


class TestEstimate:
    def test_values_have_names(self, found):
        assert list(found.params) == ["platform_point", "base_point", "direction"]
        np.testing.assert_array_equal(found.params["base_point"], found.values[:, 3:6])

    def test_error_is_the_papers_index(self, found, left_hand):
        error = found.error(left_hand.leg(3))
        assert set(error) == {"platform_point", "base_point"}
        expected = [np.linalg.norm(values[3:6] - left_hand.base_points[2]) for values in found.values]
        np.testing.assert_allclose(error["base_point"], expected, rtol=1e-14)

    def test_a_member_is_the_estimate_of_its_problem(self, data, found):
        for index in (3, -1):
            one, alone = found[index], hx.estimate(hx.loops.FixedDirection(data[index]).linear(), hx.LeastSquares())
            assert one.batch_shape == ()
            assert one.status is hx.Status.OPTIMAL
            assert one.ok is True
            for name in ("values", "covariance", "objective", "condition", "influence"):
                np.testing.assert_allclose(getattr(one, name), getattr(alone, name), rtol=1e-9, atol=1e-13)
        assert found[2:5].values.shape == (3, 9)
        with pytest.raises(InputError, match="of one problem"):
            found[0][0]

    def test_statuses_of_a_batch(self, found):
        assert found.ok.all()
        assert found.status.shape == (8,)
        assert set(found.status) == {hx.Status.OPTIMAL}

    def test_standard_errors_and_parts_of_the_covariance(self, found):
        np.testing.assert_allclose(found.standard_errors[1] ** 2, np.diag(found.covariance[1]), rtol=1e-14)
        order = found.covariance_of("direction", "base_point")[1]
        rows = [6, 7, 8, 3, 4, 5]
        np.testing.assert_array_equal(order, found.covariance[1][np.ix_(rows, rows)])
        with pytest.raises(InputError, match="unknown parameter 'nonsense'"):
            found.covariance_of("nonsense")

    def test_without_a_covariance_the_reason_is_given(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "direction", 3, rng=0)
        found = hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), hx.LeastSquares())
        assert found.covariance is None
        for ask in (lambda: found.standard_errors, lambda: found.covariance_of("base_point")):
            with pytest.raises(InputError, match="no covariance: no noise model, and no residual is left"):
                ask()
        assert "no noise model" in found.summary()

    def test_frame_is_tidy(self, found):
        frame = found.to_frame()
        assert len(frame) == 8 * 9
        row = frame[(frame["problem"] == 5) & (frame["parameter"] == "base_point.y")].iloc[0]
        assert row["value"] == found.values[5, 4]
        assert row["standard_error"] == found.standard_errors[5, 4]
        assert (row["unit"], row["status"]) == ("cm", "OPTIMAL")
        single = found[0].to_frame()
        assert isinstance(single, pd.DataFrame)
        assert len(single) == 9

    def test_summary_shows_every_name_with_unit_and_error(self, found):
        text = found[0].summary()
        for label, value, error in zip(found.parameters.labels, found.values[0], found.standard_errors[0], strict=True):
            (line,) = [line for line in text.splitlines() if line.strip().startswith(label + " ")]
            assert f"{value:.6f}" in line
            assert f"± {error:.3g}" in line
        for part in ("OPTIMAL", "sandwich", "nuisance", " cm", "degrees of freedom 9", "condition"):
            assert part in text

    def test_summary_of_a_batch_counts_statuses(self, data):
        bad = with_identical_poses(data, 2)
        text = hx.estimate(hx.loops.FixedDirection(bad).linear(), hx.LeastSquares()).summary()
        assert "7 OPTIMAL, 1 RANK_DEFICIENT" in text

    def test_an_estimate_pickles(self, found):
        again = pickle.loads(pickle.dumps(found))
        np.testing.assert_array_equal(again.values, found.values)
        assert again.parameters == found.parameters

    def test_two_batch_dimensions(self, data):
        shaped = hx.LegMeasurements(
            data.position.reshape(2, 4, 6, 3),
            data.rotation.reshape(2, 4, 6, 3, 3),
            data.length.reshape(2, 4, 6),
            data.lock,
            data.noise,
            data.nominal,
        )
        found = hx.estimate(hx.loops.FixedDirection(shaped).linear(), hx.LeastSquares())
        flat = hx.estimate(hx.loops.FixedDirection(data).linear(), hx.LeastSquares())
        np.testing.assert_allclose(found.values.reshape(8, 9), flat.values, rtol=1e-12)
        assert found.status.shape == (2, 4)
        assert found[1, 2].batch_shape == ()
        assert len(found.to_frame()) == 72


class TestThrow:
    def test_a_single_failure_raises_and_a_batch_does_not(self, data):
        bad = with_identical_poses(data, 2)
        loop, single = hx.loops.FixedDirection(bad), hx.loops.FixedDirection(bad[2])
        found = hx.estimate(loop.linear(), hx.LeastSquares())
        assert [status.name for status in found.status] == ["OPTIMAL"] * 2 + ["RANK_DEFICIENT"] + ["OPTIMAL"] * 5
        assert np.isnan(found.values[2]).all()
        assert np.isfinite(np.delete(found.values, 2, axis=0)).all()
        with pytest.raises(RankDeficientError):
            hx.estimate(single.linear(), hx.LeastSquares())

    def test_true_raises_for_a_batch_and_false_never(self, data):
        bad = with_identical_poses(data, 2)
        with pytest.raises(RankDeficientError, match="in 1 of 8 problems"):
            hx.estimate(hx.loops.FixedDirection(bad).linear(), hx.LeastSquares(), throw=True)
        found = hx.estimate(hx.loops.FixedDirection(bad[2]).linear(), hx.LeastSquares(), throw=False)
        assert found.status is hx.Status.RANK_DEFICIENT
        assert found.ok is False
        assert np.isnan(found.values).all()
        assert np.isnan(found.covariance).all()

    def test_other_failures_are_estimation_errors(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "none", 12, nominal=left_hand.perturbed(3, rng=0), rng=0)
        slow = hx.InverseKinematics(max_iterations=1)
        with pytest.raises(EstimationError, match="NOT_CONVERGED"):
            hx.estimate(hx.loops.LegLength(data), slow)
        assert hx.estimate(hx.loops.LegLength(data), slow, throw=False).status is hx.Status.NOT_CONVERGED

    @pytest.mark.parametrize(
        ("status", "remedy"),
        [
            (hx.Status.INACCURATE, "more or other poses"),
            (hx.Status.NOT_CONVERGED, "give more iterations or another start"),
            (hx.Status.INFEASIBLE, "loosen the constraints"),
            (hx.Status.FAILED, "another estimator"),
        ],
    )
    def test_every_failure_says_what_to_do(self, found, status, remedy):
        class Fails:
            accepts, hint = (object,), ""

            def fit(self, target):
                return replace(found, codes=np.where(np.arange(found.codes.size) == 1, status, found.codes))

        with pytest.raises(EstimationError, match=f"{status.name} in 1 of {found.codes.size} problems; .*{remedy}"):
            hx.estimate(None, Fails(), throw=True)

    def test_a_wrong_call_always_raises(self, left_hand):
        data = hx.simulate_leg(left_hand, 3, "direction", 2, 5, rng=0)
        for throw in (True, False, None):
            with pytest.raises(
                RankDeficientError, match=r"too few poses: 6 equations for 9 unknowns.*at least 3 poses"
            ):
                hx.estimate(hx.loops.FixedDirection(data).linear(), hx.LeastSquares(), throw=throw)


class TestWrongTargets:
    def test_the_error_says_what_to_write(self, data, left_hand):
        loop = hx.loops.FixedDirection(data)
        with pytest.raises(InputError, match=r"LeastSquares takes a LinearProblem, got FixedDirection: write .*linear"):
            hx.estimate(loop, hx.LeastSquares())
        with pytest.raises(
            InputError, match=r"InverseKinematics takes a LegLength, got LinearProblem: write .*LegLength"
        ):
            hx.estimate(loop.linear(), hx.InverseKinematics())
        with pytest.raises(InputError, match="takes a LinearProblem, got ndarray"):
            hx.estimate(np.eye(3), hx.LeastSquares())

    @pytest.mark.parametrize("estimator", [hx.LeastSquares, None, "svd", 3])
    def test_what_is_no_estimator_is_said_so(self, data, estimator):
        with pytest.raises(InputError, match=r"estimator: expected one such as LeastSquares\(\)"):
            hx.estimate(hx.loops.FixedDirection(data).linear(), estimator)


def test_errors_are_one_family_and_pickle():
    error = RankDeficientError("message", ("base_point.x",))
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.combinations) == ("message", ("base_point.x",))
    for name in ("InputError", "UnitError", "LockError", "FileFormatError", "SamplingError", "EstimationError"):
        assert issubclass(getattr(hx, name), HexoptError)
    assert issubclass(InputError, ValueError)
