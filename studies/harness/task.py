"""What a worker does: run one chunk of one scenario, and return it as the bytes of a Parquet file."""

from __future__ import annotations

import contextlib
import functools
import io
import json
import os
import socket
import threading
import time
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from threadpoolctl import threadpool_limits

from studies.harness.identity import versions
from studies.harness.study import Study, StudyError, generator, stream_of

METADATA = b"study"  # the key of a chunk's own description in its file
_ADDED = ("scenario", "chunk", "seed", "stream")
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS")
_one_at_a_time = threading.Lock()


class TaskError(StudyError):
    """The function `run` of a study raised, or returned no tidy frame; `details` is the worker's traceback."""

    details: str = ""


@dataclass(frozen=True)
class Task:
    """One chunk of one scenario: `fingerprint` is of its configuration, `versions` are of the driver's code."""

    run: Any
    scenario: Any
    key: str
    chunk: int
    sets: int
    chunk_size: int
    seed: int
    fingerprint: str = ""
    packages: tuple[str, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)

    def label(self) -> dict[str, Any]:
        """What the file of this chunk says of itself."""
        names = ("fingerprint", "key", "chunk", "sets")
        return {name: getattr(self, name) for name in names}

    def __str__(self) -> str:
        return (
            f"scenario {self.key!r}, chunk {self.chunk} ({self.sets} sets, seed {self.seed}, "
            f"spawn key ({stream_of(self.key)}, {self.chunk}))"
        )


def rerun(study: Study[Any], key: str, chunk: int, *, sets: int | None = None, seed: int | None = None) -> pd.DataFrame:
    """Run one chunk again in this process, say under a debugger.

    Parameters
    ----------
    study : Study
        The study.
    key, chunk, seed
        As in the columns ``scenario``, ``chunk`` and ``seed`` of its rows; `seed` is the study's unless given.
    sets : int, optional
        Repetitions in the chunk: the study's `chunk_size`, unless it is the last, smaller one.

    Returns
    -------
    pandas.DataFrame
        The rows of this chunk, bit for bit.
    """
    size, seed = study.chunk_size, study.seed if seed is None else seed
    with single_threaded():
        return _rows(Task(study.run, study.keyed()[key], key, chunk, sets or size, size, seed)).to_pandas()


def execute(task: Task) -> tuple[str, int, bytes]:
    """Run a chunk and return it with its key and number; an error names the scenario, the chunk and the seed."""
    try:
        buffer = io.BytesIO()
        pq.write_table(_rows(task), buffer, write_page_checksum=True)
    except Exception as error:
        failure = TaskError(f"{task} raised {type(error).__name__}: {' '.join(str(error).split())}")
        failure.details = traceback.format_exc()
        raise failure from None
    return task.key, task.chunk, buffer.getvalue()


def execute_in_worker(task: Task, parent: int | None = None) -> tuple[str, int, bytes]:
    """As `execute`, in a worker's process: with one BLAS thread, one task at a time, and the driver's code.

    With the process id of its `parent`, the worker ends when that is killed.
    """
    with _one_at_a_time:
        _limit_for_good()
        if parent is not None:
            _die_with(parent)
        for name, version in task.versions.items():
            if (mine := versions(task.packages).get(name)) != version:
                raise StudyError(f"a worker on {socket.gethostname()} has {name} {mine}, the driver {version}")
        return execute(task)


def _rows(task: Task) -> pa.Table:
    stream = stream_of(task.key)
    frame = task.run(task.scenario, task.sets, generator(task.seed, stream, task.chunk))
    if not isinstance(frame, pd.DataFrame):
        raise TypeError(f"run must return a pandas.DataFrame, not {type(frame).__name__}")
    if taken := [name for name in _ADDED if name in frame]:
        raise ValueError(f"run returned the column {taken[0]!r}, which the sweep adds itself")
    rows = pa.Table.from_pandas(frame, preserve_index=False, nthreads=1)
    first = {"scenario": pa.repeat(task.key, len(rows)), "repetition": _repetition(task, frame)}
    last = {"chunk": task.chunk, "seed": task.seed, "stream": stream}
    columns = first | {name: rows[name] for name in rows.column_names if name != "repetition"}
    columns |= {name: pa.repeat(number, len(rows)) for name, number in last.items()}
    label = json.dumps(task.label(), sort_keys=True).encode()
    return pa.table(columns).replace_schema_metadata({**(rows.schema.metadata or {}), METADATA: label})


def _repetition(task: Task, frame: pd.DataFrame) -> np.ndarray:
    """The column ``repetition``, counted over all chunks."""
    if "repetition" in frame:
        repetition = frame["repetition"].to_numpy()
    elif len(frame) == task.sets:
        repetition = np.arange(task.sets)
    else:
        raise ValueError(f"run returned {len(frame)} rows for {task.sets} sets, and no column 'repetition'")
    if not np.array_equal(np.unique(repetition), np.arange(task.sets)):
        raise ValueError(f"the column 'repetition' must take each value 0 … {task.sets - 1}")
    return repetition.astype(np.int64) + task.chunk * task.chunk_size


@contextlib.contextmanager
def single_threaded() -> Iterator[None]:
    """Limit BLAS and OpenMP to one thread: libraries in memory by a call, those yet to load by their variables."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        with threadpool_limits(1):
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@functools.cache
def _limit_for_good() -> contextlib.AbstractContextManager[None]:
    limit = single_threaded()
    limit.__enter__()
    return limit  # kept in the cache: collected, it would lift the limit


@functools.cache
def _die_with(parent: int) -> None:
    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
