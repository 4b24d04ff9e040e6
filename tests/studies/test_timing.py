"""The timing study: its peer computes the same thing, and it runs."""

import numpy as np
import pandas as pd
import pytest

import hexopt as hx
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


def test_it_writes_its_table(tmp_path, capsys):
    assert main(["--out", str(tmp_path), "--repeats", "1", "--sets", "20"]) == 0
    table = pd.read_csv(tmp_path / "plain_loop.csv")
    assert list(table["poses N"]) == [7, 7, 20, 20, 50, 50]
    assert "ratio" in capsys.readouterr().out
