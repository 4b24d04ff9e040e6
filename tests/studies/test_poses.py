"""The study of the choice of poses: its designs, what they lead to, and its smoke test from run to report."""

import html
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import hexopt as hx
from studies.harness import Study, load, sweep
from studies.poses import real, report, summaries
from studies.poses.claims import WANTED, claims
from studies.poses.data import BEST, PAPER, Case, judged, predicted
from studies.poses.designs import DESIGNS, KAPPA_RAW, RANDOM, REFINED, STEPWISE, A, designs_for, in_unit, random_sets
from studies.poses.nominals import AT_ONCE, SEQUENTIAL, SINGLE
from studies.poses.raw import condition, paper_rows, raw_rows, smallest
from studies.poses.run import STUDY, main, run
from studies.poses.scenarios import COUNTS, FEWEST, SCENARIOS, SETTINGS, SIZES, ranges_of

BY_KEY = {scenario.key: scenario for scenario in SCENARIOS}
FIGURES = ["counts-hand", "counts-rubin", "legs-hand", "legs-rubin", "nominal", "promised", "units"]


def small(key, **settings):
    return replace(BY_KEY[key], **{"candidates": 60, "draws": 20, "random_draws": 20, **settings})


def case_of(key, **settings):
    return Case.of(small(key, **settings), np.random.default_rng(0))


def test_scenarios_hold_all_legs_all_locks_two_robots_and_many_numbers_of_poses():
    legs = [s for s in SCENARIOS if s.experiment == "legs"]
    assert {(s.robot, s.setting, s.leg) for s in legs} == {
        (robot, setting, leg) for robot in COUNTS for setting in SIZES for leg in range(1, 7)
    }
    assert all(s.draws == s.random_draws == 500 for s in legs if s.robot == "hand" and s.setting != "free")
    assert {s.n_poses for s in SCENARIOS if s.experiment == "counts" and s.setting == "I"} == {
        4,
        5,
        6,
        7,
        8,
        10,
        14,
        20,
        30,
    }
    assert all(s.n_poses >= FEWEST[s.setting] for s in SCENARIOS)
    assert {s.setting for s in SCENARIOS} == set(SETTINGS)


def test_every_design_is_in_some_scenario():
    assert {name for scenario in SCENARIOS for name in designs_for(scenario)} == set(DESIGNS)


@pytest.mark.parametrize("setting", SIZES)
def test_designs_are_of_different_candidates_and_better_than_random_ones(setting):
    scenario = small(f"legs, hand, {setting}, leg=3")
    rng = np.random.default_rng(0)
    case, n = Case.of(scenario, rng), scenario.n_poses

    def total(poses):
        return sum(np.square(error) for name, error in predicted(case, poses).items())

    usual = np.median(total(case.poses(random_sets(case, n, 50, rng))))
    best = total(DESIGNS[A](case, n, rng))
    for name in (A, STEPWISE, "D (O1)", "E (O3)"):
        poses = DESIGNS[name](case, n, rng)
        assert len(np.unique(poses.position, axis=0)) == n
        assert total(poses) < usual
        assert total(poses) >= best * (1 - 0.05)
    refined = DESIGNS[REFINED](case, n, rng)
    assert total(refined) < best


def test_random_sets_are_of_different_candidates():
    case = case_of("legs, hand, I, leg=3")
    index = random_sets(case, 7, 40, np.random.default_rng(0))
    assert index.shape == (40, 7)
    assert all(len(set(one)) == 7 for one in index.tolist())
    assert case.poses(index).batch_shape == (40,)
    assert np.array_equal(case.poses(index).position[3], case.poses(index[3]).position)


