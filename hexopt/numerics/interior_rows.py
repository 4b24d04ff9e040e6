r"""A programme as the rows of :mod:`hexopt.numerics.interior`, and its solution from theirs.

About a centre c, the least squares inside the box, and in units s of the residuals there, :math:`x = c + s \xi`:

.. math:: \min_{\xi, \tau} \sum_i \phi_i(a_i^T \xi - y_i) + \pi^T \tau \quad\text{s.t.}\quad
          -l_i - P_i \tau \le a_i^T \xi - y_i \le h_i + P_i \tau .

First come the rows of losses, then those of sides: of the peaks :math:`|z_i| \le \tau` of Chebyshev's losses, of
intervals with normals of unit length, and of the box. Rows of unbounded quadratic losses are plain: they stand apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, matvec, norm, transpose
from .factor import factored, solved
from .programme import Interval, Programme, Solution, Term, transposed_product

__all__ = ["Posed", "Rows", "down", "up"]

#: Residuals below this share of the data are rounding.
ROUNDING = 1e-12


def up(columns: Array, x: Array) -> Array:
    """A x from Aᵀ (B, p, m) and (p, B), shape (m, B)."""
    product = np.ascontiguousarray(x.T)[:, None, :] @ columns
    return np.ascontiguousarray(product[:, 0, :].T)


def down(columns: Array, u: Array) -> Array:
    """Aᵀ u from Aᵀ (B, p, m) and (m, B), shape (p, B)."""
    product = columns @ np.ascontiguousarray(u.T)[..., None]
    return np.ascontiguousarray(product[..., 0].T)


@dataclass(frozen=True, eq=False)
class Rows:
    """L rows of losses before S rows of sides, K plain ones, and T unknowns τ; the batch is last, but in columns."""

    columns: Array  # Aᵀ, (B, p, L + S)
    rhs: Array  # y, (L + S, B)
    bound: Array  # of the dual of a loss, (L, B)
    limit: Array  # h and l of a side, 0 where they are infinite, (2, S, B)
    on: Array  # 1, or 0 where a limit is infinite or of an equation, (2, L + S, B)
    equation: Array  # 1 where a side is one, (S, B)
    plain: Array  # Aᵀ of the plain rows, (B, p, K)
    plain_rhs: Array  # (K, B)
    gram: Array  # of the plain rows, (p, p, B)
    price: Array  # π, (T, B)
    curvature: Array  # M of the losses, (L, 1)
    peak: Array  # P: 1 where a side is of τ, (S, T)

    @property
    def size(self) -> int:
        """How many unknowns without τ."""
        return len(self.gram)

    @property
    def losses(self) -> int:
        """How many rows of losses."""
        return len(self.bound)

    @cached_property
    def pairs(self) -> Array:
        """How many pairs there are, at least one, (B,)."""
        return np.maximum(self.on.sum(axis=(0, 1)), 1.0)

    def take(self, which: Any) -> Rows:
        """Some members."""
        names = ("rhs", "bound", "limit", "on", "equation", "plain_rhs", "gram", "price")
        parts = {name: getattr(self, name)[..., which] for name in names}
        return replace(self, columns=self.columns[which], plain=self.plain[which], **parts)

    def inactive(self, x: Array, dual: Array) -> BoolArray:
        """The sides whose gap exceeds their multiplier, (S, B)."""
        size, first = self.size, self.losses
        z, push = (up(self.columns, x[:size]) - self.rhs)[first:], dual[first:]
        room = np.where(push > 0, self.limit[0] - z, self.limit[1] + z) + self.peak @ x[size:]
        on = np.where(push > 0, self.on[0, first:], self.on[1, first:])
        return ((np.abs(push) < room) | (on == 0)) & (self.equation == 0)


@dataclass(frozen=True, eq=False)
class Posed:
    """A programme with its rows, and what leads back."""

    programme: Programme
    rows: Rows
    centre: Array  # (B, p)
    unit: Array  # of residuals, (B,)
    price: Array  # by which duals are multiplied, (B,)
    length: list[Array]  # of the normals of intervals, (B, q)

    @classmethod
    def of(cls, programme: Programme) -> Posed:
        """A programme about least squares, with sides of unit length, in units of the residuals."""
        length = [np.maximum(norm(one.matrix), 1e-300) for one in programme.intervals]
        sides = tuple(
            Interval(one.matrix / by[..., None], one.lower / by, one.upper / by)
            for one, by in zip(programme.intervals, length, strict=True)
        )
        centre = _centre(programme)
        about = replace(programme, intervals=sides).about(centre)
        data = np.concatenate([centre, *(term.rhs for term in programme.terms)], axis=-1)
        unit, price = _units(about, ROUNDING * np.abs(data).max(axis=-1, initial=0.0))
        return cls(programme, _rows(about, unit, price), centre, unit, price, length)

    def solution(self, x: Array, dual: Array, solved: BoolArray, iterations: npt.NDArray[np.int64]) -> Solution:
        """The solution of x and τ (p + T, B) and duals (L + S, B); sides and bounds are exact where it is solved."""
        programme, rows = self.programme, self.rows
        inactive = rows.inactive(x, dual) & solved
        sides = np.where(inactive, 0.0, dual[rows.losses :])
        values = self.centre + self.unit[:, None] * x[: rows.size].T
        values = np.clip(values, programme.lower, programme.upper)
        if programme.is_boxed:
            box = np.where(solved, sides[-rows.size :], 0.0).T
            values = np.where(box > 0, programme.upper, np.where(box < 0, programme.lower, values))
        terms = [*_bounded(programme), *_peaks(programme)]
        ends = np.cumsum([part.shape[-1] for part in (*(term.rhs for term in terms), *self.length)], dtype=int)
        scaled = np.concatenate([dual[: rows.losses], sides]).T / self.price[:, None]
        parts = np.split(scaled, ends, axis=-1)
        of_term = {
            id(term): np.clip(part, -term.loss.bound, term.loss.bound) if term.loss.per == "row" else part
            for term, part in zip(terms, parts, strict=False)
        }
        return Solution(
            values,
            solved,
            iterations,
            tuple(of_term.get(id(term), matvec(term.matrix, values) - term.rhs) for term in programme.terms),
            tuple(part / by for part, by in zip(parts[len(terms) :], self.length, strict=False)),
        )


def _bounded(programme: Programme) -> list[Term]:
    return [one for one in programme.terms if one.loss.per == "row" and np.isfinite(one.loss.bound)]


def _peaks(programme: Programme) -> list[Term]:
    return [one for one in programme.terms if one.loss.per == "all"]


def _centre(programme: Programme) -> Array:
    """Least squares, moved into the box."""
    gram = np.asarray(sum(transpose(term.matrix) @ term.matrix for term in programme.terms))
    force = np.asarray(sum(transposed_product(term.matrix, term.rhs) for term in programme.terms))
    return np.clip(solved(factored(np.moveaxis(gram, 0, -1)), force.T).T, programme.lower, programme.upper)


def _units(programme: Programme, least: Array) -> tuple[Array, Array]:
    """Of residuals and violations about the centre, and by what duals are multiplied then, (B,)."""
    unit = np.maximum(np.abs(np.concatenate([term.rhs for term in programme.terms], axis=-1)).mean(axis=-1), least)
    for one in programme.intervals:
        unit = np.maximum(unit, np.maximum(one.lower, -one.upper).max(axis=-1, initial=0.0))
    unit = np.where(unit > 0, unit, 1.0)
    if any(term.loss.curvature for term in programme.terms):
        return unit, 1 / unit
    return unit, np.full(len(unit), 1 / max(term.loss.bound for term in programme.terms))


def _rows(programme: Programme, unit: Array, price: Array) -> Rows:
    """The rows of a programme about its centre."""
    bounded, peaks = _bounded(programme), _peaks(programme)
    plain = [term for term in programme.terms if not np.isfinite(term.loss.bound)]
    sides = _sides(programme, peaks)
    batch, size = programme.lower.shape

    def joined(*parts: Array) -> Array:
        return np.concatenate([np.zeros((0, batch)), *(part.T for part in parts)]) / unit

    def columns(*parts: Array) -> Array:
        return np.ascontiguousarray(np.concatenate([np.zeros((batch, size, 0)), *map(transpose, parts)], axis=-1))

    def constant(value: Callable[[Term], float]) -> Array:
        return np.concatenate([np.zeros(0), *(np.full(term.rhs.shape[-1], value(term)) for term in bounded)])[:, None]

    limit = np.stack([joined(*(one.upper for one in sides)), -joined(*(one.lower for one in sides))])
    peak = np.zeros((limit.shape[1], len(peaks)))
    for k, ends in enumerate(np.cumsum([term.rhs.shape[-1] for term in peaks])):
        peak[ends - peaks[k].rhs.shape[-1] : ends, k] = 1.0
    equation = (limit[0] == -limit[1]) & ~peak.any(axis=-1, keepdims=True)
    fixed, finite = columns(*(term.matrix for term in plain)), np.isfinite(limit)
    y = joined(*(term.rhs for term in (*bounded, *peaks)))
    bound = constant(lambda term: term.loss.bound) * price
    return Rows(
        columns=columns(*(term.matrix for term in bounded), *(one.matrix for one in sides)),
        rhs=np.concatenate([y, np.zeros((len(bound) + len(peak) - len(y), batch))]),
        bound=bound,
        limit=np.where(finite, limit, 0.0),
        on=np.concatenate([np.ones((2, *bound.shape)), finite & ~equation], axis=1),
        equation=equation.astype(float),
        plain=fixed,
        plain_rhs=joined(*(term.rhs for term in plain)),
        gram=np.ascontiguousarray(np.moveaxis(fixed @ transpose(fixed), 0, -1)),
        price=np.broadcast_to(price, (len(peaks), batch)),
        curvature=constant(lambda term: float(term.loss.curvature or 0)),
        peak=peak,
    )


def _sides(programme: Programme, peaks: list[Term]) -> list[Interval]:
    """Peaks, intervals and the box as intervals; those of peaks are empty but for τ."""
    sides = [Interval(term.matrix, 0 * term.rhs, 0 * term.rhs) for term in peaks] + list(programme.intervals)
    if programme.is_boxed:
        batch, size = programme.lower.shape
        eye = np.broadcast_to(np.eye(size), (batch, size, size))
        sides.append(Interval(eye, programme.lower, programme.upper))
    return sides
