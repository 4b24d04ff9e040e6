"""Leg lengths fitted by CasADi and IPOPT, one set at a time: the reference of the batched routes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..arrays import Array, BoolArray
from ..constraints import Box, Constraint
from ..errors import InputError
from ..loops import LegLength
from ..losses import Huber, Loss, Quadratic
from ..numerics.programme import Programme
from ..priors import Prior
from .leg_rows import LegRows

__all__ = ["check_ipopt", "fitted_by_ipopt"]


def check_ipopt(loss: Loss, priors: Sequence[Prior], bounds: Sequence[Constraint]) -> None:
    """What the reference takes."""
    wrong: list[object] = [] if isinstance(loss, (Quadratic, Huber)) else [loss]
    wrong += [prior for prior in priors if not prior.gaussian]
    wrong += [bound for bound in bounds if not isinstance(bound, Box)]
    if wrong:
        raise InputError(
            f"backend='ipopt' takes Quadratic and Huber, normal priors and boxes; for {wrong[0]!r} write 'auto'"
        )


def fitted_by_ipopt(
    rows: LegRows, start: Array, max_iterations: int, frame: Programme | None = None
) -> tuple[Array, BoolArray, Any]:
    """Where IPOPT ends from starts (B, p): values, which are NaN without its success, that success, and iterations.

    The loss, normal priors and the box are those of a `frame`; without one it is plain least squares.
    """
    from .. import symbolic

    loss: Any = None if frame is None else frame.terms[0].loss
    values, iterations = np.full(start.shape, np.nan), np.zeros(len(start), dtype=np.int64)
    for i, first in enumerate(start):
        extra: dict[str, Any] = {}
        if frame is not None:
            if (frame.lower[i] > frame.upper[i]).any():
                continue  # nothing is inside
            extra = {"lower": frame.lower[i], "upper": frame.upper[i]}
            if len(frame.terms) > 1:
                root = np.concatenate([term.matrix[i] for term in frame.terms[1:]])
                mean = np.linalg.lstsq(root, np.concatenate([term.rhs[i] for term in frame.terms[1:]]), rcond=None)[0]
                extra["prior"] = (mean, root)
        if rows.factor is not None:
            extra["weights"] = rows.factor[i, :, None, None] if rows.factor.ndim == 2 else rows.factor[i][None]
        found = symbolic.fit(
            _member(rows, i),
            first,
            huber=loss.threshold if isinstance(loss, Huber) else None,
            max_iterations=max_iterations,
            **extra,
        )
        values[i], iterations[i] = found.values, found.iterations
    return values, np.isfinite(values).all(axis=-1), iterations


def _member(rows: LegRows, i: int) -> LegLength:
    """The loop of one set."""
    loop = rows.loop
    data = loop.data[np.unravel_index(i, loop.data.batch_shape)] if loop.data.batch_shape else loop.data
    known: Any = {name: value[i] if value.shape[-1] > 1 else value[i, 0] for name, value in rows.known.items()}
    return LegLength(data, unknown=loop.unknown, **known)
