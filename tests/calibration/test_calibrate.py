"""Whole calibrations: sets sorted by leg and lock, a robot and a report out of them."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError, LockError, RankDeficientError, UnitError

NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
METHODS = {
    "one step": (hx.OneStep(), ["direction"]),
    "one step direct": (hx.OneStep("direct"), ["direction"]),
    "three steps": (hx.ThreeStep(), ["leg", "length"]),
    "three steps direct": (hx.ThreeStep("direct"), ["leg", "length"]),
    "three steps centred": (hx.ThreeStep("centred"), ["leg", "length"]),
}


def sets_of(robot, locks, legs=range(1, 7), noise=None, n=8):
    """One set a leg and lock, whose nominals are worthless: calibrate brings its own."""
    return [
        hx.simulate_leg(robot, leg, lock, n, noise=noise, nominal=robot.perturbed(3, rng=1), rng=10 * leg)
        for leg in legs
        for lock in locks
    ]


def joints_error(one, two):
    return max(np.abs(one.base_points - two.base_points).max(), np.abs(one.platform_points - two.platform_points).max())


class TestExact:
    @pytest.mark.parametrize("name", METHODS)
    def test_all_six_legs_without_noise(self, robot, name):
        method, locks = METHODS[name]
        scale = robot.size / 20
        nominal = robot.perturbed(0.5 * scale, offsets=0.0 if "one" in name else 0.5 * scale, rng=0)
        sets = [
            hx.simulate_leg(robot, leg, lock, 8, nominal=robot, rng=10 * leg) for leg in range(1, 7) for lock in locks
        ]
        result = hx.calibrate(nominal, sets, method)
        assert joints_error(nominal, robot) > 0.1 * scale
        worst = 1e-5 if robot.name.startswith("Rubin") else 1e-9  # κ up to 1e10 there
        assert joints_error(result.robot, robot) < worst * robot.size
        assert np.abs(result.robot.offsets - robot.offsets).max() < worst * robot.size
        assert list(result.legs) == [1, 2, 3, 4, 5, 6]
        for part in result.legs.values():
            assert part.residual_rms < worst * robot.size

    @pytest.mark.parametrize("model", [36, 42, 48])
    def test_free_poses(self, left_hand, model):
        nominal = left_hand.perturbed(0.5, offsets=0.3 if model > 36 else 0.0, rng=0)
        if model == 48:
            nominal = replace(nominal, gains=nominal.gains * 1.01)
        data = hx.simulate(left_hand, n_poses=40, rng=0)
        result = hx.calibrate(nominal, data, hx.FreePoses(model))
        assert joints_error(result.robot, left_hand) < 1e-8
        np.testing.assert_allclose(result.robot.offsets, left_hand.offsets, atol=1e-8)
        np.testing.assert_allclose(result.robot.gains, left_hand.gains, atol=1e-10)
        assert {part.n_poses for part in result.legs.values()} == {40}

    def test_order_and_kind_of_the_sets_do_not_matter(self, left_hand):
        sets = sets_of(left_hand, ["leg", "length"])
        one = hx.calibrate(left_hand, sets, hx.ThreeStep())
        two = hx.calibrate(left_hand, sets[::-1], hx.ThreeStep())
        np.testing.assert_array_equal(one.robot.base_points, two.robot.base_points)
        six = [hx.simulate(left_hand, "direction", 6, leg=leg, rng=leg) for leg in (2, 5)]
        result = hx.calibrate(left_hand.perturbed(0.5, rng=0), six, hx.OneStep())
        assert list(result.legs) == [2, 5]

    def test_legs_without_a_set_keep_their_nominal(self, left_hand):
        nominal = left_hand.perturbed(0.5, offsets=0.5, rng=0)
        result = hx.calibrate(nominal, sets_of(left_hand, ["direction"], legs=[2]), hx.OneStep())
        others = [0, 2, 3, 4, 5]
        np.testing.assert_array_equal(result.robot.base_points[others], nominal.base_points[others])
        np.testing.assert_array_equal(result.robot.offsets, nominal.offsets)
        assert result.nominal is nominal
        assert "not measured, nominal kept: leg 1, 3, 4, 5, 6" in result.summary()

    def test_the_offset_of_the_nominal_is_what_one_step_uses(self, left_hand):
        """OneStep takes the offset as known: from the robot that is calibrated, not from the sets."""
        sets = sets_of(left_hand, ["direction"], legs=[2])
        wrong = replace(left_hand, offsets=left_hand.offsets + 0.5)
        assert joints_error(hx.calibrate(left_hand, sets, hx.OneStep()).robot, left_hand) < 1e-9
        assert joints_error(hx.calibrate(wrong, sets, hx.OneStep()).robot, left_hand) > 0.1

    def test_a_calibrated_robot_survives_toml(self, left_hand, tmp_path):
        result = hx.calibrate(left_hand, sets_of(left_hand, ["direction"], noise=NOISE), hx.OneStep())
        again = hx.Hexapod.from_toml(result.robot.to_toml(tmp_path / "calibrated.toml"))
        np.testing.assert_array_equal(again.base_points, result.robot.base_points)


class TestReport:
    @pytest.fixture(params=["one step", "three steps"])
    def result(self, request, left_hand):
        method, locks = METHODS[request.param]
        return hx.calibrate(left_hand.perturbed(0.3, rng=0), sets_of(left_hand, locks, noise=NOISE), method)

    def test_covariances_are_in_the_order_of_the_names(self, result):
        for number, part in result.legs.items():
            size = sum(3 if "point" in name else 1 for name in part.names)
            assert part.covariance.shape == (size, size)
            assert result.covariance[number] is part.covariance
            step = next(iter(part.steps.values()))
            np.testing.assert_allclose(part.covariance[:3, :3], step.covariance_of("platform_point"), rtol=1e-9)

    def test_errors_are_within_their_standard_errors(self, result, left_hand):
        frame = result.to_frame()
        truth = np.concatenate(
            [np.concatenate([left_hand.leg(k).block(name) for name in result.legs[k].names]) for k in result.legs]
        )
        z = (frame["calibrated"].to_numpy() - truth) / frame["standard_error"].to_numpy()
        assert 0.5 < np.sqrt(np.mean(z**2)) < 1.5

    def test_the_table_holds_what_the_legs_do(self, result):
        frame = result.to_frame()
        row = frame[(frame["leg"] == 4) & (frame["parameter"] == "base_point.y")].iloc[0]
        part = result.legs[4]
        assert row["calibrated"] == part.leg.base_point[1]
        assert row["nominal"] == result.nominal.base_points[3, 1]
        assert row["standard_error"] == np.sqrt(part.covariance[4, 4])
        assert row["unit"] == "cm"
        assert len(frame) == 6 * len(part.covariance)

    def test_the_residual_is_that_of_leg_lengths(self, result, left_hand):
        part = result.legs[2]
        locks = ["direction"] if len(part.steps) == 1 else ["leg", "length"]
        squares = []
        for data in sets_of(left_hand, locks, legs=[2], noise=NOISE):
            vector = data.position + data.rotation @ part.leg.platform_point - part.leg.base_point
            squares.append((np.linalg.norm(vector, axis=1) - (data.length + part.leg.offset)) ** 2)
        np.testing.assert_allclose(part.residual_rms, np.sqrt(np.concatenate(squares).mean()), rtol=1e-9)
        assert part.n_poses == 8 * len(locks)

    def test_summary_shows_all_of_it(self, result):
        text = result.summary()
        for part in ("6 of 6 legs", "platform_point.x", "base_point.z", "± 1 σ", " cm", "residual of leg length, RMS"):
            assert part in text
        for number, leg in result.legs.items():
            assert f"leg {number}: {float(leg.residual_rms):.4g} over {leg.n_poses} poses" in text
            assert f"{leg.leg.base_point[0]:.5f}" in text

    def test_without_noise_model_no_standard_errors_are_claimed_for_three_steps(self, left_hand):
        result = hx.calibrate(left_hand, sets_of(left_hand, ["leg", "length"]), hx.ThreeStep())
        assert result.covariance[1] is None
        assert "no noise model" in result.summary()
        assert result.to_frame()["standard_error"].isna().all()


class TestBatches:
    """Studies run a method on batches of sets of one leg; a failed set leaves the others alone."""

    def spoilt(self, data, index):
        position, rotation, length = (np.array(part) for part in (data.position, data.rotation, data.length))
        for part in (position, rotation, length):
            part[index] = part[index, :1]
        return replace(data, position=position, rotation=rotation, length=length)

    @pytest.mark.parametrize("name", METHODS)
    def test_a_batch_equals_its_members(self, left_hand, name):
        method, locks = METHODS[name]
        sets = {hx.Lock(lock): hx.simulate_leg(left_hand, 3, lock, 8, 5, noise=NOISE, rng=0) for lock in locks}
        together = method.calibrate_leg(sets)
        for i in range(5):
            alone = method.calibrate_leg({lock: data[i] for lock, data in sets.items()})
            np.testing.assert_allclose(together.leg.base_point[i], alone.leg.base_point, rtol=1e-9, atol=1e-10)
            np.testing.assert_allclose(together.covariance[i], alone.covariance, rtol=1e-6, atol=1e-12)
            np.testing.assert_allclose(together.residual_rms[i], alone.residual_rms, rtol=1e-6)

    @pytest.mark.parametrize("name", METHODS)
    @pytest.mark.parametrize("weights", [None, "model"])
    def test_a_failed_set_has_no_leg_and_no_values(self, left_hand, name, weights):
        method, locks = METHODS[name]
        nominal = left_hand.perturbed(0.5, rng=0)
        sets = {
            hx.Lock(lock): hx.simulate_leg(left_hand, 3, lock, 8, 5, noise=NOISE, nominal=nominal, rng=0)
            for lock in locks
        }
        estimator = hx.LeastSquares(weights=weights)
        clean = method.calibrate_leg(sets, estimator)
        for lock in sets:
            spoilt = {**sets, lock: self.spoilt(sets[lock], 2)}
            result = method.calibrate_leg(spoilt, estimator)
            ok = np.all([step.ok for step in result.steps.values()], axis=0)
            np.testing.assert_array_equal(ok, [True, True, False, True, True])
            np.testing.assert_array_equal(result.ok, ok)
            assert np.isnan(result.values["base_point"][2]).all()
            assert np.isnan(result.residual_rms[2])
            assert np.isfinite(result.residual_rms[ok]).all()
            with pytest.raises(hx.errors.EstimationError, match="leg 3: 1 of 5 calibrations failed"):
                _ = result.leg
            assert np.isnan(result.covariance[2]).any()
            np.testing.assert_allclose(result.values["base_point"][ok], clean.leg.base_point[ok], atol=1e-9)
            np.testing.assert_allclose(result.covariance[ok], clean.covariance[ok], rtol=1e-7, atol=1e-13)


class TestWrongCalls:
    def test_a_missing_lock_names_leg_and_lock(self, left_hand):
        with pytest.raises(LockError, match=r"leg 4: ThreeStep.* also needs a set with the lock length"):
            hx.calibrate(left_hand, sets_of(left_hand, ["leg"], legs=[4]), hx.ThreeStep())

    def test_a_lock_that_the_method_does_not_use(self, left_hand):
        with pytest.raises(LockError, match=r"OneStep.* uses sets with the lock 'direction'; one has 'leg'"):
            hx.calibrate(left_hand, sets_of(left_hand, ["leg"], legs=[4]), hx.OneStep())

    def test_two_sets_for_one_leg_and_lock(self, left_hand):
        sets = sets_of(left_hand, ["direction"], legs=[4]) * 2
        with pytest.raises(InputError, match="leg 4 has two sets with the lock 'direction'; give one of each"):
            hx.calibrate(left_hand, sets, hx.OneStep())

    def test_units(self, left_hand):
        with pytest.raises(UnitError, match="the measurements are in cm, the robot in mm"):
            hx.calibrate(hx.robots.jugglebot(), sets_of(left_hand, ["direction"]), hx.OneStep())

    def test_a_batch(self, left_hand):
        batch = hx.simulate_leg(left_hand, 3, "direction", 8, 5, rng=0)
        with pytest.raises(InputError, match=r"takes single sets, got a batch of \(5,\); write data\[i\]"):
            hx.calibrate(left_hand, batch, hx.OneStep())

    def test_no_leg_number(self, left_hand):
        data = sets_of(left_hand, ["direction"], legs=[4])[0]
        bare = hx.LegMeasurements(data.position, data.rotation, data.length, data.lock, length_unit="cm")
        with pytest.raises(InputError, match=r"which leg was measured\? give nominal=robot\.leg\(k\)"):
            hx.calibrate(left_hand, [bare], hx.OneStep())

    @pytest.mark.parametrize(
        ("robot", "sets", "method", "message"),
        [
            ("left-hand", [], hx.OneStep(), "robot: expected a Hexapod"),
            (None, [], hx.OneStep(), "sets: there are no measurements"),
            (None, [3], hx.OneStep(), "sets: expected LegMeasurements or Measurements, got int"),
            (None, [], hx.OneStep, r"method: expected Joint\(\), OneStep\(\), ThreeStep\(\) or FreePoses\(\)"),
            (None, [], "one-step", r"method: expected Joint\(\), OneStep\(\)"),
        ],
    )
    def test_wrong_arguments(self, left_hand, robot, sets, method, message):
        with pytest.raises(InputError, match=message):
            hx.calibrate(robot or left_hand, sets, method)

    def test_a_model_that_does_not_exist(self):
        with pytest.raises(InputError, match="model: expected 36, 42 or 48 parameters, got 40"):
            hx.FreePoses(40)

    @pytest.mark.parametrize("method", [hx.OneStep, hx.ThreeStep])
    def test_a_form_that_does_not_exist(self, left_hand, method):
        locks = [str(lock) for lock in method.locks]
        with pytest.raises(InputError, match=r"form: .* got 'sideways'"):
            hx.calibrate(left_hand, sets_of(left_hand, locks, legs=[1]), method("sideways"))

    def test_failures_name_the_leg(self, left_hand):
        data = sets_of(left_hand, ["direction"], legs=[4])[0].poses([0, 0, 0, 0])
        with pytest.raises(RankDeficientError, match=r"^leg 4: .*do not determine") as caught:
            hx.calibrate(left_hand, [data], hx.OneStep())
        assert caught.value.combinations
        free = hx.simulate(left_hand, n_poses=12, rng=0)
        with pytest.raises(EstimationError, match=r"^leg 1: .*NOT_CONVERGED"):
            hx.calibrate(left_hand.perturbed(3, rng=0), free, hx.FreePoses(42), hx.InverseKinematics(max_iterations=1))


def test_a_real_hexapod(real_data):
    """METHODS and the data's README: 0.41 mm RMS with gains (Model 48), 0.88 mm without (Model 42)."""
    robot = hx.Hexapod.from_toml(real_data / "nominal.toml")
    table = np.genfromtxt(real_data / "calibration_108.csv", delimiter=",", names=True)
    length = np.stack([table[f"leg_length_{k}"] for k in range(1, 7)], axis=-1)
    position = np.stack([table[f"position_{axis}"] for axis in "xyz"], axis=-1)
    quaternion = np.stack([table[f"orientation_{axis}"] for axis in "xyzw"], axis=-1)
    rotation = hx.rotations.quaternion_to_matrix(quaternion)
    data = hx.Measurements(position, rotation, length, nominal=robot)
    for model, expected in ((48, 0.41), (42, 0.88)):
        result = hx.calibrate(robot, data, hx.FreePoses(model))
        rms = np.sqrt(np.mean([part.residual_rms**2 for part in result.legs.values()]))
        assert abs(rms - expected) < 0.005
