"""The answer to what a clamp should hold: what was tried, what became of it, and the best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..arrays import Array
from ..measurements import Lock, Measurements
from .design import Design

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["LockChoice"]


@dataclass(frozen=True, eq=False)
class LockChoice:
    r"""What the clamp was tried with, and what is best.

    Attributes
    ----------
    lock : Lock
    leg : int
    tried : ndarray, shape (t, 3) or (t,)
        The directions, points or true lengths.
    bounds : ndarray, shape (t,)
        No design from the candidates of each has a lower value: proven. NaN where there are no candidates, or where
        the criterion has no bounds.
    values : ndarray, shape (t,)
        Of the designs; NaN where the bound alone shows that it cannot win.
    reasons : tuple of str
        Why there is no design on a value; empty where there could be one.
    best : int
        Which of them is best.
    design : Design
        On the best.
    pool : Measurements
        Its candidates, with all six readings.
    """

    lock: Lock
    leg: int
    tried: Array
    bounds: Array
    values: Array
    reasons: tuple[str, ...]
    best: int
    design: Design
    pool: Measurements

    @property
    def given(self) -> Array:
        """The best direction (3,), point (3,) or true length (), for ``candidates(…, given=…)``."""
        best: Array = np.asarray(self.tried[self.best])
        return best

    @property
    def hopeless(self) -> int:
        """On how many of them there is no design."""
        return sum(bool(reason) for reason in self.reasons)

    def summary(self) -> str:
        """A readable report: how many were tried, what became of them, and the best."""
        made = int(np.isfinite(self.values).sum())
        beaten = len(self.tried) - made - self.hopeless
        best = ", ".join(f"{number:.4g}" for number in np.atleast_1d(self.given))
        lines = [
            f"lock {str(self.lock)!r} of leg {self.leg}: {best} is the best of {len(self.tried)}",
            f"  designs made on {made}, from {np.nanmin(self.values):.6g} to {np.nanmax(self.values):.6g}",
            f"  {beaten} cannot win, by their bounds" * (beaten > 0),
            f"  no design on {self.hopeless}, first: {next(filter(None, self.reasons), '')}" * (self.hopeless > 0),
            self.design.summary(),
        ]
        return "\n".join(line for line in lines if line)

    def to_frame(self) -> pd.DataFrame:
        """A table: one row for each that was tried."""
        import pandas as pd

        named = ("length",) if self.lock is Lock.LENGTH else ("x", "y", "z")
        columns = dict(zip(named, np.atleast_2d(self.tried.T), strict=True))
        return pd.DataFrame(columns | {"bound": self.bounds, "value": self.values, "reason": self.reasons})
