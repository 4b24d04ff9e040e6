"""The command line: short answers, one line when something is wrong, and the example of the README."""

import math
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from toy_study import STUDY, Toy

from studies import __main__ as studies_main
from studies.harness import aggregate, cli, load

CHECKOUT = Path(__file__).parents[2]
ENVIRONMENT = os.environ | {"PYTHONPATH": str(CHECKOUT), "COLUMNS": "120"}


def python(*arguments, cwd=CHECKOUT):
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, timeout=100, check=False)


def test_studies_are_listed_without_being_imported():
    code = "import sys; from studies.__main__ import main; main([]); print(sorted(sys.modules), file=sys.stderr)"
    done = python("-c", code)
    assert done.returncode == 0
    assert "usage: python -m studies NAME [options]" in done.stdout
    assert not {"numpy", "pandas", "matplotlib", "hexopt", "studies.harness"} & set(eval(done.stderr))
    for run in (CHECKOUT / "studies").glob("*/run.py"):
        assert re.search(rf"^  {run.parent.name} +\S", done.stdout, re.MULTILINE)
    assert "harness" not in done.stdout


def test_a_study_is_a_folder_with_a_run(tmp_path, monkeypatch, capsys):
    (tmp_path / "studies" / "mine").mkdir(parents=True)
    (tmp_path / "studies" / "mine" / "run.py").write_text('"""What it is.\n\nMore."""\nraise ImportError\n')
    monkeypatch.setattr(studies_main, "__file__", str(tmp_path / "studies" / "__main__.py"))
    assert studies_main.find_studies() == {"mine": "What it is."}
    assert studies_main.main(["nosuch"]) == 2
    assert capsys.readouterr().err == "studies: there is no study 'nosuch', only: mine\n"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--sets", "x"], "argument --sets: 'x' is not a whole number"),
        (["--sets", "0"], "argument --sets: 0 is less than 1"),
        (["--workers", "0"], "argument --workers: 0 is less than 1"),
        (["--seed", "-1"], "argument --seed: -1 is less than 0"),
        (["--workers", "2", "--dask", "tcp://host:1"], "argument --dask: not allowed with argument --workers"),
        (["--set", "5"], "unrecognized arguments: --set 5"),
        (["--report-only"], "unrecognized arguments: --report-only"),
    ],
)
def test_bad_options_are_one_line(options, said, capsys):
    with pytest.raises(SystemExit) as stop:
        cli.main(STUDY, options)
    assert stop.value.code == 2
    assert capsys.readouterr().err == f"python -m studies toy: {said} (--help lists the options)\n"


def test_defaults_are_the_study_s_own():
    options = cli.parser(STUDY).parse_args([])
    assert (options.sets, options.seed, options.out) == (50, 5, Path("results/toy"))
    assert f"processes [{os.cpu_count()}]" in cli.parser(STUDY).format_help()


def test_a_run_and_its_report(tmp_path, capsys):
    reports = []

    def report(out):
        reports.append(len(load(out)))
        return out / "report.html"

    options = ["--sets", "16", "--workers", "1", "--seed", "7", "--out", str(tmp_path / "out")]
    assert cli.main(STUDY, options, report) == 0
    said = capsys.readouterr()
    assert re.fullmatch(r"4 chunks made in [\d.]+ s: .*out\nreport: .*report.html\n", said.out)
    assert said.err == ""
    assert set(load(tmp_path / "out")["seed"]) == {7}
    assert cli.main(STUDY, options, report) == 1
    assert capsys.readouterr().err.startswith("python -m studies toy: ")
    assert cli.main(STUDY, [*options, "--report-only"], report) == 0
    assert cli.main(STUDY, [*options, "--resume"], report) == 0
    assert reports == [96, 96, 96]


def test_a_failed_task_shows_its_traceback_and_one_line(tmp_path, capsys):
    study = replace(STUDY, scenarios=[Toy("bad", act="fail")])
    assert cli.main(study, ["--workers", "1", "--out", str(tmp_path)]) == 1
    *details, last = capsys.readouterr().err.splitlines()
    assert "Traceback" in details[0]
    assert last.startswith("python -m studies toy: scenario 'bad', chunk 0 (8 sets, seed 5, spawn key (")


def test_the_example_of_the_readme_runs(tmp_path):
    readme = (CHECKOUT / "studies" / "harness" / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n(.*?)^```$", readme, re.MULTILINE | re.DOTALL)
    assert len(code.splitlines()) <= 40
    assert sum(bool(line.strip()) for line in code.splitlines()) <= 30
    (tmp_path / "mine.py").write_text(code, encoding="utf-8")
    commands = re.findall(r"^    python (mine.py.*?)(?: *#.*)?$", readme, re.MULTILINE)
    assert len(commands) == 4
    for command in commands:
        if "--dask" in command:
            continue  # test_cluster has a cluster
        done = python(*command.split(), cwd=tmp_path)
        assert (done.returncode, done.stderr) == (0, ""), command
    found = aggregate(tmp_path / "results" / "mine", ["scenario", "method"], "error")
    assert list(found["count"]) == [5000] * 4
    ratio = (found.loc[("large", "median"), "std"] / found.loc[("large", "mean"), "std"]) ** 2
    assert ratio == pytest.approx(math.pi / 2, abs=0.1), "what theory says of many normal samples"
