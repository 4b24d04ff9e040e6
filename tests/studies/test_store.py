"""What is on disk is whole, and of one configuration; a killed sweep goes on."""

import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import toy_study
from toy_study import SLOW, STUDY, Toy

from studies.harness import StudyError, driver, load, store, sweep
from studies.harness.store import locked

CHECKOUT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(CHECKOUT)}


@pytest.fixture
def out(tmp_path):
    sweep(STUDY, tmp_path / "out")
    return tmp_path / "out"


def snapshot(out):
    return {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        ({}, {"seed": 6}, "seed 5, not 6"),
        ({"chunk_size": 10}, {}, "chunk_size 8, not 10"),
        ({"name": "other"}, {}, "study 'toy', not 'other'"),
        ({"scenarios": [replace(STUDY.scenarios[0], scale=0.2)]}, {}, "scenario 'narrow' is defined otherwise"),
        ({}, {"sets": 49}, "50 sets of 'narrow', and --sets 49 would take some away"),
    ],
)
@pytest.mark.parametrize("resume", [False, True])
def test_another_configuration_is_refused(change, options, said, resume, out):
    before = snapshot(out)
    with pytest.raises(StudyError, match="holds another configuration") as caught:
        sweep(replace(STUDY, **change), out, resume=resume, **options)
    assert said in str(caught.value)
    assert f"choose another --out, or delete {out}" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert snapshot(out) == before


def test_other_versions_and_sources_are_refused(out, monkeypatch):
    monkeypatch.setattr(store, "source_of", lambda run: "edited")
    monkeypatch.setattr(store, "versions", lambda packages: {"numpy": "9.9"})
    with pytest.raises(StudyError, match=r"numpy [\d.]+, not 9.9; study source \w+, not edited"):
        sweep(STUDY, out, resume=True)


def test_types_of_a_definition_count(out, tmp_path):
    class Other(Toy):
        pass

    scenario = Other(**vars(STUDY.scenarios[0]))
    with pytest.raises(StudyError, match="defined otherwise"):
        sweep(replace(STUDY, scenarios=[scenario]), out, resume=True)


def test_a_folder_with_chunks_needs_resume(out):
    before = snapshot(out)
    with pytest.raises(StudyError, match="holds chunks already: add --resume"):
        sweep(STUDY, out)
    assert snapshot(out) == before
    done = sweep(STUDY, out, resume=True)
    assert (done.made, done.kept) == (0, 14)


def test_a_lost_or_damaged_manifest_is_told(out):
    (out / "manifest.json").write_text('{"format": 1')
    with pytest.raises(StudyError, match=r"manifest\.json is damaged"):
        sweep(STUDY, out, resume=True)
    (out / "manifest.json").unlink()
    with pytest.raises(StudyError, match=r"there is no .*manifest\.json"):
        sweep(STUDY, out, resume=True)


def truncate(path):
    path.write_bytes(path.read_bytes()[:-100])


def empty(path):
    path.write_bytes(b"")


def flip(path):
    data = bytearray(path.read_bytes())
    data[data.index(b"PAR1") + 300] ^= 1  # within a page: only its checksum tells
    path.write_bytes(data)


@pytest.mark.parametrize("damage", [truncate, empty, flip])
def test_a_damaged_chunk_is_told_and_made_again(damage, out, contents, caplog):
    before = contents(out)
    victim = sorted(out.rglob("*.parquet"))[3]
    damage(victim)
    with pytest.raises(StudyError, match=r"00003.parquet cannot be read"):
        load(out)
    done = sweep(STUDY, out, resume=True)
    assert (done.made, done.kept) == (1, 13)
    assert f"note: {victim} is damaged and will be made again" in caplog.text
    assert contents(out) == before


def test_a_chunk_of_another_sweep_does_not_count(out, tmp_path, contents):
    before = contents(out)
    sweep(STUDY, tmp_path / "other", seed=6)
    name = next(iter(before))
    shutil.copy(tmp_path / "other" / "chunks" / name, out / "chunks" / name)
    with pytest.raises(StudyError, match="is unfinished"):
        load(out)
    assert sweep(STUDY, out, resume=True).made == 1
    assert contents(out) == before


