"""What the rows of leg lengths say where an iteration has ended."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..arrays import Array, BoolArray, matvec, norm
from ..numerics.lm import LMEnd, LMResult
from ..numerics.lstsq import GRAM_LIMIT, LstsqSolution, solve
from .leg_rows import LegRows

__all__ = ["last_step"]

#: The share of the residual that a success may leave in the range of the rows, where a step would take it away.
STILL = 1e-6


def last_step(rows: LegRows, found: LMResult, *, values_only: bool) -> tuple[Array, BoolArray, LstsqSolution]:
    """The sum of squares where each set ended, whether one more step leaves it as it is, and that step.

    For values only, the step is empty but for rank and condition, and rows are evaluated only where the end of the
    iteration leaves a doubt: its last step was not small enough to be the last, or its rank is not clear.

    Parameters
    ----------
    rows : LegRows
    found : LMResult
        In the shape of the batch, but for its `end`.
    values_only : bool
    """
    shape, flat = found.converged.shape, found.values.reshape(-1, found.values.shape[-1])
    end = found.end or LMEnd(*np.full((3, len(flat)), np.inf))
    sure = (end.moved <= STILL) & (end.condition < GRAM_LIMIT) & values_only
    which = np.flatnonzero(~sure)
    rows = rows.take(which) if sure.any() else rows
    residual, jacobian = rows.at(flat[which])
    local = solve(jacobian, -residual, inverse=not values_only)
    square = np.einsum("bm,bm->b", residual, residual)
    still = square - 2 * local.objective <= STILL**2 * square  # what a step would still take away
    if not still.all():
        still |= norm(matvec(jacobian, np.nan_to_num(local.values))) <= norm(rows.rounding(flat[which]))

    def whole(known: Any, new: Any) -> Any:
        out = np.array(known)
        out[which] = new
        return out.reshape(shape)

    parts = vars(local) | {
        "full_rank": whole(sure, local.full_rank),
        "condition": whole(end.condition, local.condition),
    }
    if not values_only:
        parts = {name: part.reshape((*shape, *part.shape[1:])) for name, part in vars(local).items()}
    return whole(2 * end.objective, square), whole(sure, still), LstsqSolution(**parts)
