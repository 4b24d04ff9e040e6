"""Make the virtual environment that environment.lock describes, unless it stands already.

Usage: python .ci/environment.py DIRECTORY

The Makefile runs this before every target that needs the environment. It uses the standard library alone,
and the Python that runs it is the Python of the environment.
"""

import hashlib
import importlib.util
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "environment.lock"


def digest(*parts: object) -> str:
    """Return a hash that changes when any of the parts does."""
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()


def keys(directory: Path) -> tuple[str, str]:
    """Return two hashes: of what the locked packages depend on, and of what the project's build does."""
    packages = digest(LOCK.read_text(), sys.version, sys.base_prefix, directory)
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return packages, digest(packages, pyproject["build-system"], pyproject["project"], pyproject["tool"]["hatch"])


def read(stamp: Path) -> str | None:
    """Return what a stamp says, or None where there is none."""
    return stamp.read_text() if stamp.exists() else None


def install(directory: Path, *arguments: str) -> None:
    """Run pip in the environment; it prints errors only."""
    python = str(directory / "bin" / "python")
    subprocess.run([python, "-m", "pip", "-qq", "--no-input", "install", *arguments], check=True, cwd=ROOT)


def make(directory: Path) -> None:
    """Bring the environment up to date; what is up to date already is left alone."""
    packages, project = keys(directory)
    packages_stamp, project_stamp = directory / "packages.stamp", directory / "project.stamp"
    if read(project_stamp) == project:
        return
    # A stamp is removed first and written last: an interrupted run is never taken for a finished one.
    project_stamp.unlink(missing_ok=True)
    if read(packages_stamp) != packages:
        if importlib.util.find_spec("ensurepip") is None:
            sys.exit(f"{sys.executable} lacks ensurepip: install its venv package, or set PYTHON to another")
        print(f"Making {directory.name} with Python {sys.version.split()[0]} ...", flush=True)
        packages_stamp.unlink(missing_ok=True)
        venv.EnvBuilder(clear=True, symlinks=True, with_pip=True).create(directory)
        install(directory, "--require-hashes", "--only-binary", ":all:", "-r", str(LOCK))
        packages_stamp.write_text(packages)
    install(directory, "--no-deps", "--no-build-isolation", "--editable", ".")
    project_stamp.write_text(project)


if __name__ == "__main__":
    try:
        make(ROOT / sys.argv[1])
    except subprocess.CalledProcessError as error:
        sys.exit(f"The environment was not made: pip ended with exit status {error.returncode}.")
