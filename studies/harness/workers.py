"""Where tasks run: in this process, in loky's worker processes, or on a Dask cluster (`cluster`).

Each way is a generator of finished chunks ``(key, chunk, data)``, in the order in which they finish.
"""

from __future__ import annotations

import os
import pickle
import warnings
from collections.abc import Generator, Sequence
from concurrent.futures import BrokenExecutor

import joblib

from studies.harness.study import StudyError
from studies.harness.task import Task, execute, execute_in_worker, single_threaded

Finished = Generator[tuple[str, int, bytes]]


def run_tasks(tasks: Sequence[Task], workers: int, dask: str | None) -> Finished:
    """Run the tasks where they are asked to run."""
    if tasks and dask is not None:
        from studies.harness.cluster import run_dask  # a second of imports, and an optional package

        return run_dask(tasks, dask)
    workers = min(workers, len(tasks))
    return run_loky(tasks, workers) if workers > 1 else run_here(tasks)


def run_here(tasks: Sequence[Task]) -> Finished:
    """Run the tasks in this process."""
    with single_threaded():
        for task in tasks:
            yield execute(task)


def run_loky(tasks: Sequence[Task], workers: int) -> Finished:
    """Run the tasks in processes of this machine; joblib sends small tasks in batches."""
    parallel = joblib.Parallel(n_jobs=workers, backend="loky", return_as="generator_unordered", max_nbytes=None)
    parent = os.getpid()
    finished = parallel(joblib.delayed(execute_in_worker)(task, parent) for task in tasks)
    try:
        yield from finished
    except BrokenExecutor as error:
        reason = " ".join(str(error).split())
        raise StudyError(f"a worker process died, out of memory perhaps, or could not start: {reason}") from error
    except pickle.PicklingError as error:
        raise StudyError(f"a scenario or run cannot be sent to the workers: {error}") from error
    finally:
        with warnings.catch_warnings(action="ignore"):  # joblib warns of the tasks that an interrupt cuts short
            finished.close()
