r"""Piecewise linear-quadratic programmes of a batch, by a primal–dual interior-point method.

.. math:: \min_x \sum_i \phi_i(a_i^T x - y_i), \qquad \phi(z) = \sup_{|u| \le b} u z - \tfrac{M}{2} u^2
          \quad\text{or}\quad \phi(z) = 0 \text{ for } -l \le z \le h,

over rows of two kinds: a loss bounds its dual u, a side (of the box or an interval) bounds its residual z. The sides
of Chebyshev's loss, :math:`|z_i| \le \tau`, have one more unknown :math:`\tau`, which is minimised. Either bound is a
pair of a gap g ≥ 0 and a multiplier m ≥ 0, with :math:`g m = 0` at the optimum. Relaxed to :math:`g m = \mu`, all
pairs are eliminated to :math:`(H + A^T W A)\,\Delta x = \dots`, and Mehrotra's predictor and corrector follow
:math:`\mu \to 0`. Rows of an unbounded quadratic loss have no pair: they make the constant H. Nor have equations,
which weigh much instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, matvec, norm, transpose
from .programme import Interval, Programme, Solution, Term, transposed_product

__all__ = ["interior_solves", "solve_interior"]

MAX_ITERATIONS = 100
#: The relative error at which a member stops, and the one up to which it counts as solved.
TOLERANCE, ACCEPTED = 1e-15, 1e-9
#: After so many iterations without improvement a member stops: near the optimum, and far from it.
PATIENCE, LONG_PATIENCE = 4, 20
#: After so many it goes back to the middle, at this share of its complementarity.
SLOW, CENTRING = 3, 0.5
#: The share of the way to the boundary that a step goes.
SHARE = 0.9995
#: What is smaller than this, in units of the residuals, is judged absolutely.
FLOOR = 1e-3
#: Residuals below this share of the data are rounding.
ROUNDING = 1e-12
#: Pivots below this share of their diagonal are rounding: that direction rests.
PIVOT = 1e-15
#: The weight of an equation; what it leaves, the next iteration takes away.
STIFF = 1e8
#: How many numbers the matrices of one chunk of the batch hold, so that it stays in the cache.
CHUNK = 150_000
#: Members that are done leave the arrays when no more than this share is left.
COMPRESS = 0.75


def interior_solves(programme: Programme) -> bool:
    """Whether :func:`solve_interior` takes programmes of this structure."""
    known = all(one.loss.curvature is not None and one.loss.per in ("row", "all") for one in programme.terms)
    return known and not programme.balls


def solve_interior(programme: Programme) -> Solution:
    """Minimise every member of a batch; use scaled variables.

    Parameters
    ----------
    programme : Programme
        With losses per row or of all rows that are support functions, a box, and intervals.

    Returns
    -------
    Solution
        With the duals of terms and intervals; x is inside the box. A member that does not converge, such as an
        infeasible one, has the best point that was seen.
    """
    step = max(1, CHUNK // max(1, programme.size * sum(term.rhs.shape[-1] for term in programme.terms)))
    with np.errstate(all="ignore"):
        parts = [_solve(programme.take(slice(k, k + step))) for k in range(0, max(programme.batch, 1), step)]
    return Solution(
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.converged for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        tuple(np.concatenate(u) for u in zip(*(part.rows or () for part in parts), strict=True)),
        tuple(np.concatenate(w) for w in zip(*(part.intervals for part in parts), strict=True)),
    )


def _solve(programme: Programme) -> Solution:
    """One chunk: with sides of unit length, about least squares, in units of the residuals."""
    length = [np.maximum(norm(one.matrix), 1e-300) for one in programme.intervals]
    sides = tuple(
        Interval(one.matrix / by[..., None], one.lower / by, one.upper / by)
        for one, by in zip(programme.intervals, length, strict=True)
    )
    centre = _centre(programme)
    about = replace(programme, intervals=sides).about(centre)
    unit, price = _units(about, ROUNDING * _largest(centre, *(term.rhs for term in programme.terms)))
    rows = _rows(about, unit, price)
    x, dual, error, iterations = _follow(rows)
    solved = error <= ACCEPTED
    dual[:, rows.losses :][_inactive(rows, x, dual) & solved[:, None]] = 0.0
    values = np.clip(centre + unit[:, None] * x[:, : rows.size], programme.lower, programme.upper)
    if programme.is_boxed:
        box = np.where(solved[:, None], dual[:, -rows.size :], 0.0)
        values = np.where(box > 0, programme.upper, np.where(box < 0, programme.lower, values))
    dual /= price[:, None]
    bounded, peaks = _bounded(programme), _peaks(programme)
    ends = np.cumsum([part.shape[-1] for part in (*(term.rhs for term in (*bounded, *peaks)), *length)], dtype=int)
    parts = np.split(dual, ends, axis=-1)
    of_term = {id(term): part for term, part in zip((*bounded, *peaks), parts, strict=False)}
    for term in bounded:
        np.clip(of_term[id(term)], -term.loss.bound, term.loss.bound, out=of_term[id(term)])
    return Solution(
        values,
        solved,
        iterations,
        tuple(of_term.get(id(term), matvec(term.matrix, values) - term.rhs) for term in programme.terms),
        tuple(part / by for part, by in zip(parts[len(of_term) :], length, strict=False)),
    )


# --- the programme as rows --------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Rows:
    """L rows of losses before S rows of sides, K plain ones, and T unknowns τ."""

    columns: Array  # Aᵀ, (B, p, L + S)
    rhs: Array  # (B, L + S)
    bound: Array  # of the dual of a loss, (B, L)
    limit: Array  # the upper, and minus the lower limit of a side, (2, B, S)
    on: Array  # 0 where such a limit is infinite or of an equation, (2, B, S)
    stiff: Array  # the weight of equations, 0 elsewhere, (B, S)
    plain: Array  # Aᵀ of the plain rows, (B, p, K)
    plain_rhs: Array  # (B, K)
    gram: Array  # H, (B, p, p)
    price: Array  # of each τ, (B, T)
    curvature: Array  # M of the losses, (L,)
    peak: Array  # 1 where a side is of τ, (S, T)

    @property
    def size(self) -> int:
        """How many unknowns without τ."""
        return self.gram.shape[-1]

    @property
    def losses(self) -> int:
        """How many rows of losses."""
        return len(self.curvature)

    def take(self, which: Any) -> _Rows:
        """Some members."""
        names = ("columns", "rhs", "bound", "stiff", "plain", "plain_rhs", "gram", "price")
        parts = {name: getattr(self, name)[which] for name in names}
        return replace(self, **parts, limit=self.limit[:, which], on=self.on[:, which])


def _bounded(programme: Programme) -> list[Term]:
    return [one for one in programme.terms if one.loss.per == "row" and np.isfinite(one.loss.bound)]


def _peaks(programme: Programme) -> list[Term]:
    return [one for one in programme.terms if one.loss.per == "all"]


def _centre(programme: Programme) -> Array:
    """Least squares, moved into the box."""
    gram = np.asarray(sum(transpose(term.matrix) @ term.matrix for term in programme.terms))
    force = np.asarray(sum(transposed_product(term.matrix, term.rhs) for term in programme.terms))
    return np.clip(_solved(_factor(gram), force), programme.lower, programme.upper)


def _units(programme: Programme, least: Array) -> tuple[Array, Array]:
    """Of residuals and violations about the centre, and by what duals are multiplied then, (B,)."""
    unit = np.maximum(np.abs(np.concatenate([term.rhs for term in programme.terms], axis=-1)).mean(axis=-1), least)
    for one in programme.intervals:
        unit = np.maximum(unit, np.maximum(one.lower, -one.upper).max(axis=-1, initial=0.0))
    unit = np.where(unit > 0, unit, 1.0)
    if any(term.loss.curvature for term in programme.terms):
        return unit, 1 / unit
    return unit, np.full(len(unit), 1 / max(term.loss.bound for term in programme.terms))


def _rows(programme: Programme, unit: Array, price: Array) -> _Rows:
    """The rows of a programme about its centre."""
    bounded, peaks = _bounded(programme), _peaks(programme)
    plain = [term for term in programme.terms if not np.isfinite(term.loss.bound)]
    batch, size = programme.lower.shape
    sides = [Interval(term.matrix, 0 * term.rhs, 0 * term.rhs) for term in peaks] + list(programme.intervals)
    if programme.is_boxed:
        eye = np.broadcast_to(np.eye(size), (batch, size, size))
        sides.append(Interval(eye, programme.lower, programme.upper))
    empty = np.zeros((batch, 0))

    def joined(*parts: Array) -> Array:
        return np.concatenate([empty, *parts], axis=-1) / unit[:, None]

    def columns(*parts: Array) -> Array:
        return np.ascontiguousarray(np.concatenate([np.zeros((batch, size, 0)), *map(transpose, parts)], axis=-1))

    limit = np.stack([joined(*(one.upper for one in sides)), -joined(*(one.lower for one in sides))])
    peak = np.zeros((limit.shape[-1], len(peaks)))
    for k, ends in enumerate(np.cumsum([term.rhs.shape[-1] for term in peaks])):
        peak[ends - peaks[k].rhs.shape[-1] : ends, k] = 1.0
    equation = (limit[0] == -limit[1]) & ~peak.any(axis=-1)
    fixed = columns(*(term.matrix for term in plain))
    y = joined(*(term.rhs for term in (*bounded, *peaks)))
    bound = np.concatenate([np.zeros(0), *(np.full(term.rhs.shape[-1], term.loss.bound) for term in bounded)])
    curved = [np.full(term.rhs.shape[-1], float(term.loss.curvature or 0)) for term in bounded]
    return _Rows(
        columns=columns(*(term.matrix for term in bounded), *(one.matrix for one in sides)),
        rhs=np.concatenate([y, np.zeros((batch, len(bound) + len(peak) - y.shape[-1]))], axis=-1),
        bound=price[:, None] * bound,
        limit=limit,
        on=(np.isfinite(limit) & ~equation).astype(float),
        stiff=STIFF * equation,
        plain=fixed,
        plain_rhs=joined(*(term.rhs for term in plain)),
        gram=fixed @ transpose(fixed),
        price=np.broadcast_to(price[:, None], (batch, len(peaks))),
        curvature=np.concatenate([np.zeros(0), *curved]),
        peak=peak,
    )


# --- points and steps -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Point:
    """x and every τ (B, n), the duals (B, L + S), and the pairs (2, B, L + S), which are 1 where there is none."""

    x: Array
    dual: Array
    gap: Array
    multiplier: Array

    def take(self, which: Any) -> _Point:
        """Some members."""
        return _Point(self.x[which], self.dual[which], self.gap[:, which], self.multiplier[:, which])

    def moved(self, length: Array, step: _Point) -> _Point:
        """A share of a step on."""
        by = length[:, None]
        return _Point(
            self.x + by * step.x,
            self.dual + by * step.dual,
            self.gap + by * step.gap,
            self.multiplier + by * step.multiplier,
        )


def _start(rows: _Rows) -> _Point:
    """At the centre, with pairs apart from zero; without constraints in balance."""
    first = rows.losses
    z, side = -rows.rhs[:, :first], -rows.rhs[:, first:]
    size, bent = np.abs(z), rows.curvature > 0
    flat = 0.8 * rows.bound * z / np.maximum(size.max(axis=-1, initial=0.0, keepdims=True), 1e-300)
    dual = np.where(bent & (size < np.abs(flat)), z, flat)
    force = z - rows.curvature * dual
    worth = (size * np.where(bent, np.minimum(size, rows.bound), rows.bound)).sum(axis=-1)
    mu = (worth + np.square(rows.plain_rhs).sum(axis=-1)) / max(1, first + rows.plain_rhs.shape[-1])
    mu = np.where(mu > 1e-6, mu, 1.0)[:, None]
    gap = np.stack([rows.bound - dual, rows.bound + dual])
    multiplier = mu / gap + np.stack([np.maximum(force, 0.0), np.maximum(-force, 0.0)])
    tops = (np.abs(side)[:, None, :] * rows.peak.T).max(axis=-1, initial=0.0)
    height, in_peak = 1.2 * tops + 0.1, rows.peak.any(axis=-1)
    both = np.stack([side, -side])
    room = np.maximum(rows.limit + height @ rows.peak.T - both, np.where(in_peak, 0.0, 1.0))
    share = 0.5 * (rows.price / np.maximum(rows.peak.sum(axis=0), 1.0)) @ rows.peak.T
    push = share * (1 + 0.8 * both / np.maximum(tops @ rows.peak.T, 1e-300))
    room = np.where(rows.on > 0, room, 1.0)
    push = np.where(rows.on > 0, np.where(in_peak, push, mu / room), 1.0)
    return _Point(
        np.concatenate([np.zeros((len(z), rows.size)), height], axis=-1),
        np.concatenate([dual, rows.on[0] * push[0] - rows.on[1] * push[1]], axis=-1),
        np.concatenate([gap, room], axis=-1),
        np.concatenate([multiplier, push], axis=-1),
    )


class _Residual:
    """What is missing at a point."""

    def __init__(self, rows: _Rows, at: _Point) -> None:
        size, first = rows.size, rows.losses
        self.rows, self.at = rows, at
        push = at.multiplier
        self.z = _up(rows.columns, at.x[:, :size]) - rows.rhs
        self.plain = _up(rows.plain, at.x[:, :size]) - rows.plain_rhs
        side, rise = self.z[:, first:], at.x[:, size:] @ rows.peak.T
        #: Of the balance of x and of every τ, of the losses, of the sides, of the equations.
        self.balance = _down(rows.columns, at.dual) + _down(rows.plain, self.plain)
        self.surplus = rows.price - (push[0, :, first:] + push[1, :, first:]) @ rows.peak
        self.force = self.z[:, :first] - rows.curvature * at.dual[:, :first] - push[0, :, :first] + push[1, :, :first]
        self.lack = np.where(rows.on > 0, rows.limit + (rise - at.gap[:, :, first:]), 0.0)
        self.lack[0] -= rows.on[0] * side
        self.lack[1] += rows.on[1] * side
        self.miss = np.where(rows.stiff > 0, side - rows.limit[0], 0.0)
        self.product = at.gap * push
        self.product[:, :, first:] *= rows.on

    def error(self) -> Array:
        """The relative complementarity, or what is missing if that is worse, (B,)."""
        rows, at, first = self.rows, self.at, self.rows.losses
        size = np.vecdot(np.abs(at.dual[:, :first]), np.abs(self.z[:, :first])) + np.vecdot(self.plain, self.plain)
        size = size + np.vecdot(rows.price, at.x[:, rows.size :])
        force = np.maximum(_largest(at.dual, self.plain), FLOOR)
        lack = self.lack / (1 + at.gap[:, :, first:])
        missing = _largest(0.1 * self.balance / force[:, None], self.force, *lack, self.miss, 0.1 * self.surplus)
        return np.maximum(self.product.sum(axis=(0, 2)) / np.maximum(size, FLOOR), 1e-2 * missing)


class _Newton:
    """The linear system at a point."""

    def __init__(self, now: _Residual) -> None:
        rows, at, size, first = now.rows, now.at, now.rows.size, now.rows.losses
        self.now = now
        self.ratio = at.multiplier / at.gap
        self.ratio[:, :, first:] *= rows.on
        total = self.ratio[0] + self.ratio[1]
        self.weight = total.copy()
        self.weight[:, :first] = 1.0 / (rows.curvature + total[:, :first])
        self.weight[:, first:] += rows.stiff
        self.slope = self.ratio[0, :, first:] - self.ratio[1, :, first:]
        moved = self.ratio[:, :, first:] * now.lack
        self.offset = rows.stiff * now.miss - moved[0] + moved[1]
        self.surplus = now.surplus + (moved[0] + moved[1]) @ rows.peak
        gram = np.zeros((len(at.x), at.x.shape[1], at.x.shape[1]))
        gram[:, :size, :size] = (rows.columns * self.weight[:, None, :]) @ transpose(rows.columns) + rows.gram
        gram[:, :size, size:] = -rows.columns[:, :, first:] @ (self.slope[:, :, None] * rows.peak)
        gram[:, size:, :size] = transpose(gram[:, :size, size:])
        tau = np.arange(size, at.x.shape[1])
        gram[:, tau, tau] = total[:, first:] @ rows.peak
        self.factor = _factor(gram)

    def step(self, aim: Array) -> _Point:
        """The step after which g m / g would be `aim` to first order."""
        rows, now, size, first = self.now.rows, self.now, self.now.rows.size, self.now.rows.losses
        k = aim[0] - aim[1]
        k[:, :first] = self.weight[:, :first] * (now.force - k[:, :first])
        k[:, first:] += self.offset
        extra = (aim[0, :, first:] + aim[1, :, first:]) @ rows.peak - self.surplus
        x = _solved(self.factor, np.concatenate([-now.balance - _down(rows.columns, k), extra], axis=-1))
        z, rise = _up(rows.columns, x[:, :size]), x[:, size:] @ rows.peak.T
        dual = self.weight * z
        dual += k
        dual[:, first:] -= self.slope * rise
        gap = np.empty(aim.shape)
        np.negative(dual[:, :first], out=gap[0, :, :first])
        gap[1, :, :first] = dual[:, :first]
        gap[0, :, first:] = now.lack[0] + rows.on[0] * (rise - z[:, first:])
        gap[1, :, first:] = now.lack[1] + rows.on[1] * (rise + z[:, first:])
        return _Point(x, dual, gap, aim - self.ratio * gap)


def _advanced(now: _Residual, slow: BoolArray) -> _Point:
    """The next point: Mehrotra's, or nearer to the middle where that was slow."""
    system, at, first = _Newton(now), now.at, now.rows.losses
    aim = -at.multiplier
    aim[:, :, first:] *= now.rows.on
    relative = system.step(aim).gap / at.gap
    worst = np.maximum(-relative.min(axis=(0, 2), initial=0.0), 1 + relative.max(axis=(0, 2), initial=-1.0))
    length = 1 / np.maximum(1.0, worst)
    second = now.product * relative
    second *= 1 + relative
    total = now.product.sum(axis=(0, 2))
    ahead = np.maximum((1 - length) * total - length**2 * second.sum(axis=(0, 2)), 0.0)
    share = (ahead / np.maximum(total, 1e-300)) ** 3
    share = np.where(slow, np.maximum(share, CENTRING), share)
    second[:, slow] = 0.0
    mu = share * total / np.maximum(2 * first + now.rows.on.sum(axis=(0, 2)), 1.0)
    aim = second - now.product
    aim[:, :, :first] += mu[:, None]
    aim[:, :, first:] += mu[:, None] * now.rows.on
    aim /= at.gap
    step = system.step(aim)
    worst = np.maximum(-(step.gap / at.gap).min(axis=(0, 2), initial=0.0), 1e-300)
    worst = np.maximum(worst, -(step.multiplier / at.multiplier).min(axis=(0, 2), initial=0.0))
    length = np.minimum(1.0, SHARE / worst)
    if slow.any():
        cross = 2 * (step.gap * step.multiplier).sum(axis=(0, 2))
        length = np.where(slow & (cross > 0), np.minimum(length, (1 - share) * total / cross), length)
    return at.moved(length, step)


