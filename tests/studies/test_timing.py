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
from studies.timing.selection import CHOSEN, equation, information, plain_exchange, reached, solved


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


SELECTIONS = [(setting, criterion) for setting in ("I", "II", "III") for criterion in ("A", "D")]


@pytest.mark.parametrize(("setting", "criterion"), SELECTIONS)
def test_cvxpy_ends_at_the_relaxation(setting, criterion):
    loop = equation(setting, 40)
    value, alone = solved(information(loop), loop.parameters.main.size, criterion)
    design = hx.select_poses(loop, CHOSEN, criterion, starts=1)
    assert value == pytest.approx(design.relaxed, rel=1e-6)
    assert alone > 0


@pytest.mark.parametrize(("setting", "criterion"), SELECTIONS)
def test_the_plain_exchange_ends_where_no_exchange_helps(setting, criterion):
    loop = equation(setting, 30)
    matrices, k = information(loop), loop.parameters.main.size

    def value(index):
        covariance = np.linalg.inv(matrices[index].sum(axis=0))[:k, :k]
        return np.trace(covariance) if criterion == "A" else np.linalg.slogdet(covariance)[1]

    chosen, found = plain_exchange(matrices, k, criterion)
    assert len(set(chosen)) == CHOSEN
    assert found == pytest.approx(value(chosen), rel=1e-9)
    rest = np.setdiff1d(np.arange(30), chosen)
    others = [np.append(np.delete(chosen, place), new) for place in range(CHOSEN) for new in rest]
    assert min(map(value, others)) >= found - 1e-9 * abs(found)
    design = hx.select_poses(loop, CHOSEN, criterion)
    assert value(design.indices) == pytest.approx(design.value, rel=1e-8)  # they speak of the same criterion
    assert reached(design.bound, design.value, criterion, k) == pytest.approx(design.efficiency)
    assert reached(design.bound, found, criterion, k) <= 1


def test_a_table_that_is_not_there_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--out", str(tmp_path), "--only", "proof"])
    assert "--only: no table proof; there are plain_loop" in capsys.readouterr().err


def test_it_writes_its_tables(tmp_path, capsys):
    small = ["--repeats", "1", "--sets", "20", "--candidates", "3000"]
    assert main(["--out", str(tmp_path), *small]) == 0
    table = pd.read_csv(tmp_path / "plain_loop.csv")
    assert list(table["poses N"]) == [7, 7, 20, 20, 50, 50]
    assert set(pd.read_csv(tmp_path / "nonlinear.csv")["covariance"]) == {True, False}
    assert list(pd.read_csv(tmp_path / "ipopt.csv")["loss"]) == ["Quadratic", "Huber"] * 2
    peers = pd.read_csv(tmp_path / "likelihood.csv")
    assert list(peers["poses N"]) == [7] * 4 + [20] * 4
    assert set(peers["estimator"]) == {"MaximumLikelihood", "UnitNormLeastSquares"}
    assert "ratio" in capsys.readouterr().out
    tables = [pd.read_csv(tmp_path / f"{name}.csv") for name in ("candidates", "relaxations", "designs", "proofs")]
    assert [len(table) for table in tables] == [3, 6, 18, 6]
    assert all(set(table["type"]) == {"I", "II", "III"} for table in tables)
    assert (tables[1]["hexopt, above bound"] <= 1e-6).all()
    assert tables[3]["proven"].all()
