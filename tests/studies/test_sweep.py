"""A sweep gives the same rows to the bit, however it is run."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import threadpoolctl
import toy_study
from toy_study import STUDY, Toy

from studies.harness import Study, StudyError, TaskError, generator, load, rerun, sweep
from studies.harness.store import ChunkFile
from studies.harness.study import stream_of

WIDE = STUDY.scenarios[1].key


@pytest.fixture
def alone(tmp_path):
    """The rows of the study, run in this process."""
    sweep(STUDY, tmp_path / "alone")
    return tmp_path / "alone"


def test_one_row_for_each_scenario_method_and_repetition(alone):
    rows = load(alone)
    assert list(rows.columns[:4]) == ["scenario", "repetition", "method", "error"]
    assert len(rows) == 2 * 50 * 3 == len(rows.drop_duplicates(["scenario", "method", "repetition"]))
    assert set(rows["repetition"]) == set(range(50))
    assert (rows["chunk"] == rows["repetition"] // 8).all()
    assert len(np.unique(rows["error"])) == len(rows), "no two draws are equal: no stream was used twice"


def test_two_workers_write_the_same_bits(alone, tmp_path, contents):
    done = sweep(STUDY, tmp_path / "two", workers=2)
    assert (done.made, done.kept) == (14, 0)
    assert len(contents(alone)) == 14
    assert contents(tmp_path / "two") == contents(alone)


def test_another_seed_gives_other_rows(alone, tmp_path):
    sweep(STUDY, tmp_path / "other", seed=6)
    assert not np.isin(load(tmp_path / "other")["error"], load(alone)["error"]).any()


def test_the_order_of_the_rows_is_not_that_of_completion(tmp_path):
    study = replace(STUDY, scenarios=[Toy("tortoise", 1.0, "slow sometimes")], sets=16)
    written = []
    original = ChunkFile.write

    def spy(self, data):
        written.append(self.label["chunk"])
        original(self, data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ChunkFile, "write", spy)
        sweep(study, tmp_path, workers=2)
    assert written == [1, 0], "the test needs chunk 1 to overtake chunk 0"
    assert load(tmp_path)["chunk"].is_monotonic_increasing


def test_a_scenario_more_or_elsewhere_leaves_the_others_alone(alone, tmp_path, contents):
    scenarios = [Toy("new"), STUDY.scenarios[1], STUDY.scenarios[0]]
    sweep(replace(STUDY, scenarios=scenarios), tmp_path / "more")
    old, new = contents(alone), contents(tmp_path / "more")
    assert len(new) == 21
    assert old.items() < new.items()


def test_a_subset_runs_the_same_rows_and_the_rest_can_follow(alone, tmp_path, contents):
    out = tmp_path / "subset"
    assert sweep(STUDY, out, only="wide*").made == 7
    assert set(load(out)["scenario"]) == {WIDE}
    assert contents(out).items() < contents(alone).items()
    assert sweep(STUDY, out, resume=True).kept == 7
    assert contents(out) == contents(alone)
    with pytest.raises(StudyError, match=r"no scenario matches 'no\*', only: narrow, wide"):
        sweep(STUDY, out, only="no*", resume=True)


def test_more_sets_keep_whole_chunks_and_equal_a_fresh_run(alone, tmp_path, contents):
    fresh = tmp_path / "fresh"
    sweep(STUDY, fresh, sets=64)
    before = {path: path.stat().st_mtime_ns for path in alone.rglob("*.parquet")}
    done = sweep(STUDY, alone, sets=64, resume=True)
    assert (done.made, done.kept) == (4, 12), "of each scenario: the last chunk, of 2 sets, again, and one more"
    assert sum(path.stat().st_mtime_ns == time for path, time in before.items()) == 12
    assert contents(alone) == contents(fresh)


def test_any_chunk_can_be_made_again(alone):
    rows = load(alone)
    for chunk, sets in ((2, None), (6, 2)):
        stored = rows[(rows["scenario"] == WIDE) & (rows["chunk"] == chunk)].reset_index(drop=True)
        pd.testing.assert_frame_equal(rerun(STUDY, WIDE, chunk, sets=sets), stored, check_exact=True)
    first = rows.iloc[0]
    draws = generator(int(first["seed"]), int(first["stream"]), int(first["chunk"])).normal(size=(8, 50))
    assert first["error"] == (0.1 * draws)[0].mean()


@pytest.mark.parametrize("workers", [1, 2])
def test_blas_has_one_thread_in_a_task_and_its_own_after(workers, tmp_path, monkeypatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")

    def threads():
        """By library: some keep one thread whatever they are told, and other tests may have loaded such a one."""
        return {lib["filepath"]: lib["num_threads"] for lib in threadpoolctl.threadpool_info()}

    with threadpoolctl.threadpool_limits(2, "blas"):
        before = threads()
        assert 2 in before.values()
        sweep(replace(STUDY, scenarios=[Toy("a", act="look")]), tmp_path, workers=workers)
        assert {name: threads()[name] for name in before} == before
    rows = load(tmp_path)
    assert set(rows["threads"]) == {1}
    assert set(rows["variable"]) == {"1"}, "libraries that load later read it"
    assert toy_study.os.environ["OPENBLAS_NUM_THREADS"] == "2"


@pytest.mark.parametrize("workers", [1, 2])
def test_an_error_in_a_task_says_which_and_keeps_the_others(workers, tmp_path):
    study = replace(STUDY, scenarios=[STUDY.scenarios[0], Toy("bad", act="fail")], sets=400)
    with pytest.raises(TaskError) as caught:
        sweep(study, tmp_path, workers=workers)
    said = str(caught.value)
    assert said.startswith("scenario 'bad', chunk ")
    assert said.endswith("raised ZeroDivisionError: no such luck, in two lines")
    assert f"seed 5, spawn key ({stream_of('bad')}, " in said
    assert "in _act" in caught.value.details
    kept = load(tmp_path, partial=True)
    assert set(kept["scenario"]) == {"narrow"}
    with pytest.raises(StudyError, match="is unfinished"):
        load(tmp_path)


def test_an_error_names_a_chunk_that_fails_again(tmp_path):
    study = replace(STUDY, scenarios=[Toy("moody", act="fail sometimes")])
    with pytest.raises(TaskError, match=r"chunk 1 \(8 sets"):
        sweep(study, tmp_path)
    assert set(load(tmp_path, partial=True)["chunk"]) == {0}
    with pytest.raises(ZeroDivisionError):
        rerun(study, "moody", chunk=1)
    assert len(rerun(study, "moody", chunk=2)) == 24


def test_a_worker_that_dies_ends_the_sweep(tmp_path):
    study = replace(STUDY, scenarios=[Toy("deadly", act="die")])
    with pytest.raises(StudyError, match="a worker process died"):
        sweep(study, tmp_path, workers=2)


def frame(scenario, n_sets, rng):
    made = {
        "not a frame": [1, 2],
        "column": pd.DataFrame({"chunk": range(n_sets)}),
        "rows": pd.DataFrame({"error": range(2 * n_sets)}),
        "repetition": pd.DataFrame({"repetition": [*range(n_sets - 1), n_sets], "error": 0.0}),
        "lost": pd.DataFrame({"repetition": range(n_sets - 1), "error": 0.0}),
    }
    return made[scenario["key"]]


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("not a frame", "must return a pandas.DataFrame, not list"),
        ("column", "returned the column 'chunk', which the sweep adds"),
        ("rows", "returned 100 rows for 50 sets, and no column 'repetition'"),
        ("repetition", "must take each value 0 … 49"),
        ("lost", "must take each value 0 … 49"),
    ],
)
def test_what_is_no_tidy_frame_is_refused(key, said, tmp_path):
    with pytest.raises(TaskError, match=said):
        sweep(Study("frames", frame, [{"key": key}], sets=50, chunk_size=50), tmp_path)


def numbers(scenario, n_sets, rng):
    return pd.DataFrame({"x": rng.normal(size=n_sets)}, index=pd.Index(range(n_sets), name="whatever"))


def test_a_frame_with_one_row_a_set_needs_no_repetition(tmp_path):
    sweep(Study("numbers", numbers, [{"key": "a"}], sets=5, chunk_size=2), tmp_path)
    rows = load(tmp_path)
    assert list(rows.columns) == ["scenario", "repetition", "x", "chunk", "seed", "stream"]
    assert list(rows["repetition"]) == [0, 1, 2, 3, 4]


def test_a_study_refuses_what_workers_or_the_manifest_could_not_hold(tmp_path):
    with pytest.raises(StudyError, match="run must be a function at the top of a module"):
        replace(STUDY, run=lambda scenario, n_sets, rng: None)
    with pytest.raises(StudyError, match="scenarios share the key 'narrow'"):
        replace(STUDY, scenarios=[*STUDY.scenarios, Toy("narrow")])
    with pytest.raises(StudyError, match="a scenario needs a key"):
        replace(STUDY, scenarios=[{"noise": 1.0}])
    with pytest.raises(StudyError, match="chunk_size must be at least 1"):
        replace(STUDY, chunk_size=0)
    with pytest.raises(StudyError, match="scenario 'x' cannot be written to the manifest: <object"):
        sweep(replace(STUDY, scenarios=[{"key": "x", "what": object()}]), tmp_path)
    with pytest.raises(StudyError, match="the seed from 0 to"):
        sweep(STUDY, tmp_path, seed=-1)


def test_the_manifest_tells_what_was_run_and_by_what(alone):
    manifest = json.loads((alone / "manifest.json").read_text())
    assert (manifest["study"], manifest["seed"], manifest["chunk_size"]) == ("toy", 5, 8)
    assert manifest["versions"]["numpy"] == np.__version__
    assert manifest["scenarios"]["narrow"]["definition"] == {"type": "Toy", "key": "narrow", "scale": 0.1, "act": ""}
    (run,) = map(json.loads, (alone / "runs.jsonl").read_text().splitlines())
    assert (run["made"], run["kept"], run["missing"]) == (14, 0, 0)
