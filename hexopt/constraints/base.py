"""What a constraint is: rows between bounds, and rows inside balls; the checks of what it is made of."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, frozen
from ..errors import InputError
from ..parameters import Parameters

__all__ = ["BallRows", "Constraint", "IntervalRows", "bound_array", "check_order", "checked_pair"]


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """lower ≤ C x ≤ upper: matrix (..., q, p), bounds (..., q), infinite where there is none.

    `is_box` says that every row picks one entry of x.
    """

    name: str
    matrix: Array
    lower: Array
    upper: Array
    is_box: bool = False


@dataclass(frozen=True, eq=False)
class BallRows:
    """‖C x − c‖ ≤ r: matrix (..., q, p), centre (..., q), radius (...)."""

    name: str
    matrix: Array
    centre: Array
    radius: Array


class Constraint(ABC):
    """A convex set of parameters: write `rows` to make your own.

    The name of each part is that of its multipliers in ``Estimate.duals``: positive where the upper bound holds
    the estimate back, negative where the lower does; of a ball, the force towards its surface.
    """

    @abstractmethod
    def rows(self, parameters: Parameters) -> list[IntervalRows | BallRows]:
        """The parts of the set, for a problem of these parameters."""

    def centre(self, parameters: Parameters) -> Array:
        """A point of the set for the parameters that it surrounds, shape (..., p); NaN for all others."""
        return np.full(parameters.size, np.nan)


def bound_array(name: str, value: Any, missing: float) -> Array:
    """One side of a bound as an array in which infinities are allowed and NaN is not."""
    raw = np.asarray(missing if value is None else value)
    if raw.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected numbers, infinities or None, got {value!r}")
    array = raw.astype(float)
    if np.isnan(array).any():
        raise InputError(f"{name}: a bound is NaN; write None or an infinity where there is none")
    return frozen(array.copy())


def checked_pair(kind: str, name: str, value: Any, what: str) -> tuple[Any, Any]:
    """The two parts of a value by name."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"{kind}: {name} needs a pair {what}, got {value!r}")
    return value[0], value[1]


def check_order(name: str, lower: Array, upper: Array) -> None:
    """No lower bound may be above its upper bound."""
    if (lower == np.inf).any() or (upper == -np.inf).any():
        raise InputError(f"{name}: a lower bound of +inf, or an upper of −inf, leaves nothing; write None for no bound")
    try:
        wrong = lower > upper
    except ValueError:
        raise InputError(f"{name}: bounds of shapes {lower.shape} and {upper.shape} do not fit") from None
    if wrong.any():
        where = np.unravel_index(int(np.argmax(wrong)), wrong.shape)
        low, high = (np.broadcast_to(side, wrong.shape)[where] for side in (lower, upper))
        raise InputError(f"{name}: the lower bound {low:g} is above the upper bound {high:g}")
