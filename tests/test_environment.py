"""environment.lock must satisfy pyproject.toml and name no index; the environment must follow both."""

import importlib.util
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.markers import Marker, default_environment
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import hexopt

ROOT = Path(__file__).resolve().parents[1]
_SPEC = importlib.util.spec_from_file_location("environment", ROOT / ".ci" / "environment.py")
environment = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(environment)
LOCK = (ROOT / "environment.lock").read_text(encoding="utf-8")
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
PYTHONS = ["3.11", "3.12", "3.13"]

PIN = re.compile(r"(?P<name>[\w.-]+)==(?P<version>[\w.!+-]+)( ; (?P<marker>[^\\]+?))?( \\)?")
HASH = re.compile(r"    --hash=sha256:[0-9a-f]{64}( \\)?")


def foreign_lines(lock):
    """Return the lines that are no pin, no hash and no plain comment: options, addresses, local paths."""
    plain = re.compile(r"\s*(#(?!.*://).*)?")
    return [line for line in lock.splitlines() if not any(kind.fullmatch(line) for kind in (PIN, HASH, plain))]


def pins(lock, python):
    """Return the locked (name, version, number of hashes) that apply to a version of Python."""
    found = []
    here = {**default_environment(), "python_version": python, "python_full_version": f"{python}.0"}
    for block in re.split(r"\n(?=\w)", lock):
        pin = PIN.fullmatch(block.partition("\n")[0])
        if pin and (pin["marker"] is None or Marker(pin["marker"]).evaluate(here)):
            hashes = sum(1 for line in block.splitlines() if HASH.fullmatch(line))
            found.append((canonicalize_name(pin["name"]), pin["version"], hashes))
    return found


def requirements(pyproject):
    """Return all that the project asks for: to build, to run, and for each extra."""
    data = tomllib.loads(pyproject)
    lists = [data["build-system"]["requires"], data["project"]["dependencies"]]
    lists.extend(data["project"]["optional-dependencies"].values())
    return [Requirement(line) for lines in lists for line in lines]


def unsatisfied(pyproject, lock, python):
    """Return the requirements that the lock does not meet, each with the reason."""
    locked = pins(lock, python)
    problems = [f"{name} has no hash" for name, _, hashes in locked if not hashes]
    for requirement in requirements(pyproject):
        versions = [version for name, version, _ in locked if name == canonicalize_name(requirement.name)]
        if len(versions) != 1:
            problems.append(f"{requirement} is pinned {len(versions)} times")
        elif versions[0] not in requirement.specifier:
            problems.append(f"{requirement} is pinned at {versions[0]}")
    return problems


@pytest.mark.parametrize("python", PYTHONS)
def test_lock_satisfies_pyproject(python):
    assert unsatisfied(PYPROJECT, LOCK, python) == []


def test_lock_names_no_index_and_no_host():
    assert foreign_lines(LOCK) == []


def test_every_supported_python_is_checked():
    classifiers = tomllib.loads(PYPROJECT)["project"]["classifiers"]
    assert re.findall(r"Python :: (3\.\d+)", "\n".join(classifiers)) == PYTHONS


def test_version_is_the_same_in_code_and_metadata():
    assert hexopt.__version__ == tomllib.loads(PYPROJECT)["project"]["version"]


# --- each check can fail

SMALL_PROJECT = """
[build-system]
requires = ["builder"]
[project]
dependencies = ["Big_Sum>=2.0"]
[project.optional-dependencies]
more = ["other"]
"""
DIGEST = "0" * 64
SMALL_LOCK = f"""\
# made by a test
big-sum==2.1 \\
    --hash=sha256:{DIGEST} \\
    --hash=sha256:{DIGEST}
    # via the project
builder==1.0 \\
    --hash=sha256:{DIGEST}
other==3.0 ; python_full_version >= '3.11' and sys_platform != 'none' \\
    --hash=sha256:{DIGEST}
"""


