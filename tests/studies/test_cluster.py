"""A Dask cluster whose workers were started elsewhere, and know nothing of the studies."""

import contextlib
import importlib
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from toy_study import SLOW, STUDY, Toy

from studies.harness import StudyError, TaskError, load, store, sweep

distributed = pytest.importorskip("distributed", reason="dask is an optional dependency: pip install 'hexopt[dask]'")

CHECKOUT = Path(__file__).parents[2]
WORKER = """
import os
import runpy
import sys
from pathlib import Path

hidden = {hidden!r}
sys.path[:] = [path for path in sys.path if path and str(Path(path).resolve()) not in hidden]

if __name__ == "__main__":
    runpy.run_module("distributed.cli.dask_" + os.environ["PROGRAM"], run_name="__main__")
"""


class Cluster:
    """A scheduler with workers in another folder, which have hexopt and its dependencies, but not the checkout."""

    def __init__(self, folder, workers):
        (folder / "site").mkdir()
        (folder / "site" / "hexopt").symlink_to(CHECKOUT / "hexopt")
        (folder / "worker.py").write_text(WORKER.format(hidden=[str(CHECKOUT), str(Path(__file__).parent)]))
        self.folder, self.log, self.processes = folder, (folder / "log").open("w"), []
        self.start("worker.py", "--port", "0", program="scheduler")
        file = folder / "scheduler.json"
        wait_until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = json.loads(file.read_text())["address"]
        if workers:
            self.start("worker.py", "--nworkers", str(workers), "--nthreads", "2", program="worker")

    def start(self, *command, program):
        options = ["--host", "127.0.0.1", "--no-dashboard", "--scheduler-file", str(self.folder / "scheduler.json")]
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST")} | {
            "PROGRAM": program,
            "PYTHONPATH": str(self.folder / "site"),
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0",
            "DASK_TEMPORARY_DIRECTORY": str(self.folder),
        }
        process = subprocess.Popen(
            [sys.executable, *command, *options],
            cwd=self.folder,
            env=environment,
            stdout=self.log,
            stderr=self.log,
            start_new_session=True,
        )
        self.processes.append(process)

    def stop(self):
        for process in self.processes:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(timeout=20)
        self.log.close()


