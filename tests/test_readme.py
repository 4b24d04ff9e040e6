"""What README shows must run."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_scripts_run_one_after_the_other():
    script = "\n".join(re.findall(r"```python\n(.*?)```", README, flags=re.S))
    done = subprocess.run([sys.executable, "-W", "error", "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    paper, weighted = map(float, done.stdout.splitlines()[0].split())
    assert weighted < paper
    assert "direction.x" in done.stdout
    proven, gap = done.stdout.splitlines()[-1].split()
    assert proven == "True"
    assert float(gap) < 1e-8


def test_links_lead_somewhere():
    targets = re.findall(r"\]\((?!http)([^)#]+)\)", README)
    assert targets
    assert [target for target in targets if not (ROOT / target).exists()] == []


def test_the_raw_commands_are_those_of_the_makefile():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for command in ("-m studies paper --out", "-m pytest -n auto"):
        assert command in README
        assert command in makefile


def test_the_command_of_the_real_hexapod_exists():
    (line,) = re.findall(r"^    hexopt (calibrate .*)$", README, flags=re.M)
    environment = {**os.environ, "COLUMNS": "200"}
    command = [sys.executable, "-c", "from hexopt.cli import main; main()", "calibrate", "--help"]
    help_text = subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stdout
    assert [flag for flag in re.findall(r"--[a-z-]+", line) if flag not in help_text] == []
