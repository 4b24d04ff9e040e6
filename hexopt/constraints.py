r"""Convex constraints on named parameters: boxes, balls, linear equations and inequalities."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from .arrays import Array, frozen
from .errors import InputError
from .geometry import Leg
from .named import NamedArrays, chosen_blocks, named_points, per_name, rows_of, sized
from .parameters import Parameters

__all__ = ["Ball", "BallRows", "Box", "Constraint", "IntervalRows", "Linear"]


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


def _bound(name: str, value: Any, missing: float) -> Array:
    """One side of a bound as an array in which infinities are allowed and NaN is not."""
    raw = np.asarray(missing if value is None else value)
    if raw.dtype.kind not in "iuf":
        raise InputError(f"{name}: expected numbers, infinities or None, got {value!r}")
    array = raw.astype(float)
    if np.isnan(array).any():
        raise InputError(f"{name}: a bound is NaN; write None or an infinity where there is none")
    return frozen(array.copy())


def _pair(kind: str, name: str, value: Any, what: str) -> tuple[Any, Any]:
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise InputError(f"{kind}: {name} needs a pair {what}, got {value!r}")
    return value[0], value[1]


def _check_order(name: str, lower: Array, upper: Array) -> None:
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


@dataclass(frozen=True, eq=False, repr=False)
class Box(NamedArrays, Constraint):
    r"""Bounds: :math:`l \le x \le h` on the entries of named parameters.

    Parameters
    ----------
    bounds : dict of str to (lower, upper)
        By parameter name, each side (..., size), a number for all entries, or None for no bound.
    unit : str, optional
        The length unit of the values, checked against the problem.
    if_present : bool, default False
        Whether names that a problem does not have are left out instead of being an error.
    name : str, default "box"
        Of the multipliers in ``Estimate.duals``.

    Raises
    ------
    InputError
        If a lower bound is above its upper bound.

    Examples
    --------
    >>> import hexopt as hx
    >>> Box.around(hx.robots.left_hand().leg(3), 0.5).bounds["base_point"][0]
    array([12.26,  3.4 , -0.5 ])
    """

    bounds: Mapping[str, tuple[Array, Array]]
    unit: str | None = None
    if_present: bool = False
    name: str = "box"

    def __post_init__(self) -> None:
        pairs = {}
        for name, value in per_name("Box", "bounds", self.bounds).items():
            low, high = _pair("Box", name, value, "(lower, upper)")
            lower, upper = _bound(name, low, -np.inf), _bound(name, high, np.inf)
            _check_order(f"Box of {name}", lower, upper)
            pairs[name] = (lower, upper)
        object.__setattr__(self, "bounds", pairs)

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], radius: npt.ArrayLike | Mapping[str, Any]) -> Box:
        """The two points of a leg, or of several, within `radius` in every entry (a number, or by name)."""
        points, unit = named_points(cls.__name__, leg, radius)
        return cls({name: (c - r, c + r) for name, (c, r) in points.items()}, unit=unit, if_present=True)

    def rows(self, parameters: Parameters) -> list[IntervalRows | BallRows]:
        """One part: the named entries between their bounds."""
        blocks = chosen_blocks("Box", self.bounds, parameters, if_present=self.if_present, length_unit=self.unit)
        sides = []
        for side in (0, 1):
            parts = []
            for block in blocks:
                value = self.bounds[block.name][side]
                wide = value if value.ndim == 0 and block.size > 1 else sized(block.name, value, block)
                parts.append(np.broadcast_to(wide, (*wide.shape[:-1], block.size)))
            shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
            sides.append(np.concatenate([np.broadcast_to(p, (*shape, p.shape[-1])) for p in parts], axis=-1))
        matrix = np.concatenate([rows_of(parameters, block.name) for block in blocks])
        return [IntervalRows(self.name, matrix, sides[0], sides[1], is_box=True)]

    def centre(self, parameters: Parameters) -> Array:
        """The middle of the box where both bounds are finite."""
        (part,) = self.rows(parameters)
        assert isinstance(part, IntervalRows)
        with np.errstate(invalid="ignore"):
            middle = 0.5 * (part.lower + part.upper)
        out = np.full((*middle.shape[:-1], parameters.size), np.nan)
        out[..., np.argmax(part.matrix, axis=-1)] = np.where(np.isfinite(middle), middle, np.nan)
        return out


@dataclass(frozen=True, eq=False, repr=False)
class Ball(NamedArrays, Constraint):
    r"""Named points within a radius of their nominal: :math:`\lVert x - c\rVert \le r`.

    Parameters
    ----------
    balls : dict of str to (centre, radius)
        By parameter name: centre (..., size), radius (...) > 0.
    unit, if_present
        As in :class:`Box`.
    name : str, default "ball"
        Its multipliers are ``duals["ball.base_point"]`` and so on.

    Examples
    --------
    >>> import hexopt as hx
    >>> float(Ball.around(hx.robots.left_hand().leg(3), 0.5).balls["base_point"][1])
    0.5
    """

    balls: Mapping[str, tuple[Array, Array]]
    unit: str | None = None
    if_present: bool = False
    name: str = "ball"

    def __post_init__(self) -> None:
        pairs = {}
        for name, value in per_name("Ball", "balls", self.balls).items():
            point, size = _pair("Ball", name, value, "(centre, radius)")
            centre, radius = _bound(name, point, np.nan), _bound(f"radius of {name}", size, np.nan)
            if not np.isfinite(centre).all() or not (np.isfinite(radius) & (radius > 0)).all():
                raise InputError(f"Ball of {name}: expected a finite centre and a radius > 0, got radius {size!r}")
            pairs[name] = (centre, radius)
        object.__setattr__(self, "balls", pairs)

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], radius: npt.ArrayLike | Mapping[str, Any]) -> Ball:
        """The two points of a leg, or of several, within `radius` (a number, or by name)."""
        points, unit = named_points(cls.__name__, leg, radius)
        return cls(points, unit=unit, if_present=True)

    def rows(self, parameters: Parameters) -> list[IntervalRows | BallRows]:
        """One ball a named block."""
        blocks = chosen_blocks("Ball", self.balls, parameters, if_present=self.if_present, length_unit=self.unit)
        return [
            BallRows(
                f"{self.name}.{block.name}",
                rows_of(parameters, block.name),
                sized(block.name, self.balls[block.name][0], block),
                self.balls[block.name][1],
            )
            for block in blocks
        ]

    def centre(self, parameters: Parameters) -> Array:
        """The centres."""
        parts = [part for part in self.rows(parameters) if isinstance(part, BallRows)]
        shape = np.broadcast_shapes(*(part.centre.shape[:-1] for part in parts))
        out = np.full((*shape, parameters.size), np.nan)
        for part in parts:
            out[..., np.argmax(part.matrix, axis=-1)] = part.centre
        return out


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
            array = np.atleast_1d(_bound(f"coefficients of {name}", value, np.nan))
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
            np.atleast_1d(_bound(f"Linear: {side}", value, missing))
            for side, value, missing in (("lower", low, -np.inf), ("upper", high, np.inf))
        )
        _check_order("Linear", lower, upper)
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
