"""Help that teaches, stable output, and a terminal that cannot show everything."""

import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import entry_points

import pytest

import hexopt as hx
from hexopt.cli import main
from hexopt.robots import BUILT_IN

COMMANDS = ["robots", "simulate", "select", "calibrate"]


def start(*arguments, **settings):
    code = "from hexopt.cli import main; main()"
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, **settings)


def test_the_entry_point_is_main():
    (entry,) = entry_points(group="console_scripts", name="hexopt")
    assert entry.load() is main


def test_version(done):
    assert done("--version") == f"hexopt {hx.__version__}\n"


def test_without_arguments_the_commands_are_shown(hexopt):
    answer = hexopt("")
    assert (answer.code, answer.err) == (0, "")
    assert all(f"\n  {command} " in answer.out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches(done, command):
    text = done(f"{command} --help")
    assert text == done(f"{command} -h")
    assert f"  hexopt {command}" in text
    assert max(map(len, text.splitlines())) <= 80
    assert "\x1b" not in text


def examples(text):
    lines = re.sub(r"\\\n +", "", text).splitlines()
    return [line.strip() for line in lines if line.startswith("    hexopt ")]


def test_the_examples_of_the_help_run(done):
    done("robots left-hand --toml my.toml")
    first, second = examples(done("--help"))
    done(*shlex.split(first)[1:])
    assert "wrote found.toml" in done(*shlex.split(second)[1:])
    for command in ("simulate", "select"):
        for example in examples(done(f"{command} --help")):
            done(*shlex.split(example)[1:], "--force")


def test_robots_are_listed_with_their_units(done):
    text = done("robots")
    assert [line.split()[0] for line in text.splitlines()[1:]] == list(BUILT_IN)
    assert "lengths" in text
    assert "readings" in text


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_robot_is_shown_and_written(done, name):
    text = done(f"robots {name}")
    robot = BUILT_IN[name]()
    assert text.startswith(f"{robot.name}: lengths in {robot.length_unit}, leg readings in {robot.reading_unit}")
    assert done(f"robots {name} --toml my.toml") == f"wrote my.toml: {robot.name}\n"
    assert done("robots my.toml") == text


def test_output_in_plain_ascii():
    done = start("robots", "left-hand", env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert (done.returncode, done.stderr) == (0, "")
    assert "gain ? reading" in done.stdout


def test_a_reader_that_leaves_is_no_error():
    code = "from hexopt.cli import main; main(['robots', 'left-hand'])"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdout.close()
        assert b"Traceback" not in process.stderr.read()


def test_an_error_in_a_process_of_its_own(tmp_path):
    done = start("robots", "nobody", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("hexopt: error: robot: 'nobody' is neither")
    assert len(done.stderr.splitlines()) == 1