def test_a_good_lock_passes():
    assert unsatisfied(SMALL_PROJECT, SMALL_LOCK, "3.11") == []
    assert foreign_lines(SMALL_LOCK) == []


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("big-sum==2.1", "big-sum==1.9", "Big_Sum>=2.0 is pinned at 1.9"),
        ("big-sum==2.1", "sum==2.1", "Big_Sum>=2.0 is pinned 0 times"),
        ("builder==1.0", "other==3.0", "builder is pinned 0 times"),
        ("builder==1.0", "other==3.0", "other is pinned 2 times"),
        (">= '3.11'", ">= '3.12'", "other is pinned 0 times"),
        (f"builder==1.0 \\\n    --hash=sha256:{DIGEST}", "builder==1.0", "builder has no hash"),
    ],
    ids=["too-old", "missing", "missing-backend", "twice", "other-python", "no-hash"],
)
def test_a_wrong_lock_fails(old, new, problem):
    assert old in SMALL_LOCK
    assert problem in unsatisfied(SMALL_PROJECT, SMALL_LOCK.replace(old, new), "3.11")


@pytest.mark.parametrize("part", ["Big_Sum>=2.0", "builder", "other"])
def test_a_new_requirement_fails(part):
    changed = SMALL_PROJECT.replace(f'"{part}"', f'"{part}", "newcomer"')
    assert unsatisfied(changed, SMALL_LOCK, "3.11") == ["newcomer is pinned 0 times"]


@pytest.mark.parametrize(
    "line",
    [
        "--find-links wheels",
        "-i https://example.org/simple",
        "    # from https://example.org/simple",
        "other @ https://example.org/other.whl",
        "./wheels/other-3.0-py3-none-any.whl",
        "other>=3.0",
    ],
)
def test_a_foreign_line_is_found(line):
    assert foreign_lines(SMALL_LOCK + line + "\n") == [line]


# --- the environment follows the lock


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout in which nothing is really installed: the list tells what would have been."""
    (tmp_path / "environment.lock").write_text(SMALL_LOCK)
    (tmp_path / "pyproject.toml").write_text(SMALL_PROJECT + "[tool.hatch]\n")
    done = []

    def create(self, directory):
        directory.mkdir(exist_ok=True)
        done.append("environment")

    monkeypatch.setattr(environment, "ROOT", tmp_path)
    monkeypatch.setattr(environment, "LOCK", tmp_path / "environment.lock")
    monkeypatch.setattr(environment.venv.EnvBuilder, "create", create)
    monkeypatch.setattr(environment, "install", lambda directory, *arguments: done.append(arguments[-1]))
    return tmp_path, done


def test_environment_is_made_once(checkout):
    root, done = checkout
    environment.make(root / "env")
    environment.make(root / "env")
    assert done == ["environment", str(root / "environment.lock"), "."]


def test_a_changed_lock_makes_a_new_environment(checkout):
    root, done = checkout
    environment.make(root / "env")
    (root / "environment.lock").write_text(SMALL_LOCK.replace("3.0", "3.1"))
    environment.make(root / "env")
    assert done.count("environment") == 2


def test_a_changed_pyproject_installs_the_project_alone(checkout):
    root, done = checkout
    environment.make(root / "env")
    with (root / "pyproject.toml").open("a") as file:
        file.write("[tool.hatch.build]\ndev-mode-dirs = ['.']\n")
    environment.make(root / "env")
    assert done[3:] == ["."]


@pytest.mark.parametrize("last", ["environment.lock", "."])
def test_an_interrupted_installation_is_not_taken_for_a_finished_one(checkout, monkeypatch, last):
    root, done = checkout

    def interrupted(directory, *arguments):
        if arguments[-1].endswith(last):
            raise subprocess.CalledProcessError(1, "pip")

    with monkeypatch.context() as patch:
        patch.setattr(environment, "install", interrupted)
        with pytest.raises(subprocess.CalledProcessError):
            environment.make(root / "env")
    environment.make(root / "env")
    assert done[-1] == "."
    environment.make(root / "env")
    assert done.count(".") == 1


def test_a_python_without_ensurepip_is_named(checkout, monkeypatch):
    root, done = checkout
    monkeypatch.setattr(environment.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(SystemExit, match="ensurepip"):
        environment.make(root / "env")
    assert done == []
