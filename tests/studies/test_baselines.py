"""The study of the baselines: its methods, its bounds, its claims, and its smoke test from run to report."""

import re
from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx
from studies.baselines import report, summaries
from studies.baselines.claims import Claim, claims
from studies.baselines.cost import FILE, measure
from studies.baselines.data import draw, judged
from studies.baselines.methods import FK, INNOCENTI, METHODS, ML, PAPER, answer, methods_for
from studies.baselines.run import STUDY, main, run
from studies.baselines.running import FIRST_FIT, PRIOR, RECURSIVE
from studies.baselines.scenarios import ERR, LEG, SCENARIOS, SETTINGS
from studies.baselines.together import ALONE, CARRIED, IGNORED, JOINTLY, PAPER_STEPS, SEPARATE, TOGETHER
from studies.harness import Study, load, sweep

BY_KEY = {scenario.key: scenario for scenario in SCENARIOS}
FIGURES = ["basin", "coverage", "efficiency-base", "efficiency-platform", "innocenti", "running"]


def rows_of(key, n_sets, seed=1):
    return run(BY_KEY[key], n_sets, np.random.default_rng(seed))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def test_every_setting_is_tried_at_every_noise_and_trials_have_enough_sets():
    grid = [s for s in SCENARIOS if s.experiment == "methods"]
    assert {s.setting for s in grid} == set(SETTINGS)
    assert {(s.errors, s.level) for s in grid} == {("normal", ERR), ("uniform", ERR), ("uniform", 10 * ERR)}
    for setting in ("I", "II", "III"):
        trials = [s for s in SCENARIOS if s.experiment == "trials" and s.setting == setting and s.n_poses == 7]
        assert len(trials) * STUDY.sets == 10_000


def test_every_baseline_has_one_entry_that_some_scenario_runs():
    tried = {name for s in SCENARIOS if s.experiment == "methods" for name in methods_for(s)}
    assert tried == set(METHODS)
    assert set(methods_for(BY_KEY["basin, III ab, off=5"])) == {"Zhuang–Roth", "Unscented", ML}


@pytest.mark.parametrize("setting", SETTINGS)
def test_methods_are_exact_without_noise(setting):
    scenario = next(s for s in SCENARIOS if s.experiment == "methods" and s.setting == setting and s.n_poses >= 7)
    exact = draw(scenario, 3, np.random.default_rng(0))[1]
    leg = exact.truth.leg(LEG)
    bound = exact.bound()
    for name, method in methods_for(scenario).items():
        found = answer(method, exact)
        assert found.ok.all(), name
        columns = judged(found, leg, bound[: len(found.codes)])
        for short in found.values:  # sigma points feel the curvature, others do not
            least = 0.1 * columns[f"{short}_bound"] if name == "Unscented" else 1e-8
            assert (columns[f"{short}_error"] < least).all(), (name, short)


def test_all_methods_are_given_the_same_sets():
    scenario = BY_KEY["methods, normal, free, N=10"]
    case, _ = draw(scenario, 20, np.random.default_rng(0))
    few = case.sets(1, 4)
    assert np.array_equal(few.views[0].position, case.views[0].position[1:4])
    assert np.array_equal(few.readings.length[..., LEG - 1], few.views[0].length)
    assert np.array_equal(few.nominal_robot.base_points[LEG - 1], case.nominal.base_point[1])
    found = {name: len(answer(method, case).codes) for name, method in methods_for(scenario).items()}
    assert found[ML] == 20
    assert found[FK] == 2


def test_nominals_are_off_as_said_and_the_offset_is_known_where_it_is_not_estimated():
    for setting, n in (("free", 10), ("2 × I", 5)):
        case, _ = draw(BY_KEY[f"basin, {setting}, off=2"], 50, np.random.default_rng(0))
        assert case.views[0].n_poses == n
        leg, nominal = case.truth.leg(LEG), case.nominal
        assert np.abs(nominal.base_point - leg.base_point) == pytest.approx(2.0)
        assert np.abs(nominal.offset - leg.offset) == pytest.approx(2.0 if setting == "free" else 0.0)