@pytest.mark.parametrize("setting", SIZES)
def test_the_best_estimator_errs_as_predicted(setting):
    case = case_of(f"legs, hand, {setting}, leg=1")
    rng = np.random.default_rng(0)
    poses = DESIGNS[A](case, SIZES[setting], rng)
    batch = poses.moved_to(poses.position[None], poses.rotation[None], poses.length[None])
    found, promised = judged(case, batch, 500, rng), predicted(case, poses)
    for name, promise in promised.items():
        value, error = (found[BEST][name.replace("predicted", what)][0] for what in ("rms", "rms_error"))
        assert abs(value - promise) < 4 * error
        assert found[PAPER][name.replace("predicted", "rms")][0] > 0.9 * value
    assert found[BEST]["failed"] == 0


def test_estimates_that_fail_are_counted_and_have_no_error(monkeypatch):
    case = case_of("legs, hand, I, leg=3")
    hasty = hx.MaximumLikelihood(max_iterations=1)
    monkeypatch.setattr(Case, "solvers", lambda self, loop: {BEST: (loop, hasty)})
    found = judged(case, case.poses(random_sets(case, 5, 3, np.random.default_rng(0))), 4, np.random.default_rng(0))
    assert (found[BEST]["failed"] == 1).all()
    assert np.isnan(found[BEST]["base_rms"]).all()


def test_raw_condition_numbers_are_those_of_the_matrix_in_its_unit():
    case = case_of("legs, hand, III, leg=3")
    loop = case.loop(case.poses(np.arange(9)))
    centimetres = condition(raw_rows(case, loop))
    assert centimetres == pytest.approx(np.linalg.cond(loop.linear("direct").matrix))
    assert condition(paper_rows(case, loop)) == pytest.approx(np.linalg.cond(loop.linear("consecutive").matrix))
    robot = case.robot.geometry
    points = {name: 0.01 * getattr(robot, name) for name in ("base_points", "platform_points", "offsets")}
    leg = replace(robot, **points, length_unit="m").leg(3)
    pool = case.poses(np.arange(9))
    data = replace(pool, position=0.01 * pool.position, length=0.01 * pool.length, nominal=leg, length_unit="m")
    metres = hx.loops.FixedLength(data, platform_point=leg.platform_point).linear("direct").matrix
    assert condition(raw_rows(case, loop, "m")) == pytest.approx(np.linalg.cond(metres))
    assert condition(raw_rows(case, loop, "m")) > 2 * centimetres
    assert condition(np.zeros((2, 4, 3))).tolist() == [np.inf, np.inf]


def test_exchanges_lower_the_condition_number():
    case = case_of("units, hand, III, N=7, leg=3")
    rng = np.random.default_rng(0)
    index = smallest(case, raw_rows, 7, rng)
    assert len(set(index.tolist())) == 7
    random = condition(raw_rows(case, case.loop(case.poses(random_sets(case, 7, 200, rng)))))
    assert condition(raw_rows(case, case.loop(case.poses(index)))) < random.min()


def test_the_condition_number_chooses_by_the_unit():
    scenario = small("units, hand, III, N=7, leg=3", candidates=200, draws=100)
    rows = run(scenario, 40, np.random.default_rng(0))
    table = summaries.against_random(rows.assign(scenario="x", **{n: getattr(scenario, n) for n in summaries.SETTLED}))
    gain = table[table.estimator == BEST].set_index("design").gain
    assert gain[in_unit("um")] < 0.7 * gain[in_unit("m")]
    assert gain[A] > 2
    assert KAPPA_RAW not in gain.index


def test_a_design_at_a_wrong_nominal_is_judged_at_the_truth():
    rows = run(small("nominal, II, off=1"), 4, np.random.default_rng(0))
    one = rows[rows.design == SINGLE]
    assert one.repetition.tolist() == [0, 1, 2, 3]
    assert one.efficiency.between(0.8, 1.05).all()
    assert (rows.groupby("design").size() >= 1).all()


def test_poses_one_by_one_end_with_as_many_and_as_good_ones():
    rows = run(small("sequential, II, off=1"), 3, np.random.default_rng(0))
    assert rows.groupby("design").size().to_dict() == {AT_ONCE: 3, SEQUENTIAL: 3}
    assert rows.efficiency.between(0.7, 1.05).all()
    assert rows.platform_error.between(0, 1).all()


