"""Run tasks on a Dask cluster whose workers were started anywhere, without the code of the studies.

This does not go through joblib's Dask backend: when a worker cannot load a task, or dies of one, that
backend waits for ever. Here each of these ends the sweep with an error.
"""

from __future__ import annotations

import contextlib
import gc
import hashlib
import inspect
import io
import itertools
import pickle
import tempfile
import time
import zipfile
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import studies
from studies.harness.study import StudyError
from studies.harness.task import Task, execute_in_worker

try:
    import cloudpickle  # type: ignore[import-untyped]
    from distributed import CancelledError, Client, KilledWorker, wait
    from distributed.diagnostics.plugin import UploadFile
except ImportError:
    raise StudyError("--dask needs dask and distributed: pip install 'hexopt[dask]'") from None

TIMEOUT = 15  # seconds for the scheduler, or for a first worker, to answer
BATCH = 0.2  # seconds that a batch of small tasks should last
_FORGET = "import sys\nfor name in list(sys.modules):\n    if name.partition('.')[0] in {}: del sys.modules[name]"
_Batch = tuple[float, list[tuple[str, int, bytes]]]


def run_dask(tasks: Sequence[Task], address: str) -> Generator[tuple[str, int, bytes]]:
    """Run the tasks on the workers of the scheduler at `address`."""
    with _connected(address) as client:
        _send_code(client, tasks[0].run)
        queue, size = iter(tasks), 1
        running: set[Any] = set()
        slots = 2 * sum(client.nthreads().values())
        while True:
            while len(running) < slots and (batch := list(itertools.islice(queue, size))):
                running.add(client.submit(pickle.loads, cloudpickle.dumps(_Call(batch)), pure=False))
            if not running:
                return
            done, running = _wait(client, running)
            for seconds, chunks in client.gather(list(done)):
                size = _better_size(len(chunks), seconds)
                yield from chunks


class _Call:
    """What unpickles as the result of a batch: unpickling is the call.

    So a task is bytes to the scheduler, which would load a function to look at it, but has no `studies`.
    """

    def __init__(self, tasks: Sequence[Task]) -> None:
        self.tasks = tasks

    def __reduce__(self) -> tuple[Callable[[Sequence[Task]], _Batch], tuple[Sequence[Task]]]:
        return _execute_batch, (self.tasks,)


def _execute_batch(tasks: Sequence[Task]) -> _Batch:
    start = time.perf_counter()
    chunks = [execute_in_worker(task) for task in tasks]
    return time.perf_counter() - start, chunks


def _better_size(size: int, seconds: float) -> int:
    """As many tasks as last for `BATCH`, but at most twice as many as in the last batch."""
    return max(1, min(2 * size, int(size * BATCH / max(seconds, 1e-6))))


def _wait(client: Client, running: set[Any]) -> tuple[set[Any], set[Any]]:
    """The futures that are done, and those that are not; an error when nobody is left to do them."""
    while True:
        try:
            done, rest = wait(running, timeout=TIMEOUT, return_when="FIRST_COMPLETED")
        except TimeoutError:
            if not client.nthreads():
                raise StudyError("no worker is left on the Dask cluster") from None
        else:
            return done, rest


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Client]:
    """A client of the scheduler at `address`; what goes wrong on the cluster becomes a `StudyError`."""
    # A client that could not connect is garbage that closes itself when it is collected. If that happens while
    # another one starts, distributed waits for its own lock for ever: collect before, and not in between.
    gc.collect()
    collecting = gc.isenabled()
    gc.disable()
    try:
        client = Client(address, timeout=TIMEOUT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        reason = " ".join(str(error).split())
        raise StudyError(f"no Dask scheduler answers at {address} ({reason})") from None
    finally:
        if collecting:
            gc.enable()
    with client:
        try:
            client.wait_for_workers(1, timeout=TIMEOUT)
            with client.as_current():
                yield client
        except TimeoutError:
            raise StudyError(f"the Dask scheduler at {address} has no worker (waited {TIMEOUT} s)") from None
        except CancelledError:
            raise StudyError(f"the Dask scheduler at {address} is gone") from None
        except KilledWorker as error:
            raise StudyError(f"a task killed its Dask workers, out of memory perhaps: {error}") from None
        except ImportError as error:
            raise StudyError(f"a Dask worker cannot load the study: {error}") from error
        except (RuntimeError, OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise StudyError(f"the Dask cluster failed: {type(error).__name__}: {reason}") from error


def _send_code(client: Client, run: Callable[..., Any]) -> None:
    """Give the workers, those that join later too, the driver's `studies` and the module of `run`."""
    roots = _roots(run)
    data = _zipped(roots)
    names = [root.stem for root in roots]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / f"studies-{hashlib.sha256(data).hexdigest()[:16]}.zip"
        file.write_bytes(data)
        plugin = UploadFile(str(file))
    # A worker of an earlier sweep has modules of an earlier checkout; one that cannot answer now will join anew.
    client.run(exec, _FORGET.format(names), on_error="ignore")
    client.register_plugin(plugin, name="hexopt-studies")


def _roots(run: Callable[..., Any]) -> list[Path]:
    """The package `studies`, and that (or the module) of a `run` from elsewhere."""
    roots = [Path(studies.__path__[0])]
    name, file = run.__module__, inspect.getsourcefile(run)
    parts = name.split(".")
    mine = parts[0] not in ("__main__", "studies")  # a script's own functions are sent by value
    if mine and file and "site-packages" not in Path(file).parts:
        path = Path(file) if Path(file).name != "__init__.py" else Path(file).parent
        roots.append(path if len(parts) == 1 else path.parents[len(parts) - 2])
    return roots


def _zipped(roots: Sequence[Path]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for root in roots:
            for file in [root] if root.is_file() else sorted(root.rglob("*.py")):
                info = zipfile.ZipInfo(file.relative_to(root.parent).as_posix())  # dated 1980: equal code, equal zip
                archive.writestr(info, file.read_bytes())
    return buffer.getvalue()