def wait_until(condition):
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a cluster of two workers."""
    started = Cluster(tmp_path_factory.mktemp("elsewhere"), workers=2)
    yield started.address
    started.stop()


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    from studies.harness import cluster

    monkeypatch.setattr(cluster, "TIMEOUT", 10)


def test_workers_elsewhere_write_the_same_bits(cluster, tmp_path, contents):
    with distributed.Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=20)
        for name, there in (("studies", False), ("toy_study", False), ("hexopt", True)):
            code = f"import importlib.util as u; assert (u.find_spec({name!r}) is not None) == {there}"
            client.run(exec, code)
    sweep(STUDY, tmp_path / "here")
    done = sweep(STUDY, tmp_path / "there", dask=cluster)
    assert (done.made, done.kept) == (14, 0)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")
    sweep(STUDY, tmp_path / "here", sets=64, resume=True)
    sweep(STUDY, tmp_path / "there", sets=64, resume=True, dask=cluster)
    assert contents(tmp_path / "there") == contents(tmp_path / "here")


def test_blas_has_one_thread_there(cluster, tmp_path):
    sweep(replace(STUDY, scenarios=[Toy("a", act="look")]), tmp_path, dask=cluster)
    assert set(load(tmp_path)["threads"]) == {1}


def test_many_small_chunks(cluster, tmp_path):
    sweep(replace(STUDY, chunk_size=1), tmp_path, sets=200, dask=cluster)
    assert len(load(tmp_path)) == 2 * 200 * 3


MINE = """
import pandas as pd
from studies.harness import Study
def run(scenario, n_sets, rng): return pd.DataFrame({{"x": [{value}] * n_sets}})
STUDY = Study("mine", run, [{{"key": "a"}}], sets=16, chunk_size=1)
"""


def test_workers_take_code_that_was_changed(cluster, tmp_path, monkeypatch):
    package = tmp_path / "package_of_test_cluster"
    package.mkdir()
    (package / "__init__.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    for value in (1, 2):
        (package / "run.py").write_text(MINE.format(value=value) + "\n" * value)
        importlib.invalidate_caches()
        sys.modules.pop("package_of_test_cluster.run", None)
        sweep(importlib.import_module("package_of_test_cluster.run").STUDY, tmp_path / str(value), dask=cluster)
        assert set(load(tmp_path / str(value))["x"]) == {value}


def test_an_error_there_says_which(cluster, tmp_path):
    study = replace(STUDY, scenarios=[STUDY.scenarios[0], Toy("bad", act="fail")])
    with pytest.raises(TaskError, match=r"scenario 'bad', chunk \d .* raised ZeroDivisionError: no such luck"):
        sweep(study, tmp_path, dask=cluster)


def test_a_worker_with_other_versions_is_refused(cluster, tmp_path, monkeypatch):
    versions = store.versions(())
    monkeypatch.setattr(store, "versions", lambda packages: {**versions, "numpy": "9.9"})
    with pytest.raises(StudyError, match=r"a worker on .* has numpy [\d.]+, the driver 9.9"):
        sweep(STUDY, tmp_path, dask=cluster)


def test_a_worker_that_cannot_load_the_study_ends_the_sweep(cluster, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "needs_of_test_cluster.py").write_text("")
    source = MINE.format(value=1) + "import needs_of_test_cluster\n"
    (tmp_path / "lonely_of_test_cluster.py").write_text(source)
    importlib.invalidate_caches()
    with pytest.raises(StudyError, match=r"a Dask worker cannot load the study: .*needs_of_test_cluster"):
        sweep(importlib.import_module("lonely_of_test_cluster").STUDY, tmp_path / "out", dask=cluster)


def test_the_example_of_the_readme_runs_there(cluster, tmp_path):
    readme = (CHECKOUT / "studies" / "harness" / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    (tmp_path / "mine.py").write_text(code, encoding="utf-8")
    (command,) = re.findall(r"^    python (mine.py --dask.*)$", readme, re.MULTILINE)
    command = [sys.executable, *command.replace("tcp://host:8786", cluster).split()]
    environment = os.environ | {"PYTHONPATH": str(CHECKOUT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(load(tmp_path / "results" / "elsewhere")) == 4000


def test_a_scheduler_that_goes_ends_the_sweep_and_the_rest_can_follow(tmp_path_factory, tmp_path, contents):
    lost = Cluster(tmp_path_factory.mktemp("lost"), workers=1)

    def kill():
        wait_until(lambda: len(list(tmp_path.rglob("*.parquet"))) >= 2)
        lost.stop()

    killer = threading.Thread(target=kill)
    killer.start()
    with pytest.raises(StudyError, match="is gone"):
        sweep(SLOW, tmp_path / "out", dask=lost.address)
    killer.join()
    left = len(contents(tmp_path / "out"))
    assert 2 <= left < 24
    assert sweep(SLOW, tmp_path / "out", resume=True, workers=2).kept == left


def test_a_scheduler_without_workers_ends_the_sweep(tmp_path_factory, tmp_path, monkeypatch):
    from studies.harness import cluster

    monkeypatch.setattr(cluster, "TIMEOUT", 1)
    empty = Cluster(tmp_path_factory.mktemp("empty"), workers=0)
    with pytest.raises(StudyError, match="has no worker"):
        sweep(STUDY, tmp_path, dask=empty.address)
    empty.stop()


def test_an_address_without_a_scheduler_ends_the_sweep_soon(tmp_path, monkeypatch):
    from studies.harness import cluster

    monkeypatch.setattr(cluster, "TIMEOUT", 1)
    for nowhere in ("tcp://127.0.0.1:9", "nonsense://x", "tcp://127.0.0.1:notaport"):
        start = time.monotonic()
        with pytest.raises(StudyError, match="no Dask scheduler answers at"):
            sweep(STUDY, tmp_path, dask=nowhere)
        assert time.monotonic() - start < 10


def test_a_task_that_kills_its_worker_ends_the_sweep(
    cluster, tmp_path
):  # the last one, since it leaves the cluster in disorder
    with pytest.raises(StudyError, match=r"a task killed its Dask workers"):
        sweep(replace(STUDY, scenarios=[Toy("deadly", act="die")]), tmp_path, dask=cluster)
