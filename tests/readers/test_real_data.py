"""The real hexapod: 108 poses without locked legs."""

import numpy as np
import pytest

import hexopt as hx


def test_all_poses_are_read(real_data):
    robot = hx.Hexapod.from_toml(real_data / "nominal.toml")
    (data,) = hx.read_measurements(real_data / "calibration_108.csv", length_unit="mm", nominal=robot)
    table = np.genfromtxt(real_data / "calibration_108.csv", delimiter=",", names=True)
    assert data.n_poses == len(table) == 108
    np.testing.assert_array_equal(data.length[:, 2], table["leg_length_3"])
    np.testing.assert_array_equal(data.position[:, 1], table["position_y"])


@pytest.mark.parametrize(("model", "rms"), [(42, 0.88), (48, 0.41)])
def test_the_fit_is_as_good_as_its_source_says(real_data, model, rms):
    robot = hx.Hexapod.from_toml(real_data / "nominal.toml")
    sets = hx.read_measurements(real_data / "calibration_108.csv", length_unit="mm", nominal=robot)
    found = hx.calibrate(robot, sets, hx.FreePoses(model))
    squares = [leg.residual_rms**2 for leg in found.legs.values()]
    assert float(np.sqrt(np.mean(squares))) == pytest.approx(rms, abs=0.005)