def test_some_scenarios_alone_give_rows_and_no_report(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv(real.FOLDER, raising=False)
    out = tmp_path / "some"
    assert main(["--only", "counts, rubin, III, N=4", "--sets", "2", "--workers", "1", "--out", str(out)]) == 0
    assert "no report" in capsys.readouterr().err
    assert not (out / "report.html").exists()


def test_without_real_measurements_there_is_a_reason(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv(real.FOLDER, raising=False)
    real.measure(tmp_path)
    assert real.FOLDER in capsys.readouterr().out
    assert summaries.real(tmp_path) is None


def test_a_twelve_that_cannot_be_fitted_has_an_infinite_error(real_data):
    data = real.load(real_data)
    index = real.random_twelves(data, 2, np.random.default_rng(0))
    data = replace(data, rotation=np.broadcast_to(np.eye(3), data.rotation.shape))  # hides b from a
    rms = real.prediction(data, index)
    assert np.isinf(rms).all()


@pytest.mark.parametrize("criterion", real.CRITERIA)
def test_twelve_chosen_real_poses_predict_the_rest_better_than_random_ones(real_data, criterion):
    data = real.load(real_data)
    index = real.chosen(data, criterion)
    assert len(set(index.tolist())) == real.N
    random = real.prediction(data, real.random_twelves(data, real.RANDOM_SETS, np.random.default_rng(1)))
    assert (random > real.prediction(data, index[None])).mean() >= 0.95


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    out = tmp_path_factory.mktemp("poses")
    keys = [f"legs, {robot}, {setting}, leg=2" for robot in COUNTS for setting in SIZES]
    keys += [f"counts, {robot}, {setting}, N=10" for robot in COUNTS for setting in SIZES]
    keys += [s.key for s in SCENARIOS if s.experiment == "units" and s.leg == 4]
    keys += [s.key for s in SCENARIOS if s.experiment == "nominal" and s.off == 0.5]
    keys += [s.key for s in SCENARIOS if s.experiment == "sequential" and s.off == 1]
    few = tuple(small(key, candidates=30, draws=5, random_draws=5) for key in keys)
    sweep(Study(name="poses", run=run, scenarios=few, sets=2, chunk_size=2, seed=5), out, workers=1)
    return out


def test_from_run_to_report_with_two_repetitions(swept, monkeypatch):
    monkeypatch.setattr(report, "is_whole", lambda out: True)  # some legs and numbers of poses only
    page = html.unescape(report.write(swept).read_text(encoding="utf-8"))
    for word in ("The claims, measured", ranges_of("hand"), "misleads", "wrong nominal", "How many", real.FOLDER):
        assert word in page
    assert "bound method" not in page
    assert "nan" not in re.sub(r'src="[^"]*"', "", page)
    assert len(re.findall(r"<img ", page)) == len(FIGURES)
    drawn = {path.name for path in (swept / "figures").iterdir()}
    assert drawn == {f"{name}.{kind}" for name in FIGURES for kind in ("png", "svg")}


def test_a_row_for_each_scenario_design_estimator_and_repetition(swept):
    rows = load(swept)
    assert not rows.duplicated(["scenario", "design", "estimator", "repetition"]).any()
    random = rows[rows.design == RANDOM]
    assert (random.groupby(["scenario", "estimator"]).size() == 2).all()


def test_claims_are_read_off_the_rows(swept):
    measured = pd.DataFrame({"design": ["A", *["random"] * 4], "rms": [0.5, 0.4, 0.6, 0.7, 0.8]})
    found = claims(summaries.rows_of(swept), measured)
    assert {claim.holds for claim in found} <= {"yes", "no", "–"}
    wanted = [claim for claim in found if "mean of the legs" in claim.what and claim.holds != "–"]
    assert [claim.low for claim in wanted] == list(WANTED.values())
    assert found[-1].found == pytest.approx(75.0)


def test_the_study_is_of_a_hundred_random_sets():
    assert (STUDY.sets, len(STUDY.scenarios)) == (100, len(SCENARIOS))