def test_maximum_likelihood_reaches_the_bound_and_the_papers_estimator_does_not():
    rows = rows_of("trials, I, N=7, part 0", 2000)
    ours, paper = (rows[rows.method == name] for name in (ML, PAPER))
    assert ours.normalised.mean() == pytest.approx(1.0, abs=0.05)
    assert rms(ours.base_error) == pytest.approx(rms(ours.base_bound), rel=0.04)
    assert rms(paper.base_error) / rms(ours.base_error) > 1.5


def test_large_errors_bias_the_papers_estimator_and_not_maximum_likelihood():
    rows = rows_of("bias, err=0.5, part 0", 400)
    found = summaries.bias(rows.assign(level=0.5), ["level"])
    base = found[found.block == "base"].set_index("method").bias / 0.5
    assert base[PAPER] == pytest.approx(3.0, abs=0.6)
    assert base[ML] < 0.5


def test_all_readings_of_six_sets_beat_six_legs_on_their_own():
    rows = rows_of("joint, cone=20", 40)
    for column, least in (("base_error", 2.5), ("platform_error", 1.3)):
        found = summaries.gain(rows.assign(scenario="joint"), ["scenario"], ALONE, TOGETHER, column)
        assert found.gain.item() > least
    whole = rows[rows.method == TOGETHER]
    assert rms(whole.base_error) == pytest.approx(rms(whole.base_bound), rel=0.1)
    assert whole.offset_error.notna().all()


def test_on_one_set_the_other_legs_bring_nothing_until_there_are_poses_to_spare():
    gains = []
    for n in (7, 20):
        rows = rows_of(f"one set, N={n}", 5)
        both = [rows[rows.method == name].base_bound.to_numpy() for name in (ALONE, TOGETHER)]
        gains.append((both[0] / both[1]).mean())
    assert gains[0] == pytest.approx(1.0, abs=1e-3)
    assert gains[1] > 1.01


def test_the_legs_of_a_pose_share_its_error():
    rows = rows_of("home, part 0", 60)
    covered = rows.groupby("method").home_covered.mean()
    assert covered[TOGETHER] > 0.88
    assert covered[SEPARATE] < covered[TOGETHER]
    errors = rows.groupby("method").home_error.agg(rms)
    assert errors[SEPARATE] / errors[TOGETHER] > 1.2


def test_three_steps_must_carry_the_error_of_b():
    rows = rows_of("chain, N=7+50, part 0", 300)
    covered = rows.groupby("method").base_covered.mean()
    assert covered[CARRIED] == pytest.approx(0.95, abs=0.03)
    assert covered[IGNORED] < 0.75
    errors = rows.groupby("method").base_error.agg(rms)
    assert min(errors[PAPER_STEPS], errors[IGNORED]) / errors[JOINTLY] > 1.3
    assert 1.0 < errors[CARRIED] / errors[JOINTLY] < 1.2  # weights that know the error of b


def test_running_estimates_have_a_row_a_pose_and_say_how_sure_they_are():
    rows = rows_of("running, I, prior=0.1", 20)
    assert set(rows.method) == {ML, RECURSIVE, FIRST_FIT, PRIOR}
    one = rows[(rows.method == RECURSIVE) & (rows.repetition == 0)]
    assert one.poses_seen.tolist() == list(range(1, 21))
    assert not one.ok.iloc[0]
    sure = one.base_predicted[one.ok].to_numpy()
    assert (np.diff(sure) < 0).all()


def test_bad_starts_are_told_from_good_ones():
    good, bad = (rows_of(f"basin, 2 × I, off={off:g}", 30) for off in (0.1, 5))
    assert good[good.method == "Murareci"].reached.mean() > 0.9
    assert bad[bad.method == "Murareci"].reached.mean() < 0.7
    assert (bad[bad.method == ML].reached == 1).all()  # needs no guess
    assert not (bad.reached.astype(bool) & ~bad.ok).any()