def test_half_a_file_is_not_a_chunk(out, contents):
    before = contents(out)
    victim = min(out.rglob("*.parquet"))
    victim.rename(victim.with_suffix(".tmp"))
    assert len(load(out, partial=True)) == len(load(out, ["chunk"], partial=True)) == 300 - 24
    assert sweep(STUDY, out, resume=True).made == 1
    assert contents(out) == before, "and nothing is left of it"


def test_two_runs_cannot_write_to_one_folder(out):
    if store.fcntl is None:
        pytest.skip("this system has no flock")
    with locked(out), pytest.raises(StudyError, match="another run is writing to"):
        sweep(STUDY, out, resume=True)
    sweep(STUDY, out, resume=True)


def test_a_disk_that_is_full_is_told(tmp_path, monkeypatch):
    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(driver.ChunkFile, "write", full)
    with pytest.raises(StudyError, match="No space left on device; --resume"):
        sweep(STUDY, tmp_path)


def test_a_file_in_place_of_the_folder_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(StudyError, match=r"cannot write to .*file: File exists"):
        sweep(STUDY, tmp_path / "file")


def start(out, workers):
    command = [sys.executable, toy_study.__file__, "--workers", str(workers), "--out", str(out)]
    # a shell starts its background jobs deaf to SIGINT, and a child inherits that: as on a terminal, it is to hear
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(command, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True, start_new_session=True)
    finally:
        signal.signal(signal.SIGINT, before)
    deadline = time.monotonic() + 30
    while len(list(out.rglob("*.parquet"))) < 3:
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return process


def children(pid):
    task = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in task.read_text().split()] if task.exists() else []


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    out = tmp_path_factory.mktemp("unbroken")
    sweep(SLOW, out, workers=2)
    return out


@pytest.mark.parametrize("workers", [1, 2])
def test_a_sweep_that_was_killed_goes_on_to_the_same_bits(workers, unbroken, tmp_path, contents):
    out = tmp_path / "killed"
    process = start(out, workers)
    processes = children(process.pid)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    process.stderr.close()
    whole = {name: content for name, content in contents(out).items() if name.endswith(".parquet")}
    left = len(whole)
    assert 3 <= left < 24, "it was killed in the middle"
    assert whole.items() < contents(unbroken).items()
    done = sweep(SLOW, out, resume=True, workers=2)
    assert (done.made, done.kept) == (24 - left, left)
    assert contents(out) == contents(unbroken)
    deadline = time.monotonic() + 10
    while any(Path(f"/proc/{pid}").exists() for pid in processes) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(Path(f"/proc/{pid}").exists() for pid in processes), "its workers ended with it"


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
def test_an_interrupted_sweep_says_so_and_goes_on(name, workers, unbroken, tmp_path, contents):
    out = tmp_path / "interrupted"
    process = start(out, workers)
    process.send_signal(getattr(signal, name))
    _, said = process.communicate(timeout=20)
    assert process.returncode == 130
    own = [line for line in said.splitlines() if "resource_tracker" not in line and "warnings.warn" not in line]
    assert own == ["python -m studies slow: interrupted; finished chunks are kept, --resume goes on"]
    left = len(list(out.rglob("*.parquet")))
    assert 3 <= left < 24
    assert sweep(SLOW, out, resume=True, workers=2).kept == left
    assert contents(out) == contents(unbroken)


def test_a_scenario_with_nan_is_the_same_when_the_run_goes_on(tmp_path):
    study = replace(STUDY, scenarios=[Toy("open", float("nan"))])
    sweep(study, tmp_path)
    assert sweep(study, tmp_path, resume=True).made == 0
    with pytest.raises(StudyError, match="scenario 'open' is defined otherwise"):
        sweep(replace(study, scenarios=[Toy("open", 0.0)]), tmp_path, resume=True)


def test_many_differences_are_told_in_one_short_line(tmp_path):
    first, second = (replace(STUDY, scenarios=[Toy(f"s{i}", scale) for i in range(9)]) for scale in (1.0, 2.0))
    sweep(first, tmp_path, sets=2)
    with pytest.raises(StudyError, match=r"'s2' is defined otherwise; and 6 more\): choose"):
        sweep(second, tmp_path, sets=2, resume=True)
