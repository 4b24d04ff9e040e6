"""Run a study, chunk by chunk, into a folder that survives being killed."""

from __future__ import annotations

import contextlib
import json
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from pathlib import Path
from types import FrameType
from typing import Any

from tqdm import tqdm

from studies.harness.store import ChunkFile, Manifest, chunk_files, claim, locked, plan
from studies.harness.study import Study, StudyError
from studies.harness.task import Task
from studies.harness.workers import Finished, run_tasks


@dataclass(frozen=True)
class Run:
    """What one call of `sweep` did."""

    out: Path
    made: int
    kept: int
    seconds: float

    def __str__(self) -> str:
        kept = f", {self.kept} kept" if self.kept else ""
        return f"{self.made} chunks made{kept} in {self.seconds:.1f} s: {self.out}"


def sweep(
    study: Study[Any],
    out: str | Path,
    *,
    sets: int | None = None,
    seed: int | None = None,
    workers: int = 1,
    dask: str | None = None,
    resume: bool = False,
    only: str = "*",
    progress: bool | None = None,
) -> Run:
    """Run a study and write its rows to a folder.

    The rows do not depend, to the bit, on how many workers there are, where they are, in which order they
    finish, how often the sweep was killed and resumed, or which other scenarios the study has.

    Parameters
    ----------
    study : Study
        What to run.
    out : path
        The folder for the results. One that holds another configuration is refused.
    sets, seed : int, optional
        Repetitions of each scenario, and root seed; the study's own unless given.
    workers : int
        Processes on this machine; 1 runs everything in this one.
    dask : str, optional
        Address of a Dask scheduler, whose workers then run the tasks.
    resume : bool
        Go on with what `out` holds: finished chunks stay, more `sets` or scenarios may be asked for.
    only : str
        Run only the scenarios whose keys match this pattern (as of file names: ``*``, ``?``, ``[ab]``).
    progress : bool, optional
        Show a bar; by default only on a terminal.

    Returns
    -------
    Run
        The number of chunks made and kept, and the time.
    """
    out, sets, seed = Path(out), study.sets if sets is None else sets, study.seed if seed is None else seed
    if sets < 1 or workers < 1 or not 0 <= seed < 2**63:
        raise StudyError("sets and workers must be at least 1, and the seed from 0 to 2^63 - 1")
    started, clock = datetime.now(UTC), time.perf_counter()
    with locked(out), _terminated_as_interrupted():
        asked = _only(plan(study, sets, seed), only)
        claim(out, asked, resume)
        places = list(chunk_files(out, asked))
        missing = [place for place in places if not place.is_whole()]
        tasks = [_task(study, asked, place) for place in missing]
        made = 0
        try:
            with _bar(study.name, places, missing, progress) as bar:
                for place, data in _finished(missing, run_tasks(tasks, workers, dask)):
                    _write(place, data)
                    made += 1
                    bar.update(place.label["sets"])
        finally:
            run = Run(out, made, len(places) - len(missing), time.perf_counter() - clock)
            _log_run(run, started, len(missing), f"dask {dask}" if dask else f"{workers} worker{'s' * (workers > 1)}")
    return run


def _only(manifest: Manifest, pattern: str) -> Manifest:
    scenarios = {key: entry for key, entry in manifest["scenarios"].items() if fnmatchcase(key, pattern)}
    if not scenarios:
        raise StudyError(f"no scenario matches {pattern!r}, only: {', '.join(manifest['scenarios'])}")
    return manifest | {"scenarios": scenarios}


def _task(study: Study[Any], manifest: Manifest, place: ChunkFile) -> Task:
    versions = {name: value for name, value in manifest["versions"].items() if name != "study source"}
    return Task(
        run=study.run,
        scenario=study.keyed()[place.label["key"]],
        chunk_size=study.chunk_size,
        seed=manifest["seed"],
        packages=study.packages,
        versions=versions,
        **place.label,
    )


def _finished(missing: Iterable[ChunkFile], results: Finished) -> Iterator[tuple[ChunkFile, bytes]]:
    """Each finished chunk with its place; the workers stop when this does."""
    places = {(place.label["key"], place.label["chunk"]): place for place in missing}
    with contextlib.closing(results):
        for key, chunk, data in results:
            yield places[key, chunk], data


def _write(place: ChunkFile, data: bytes) -> None:
    try:
        place.write(data)
    except OSError as error:
        raise StudyError(f"cannot write {place.path}: {error.strerror}; --resume goes on from there") from error


def _bar(name: str, places: Iterable[ChunkFile], missing: Iterable[ChunkFile], progress: bool | None) -> tqdm[Any]:
    total, todo = (sum(place.label["sets"] for place in some) for some in (places, missing))
    hidden = None if progress is None else not progress  # None: unless on a terminal
    return tqdm(desc=name, total=total, initial=total - todo, unit=" sets", disable=hidden, smoothing=0.05)


def _log_run(run: Run, started: datetime, missing: int, workers: str) -> None:
    entry = {
        "started": started.isoformat(timespec="seconds"),
        "seconds": round(run.seconds, 3),
        "command": shlex.join(["python", *sys.orig_argv[1:]]),
        "workers": workers,
        "made": run.made,
        "kept": run.kept,
        "missing": missing - run.made,
    }
    with (run.out / "runs.jsonl").open("a", encoding="utf-8") as file:
        file.write(json.dumps(entry) + "\n")


@contextlib.contextmanager
def _terminated_as_interrupted() -> Iterator[None]:
    """SIGTERM stops the sweep as Ctrl-C does: workers end, whole chunks stay."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(signum: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
