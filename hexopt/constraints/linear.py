"""Linear inequalities and equations in named parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import Array, frozen
from ..errors import InputError
from ..named import NamedArrays, chosen_blocks, per_name
from ..parameters import Parameters
from .base import BallRows, Constraint, IntervalRows, bound_array, check_order

__all__ = ["Linear"]


@dataclass(frozen=True, eq=False, repr=False)
class Linear(NamedArrays, Constraint):
    r"""Linear inequalities or equations: :math:`l \le \sum_k C_k x_k \le h`.

    Parameters
    ----------
    coefficients : dict of str to array_like
        :math:`C_k` by parameter name, shape (q, size) or (size,) for one row.
    lower, upper : array_like, shape (..., q), optional
        None where there is no such bound.
    equal : array_like, shape (..., q), optional
        Both bounds at once, for fixed or tied parameters.
    name : str, default "linear"
        Of the multipliers in ``Estimate.duals``.

    Examples
    --------
    Two base joints at the same height, within 0.01:

    >>> flat = Linear({"leg1.base_point": [0, 0, 1], "leg2.base_point": [0, 0, -1]}, lower=-0.01, upper=0.01)
    >>> flat.lower
    array([-0.01])
    """

    coefficients: Mapping[str, Array]
    lower: Array = None  # type: ignore[assignment]  # made an array below
    upper: Array = None  # type: ignore[assignment]  # made an array below
    equal: npt.ArrayLike | None = None
    name: str = "linear"

    unit: ClassVar[None] = None

    def __post_init__(self) -> None:
        parts = {}
        for name, value in per_name("Linear", "coefficients", self.coefficients).items():
            array = np.atleast_1d(bound_array(f"coefficients of {name}", value, np.nan))
            if array.ndim > 2 or not np.isfinite(array).all():
                raise InputError(f"coefficients of {name}: expected finite numbers of shape (q, size), got {value!r}")
            parts[name] = frozen(np.atleast_2d(array))
        counts = {array.shape[0] for array in parts.values()}
        if len(counts) > 1:
            raise InputError(f"Linear: coefficients of {sorted(counts)} rows do not fit together")
        if self.equal is not None and (self.lower is not None or self.upper is not None):
            raise InputError("Linear: give equal, or lower and upper, not both")
        if self.equal is None and self.lower is None and self.upper is None:
            raise InputError("Linear: give lower, upper or equal")
        low, high = (self.lower, self.upper) if self.equal is None else (self.equal, self.equal)
        lower, upper = (
            np.atleast_1d(bound_array(f"Linear: {side}", value, missing))
            for side, value, missing in (("lower", low, -np.inf), ("upper", high, np.inf))
        )
        check_order("Linear", lower, upper)
        object.__setattr__(self, "coefficients", parts)
        object.__setattr__(self, "lower", frozen(lower))
        object.__setattr__(self, "upper", frozen(upper))
        object.__setattr__(self, "equal", None)  # held by both bounds

    def rows(self, parameters: Parameters) -> list[IntervalRows | BallRows]:
        """One part of q rows."""
        blocks = chosen_blocks("Linear", self.coefficients, parameters, if_present=False, length_unit=None)
        count = len(next(iter(self.coefficients.values())))
        matrix = np.zeros((count, parameters.size))
        for block in blocks:
            part = self.coefficients[block.name]
            if part.shape[-1] != block.size:
                raise InputError(
                    f"coefficients of {block.name}: expected {block.size} ({', '.join(block.labels)}), "
                    f"got shape {part.shape}"
                )
            matrix[:, parameters[block.name]] = part
        sides = []
        for side in (self.lower, self.upper):
            if side.shape[-1] not in (1, count):
                raise InputError(f"Linear: {count} rows of coefficients, but bounds of shape {side.shape}")
            sides.append(np.broadcast_to(side, (*side.shape[:-1], count)))
        return [IntervalRows(self.name, matrix, sides[0], sides[1])]
