"""What a study is, and the random stream of each chunk of its repetitions."""

from __future__ import annotations

import dataclasses
import enum
import hashlib
import inspect
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd

Scenario = TypeVar("Scenario")


class StudyError(Exception):
    """A sweep cannot start or go on. The message is one line that says what to do."""


@dataclasses.dataclass(frozen=True)
class Study(Generic[Scenario]):
    """A Monte-Carlo comparison: scenarios × methods × repetitions.

    Parameters
    ----------
    name : str
        Names the study in its manifest.
    run : callable ``(scenario, n_sets, rng) -> pandas.DataFrame``
        Simulates and solves `n_sets` repetitions of a scenario: a tidy frame with one row for each method and
        repetition, in which the column ``repetition`` counts 0 … n_sets - 1 (it may be left out when there is
        one row for each repetition). A repetition that failed keeps its row. Must be a function at the top
        of a module, and draw all its randomness from `rng`.
    scenarios : sequence of frozen dataclasses or dicts
        Each has a `key`, a string by which results are known for ever: the random stream follows from it.
    sets : int
        Repetitions of each scenario, unless a sweep asks for another number.
    chunk_size : int
        Repetitions that are run, and written, together. It is configuration: other chunks are other streams.
    seed : int
        Root seed, unless a sweep asks for another.
    packages : tuple of str
        Packages whose versions and sources are configuration, besides NumPy, SciPy and the file of `run`.
    """

    name: str
    run: Callable[[Scenario, int, np.random.Generator], pd.DataFrame]
    scenarios: Sequence[Scenario]
    sets: int = 1000
    chunk_size: int = 100
    seed: int = 0
    packages: tuple[str, ...] = ("hexopt",)

    def __post_init__(self) -> None:
        """Refuse what could not be run in a worker, or not be found again."""
        if not inspect.isfunction(self.run) or "<" in self.run.__qualname__:
            raise StudyError(
                f"study {self.name!r}: run must be a function at the top of a module (workers import it), "
                f"not {self.run!r}"
            )
        keys = [key_of(scenario) for scenario in self.scenarios]
        if twice := {key for key in keys if keys.count(key) > 1}:
            raise StudyError(f"study {self.name!r}: scenarios share the key {sorted(twice)[0]!r}")
        for name in ("sets", "chunk_size"):
            if getattr(self, name) < 1:
                raise StudyError(f"study {self.name!r}: {name} must be at least 1")

    def keyed(self) -> dict[str, Scenario]:
        """The scenarios by their keys, in the study's order."""
        return {key_of(scenario): scenario for scenario in self.scenarios}


def key_of(scenario: object) -> str:
    """The key of a scenario: its entry or attribute ``key``."""
    key = scenario.get("key") if isinstance(scenario, Mapping) else getattr(scenario, "key", None)
    if not isinstance(key, str) or not key:
        raise StudyError(f"a scenario needs a key, a string that is its own: {scenario!r} has {key!r}")
    return key


def stream_of(key: str) -> int:
    """A 63-bit number that follows from a scenario's key alone, not from its place in the study."""
    return int.from_bytes(hashlib.blake2b(key.encode(), digest_size=8).digest(), "big") >> 1


def generator(seed: int, stream: int, chunk: int) -> np.random.Generator:
    """The random stream of one chunk: a row names all three numbers, so that it can be made again."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream, chunk)))


def chunks_of(sets: int, chunk_size: int) -> Iterator[tuple[int, int]]:
    """Number and size of the chunks of `sets` repetitions; only the last may be smaller."""
    for chunk, first in enumerate(range(0, sets, chunk_size)):
        yield chunk, min(chunk_size, sets - first)


def definition_of(scenario: object) -> dict[str, Any]:
    """A scenario as JSON data, the types of its dataclasses included."""
    try:
        plain: dict[str, Any] = _plain(scenario)
    except TypeError as error:
        raise StudyError(f"scenario {key_of(scenario)!r} cannot be written to the manifest: {error}") from None
    return plain


def _plain(value: object) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, enum.Enum):
        return f"{type(value).__qualname__}.{value.name}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {"type": type(value).__qualname__, **{name: _plain(item) for name, item in fields.items()}}
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, Sequence) and not isinstance(value, bytes):
        return [_plain(item) for item in value]
    if isinstance(value, PurePath):
        return value.as_posix()
    raise TypeError(f"{value!r} is no number, string, array, dataclass, dict or list")


def digest(value: object) -> str:
    """A short hash of JSON data."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