def _follow(rows: _Rows) -> tuple[Array, Array, Array, npt.NDArray[np.int64]]:
    """The best x and duals of every member, their errors, and the iterations."""
    at = _start(rows)
    x, dual = at.x.copy(), at.dual.copy()
    members = np.arange(len(x))
    error, done = np.full(len(x), np.inf), np.zeros(len(x), dtype=bool)
    iterations, since = np.zeros(len(x), dtype=np.int64), np.zeros(len(x), dtype=np.int64)
    for k in range(MAX_ITERATIONS + 1):
        now = _Residual(rows, at)
        worth = now.error()
        better = ~done[members] & (worth < error[members])
        where = members[better]
        x[where], dual[where], error[where] = at.x[better], at.dual[better], worth[better]
        iterations[members[~done[members]]] = k
        since[members] += 1
        since[where] = 0
        patience = np.where(error < ACCEPTED, PATIENCE, LONG_PATIENCE)
        done |= (error <= TOLERANCE) | (since >= patience)
        left = ~done[members]
        if not left.any():
            break
        at = _advanced(now, since[members] >= SLOW)
        if left.mean() < COMPRESS:
            members, at, rows = members[left], at.take(left), rows.take(left)
    return x, dual, error, iterations


def _inactive(rows: _Rows, x: Array, dual: Array) -> BoolArray:
    """The sides whose gap exceeds their multiplier, (B, S)."""
    size, first = rows.size, rows.losses
    z = (_up(rows.columns, x[:, :size]) - rows.rhs)[:, first:]
    rise, push = x[:, size:] @ rows.peak.T, dual[:, first:]
    room = np.where(push > 0, rows.limit[0] - z, rows.limit[1] + z) + rise
    return (np.abs(push) < room) & (rows.stiff == 0)