def test_too_few_poses_are_failures_with_a_status():
    scenario = replace(BY_KEY["methods, normal, I, N=5"], n_poses=2)
    case, _ = draw(scenario, 4, np.random.default_rng(0))
    for name in (PAPER, "GLS", ML, "Recursive"):
        found = answer(METHODS[name], case)
        assert set(found.codes) == {hx.Status.RANK_DEFICIENT}, name
        assert "base_error" not in judged(found, case.truth.leg(LEG), None) or not found.ok.any()


def test_ratios_are_of_root_mean_squares_with_their_error():
    ratio, error = summaries.rms_ratio(np.array([3.0, 4.0, 5.0]), np.array([1.5, 2.0, 2.5]))
    assert (ratio, error) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-12))
    rng = np.random.default_rng(0)
    found = [summaries.rms_ratio(rng.normal(size=200), 2 * rng.normal(size=200)) for _ in range(500)]
    ratios, errors = np.array(found).T
    assert ratios.std() == pytest.approx(errors.mean(), rel=0.1)


def test_a_claim_holds_within_its_limits():
    claim = Claim("", "", 0.97, 1.03, 1.0, 0.01)
    assert (claim.wanted, claim.holds) == ("0.97 to 1.03", "yes")
    assert replace(claim, found=1.1).holds == "no"
    assert (replace(claim, low=-np.inf).wanted, replace(claim, high=np.inf).wanted) == ("at most 1.03", "at least 0.97")
    assert (replace(claim, low=np.nan).wanted, replace(claim, low=np.nan).holds) == ("–", "–")


def test_some_scenarios_alone_give_rows_and_no_report(tmp_path, capsys):
    out = tmp_path / "some"
    only = ["--only", "chain, N=7+7, part 0", "--sets", "2", "--workers", "1", "--out", str(out)]
    assert main(only) == 0
    assert "no report" in capsys.readouterr().err
    assert not (out / "report.html").exists()
    assert not (out / FILE).exists()


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("baselines")
    first = [s for s in SCENARIOS if not s.part and not (s.experiment == "methods" and s.n_poses > 10)]
    sweep(Study(name="baselines", run=run, scenarios=first, sets=2, chunk_size=2, seed=5), out, workers=1)
    measure(out, sets=2, repeats=1)
    return out


def test_from_run_to_report_with_two_repetitions(swept, monkeypatch):
    monkeypatch.setattr(report, "is_whole", lambda out: True)  # all experiments, but not all numbers of poses
    page = report.write(swept).read_text(encoding="utf-8")
    for word in ("The claims, measured", "17–20.3 cm", "Failures", "Milliseconds a set", INNOCENTI, "Cramér–Rao"):
        assert word in page
    assert "bound method" not in page
    assert len(re.findall(r"<img ", page)) == len(FIGURES)
    drawn = {path.name for path in (swept / "figures").iterdir()}
    assert drawn == {f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg")}


def test_a_row_for_each_scenario_method_and_repetition(swept):
    rows = load(swept, ["scenario", "method", "repetition", "seed", "status", "poses_seen"])
    assert not rows.duplicated(["scenario", "method", "repetition", "poses_seen"]).any()
    assert not rows[rows.poses_seen.isna()].duplicated(["scenario", "method", "repetition"]).any()
    assert rows.status.notna().all()
    assert rows.seed.eq(5).all()


def test_claims_are_read_off_the_rows(swept):
    found = claims(summaries.rows_of(swept))
    assert {claim.holds for claim in found} <= {"yes", "no", "–"}
    for words in ("eᵀC⁻¹e/p", "bias of a", "whole robot", "home", "joint ML", "Innocenti", "starts", "Unscented"):
        assert any(words in claim.what for claim in found), words
