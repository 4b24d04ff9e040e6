"""What the contracts look at: values, errors, arrays behind an object, and the names that a repr may speak of."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ..arrays import Array
from ..result import Estimate, Estimator, estimate

__all__ = ["Names", "arrays_of", "main_errors", "main_values", "raised"]


class Names(Mapping[str, Any]):
    """What a repr may speak of: the names of the modules of the estimator and its settings, of hexopt, and of NumPy."""

    def __init__(self, estimator: Any) -> None:
        parts = [estimator, *vars(estimator).values()]
        homes = dict.fromkeys(type(part).__module__ for part in parts)
        self.places = [*(sys.modules[home] for home in homes), sys.modules["hexopt"], np]

    def __getitem__(self, name: str) -> Any:
        for place in self.places:
            if hasattr(place, name):
                return getattr(place, name)
        raise KeyError(name)

    def __iter__(self) -> Iterator[str]:
        return iter(())

    def __len__(self) -> int:
        return 0


def main_values(found: Estimate) -> dict[str, Array]:
    """The values that are no nuisance, by the leg's own names: the suite measures one leg."""
    return {name.rpartition(".")[2]: found.params[name] for name in found.parameters.main.names}


def main_errors(found: Estimate) -> dict[str, float]:
    """The largest standard error of each of them."""
    names = {name.rpartition(".")[2]: name for name in found.parameters.main.names}
    squares = {name: np.diagonal(found.covariance_of(full), axis1=-2, axis2=-1) for name, full in names.items()}
    return {name: float(np.sqrt(square).max()) for name, square in squares.items()}


def raised(
    kind: type[Exception],
    target: Any,
    estimator: Estimator,
    throw: bool | None = None,
    factory: Callable[[Any], Any] = lambda target: target,
) -> Exception | None:
    """The error of some kind that an estimation (or the making of its target) raises, or None."""
    try:
        estimate(factory(target), estimator, throw)
    except kind as error:
        return error
    return None


def arrays_of(thing: Any, path: str = "", seen: set[int] | None = None) -> Iterator[tuple[str, Array]]:
    """All arrays behind an object's attributes, dictionaries and sequences, with their paths."""
    seen = set() if seen is None else seen
    if isinstance(thing, np.ndarray):
        yield path, thing
        return
    if id(thing) in seen:
        return
    seen.add(id(thing))
    parts: Mapping[Any, Any] = thing if isinstance(thing, Mapping) else getattr(thing, "__dict__", {})
    if isinstance(thing, (list, tuple)):
        parts = dict(enumerate(thing))
    for name, part in list(parts.items()):
        yield from arrays_of(part, f"{path}.{name}".removeprefix("."), seen)
