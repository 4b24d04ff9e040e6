"""The answer: what a set of poses sees of the parameters, in numbers and in words."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Array, BoolArray, frozen
from ..parameters import Parameters
from .indices import observability_indices

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Direction", "Observability"]

#: How many directions and poses a summary shows.
SHOWN = 3


@dataclass(frozen=True)
class Direction:
    """A combination of parameters, and how far along it an estimate strays.

    Attributes
    ----------
    words : str
        The changes of the parameters against each other, the largest 1: "base_point.z − 0.4·offset".
    error : float
        Predicted standard error of the parameter with the largest change, by this direction alone.
    unit : str
        Its unit.
    """

    words: str
    error: float
    unit: str


@dataclass(frozen=True, eq=False)
class Observability:
    r"""What :func:`~hexopt.observability` finds; k parameters are of interest, of q unknown coordinates.

    Attributes
    ----------
    title : str
        What the rows come from.
    parameters : Parameters
        The blocks of interest.
    spread : ndarray, shape (k,)
        Their expected spread, the unit of their coordinates.
    covariance : ndarray, shape (k, k)
        Predicted, in the parameters' units; infinite on the diagonal, and NaN beside it, for those not determined.
    singular_values : ndarray, shape (q,)
        Of the whitened rows by all unknowns, in descending order; 0 for what is not seen.
    main_singular_values : ndarray, shape (k,)
        With nuisances eliminated: :math:`\sigma_j`, the inverse standard errors along `directions`.
    directions : ndarray, shape (k, k)
        By rows, orthonormal in units of the spread: one for each of the `main_singular_values`.
    condition_raw : float
        Condition number of the equations' matrix as it is: not whitened, not scaled, a unit vector counting three.
    leverage : ndarray, shape (n,)
        :math:`\operatorname{tr} M^{-1}M_i`: the share of every pose in the information. It sums to `rank`, less what
        is known of shared errors beforehand.
    rank : int
        How many of the q coordinates are seen.
    unseen : tuple of str
        What may change by any amount, and the equations still hold; in words.
    weak : tuple of Direction
        What is seen, the worst first.
    limits : ndarray, shape (k,)
        Standard errors beyond which a parameter is as good as not seen: the spread where that was given, or else a
        tenth of the robot's size.
    caveat : str
        Why the rows are not whitened, and the standard errors not to be taken as such; empty if they are.
    per : str
        What the leverage is of: every "pose", or every "difference" of poses.
    """

    title: str
    parameters: Parameters
    spread: Array
    covariance: Array
    singular_values: Array
    main_singular_values: Array
    directions: Array
    condition_raw: float
    leverage: Array
    rank: int
    unseen: tuple[str, ...]
    weak: tuple[Direction, ...]
    limits: Array
    caveat: str
    per: str = "pose"

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, frozen(value))

    @property
    def labels(self) -> tuple[str, ...]:
        """Of the k parameters of interest."""
        return self.parameters.labels

    @property
    def units(self) -> tuple[str, ...]:
        """Of the k parameters of interest."""
        return tuple(block.unit for block in self.parameters for _ in range(block.size))

    @property
    def n_poses(self) -> int:
        """Poses, or differences of poses: the N of O1."""
        return len(self.leverage)

    @property
    def condition(self) -> float:
        """Condition number of the whitened rows by all unknowns; it depends on how these are scaled."""
        return _ratio(self.singular_values)

    @property
    def main_condition(self) -> float:
        """Condition number with nuisances eliminated, of parameters in units of their spread."""
        return _ratio(self.main_singular_values)

    @property
    def indices(self) -> dict[str, float]:
        """O1…O5, of the `main_singular_values`."""
        values = observability_indices(self.main_singular_values, self.n_poses)
        return {f"O{number}": float(value) for number, value in enumerate(values, start=1)}

    @property
    def standard_errors(self) -> Array:
        """Predicted, of every parameter of interest, (k,); infinite where it is not determined."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def determined(self) -> BoolArray:
        """Which parameters of interest are determined, (k,)."""
        return np.isfinite(self.standard_errors)

    @property
    def correlation(self) -> Array:
        """Of the predicted errors, (k, k); NaN for parameters that are not determined."""
        errors = np.where(self.determined, self.standard_errors, np.nan)
        return self.covariance / errors[:, None] / errors

    @property
    def block_errors(self) -> dict[str, float]:
        """Root mean square of the predicted error of every block, in its unit: the root of its covariance's trace."""
        squares = self.parameters.split(np.diag(self.covariance))
        return {name: float(np.sqrt(part.sum())) for name, part in squares.items()}

    @property
    def doubtful(self) -> tuple[str, ...]:
        """Parameters that are determined, but worse than their limit: not seen in practice."""
        bad = self.determined & (self.standard_errors > self.limits)
        return tuple(label for label, is_bad in zip(self.labels, bad, strict=True) if is_bad)

    def summary(self) -> str:
        """A readable report: what is seen, how well, and what is not."""
        see = f"{self.per}s see" if self.n_poses > 1 else f"{self.per} sees"
        head = f"{self.title}: {self.n_poses} {see} {self.rank} of {len(self.singular_values)} unknowns"
        lines = [head, *([f"  {self.caveat}"] if self.caveat else [])]
        lines += [f"  not seen: {words}" for words in self.unseen]
        for label, error, unit in zip(self.labels, self.standard_errors, self.units, strict=True):
            text = f"± {error:.4g} {unit}" if np.isfinite(error) else "not determined"
            lines.append(f"  {label:<24s} {text}" + "  (not seen in practice)" * (label in self.doubtful))
        units = {block.name: block.unit for block in self.parameters if block.size > 1}
        lines += [f"  {name:<24s} ± {self.block_errors[name]:.4g} {unit} in all" for name, unit in units.items()]
        lines.append("  ± is the predicted standard error")
        if self.weak:
            lines.append("  worst seen:")
            lines += [f"    ± {one.error:.4g} {one.unit} along {one.words}" for one in self.weak[:SHOWN]]
        lines.append(
            f"  condition numbers: {self.condition_raw:.4g} raw, {self.condition:.4g} whitened and scaled, "
            f"{self.main_condition:.4g} without nuisance"
        )
        lines.append("  " + ", ".join(f"{name} {value:.4g}" for name, value in self.indices.items()))
        order = np.argsort(-self.leverage, kind="stable")[:SHOWN]
        shares = ", ".join(f"{self.leverage[i]:.3g} ({self.per} {i})" for i in order)
        lines.append(f"  largest leverage: {shares}; mean {self.leverage.mean():.3g}")
        return "\n".join(lines)

    def to_frame(self) -> pd.DataFrame:
        """A table: one row a parameter of interest, with its standard error, its spread and its limit."""
        import pandas as pd

        return pd.DataFrame(
            {
                "parameter": self.labels,
                "unit": self.units,
                "standard_error": self.standard_errors,
                "spread": self.spread,
                "limit": self.limits,
                "determined": self.determined,
            }
        )


def _ratio(values: Array) -> float:
    """The largest singular value over the smallest."""
    return float(values[0] / values[-1]) if values[-1] > 0 else np.inf
