"""The timing study: its peer computes the same thing, and it runs."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares

import hexopt as hx
from studies.timing.likelihood import DirectionRows, directions
from studies.timing.nonlinear import leg_lengths, plain_rows
from studies.timing.plain_loop import plain_loop
from studies.timing.run import main


@pytest.mark.parametrize("by_pose", [True, False])
def test_the_plain_loop_has_the_errors_of_the_batch(by_pose):
    robot = hx.robots.left_hand()
    home = robot.home_vectors[2] / robot.home_lengths[2]
    rng = np.random.default_rng(0)
    plain = plain_loop(robot.leg(3), home, robot.ranges, 10, 1000, 0.01, rng, by_pose=by_pose).mean(axis=0)
    noise = hx.UniformNoise(0.01, float(np.deg2rad(0.01)), 0.01)
    data = hx.simulate_leg(robot, 3, "direction", 10, 5000, noise=noise, rng=1)
    batch = hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), hx.LeastSquares()).error(robot.leg(3))
    assert plain == pytest.approx([batch["base_point"].mean(), batch["platform_point"].mean()], rel=0.06)


def test_scipy_has_the_rows_of_the_loop_and_ends_where_the_estimator_does():
    loop = leg_lengths(12, 3)
    found = hx.estimate(loop, hx.InverseKinematics())
    for i in range(3):
        data = loop.data[i]
        residual, jacobian = plain_rows(data.position, data.rotation, data.length, np.ones(12))
        single = hx.loops.LegLength(data)
        np.testing.assert_allclose(residual(found.values[i]), single.residual(found.values[i])[:, 0], atol=1e-13)
        np.testing.assert_allclose(jacobian(found.values[i]), single.jacobian(found.values[i])[:, 0], atol=1e-13)
        expected = least_squares(residual, single.values(data.nominal), jacobian, method="lm")
        assert (np.abs(expected.x - found.values[i]) <= 1e-4 * found.standard_errors[i]).all()


def test_scipy_maximises_the_likelihood_too():
    """Its rows move the measurements until the equations hold: where it ends is the estimator's answer."""
    loop = directions(10, 3)
    start = hx.estimate(loop.linear("direct"), hx.LeastSquares()).values
    found = hx.estimate(loop, hx.MaximumLikelihood())
    for i in range(3):
        rows = DirectionRows(loop.data[i], start[i])
        residual, jacobian = rows.functions()
        expected = least_squares(residual, rows.start, jacobian, method="lm", xtol=1e-12, ftol=1e-12, gtol=1e-12).x
        values = np.concatenate([expected[:6], rows.direction(expected)[0]])
        assert (np.abs(values - found.values[i]) <= 1e-4 * found.standard_errors[i]).all()
        assert residual(expected) @ residual(expected) == pytest.approx(found.chi2[i], rel=1e-8)


def test_it_writes_its_table(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--repeats", "1", "--sets", "20"]) == 0
    table = pd.read_csv(tmp_path / "plain_loop.csv")
    assert list(table["poses N"]) == [7, 7, 20, 20, 50, 50]
    assert set(pd.read_csv(tmp_path / "nonlinear.csv")["covariance"]) == {True, False}
    assert list(pd.read_csv(tmp_path / "ipopt.csv")["loss"]) == ["Quadratic", "Huber"] * 2
    peers = pd.read_csv(tmp_path / "likelihood.csv")
    assert list(peers["poses N"]) == [7] * 4 + [20] * 4
    assert set(peers["estimator"]) == {"MaximumLikelihood", "UnitNormLeastSquares"}
    assert "ratio" in capsys.readouterr().out
