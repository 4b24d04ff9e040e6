"""The study of estimators: its scenarios, its bound, its claims, and its smoke test from run to report."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import hexopt as hx
from studies.estimators import report
from studies.estimators.claims import claims, coverage, efficiency, robustness
from studies.estimators.cost import FILE, measure
from studies.estimators.run import GLS, GROUP_HUBER, LASSO, METHODS, PAPER, PRIOR, STUDY, draw, main, methods_for, run
from studies.estimators.scenarios import ERR, SCENARIOS, TOLERANCE, Tracker
from studies.harness import Study, load, sweep

BY_KEY = {scenario.key: scenario for scenario in SCENARIOS}
FIGURES = ["coverage", "errors-15-bad", "errors-5-bad", "errors-normal", "errors-tracker", "errors-uniform"]
FIGURES += ["nominals", "trials"]


def rows_of(key, n_sets=400, seed=1):
    return run(BY_KEY[key], n_sets, np.random.default_rng(seed))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_scenarios_hold_every_case_at_every_number_of_poses():
    for case in ("uniform", "normal", "5 % bad", "15 % bad", "tracker"):
        for kind in ("direction", "leg"):
            assert {s.n_poses for s in SCENARIOS if s.case == case and s.kind == kind} == {5, 7, 20, 50}
    parts = [s for s in SCENARIOS if s.case == "trials" and s.kind == "leg" and s.n_poses == 7]
    assert STUDY.sets * len(parts) == 10_000


@pytest.mark.parametrize("key", ["uniform, direction, N=7", "15 % bad, leg, N=7", "tracker, leg, N=5"])
def test_every_method_has_a_row_for_each_set_and_a_status(key):
    rows = rows_of(key, 4)
    assert list(rows.method.cat.categories) == list(METHODS)
    assert rows.groupby("method", observed=True).size().to_dict() == dict.fromkeys(methods_for(BY_KEY[key]), 4)
    assert (rows.platform_error.notna() == rows.ok).all()
    assert (rows.ok == (rows.status == hx.Status.OPTIMAL)).all()


def test_all_methods_see_the_same_bounds_and_the_same_data():
    rows = rows_of("uniform, direction, N=7", 5)
    assert (rows.groupby("repetition").base_bound.nunique() == 1).all()
    assert (rows.base_linear_bound >= rows.base_bound).all()
    gls = rows[rows.method == GLS].base_error.to_numpy()
    settled = rows[rows.method == "GLS, reweighted"].base_error.to_numpy()
    assert settled == pytest.approx(gls, rel=0.02)


def test_weighted_least_squares_states_the_bound_where_the_direction_is_free():
    loop, nominal, bounds, _ = draw(BY_KEY["normal, direction, N=20"], 50, np.random.default_rng(0))
    stated = hx.estimate(*METHODS[GLS](loop, nominal)).covariance_of("base_point")
    size = np.sqrt(np.einsum("...ii->...", stated))
    assert size == pytest.approx(bounds["base_linear_bound"], rel=0.05)
    assert (bounds["base_bound"] < bounds["base_linear_bound"]).all()


def test_weighted_least_squares_reaches_the_bound_under_a_locked_leg():
    gls = rows_of("trials, leg, N=7, part 0", 2000)
    gls = gls[gls.method == GLS]
    assert rms(gls.platform_error) == pytest.approx(rms(gls.platform_bound), rel=0.05)


def test_a_bad_pose_is_unknown_to_the_noise_model():
    scenario = BY_KEY["15 % bad, leg, N=20"]
    loop, _, bounds, leg = draw(scenario, 50, np.random.default_rng(0))
    jump = np.linalg.norm(loop.residual(loop.values(leg)), axis=-1)
    assert (jump > 0.2).mean() == pytest.approx(0.15, abs=0.04)
    clean = draw(replace(scenario, bad=0.0), 50, np.random.default_rng(0))[2]
    assert rms(bounds["platform_bound"]) == pytest.approx(rms(clean["platform_bound"]))


def test_the_trackers_covariance_is_that_of_a_target_on_an_arm():
    rng, tracker, n = np.random.default_rng(0), Tracker(), 200_000
    rotation = hx.rotations.euler_to_matrix(np.array([0.3, 0.2, -0.4]), "ZXZ")
    arm = np.asarray(tracker.arm)
    turns = tracker.angle * rng.standard_normal((n, 3))
    turned = hx.rotations.rotation_vector_to_matrix(turns) @ rotation
    moved = tracker.target * rng.standard_normal((n, 3)) - (turned - rotation) @ arm
    found = np.cov(np.concatenate([moved, turns], axis=1).T)
    stated = tracker.covariance(np.zeros(3), rotation)
    scale = np.sqrt(np.diag(stated)[:6])
    assert np.abs((found - stated[:6, :6]) / np.outer(scale, scale)).max() < 0.015


def test_nominals_are_off_as_said():
    leg = hx.robots.left_hand().leg(3)
    right = BY_KEY["uniform, leg, N=7"].nominals(leg, 20_000, np.random.default_rng(0))
    assert (right.points["base_point"] - leg.base_point).std() == pytest.approx(TOLERANCE, rel=0.02)
    wrong = BY_KEY["wrong nominal, leg, N=7"].nominals(leg, 10, np.random.default_rng(0))
    off = np.linalg.norm(wrong.points["platform_point"] - leg.platform_point, axis=-1)
    assert off == pytest.approx(np.full(10, 5 * TOLERANCE))
    one = BY_KEY["one joint moved, direction, N=7"].nominals(leg, 10, np.random.default_rng(0))
    assert (one.points["base_point"] == leg.base_point).all()


def test_two_poses_need_a_prior_and_are_counted_as_failures_without():
    for kind in ("direction", "leg"):
        rows = rows_of(f"two poses, {kind}", 50)
        ok = rows.groupby("method", observed=True).ok.mean()
        assert ok[PRIOR] == 1.0
        assert ok[PAPER] == ok[GLS] == 0.0
        assert set(rows[rows.method == GLS].status) == {hx.Status.RANK_DEFICIENT}
        assert set(methods_for(BY_KEY[f"two poses, {kind}"])) < set(METHODS)


def test_bad_poses_ruin_the_papers_estimator_and_not_the_robust_one():
    clean, bad = (rows_of(f"{case}, leg, N=20", 200) for case in ("uniform", "15 % bad"))
    means = [rows[rows.ok].groupby("method", observed=True).platform_error.mean() for rows in (clean, bad)]
    ratio = means[1] / means[0]
    assert ratio[GROUP_HUBER] < 2
    assert ratio[PAPER] > 10


def test_a_wrong_prior_costs_and_a_right_one_pays():
    right, wrong = (rows_of(f"{case}, direction, N=7") for case in ("uniform", "wrong nominal"))
    for rows, sign in ((right, -1), (wrong, 1)):
        means = rows.groupby("method", observed=True).base_error.mean()
        assert np.sign(means[PRIOR] - means[GLS]) == sign


def test_the_lasso_leaves_alone_what_has_not_moved():
    rows = rows_of("one joint moved, direction, N=7", 50)
    lasso = rows[(rows.method == LASSO) & rows.ok]
    assert lasso.base_error.median() < 1e-6 * ERR


def test_some_scenarios_alone_give_rows_and_no_report(tmp_path, capsys):
    out = tmp_path / "some"
    assert main(["--only", "trials, leg, N=7, part 0", "--sets", "2", "--workers", "1", "--out", str(out)]) == 0
    assert "no report" in capsys.readouterr().err
    assert not (out / "report.html").exists()
    assert not (out / FILE).exists()


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("estimators")
    small = Study(name="estimators", run=run, scenarios=SCENARIOS, sets=2, chunk_size=2, seed=5)
    sweep(small, out, workers=1)
    measure(out, sets=2, repeats=1)
    return out


def test_from_run_to_report_with_two_repetitions(swept):
    page = report.write(swept).read_text(encoding="utf-8")
    for word in ("Three claims", "Table 1", "17–20.3 cm", "Failures", "RANK_DEFICIENT", "Microseconds"):
        assert word in page
    assert "bound method" not in page
    assert len(re.findall(r"<img ", page)) == len(FIGURES)
    drawn = {path.name for path in (swept / "figures").iterdir()}
    assert drawn == {f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg")}


def test_a_row_for_each_scenario_method_and_repetition(swept):
    rows = load(swept, ["scenario", "method", "repetition", "seed", "status"])
    assert not rows.duplicated(["scenario", "method", "repetition"]).any()
    assert len(rows) == 2 * sum(len(methods_for(scenario)) for scenario in SCENARIOS)
    assert rows.status.notna().all()


def test_claims_are_read_off_the_rows():
    trials = pd.DataFrame(
        {
            "method": GLS,
            "kind": "leg",
            "n_poses": 7,
            "ok": [True, True, True, False],
            "joint_covered": [1.0, 1.0, 0.0, np.nan],
            "platform_error": [3.0, 4.0, 5.0, np.nan],
            "platform_bound": [5.0, 5.0, 5.0, 5.0],
            "platform_linear_bound": [5.0, 5.0, 5.0, 5.0],
            "base_error": np.nan,
            "base_bound": np.nan,
            "base_linear_bound": np.nan,
            **{f"base_{axis}_covered": np.nan for axis in "xyz"},
            **{f"platform_{axis}_covered": [1.0, 1.0, axis == "x", np.nan] for axis in "xyz"},
        }
    )
    covered, near = coverage(trials), efficiency(trials)
    assert covered.loc[0, ["sets", "failures"]].tolist() == [3, 1]
    assert covered.loc[0, "pooled"] == pytest.approx(100 * 7 / 9)
    assert near.loc[0, "ratio"] == pytest.approx(np.sqrt(50 / 75))
    settings = {"n_poses": 20, "kind": "leg", "value": "platform_error", "count": 9, "failures": 0, "sem": 0.1}
    table = pd.DataFrame(
        [
            {**settings, "case": case, "method": method, "mean": mean, "q0.5": mean, "q0.99": mean}
            for method, clean, bad in ((GROUP_HUBER, 2.0, 3.0), (PAPER, 2.0, 18.0))
            for case, mean in (("uniform", clean), ("15 % bad", bad))
        ]
    )
    assert robustness(table).set_index("method")["ratio"].to_dict() == {GROUP_HUBER: 1.5, PAPER: 9.0}
    assert claims(table, trials)["holds"].tolist() == [False, True, False, True]
