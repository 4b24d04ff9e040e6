"""The paper's study: its factors, its smoke test from run to report."""

import re

import numpy as np
import pytest

import hexopt as hx
from studies.harness import Study, sweep
from studies.paper import report
from studies.paper.published import B_PRINTED, FACTORS
from studies.paper.run import STUDY, main, run
from studies.paper.scenarios import SCENARIOS

BY_KEY = {scenario.key: scenario for scenario in SCENARIOS}


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(("kind", "n", "column"), FACTORS)
def test_published_factors_are_met_within_15_percent(kind, n, column, seed):
    scenario = BY_KEY[f"{kind}, N={n}, err=0.01"]
    rows = run(scenario, 2000, np.random.default_rng(seed))
    ours = rows[rows.method == "consecutive (paper)"][column].mean() / scenario.level
    assert ours == pytest.approx(FACTORS[kind, n, column], rel=0.15)


@pytest.mark.parametrize("level", B_PRINTED)
def test_printed_platform_points_lie_within_the_spread_of_ours(level):
    rows = run(BY_KEY[f"leg, N=7, err={level}"], 2000, np.random.default_rng(3))
    errors = rows[rows.method == "consecutive (paper)"].platform_error
    printed = np.linalg.norm(B_PRINTED[level] - hx.robots.left_hand().leg(3).platform_point)
    low, high = errors.quantile([0.05, 0.95])
    assert low < printed < high


def test_factors_do_not_depend_on_the_noise_level():
    means = {}
    for level in (0.01, 0.001):
        rows = run(BY_KEY[f"direction, N=20, err={level}"], 2000, np.random.default_rng(4))
        means[level] = rows[rows.method == "direct"].base_error.mean() / level
    assert means[0.01] == pytest.approx(means[0.001], rel=0.02)


def test_scenarios_cover_the_sizes_of_the_paper():
    counts = {
        kind: {s.n_poses for s in SCENARIOS if s.experiment == "poses" and s.kind == kind}
        for kind in ("direction", "leg", "length")
    }
    assert counts == {"direction": set(range(4, 51)), "leg": set(range(4, 31)), "length": set(range(5, 31))}
    assert STUDY.sets == 1000
    assert {s.leg for s in SCENARIOS if s.experiment == "legs"} == set(range(1, 7))


def test_every_scenario_gives_a_tidy_row_for_each_set_and_method():
    for scenario in SCENARIOS[::7]:
        rows = run(scenario, 3, np.random.default_rng(0))
        assert (rows.groupby("method", observed=True).size() == 3).all()
        assert rows.ok.all(), scenario.key
        assert {"method", "repetition", "base_error", "status", "condition"} <= set(rows)


def test_some_scenarios_alone_give_rows_and_no_report(tmp_path, capsys):
    assert main(["--only", "leg, N=7*", "--sets", "2", "--workers", "1", "--out", str(tmp_path / "some")]) == 0
    assert "no report" in capsys.readouterr().err
    assert not (tmp_path / "some" / "report.html").exists()


def test_from_run_to_report_with_two_repetitions(tmp_path):
    small = Study(name="paper", run=run, scenarios=SCENARIOS, sets=2, chunk_size=2, seed=5)
    sweep(small, tmp_path, workers=1)
    page = report.write(tmp_path).read_text(encoding="utf-8")
    for word in ("Type III", "Table 1", "17–20.3 cm", "Failures", "sign error"):
        assert word in page
    assert len(re.findall(r"<img ", page)) == 7
    drawn = {path.name for path in (tmp_path / "figures").iterdir()}
    for name in (*(f"figure-{number}" for number in range(5, 11)), "ranges"):
        assert {f"{name}.png", f"{name}.svg"} <= drawn
