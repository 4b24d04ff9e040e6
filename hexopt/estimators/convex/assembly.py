"""From a linear problem, a loss, priors and constraints to a programme in standard form, a flat batch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Array, BoolArray, norm
from ...constraints import BallRows, Constraint, IntervalRows
from ...errors import InputError
from ...losses import Loss
from ...numerics.programme import Ball, Interval, Programme, Term
from ...parameters import Parameters
from ...priors import Prior, PriorRows

__all__ = ["Assembly", "assemble", "centre_of"]


@dataclass(frozen=True, eq=False)
class Assembly:
    """A programme and what its parts are called.

    Attributes
    ----------
    programme : Programme
        The first term is the data; the others are the priors.
    gaussian : tuple of int
        Which terms are quadratic priors.
    empty : ndarray of bool, shape (B,)
        Members whose box is empty.
    row_names, interval_names, ball_names : tuple of str
        Of the terms and parts, for their duals.
    box_name : str or None
        None where there is no box.
    """

    programme: Programme
    gaussian: tuple[int, ...]
    empty: BoolArray
    row_names: tuple[str, ...]
    interval_names: tuple[str, ...]
    ball_names: tuple[str, ...]
    box_name: str | None


def assemble(
    loss: Loss,
    matrix: Array,
    rhs: Array,
    size: int,
    parameters: Parameters,
    priors: Sequence[Prior],
    constraints: Sequence[Constraint],
) -> Assembly:
    """The programme of (whitened) rows (..., m, p) with its priors and constraints, the batch made flat."""
    flat = _Flat(rhs.shape[:-1])
    terms = [Term(loss, flat(matrix, 2), flat(rhs, 1), size)]
    gaussian = []
    for prior in priors:
        for rows in prior.rows(parameters):
            if prior.gaussian:
                gaussian.append(len(terms))
            unit = _row_unit(matrix, rows)
            own: Any = rows.loss
            if unit != 1:
                own = replace(own, scale=own.bound * unit)
            terms.append(Term(own, flat(rows.matrix / unit, 2), flat(rows.rhs / unit, 1), rows.size))
    parts = [part for constraint in constraints for part in constraint.rows(parameters)]
    boxes = [part for part in parts if isinstance(part, IntervalRows) and part.is_box]
    intervals = [part for part in parts if isinstance(part, IntervalRows) and not part.is_box]
    balls = [part for part in parts if isinstance(part, BallRows)]
    lower, upper = _box(boxes, np.full((flat.count, parameters.size), np.inf), flat)
    programme = Programme(
        tuple(terms),
        lower,
        upper,
        tuple(Interval(flat(part.matrix, 2), flat(part.lower, 1), flat(part.upper, 1)) for part in intervals),
        tuple(Ball(flat(part.matrix, 2), flat(part.centre, 1), flat(part.radius, 0)) for part in balls),
    )
    names = {
        "rows": ["rows"] + ["prior"] * (len(terms) - 1),
        "box": [part.name for part in boxes[:1]],
        "interval": [part.name for part in intervals],
        "ball": [part.name for part in balls],
    }
    return Assembly(programme, tuple(gaussian), np.asarray((lower > upper).any(axis=-1)), *_numbered(names))


class _Flat:
    """Arrays broadcast to a batch that is then made flat."""

    def __init__(self, batch: tuple[int, ...]) -> None:
        self.batch, self.count = batch, int(np.prod(batch))

    def __call__(self, array: Array, trailing: int) -> Array:
        """(..., shape of the last `trailing` dimensions) as (B, …)."""
        own = array.shape[array.ndim - trailing :]
        try:
            wide = np.broadcast_to(array, (*self.batch, *own))
        except ValueError:
            raise InputError(
                f"a prior or bound has a batch of {array.shape[: array.ndim - trailing]}, the problem of {self.batch}"
            ) from None
        return wide.reshape(self.count, *own)


def _box(boxes: Sequence[IntervalRows], infinite: Array, flat: _Flat) -> tuple[Array, Array]:
    """The intersection of boxes, (B, p) each side."""
    lower, upper = -infinite, infinite.copy()
    for part in boxes:
        where = np.argmax(part.matrix, axis=-1)
        lower[:, where] = np.maximum(lower[:, where], flat(part.lower, 1))
        upper[:, where] = np.minimum(upper[:, where], flat(part.upper, 1))
    return lower, upper


def _row_unit(matrix: Array, rows: PriorRows) -> float:
    """The size of a nonsmooth prior's rows beside the data's, by which rows and strength are exchanged; else 1.

    λ‖x − μ‖ = (λs)‖(x − μ)/s‖: with s the answer of solvers does not depend on the unit of x.
    """
    if rows.loss.curvature != 0:
        return 1.0
    columns = np.sqrt(np.square(matrix).sum(axis=-2)).reshape(-1, matrix.shape[-1])
    columns = np.median(columns, axis=0) if len(columns) else np.ones(matrix.shape[-1])
    size = np.median(norm(rows.matrix / np.where(columns > 0, columns, 1.0)))
    return float(size) if size > 0 else 1.0


def _numbered(
    names: dict[str, list[str]],
) -> tuple[tuple[str, ...], tuple[str, ...], tuple[str, ...], str | None]:
    """The names of rows, intervals, balls and box, each once: the second "linear" becomes "linear.2"."""
    seen: dict[str, int] = {}
    out: dict[str, list[str]] = {}
    for kind, several in names.items():
        for name in several:
            seen[name] = seen.get(name, 0) + 1
            out.setdefault(kind, []).append(name if seen[name] == 1 else f"{name}.{seen[name]}")
    rows, intervals, balls = (tuple(out.get(kind, ())) for kind in ("rows", "interval", "ball"))
    return rows, intervals, balls, out["box"][0] if "box" in out else None


def centre_of(parameters: Parameters, priors: Sequence[Prior], constraints: Sequence[Constraint]) -> Array:
    """Where priors, then constraints, put the parameters without any measurement; zero where none says anything."""
    centre = np.full(parameters.size, np.nan)
    sources: list[Prior | Constraint] = [*priors, *constraints]
    for source in sources:
        other = source.centre(parameters)
        centre = np.where(np.isnan(centre), other, centre)
    return np.where(np.isnan(centre), 0.0, centre)
