r"""Piecewise linear-quadratic programmes of a batch, by a primal–dual interior-point method.

.. math:: \min_x \sum_i \phi_i(a_i^T x - y_i), \qquad \phi(z) = \sup_{|u| \le b} u z - \tfrac{M}{2} u^2
          \quad\text{or}\quad \phi(z) = 0 \text{ for } -l \le z \le h,

over rows of two kinds: a loss bounds its dual u, a side (of the box or an interval) bounds its residual z. The sides
of Chebyshev's loss, :math:`|z_i| \le \tau`, have one more unknown :math:`\tau`, which is minimised. Either bound is a
pair of a gap g ≥ 0 and a multiplier m ≥ 0, with :math:`g m = 0` at the optimum. Relaxed to :math:`g m = \mu`, all
pairs are eliminated to :math:`(H + A^T W A)\,\Delta x = \dots`, and Mehrotra's predictor and corrector follow
:math:`\mu \to 0`. Rows of an unbounded quadratic loss have no pair: they make the constant H. Nor have equations,
which weigh much instead.

Arrays have the batch last: then a bound of every member, such as its longest step, is one pass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, transpose
from .factor import factored, solved
from .interior_rows import Posed, Rows, down, up
from .programme import Programme, Solution

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
#: The weight of an equation; what it leaves, the next iteration takes away.
STIFF = 1e8
#: The multiplier where there is no pair, and the least divisor.
TINY = 1e-300
#: How many numbers the matrices of one chunk of the batch hold, so that it stays in the cache.
CHUNK = 300_000
#: Members that are done leave the arrays when no more than this share is left.
COMPRESS = 0.75


def interior_solves(programme: Programme) -> bool:
    """Whether :func:`solve_interior` takes programmes of this structure."""
    known = all(one.loss.curvature is not None and one.loss.per in ("row", "all") for one in programme.terms)
    return known and not programme.balls


def solve_interior(programme: Programme, tolerance: float = TOLERANCE) -> Solution:
    """Minimise every member of a batch; use scaled variables.

    Parameters
    ----------
    programme : Programme
        With losses per row or of all rows that are support functions, a box, and intervals.
    tolerance : float, default 1e-15
        Relative error at which a member may stop.

    Returns
    -------
    Solution
        With the duals of terms and intervals; x is inside the box. A member that does not converge, such as an
        infeasible one, has the best point that was seen.
    """
    numbers = programme.batch * programme.size * sum(term.rhs.shape[-1] for term in programme.terms)
    step = max(1, -(-programme.batch // max(1, -(-numbers // CHUNK))))
    with np.errstate(all="ignore"):
        parts = [_solve(programme.take(slice(k, k + step)), tolerance) for k in range(0, max(programme.batch, 1), step)]
    return Solution(
        np.concatenate([part.values for part in parts]),
        np.concatenate([part.converged for part in parts]),
        np.concatenate([part.iterations for part in parts]),
        tuple(np.concatenate(u) for u in zip(*(part.rows or () for part in parts), strict=True)),
        tuple(np.concatenate(w) for w in zip(*(part.intervals for part in parts), strict=True)),
    )


def _solve(programme: Programme, tolerance: float) -> Solution:
    """One chunk."""
    posed = Posed.of(programme)
    x, dual, error, iterations = _follow(posed.rows, tolerance)
    return posed.solution(x, dual, error <= ACCEPTED, iterations)


@dataclass(frozen=True, eq=False)
class _Point:
    """x and every τ (n, B), the duals (L + S, B), and the pairs (2, L + S, B), which are 1 and tiny for none."""

    x: Array
    dual: Array
    gap: Array
    multiplier: Array

    def take(self, which: Any) -> _Point:
        """Some members."""
        return _Point(self.x[:, which], self.dual[:, which], self.gap[..., which], self.multiplier[..., which])


def _start(rows: Rows) -> _Point:
    """At the centre, with pairs apart from zero; without constraints in balance."""
    first = rows.losses
    z, side = -rows.rhs[:first], -rows.rhs[first:]
    size, bent = np.abs(z), rows.curvature > 0
    flat = 0.8 * rows.bound * z / np.maximum(size.max(axis=0, initial=0.0), TINY)
    dual = np.where(bent & (size < np.abs(flat)), z, flat)
    force = z - rows.curvature * dual
    worth = (size * np.where(bent, np.minimum(size, rows.bound), rows.bound)).sum(axis=0)
    mu = (worth + np.square(rows.plain_rhs).sum(axis=0)) / max(1, first + len(rows.plain_rhs))
    mu = np.where(mu > 1e-6, mu, 1.0)
    gap = np.stack([rows.bound - dual, rows.bound + dual])
    multiplier = mu / gap + np.stack([np.maximum(force, 0.0), np.maximum(-force, 0.0)])
    tops = (np.abs(side)[:, None] * rows.peak[:, :, None]).max(axis=0, initial=0.0)
    height, in_peak = 1.2 * tops + 0.1, rows.peak.any(axis=-1, keepdims=True)
    both, on = np.stack([side, -side]), rows.on[:, first:] > 0
    room = np.maximum(rows.limit + rows.peak @ height - both, np.where(in_peak, 0.0, 1.0))
    share = rows.peak @ (0.5 * rows.price / np.maximum(rows.peak.sum(axis=0), 1.0)[:, None])
    push = share * (1 + 0.8 * both / np.maximum(rows.peak @ tops, TINY))
    room = np.where(on, room, 1.0)
    push = np.where(on, np.where(in_peak, push, mu / room), TINY)
    return _Point(
        np.concatenate([np.zeros((rows.size, len(mu))), height]),
        np.concatenate([dual, push[0] - push[1]]),
        np.concatenate([gap, room], axis=1),
        np.concatenate([multiplier, push], axis=1),
    )


class _Residual:
    """What is missing at a point."""

    def __init__(self, rows: Rows, at: _Point) -> None:
        size, first = rows.size, rows.losses
        self.rows, self.at = rows, at
        push = at.multiplier
        self.z = up(rows.columns, at.x[:size])
        self.z -= rows.rhs
        self.plain = up(rows.plain, at.x[:size]) - rows.plain_rhs
        side = self.z[first:]
        #: Of the balance of x and of every τ, of the losses, of the sides, of the equations.
        self.balance = down(rows.columns, at.dual) + down(rows.plain, self.plain)
        self.surplus = rows.price - rows.peak.T @ (push[0, first:] + push[1, first:])
        self.force = self.z[:first] - rows.curvature * at.dual[:first]
        self.force += push[1, :first]
        self.force -= push[0, :first]
        self.lack = rows.limit - at.gap[:, first:]
        self.lack += rows.peak @ at.x[size:]
        self.lack[0] -= side
        self.lack[1] += side
        self.lack *= rows.on[:, first:]
        self.miss = rows.equation * (side - rows.limit[0])
        self.product = at.gap * push
        self.total = self.product.sum(axis=(0, 1))

    def error(self) -> Array:
        """The relative complementarity, or what is missing if that is worse, (B,)."""
        rows, at, first = self.rows, self.at, self.rows.losses
        size = np.abs(at.dual[:first] * self.z[:first]).sum(axis=0) + np.square(self.plain).sum(axis=0)
        size += (rows.price * at.x[rows.size :]).sum(axis=0)
        force = np.maximum(_largest(at.dual, self.plain), FLOOR)
        lack = self.lack / (1 + at.gap[:, first:])
        missing = _largest(0.1 * self.balance / force, self.force, *lack, self.miss, 0.1 * self.surplus)
        return np.maximum(self.total / np.maximum(size, FLOOR), 1e-2 * missing)


class _Newton:
    """The linear system at a point."""

    def __init__(self, now: _Residual) -> None:
        rows, at, size, first = now.rows, now.at, now.rows.size, now.rows.losses
        self.now = now
        self.inverse = rows.on / at.gap
        ratio = at.multiplier * self.inverse
        self.weight = ratio[0] + ratio[1]
        rise = rows.peak.T @ self.weight[first:]
        self.weight[:first] += rows.curvature
        np.divide(1.0, self.weight[:first], out=self.weight[:first])
        stiff = STIFF * rows.equation
        self.weight[first:] += stiff
        self.slope = ratio[0, first:] - ratio[1, first:]
        moved = ratio[:, first:] * now.lack
        self.offset = stiff * now.miss - moved[0] + moved[1]
        self.surplus = now.surplus + rows.peak.T @ (moved[0] + moved[1])
        gram = np.zeros((len(at.x), *at.x.shape))
        weighted = np.einsum("bpm,bm->bpm", rows.columns, np.ascontiguousarray(self.weight.T))
        gram[:size, :size] = np.moveaxis(weighted @ transpose(rows.columns), 0, -1)
        gram[:size, :size] += rows.gram
        for k, of_peak in enumerate(rows.peak.T, start=size):
            gram[:size, k] = gram[k, :size] = -down(rows.columns[:, :, first:], of_peak[:, None] * self.slope)
            gram[k, k] = rise[k - size]
        self.factor = factored(gram)

    def step(self, aim: Array) -> tuple[Array, Array, Array]:
        """The step of x and of the duals after which m would be `aim` − m Δg / g more, and Δg / g."""
        rows, now, size, first = self.now.rows, self.now, self.now.rows.size, self.now.rows.losses
        k = aim[0] - aim[1]
        np.subtract(now.force, k[:first], out=k[:first])
        k[:first] *= self.weight[:first]
        k[first:] += self.offset
        extra = rows.peak.T @ (aim[0, first:] + aim[1, first:]) - self.surplus
        x = solved(self.factor, np.concatenate([-now.balance - down(rows.columns, k), extra]))
        z, rise = up(rows.columns, x[:size]), rows.peak @ x[size:]
        relative = np.empty(aim.shape)
        np.add(now.lack, rise, out=relative[:, first:])
        relative[0, first:] -= z[first:]
        relative[1, first:] += z[first:]
        z *= self.weight
        z += k
        z[first:] -= self.slope * rise
        np.negative(z[:first], out=relative[0, :first])
        relative[1, :first] = z[:first]
        relative *= self.inverse
        return x, z, relative


def _advanced(now: _Residual, slow: BoolArray) -> _Point:
    """The next point: Mehrotra's, or nearer to the middle where that was slow."""
    system, at = _Newton(now), now.at
    relative = system.step(-at.multiplier)[2]
    worst = np.maximum(-relative.min(axis=(0, 1), initial=0.0), 1 + relative.max(axis=(0, 1), initial=-1.0))
    length = 1 / np.maximum(1.0, worst)
    # −Δg Δm of the predictor, whose Δm / m is −1 − Δg / g
    second = 1 + relative
    second *= relative
    second *= now.product
    ahead = np.maximum((1 - length) * now.total - length**2 * second.sum(axis=(0, 1)), 0.0)
    share = (ahead / np.maximum(now.total, TINY)) ** 3
    if slow.any():
        share = np.where(slow, np.maximum(share, CENTRING), share)
        second *= ~slow
    second -= now.product
    second += share * now.total / now.rows.pairs
    second *= system.inverse
    x, dual, relative = system.step(second)
    push = second
    push -= at.multiplier * relative
    worst = np.maximum(-relative.min(axis=(0, 1), initial=0.0), TINY)
    worst = np.maximum(worst, -(push / at.multiplier).min(axis=(0, 1), initial=0.0))
    length = np.minimum(1.0, SHARE / worst)
    if slow.any():
        cross = 2 * (at.gap * relative * push).sum(axis=(0, 1))
        length = np.where(slow & (cross > 0), np.minimum(length, (1 - share) * now.total / cross), length)
    for part in (x, dual, relative, push):
        part *= length
    relative += 1
    return _Point(at.x + x, at.dual + dual, at.gap * relative, at.multiplier + push)


