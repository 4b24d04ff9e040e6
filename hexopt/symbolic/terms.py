"""What the references share: their checked arguments, and their result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, brief, frozen
from ..errors import InputError
from ..geometry import Hexapod, Leg
from ..loops.implicit import Implicit
from ..result import Estimate
from .ipopt import Optimum

__all__ = ["Fit", "Start", "Terms", "checked_start", "norm_equations", "residual_unit", "result_of"]

#: A residual is measured in no less than this share of the terms that it is the difference of.
_FLOOR = 1e-3

Start = npt.ArrayLike | Leg | Hexapod | Estimate


@dataclass(frozen=True, eq=False)
class Fit:
    """A reference solution of one problem.

    Attributes
    ----------
    values : ndarray, shape (p,)
        In the order of the model's parameters; NaN without success.
    objective : float
        NaN without success.
    success : bool
        Whether IPOPT reached a local optimum to its tight tolerance. That it is unique is not checked.
    status : str
        IPOPT's word, "Solve_Succeeded" for a success.
    multipliers : dict of str to ndarray
        "bounds" (p,), positive where the upper bound holds; one entry an equation, by name.
    iterations : int
    errors : tuple of ndarray, shape (n, e)
        The errors that the measurements of each set are given, where they are unknowns too; NaN without success.
    """

    values: Array
    objective: float
    success: bool
    status: str
    multipliers: dict[str, Array]
    iterations: int
    errors: tuple[Array, ...] = ()


@dataclass(frozen=True)
class Terms:
    """What is asked of the parameters beside the rows, checked.

    Attributes
    ----------
    lower, upper : ndarray, shape (p,)
    prior : tuple of ndarray, or None
        Mean (p,) and root (q, p).
    unit_norm : tuple of str
        Blocks that are unit vectors.
    """

    lower: Array
    upper: Array
    prior: tuple[Array, Array] | None
    unit_norm: tuple[str, ...]

    @classmethod
    def of(
        cls,
        target: Implicit,
        lower: npt.ArrayLike | None,
        upper: npt.ArrayLike | None,
        prior: tuple[npt.ArrayLike, npt.ArrayLike] | None,
        unit_norm: Sequence[str],
    ) -> Terms:
        """From the arguments of a fit."""
        p = target.parameters.size
        low, high = _limit("lower", lower, -np.inf, p), _limit("upper", upper, np.inf, p)
        if (low > high).any():
            names = [target.parameters.labels[i] for i in np.flatnonzero(low > high)]
            raise InputError(f"lower is above upper for {', '.join(names)}")
        if isinstance(unit_norm, str) or not isinstance(unit_norm, Sequence):
            raise InputError(f"unit_norm: expected names of blocks such as ['direction'], got {unit_norm!r}")
        for name in unit_norm:
            target.parameters[name]  # an unknown name is an error
        if prior is not None:
            if not isinstance(prior, (tuple, list)) or len(prior) != 2:
                raise InputError(f"prior: expected a pair of mean and root, got {brief(prior)}")
            mean, root = prior
            prior = as_array("prior mean", mean, (p,), batch=False), as_array("prior root", root, ("q", p), batch=False)
        return cls(low, high, prior, tuple(unit_norm))

    def prior_rows(self, x: ca.SX) -> ca.SX:
        """root (x − mean), or no rows."""
        return ca.SX(0, 1) if self.prior is None else ca.DM(self.prior[1]) @ (x - ca.DM(self.prior[0]))


def checked_start(target: Implicit, start: Start | None) -> Array:
    """The values (p,) to start from."""
    if not isinstance(target, Implicit):
        raise InputError(f"expected a loop, Sets, WholeRobot or PlatformPose, got {type(target).__name__}")
    if target.batch_shape:
        raise InputError(f"expected one problem, got a batch of {target.batch_shape}; take one set: data[i]")
    if start is not None and not isinstance(start, (Leg, Hexapod, Estimate)):
        start = as_array("start", start, ("p",), batch=False)
    values = target.start() if start is None else target.values(start)
    return as_array("start", values, (target.parameters.size,), batch=False)


def norm_equations(target: Implicit, x: ca.SX, names: Sequence[str]) -> dict[str, ca.SX]:
    """‖block‖² − 1 by name."""
    return {name: ca.sumsqr(x[target.parameters[name]]) - 1.0 for name in names}


def residual_unit(residual: Array, jacobian: Array, values: Array) -> float:
    """The size of residuals, for a solver's tolerances: large enough that rounding stays far below."""
    terms = np.abs(jacobian) @ np.abs(values)
    return float(max(np.sqrt(np.mean(residual**2)), _FLOOR * np.sqrt(np.mean(terms**2))))


def _limit(name: str, value: npt.ArrayLike | None, none: float, size: int) -> Array:
    if value is None:
        return np.full(size, none)
    try:
        limit = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        limit = np.full(0, none)
    if limit.shape != (size,) or np.isnan(limit).any() or (limit == -none).any():
        raise InputError(f"{name}: expected {size} values ({none} where there is no bound), got {brief(value)}")
    return limit


def result_of(found: Optimum, size: int, iterations: int, errors: tuple[Array, ...] = ()) -> Fit:
    """The answer of a programme whose first variables are the values; NaN without success."""
    multipliers = {"bounds": found.bounds[:size], **found.multipliers}
    return Fit(
        frozen(found.values[:size] if found.success else np.full(size, np.nan)),
        found.objective if found.success else float("nan"),
        found.success,
        found.status,
        {name: frozen(force) for name, force in multipliers.items()},
        iterations,
        tuple(frozen(part) for part in errors),
    )
