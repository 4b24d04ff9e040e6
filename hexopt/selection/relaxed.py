"""What a relaxation finds: weights, and what no weights can beat."""

from __future__ import annotations

from dataclasses import dataclass

from ..arrays import Array

__all__ = ["Relaxation"]


@dataclass(frozen=True, eq=False)
class Relaxation:
    r"""Weights that are as good as any, with the proof.

    Attributes
    ----------
    weights : ndarray, shape (n,)
    value : float
        The objective at the weights.
    bound : float
        No allowed weights have a lower value: recomputed from weights or multipliers, no solver's word.
    gains : ndarray, shape (n,)
        Of the bound: by how much the weight of a pose lowers the objective.
    mix : ndarray, shape (S, j)
        Multipliers of the pieces in the bound.
    relative : float
        How far apart value and bound are, as a share of the variance.
    goal : float
        What was asked of it.
    iterations : int
        Rounds over all candidates.
    stopped : str
        What ended the search.
    """

    weights: Array
    value: float
    bound: float
    gains: Array
    mix: Array
    relative: float
    goal: float
    iterations: int
    stopped: str

    @property
    def gap(self) -> float:
        """Value minus bound."""
        return self.value - self.bound

    @property
    def ok(self) -> bool:
        """Whether the bound proves the weights to the goal."""
        return self.relative <= self.goal