# --- linear algebra ---------------------------------------------------------------------------------


def _up(columns: Array, x: Array) -> Array:
    """A x."""
    return (x[:, None, :] @ columns)[:, 0, :]


def _down(columns: Array, u: Array) -> Array:
    """Aᵀ u."""
    return (columns @ u[..., None])[..., 0]


def _largest(*parts: Array) -> Array:
    """The largest size in any of several arrays, of each member."""
    return np.max(
        [np.maximum(part.max(axis=-1, initial=0.0), -part.min(axis=-1, initial=0.0)) for part in parts], axis=0
    )


def _factor(gram: Array) -> tuple[Array, Array]:
    """L D Lᵀ of a batch of Gram matrices, with the batch last; directions without a pivot rest."""
    work = np.array(gram.transpose(1, 2, 0), order="C")
    floor = PIVOT * np.einsum("iib->ib", work)
    inverse = np.zeros(floor.shape)
    for j in range(len(work)):
        np.divide(1.0, work[j, j], out=inverse[j], where=work[j, j] > floor[j])
        row = work[j + 1 :, j].copy()
        work[j + 1 :, j] *= inverse[j]
        work[j + 1 :, j + 1 :] -= work[j + 1 :, j, None] * row
    return work, inverse


def _solved(factor: tuple[Array, Array], right: Array) -> Array:
    """The solution for one right-hand side of each member."""
    lower, inverse = factor
    out = np.array(right.T, order="C")
    for j in range(len(out) - 1):
        out[j + 1 :] -= lower[j + 1 :, j] * out[j]
    out *= inverse
    for j in range(len(out) - 2, -1, -1):
        out[j] -= np.einsum("ib,ib->b", lower[j + 1 :, j], out[j + 1 :])
    return np.ascontiguousarray(out.T)