def _follow(rows: Rows, tolerance: float) -> tuple[Array, Array, Array, npt.NDArray[np.int64]]:
    """The best x and duals of every member, their errors, and the iterations."""
    at = _start(rows)
    x, dual = at.x.copy(), at.dual.copy()
    members = np.arange(x.shape[1])
    error, done = np.full(len(members), np.inf), np.zeros(len(members), dtype=bool)
    iterations, since = np.zeros(len(members), dtype=np.int64), np.zeros(len(members), dtype=np.int64)
    for k in range(MAX_ITERATIONS + 1):
        now = _Residual(rows, at)
        worth = now.error()
        better = ~done[members] & (worth < error[members])
        where = members[better]
        x[:, where], dual[:, where], error[where] = at.x[:, better], at.dual[:, better], worth[better]
        iterations[members[~done[members]]] = k
        since[members] += 1
        since[where] = 0
        patience = np.where(error < ACCEPTED, PATIENCE, LONG_PATIENCE)
        done |= (error <= tolerance) | (since >= patience)
        left = ~done[members]
        if not left.any():
            break
        at = _advanced(now, since[members] >= SLOW)
        if left.mean() < COMPRESS:
            members, at, rows = members[left], at.take(left), rows.take(left)
    return x, dual, error, iterations


def _largest(*parts: Array) -> Array:
    """The largest size in any of several arrays, of each member."""
    return np.max([np.maximum(part.max(axis=0, initial=0.0), -part.min(axis=0, initial=0.0)) for part in parts], axis=0)
