"""Which code made the rows: the versions and sources that a manifest names, and Dask workers must share."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import importlib.util
import inspect
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any


@functools.cache
def versions(packages: tuple[str, ...]) -> Mapping[str, str]:
    """What the rows' bits depend on, as this process found it first: what it has imported does not change.

    Of the `packages` it is the source as well: that of a checkout changes without its version.
    """
    found = {"python": "{}.{}".format(*sys.version_info)}
    for package in (*packages, "numpy", "scipy"):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "absent"
    return MappingProxyType(found | {f"{package} source": _package_digest(package) for package in packages})


def source_of(run: Callable[..., Any]) -> str:
    """A hash of the file that defines `run`."""
    try:
        file = inspect.getsourcefile(run)
    except TypeError:
        file = None
    return _digest([Path(file)]) if file and Path(file).is_file() else "unknown"


def _package_digest(name: str) -> str:
    """A hash of a package's files, which are not imported for it."""
    spec = importlib.util.find_spec(name)
    if spec is None or not spec.submodule_search_locations:
        return "absent"
    root = Path(spec.submodule_search_locations[0])
    return _digest(sorted(file for file in root.rglob("*") if file.is_file() and file.suffix != ".pyc"), root)


def _digest(files: list[Path], root: Path | None = None) -> str:
    sha = hashlib.sha256()
    for file in files:
        name = file.relative_to(root).as_posix() if root else file.name
        sha.update(f"{name}\0{file.stat().st_size}\0".encode() + file.read_bytes())
    return sha.hexdigest()[:16]
