"""What a prior is: losses of rows that it adds to a problem, and where it alone is least."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..arrays import Array
from ..losses import Loss
from ..named import chosen_blocks, sized
from ..parameters import Parameters

__all__ = ["Prior", "PriorRows", "named_centre"]


@dataclass(frozen=True, eq=False)
class PriorRows:
    """A loss of the rows C x − d, in blocks of `size` rows.

    Parameters
    ----------
    loss : Loss
    matrix : ndarray, shape (..., q, p)
    rhs : ndarray, shape (..., q)
    size : int, default 1
    """

    loss: Loss
    matrix: Array
    rhs: Array
    size: int = 1


class Prior(ABC):
    """What is known of some parameters before the measurements: write `rows` to make your own."""

    #: Whether x + prior is normally distributed, so that the estimate has a posterior covariance.
    gaussian: ClassVar[bool] = False

    @abstractmethod
    def rows(self, parameters: Parameters) -> list[PriorRows]:
        """The losses that the prior adds to a problem of these parameters."""

    @abstractmethod
    def centre(self, parameters: Parameters) -> Array:
        """Where the prior alone is least, shape (..., p); NaN for parameters that it does not speak of."""


def named_centre(kind: Any, values: Mapping[str, Array], parameters: Parameters) -> Array:
    """The named values in their places, NaN elsewhere."""
    blocks = chosen_blocks(type(kind).__name__, values, parameters, if_present=kind.if_present, length_unit=kind.unit)
    parts = {block.name: sized(block.name, values[block.name], block) for block in blocks}
    out = np.full((*np.broadcast_shapes(*(part.shape[:-1] for part in parts.values())), parameters.size), np.nan)
    for name, part in parts.items():
        out[..., parameters[name]] = part
    return out
