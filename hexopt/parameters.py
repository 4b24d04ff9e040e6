"""Named blocks of unknowns: the names that priors, bounds, summaries and errors speak."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .arrays import Array
from .errors import InputError

__all__ = ["Block", "Parameters"]

_AXES = "xyz"


@dataclass(frozen=True)
class Block:
    """One named group of parameters.

    Parameters
    ----------
    name : str
        For example "platform_point", or "leg3.base_point" where several legs are joined.
    size : int
        1 or 3 as a rule; the entries of a block of three are called x, y, z.
    unit : str
        For summaries.
    scale : float, default 1
        A typical size of the entries' uncertainty, used to scale condition numbers.
    nuisance : bool, default False
        Estimated on the way, of no interest in itself.
    """

    name: str
    size: int
    unit: str
    scale: float = 1.0
    nuisance: bool = False

    @property
    def labels(self) -> tuple[str, ...]:
        """One label an entry: "base_point.x", …; the bare name for a scalar."""
        if self.size == 1:
            return (self.name,)
        entries = _AXES if self.size == 3 else [str(i + 1) for i in range(self.size)]
        return tuple(f"{self.name}.{entry}" for entry in entries)


@dataclass(frozen=True)
class Parameters:
    """Ordered blocks; where each stands in a vector of values.

    Examples
    --------
    >>> parameters = Parameters((Block("platform_point", 3, "cm"), Block("offset", 1, "cm")))
    >>> parameters.size, parameters.labels[-1], parameters["offset"]
    (4, 'offset', slice(3, 4, None))
    """

    blocks: tuple[Block, ...]

    def __post_init__(self) -> None:
        names = [block.name for block in self.blocks]
        if len(set(names)) != len(names):
            raise InputError(f"parameter blocks: a name stands twice in {names}")

    def __iter__(self) -> Iterator[Block]:
        return iter(self.blocks)

    def __contains__(self, name: object) -> bool:
        return name in self._slices

    def __getitem__(self, name: str) -> slice:
        """Where the block `name` stands; an unknown name is an error that lists the known ones."""
        if name not in self._slices:
            raise InputError(f"unknown parameter {name!r}; this problem has {', '.join(self.names)}")
        return self._slices[name]

    @cached_property
    def _slices(self) -> dict[str, slice]:
        ends = np.cumsum([block.size for block in self.blocks]).tolist()
        return {block.name: slice(end - block.size, end) for block, end in zip(self.blocks, ends, strict=True)}

    @property
    def names(self) -> tuple[str, ...]:
        """The blocks' names in order."""
        return tuple(block.name for block in self.blocks)

    @cached_property
    def size(self) -> int:
        """Number of scalars."""
        return sum(block.size for block in self.blocks)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """A label for every scalar."""
        return tuple(label for block in self.blocks for label in block.labels)

    @cached_property
    def scale(self) -> Array:
        """The scale of every scalar, shape (p,)."""
        return np.concatenate([np.full(block.size, block.scale) for block in self.blocks])

    @property
    def main(self) -> Parameters:
        """The blocks that are no nuisance."""
        return Parameters(tuple(block for block in self.blocks if not block.nuisance))

    def split(self, values: Array) -> dict[str, Array]:
        """Views of `values` (..., p) by block name, each (..., size)."""
        return {name: values[..., where] for name, where in self._slices.items()}

    def combination(self, vector: Sequence[float] | Array, threshold: float = 0.05) -> str:
        """A linear combination in words, such as "0.71·base_point.x − 0.71·offset"."""
        weights = np.asarray(vector, dtype=float)
        weights = weights / np.abs(weights).max()
        order = [i for i in range(len(weights)) if weights[i] != 0 and abs(weights[i]) >= threshold]
        if order and weights[order[0]] < 0:
            weights = -weights
        text = ""
        for i in order:
            sign = "−" if weights[i] < 0 else "+"
            size = f"{abs(weights[i]):.2g}"
            factor = "" if size == "1" else f"{size}·"
            text += f" {sign} {factor}{self.labels[i]}"
        return text.removeprefix(" + ").strip()
