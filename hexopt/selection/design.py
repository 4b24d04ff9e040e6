"""The answer: the poses to measure, what they promise, and how far from the best they can be."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, norm
from ..geometry import LENGTH_UNITS
from ..measurements import LegMeasurements, Measurements
from .question import Question

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Design"]


@dataclass(frozen=True, eq=False)
class Design:
    r"""A choice of poses.

    Attributes
    ----------
    indices : ndarray of int, shape (N,)
        Which candidates, in ascending order; one that is measured twice stands twice.
    poses : LegMeasurements or Measurements
        These poses, with the readings that the candidates have; one a set where the loop has several, and None for
        a linear problem or bare information.
    criterion : str
    value : float
        The criterion of the design (with what was measured before).
    bound : float
        No design of this many of these candidates has a lower value: proven. NaN where nothing is.
    weights : ndarray, shape (n,)
        Of the relaxation, in which poses may be measured in part; NaN without one.
    relaxed : float
        The criterion of these weights.
    covariance : ndarray, shape (k, k)
        Predicted, of what is of interest, in its units; of several scenarios the mean, under ``worst=True`` that of the
        worst.
    labels, units : tuple of str
        Of the k scalars.
    efficiency : float
        How much of the best possible is reached, at least: the bound over the value, as variances.
    proven : bool
        Whether this is the best design, proven.
    stopped : str
        What ended the search.
    question : Question
        What was asked, so that it can be asked again of other poses.
    """

    indices: npt.NDArray[np.intp]
    poses: Any
    criterion: str
    value: float
    bound: float
    weights: Array
    relaxed: float
    covariance: Array
    labels: tuple[str, ...]
    units: tuple[str, ...]
    efficiency: float
    proven: bool
    stopped: str
    question: Question

    @property
    def gap(self) -> float:
        """How far the value can be from the best: value minus bound."""
        return self.value - self.bound

    @property
    def standard_errors(self) -> Array:
        """Predicted, of every scalar of interest, shape (k,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def doubtful(self) -> BoolArray:
        """What is not seen in practice, (k,): lengths whose ± exceeds a tenth of how far the candidates are out."""
        far = [float(norm(data.position).max()) for data in self.question.sets()]
        lengths = np.array([unit in LENGTH_UNITS for unit in self.units])
        return lengths & (self.standard_errors > 0.1 * max(far, default=np.inf))

    def summary(self) -> str:
        """A readable report: what is promised, of what, and what is proven."""
        sure = "nothing is proven of it" if np.isnan(self.bound) else f"bound {self.bound:.6g}, gap {self.gap:.2g}"
        lines = [
            f"{len(self.indices)} of {len(self.weights)} candidates, {self.criterion}: {self.value:.6g} ({sure})",
            f"  efficiency at least {self.efficiency:.2%}" * (not np.isnan(self.bound)),
            f"  {self.stopped}",
            "  candidates " + ", ".join(map(str, self.indices)),
        ]
        for label, error, unit, bad in zip(self.labels, self.standard_errors, self.units, self.doubtful, strict=True):
            lines.append(f"  {label:<24s} ± {error:.4g} {unit}" + "  not seen in practice" * bool(bad))
        lines.append("  ± is the predicted standard error")
        return "\n".join(line for line in lines if line.strip())

    def to_frame(self) -> pd.DataFrame:
        """A table: one row a chosen pose, with its candidate, its weight in the relaxation, and its position."""
        import pandas as pd

        columns = {"candidate": self.indices, "weight": self.weights[self.indices]}
        if isinstance(self.poses, (LegMeasurements, Measurements)):
            columns |= {axis: self.poses.position[:, i] for i, axis in enumerate("xyz")}
        return pd.DataFrame(columns)
