r"""The blocks of a conic dual: every term and constraint of a programme in normalised dual variables.

What they say together stands in :mod:`hexopt.numerics.conic`. A bound that is infinite for a member has a zero
column at cost 1, which makes its multiplier zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, BoolArray, norm
from .programme import Ball, Interval, Programme, Term

__all__ = ["Block", "Rows", "blocks_of", "pattern_of", "rows_of", "sides_of", "unit_of"]

#: In normalised units: bounds farther than FAR are left out, and duals of rows are held below CAP.
FAR, CAP = 1e6, 1e3
#: A multiplier below this share of its slack is zero.
INACTIVE = 1e-3

Rows = tuple[BoolArray, BoolArray, BoolArray]  # of an interval: the equations, those with an upper, with a lower bound


@dataclass(frozen=True, eq=False)
class Block:
    """Dual variables v of a term or a constraint: limits − cone·v lies in the cones."""

    coupling: Array  # (B, n, p), of the balance Σ couplingᵀv = 0
    cost: Array  # (B, n)
    cone: Any  # sparse (r, n)
    limits: Array  # (B, r)
    cones: list[tuple[str, int]]
    read: Callable[[Array, Array], Array]  # multipliers (B, q) of the programme, from v and the slacks of its cones
    curvature: int = 0


def unit_of(programme: Programme) -> Array:
    """The unit of residuals, (B,): of the objective at zero, and of how far zero is from feasible."""
    value = programme.objective(np.zeros(programme.lower.shape))
    unit = 2 * value / _force(programme, np.sqrt(2 * value) + 1e-300)
    for side in sides_of(programme):
        apart = np.maximum(np.maximum(side.lower, -side.upper), 0.0) / _lengths(side.matrix)
        unit = np.maximum(unit, apart.max(axis=-1, initial=0.0))
    for ball in programme.balls:
        unit = np.maximum(unit, (norm(ball.centre) - ball.radius) / _lengths(ball.matrix).max(axis=-1))
    return np.where(unit > 1e-150, unit, 1.0)


def _force(programme: Programme, unit: Array) -> Array:
    """The unit of duals, (B,): that of residuals, unless no loss has a square."""
    if any(term.loss.curvature for term in programme.terms):
        return unit
    return np.full(unit.shape, max(term.loss.bound for term in programme.terms))


def _lengths(matrix: Array) -> Array:
    """Lengths of rows, 1 for empty ones."""
    length = norm(matrix)
    return np.where(length > 0, length, 1.0)


def sides_of(programme: Programme) -> list[Interval]:
    """The box, and the intervals."""
    eye = np.broadcast_to(np.eye(programme.size), (programme.batch, programme.size, programme.size))
    return [Interval(eye, programme.lower, programme.upper), *programme.intervals]


def rows_of(side: Interval) -> Rows:
    """Which rows are equations for all members, and which others have an upper or a lower bound for some."""
    equal = (side.lower == side.upper).all(axis=0)
    return equal, ~equal & np.isfinite(side.upper).any(axis=0), ~equal & np.isfinite(side.lower).any(axis=0)


def pattern_of(programme: Programme, rows: list[Rows]) -> BoolArray:
    """Which coefficients of the balance are not zero for some member, (n, p)."""
    parts = []
    for term in programme.terms:
        mask = (term.matrix != 0).any(axis=0)
        parts += [mask, np.zeros_like(mask)] if term.loss.per == "all" else [mask]
    for side, chosen in zip(sides_of(programme), rows, strict=True):
        parts += [(side.matrix[:, which] != 0).any(axis=0) for which in chosen]
    for ball in programme.balls:
        parts += [(ball.matrix != 0).any(axis=0), np.zeros((1, programme.size), dtype=bool)]
    return np.concatenate(parts)


def blocks_of(programme: Programme, rows: list[Rows], unit: Array) -> list[Block]:
    """Every term and constraint, residuals in a unit (B,)."""
    units = unit[:, None], _force(programme, unit)[:, None]
    blocks = [_of_term(term, *units) for term in programme.terms]
    blocks += [_of_side(side, chosen, *units) for side, chosen in zip(sides_of(programme), rows, strict=True)]
    return blocks + [_of_ball(ball, *units) for ball in programme.balls]


def _of_term(term: Term, unit: Array, force: Array) -> Block:
    import scipy.sparse as sp

    count, size, per = term.matrix.shape[1], term.size, term.loss.per
    coupling, cost, eye = term.matrix, term.rhs / unit, sp.eye(count)
    bound = np.minimum(term.loss.bound / force, CAP)
    cones: list[tuple[str, int]] = []
    if not np.isfinite(term.loss.bound):
        cone, limits = sp.csc_matrix((0, count)), bound[:, :0]
    elif per == "row":
        cone, limits, cones = sp.vstack([eye, -eye]), np.repeat(bound, 2 * count, axis=1), [("row", 2 * count)]
    elif per == "pose":
        cone = sp.kron(sp.eye(count // size), sp.vstack([sp.csc_matrix((1, size)), -sp.eye(size)]))
        limits = bound * np.tile(np.arange(size + 1) == 0, count // size)
        cones = [("ball", size + 1)] * (count // size)
    else:  # |u| ≤ e, Σe ≤ bound
        coupling, cost = (np.concatenate([part, np.zeros_like(part)], axis=1) for part in (coupling, cost))
        cone = sp.bmat([[eye, -eye], [-eye, -eye], [None, np.ones((1, count))]])
        limits = bound * (np.arange(2 * count + 1) == 2 * count)
        cones = [("row", 2 * count + 1)]
    return Block(coupling, cost, cone, limits, cones, lambda v, slack: force * v[:, :count], term.loss.curvature or 0)


def _of_side(side: Interval, rows: Rows, unit: Array, force: Array) -> Block:
    import scipy.sparse as sp

    equal, up, low = rows
    length = _lengths(side.matrix)
    matrix, upper, lower = side.matrix / length[..., None], side.upper / (unit * length), side.lower / (unit * length)
    coupling = np.concatenate([matrix[:, equal], matrix[:, up], -matrix[:, low]], axis=1)
    cost = np.concatenate([upper[:, equal], upper[:, up], -lower[:, low]], axis=1)
    free, above = int(equal.sum()), int(equal.sum() + up.sum())
    bounded = cost.shape[1] - free
    vacuous = (cost > FAR) & (np.arange(cost.shape[1]) >= free)

    def read(v: Array, slack: Array) -> Array:
        net = np.zeros(side.lower.shape)
        inactive = np.concatenate([np.zeros_like(v[:, :free]), INACTIVE * slack], axis=1)
        v = np.where(vacuous | ((np.arange(v.shape[1]) >= free) & (v <= inactive)), 0.0, v)
        net[:, equal] = v[:, :free]
        net[:, up] += v[:, free:above]
        net[:, low] -= v[:, above:]
        return net * force / length

    coupling, cost = np.where(vacuous[..., None], 0.0, coupling), np.where(vacuous, 1.0, cost)
    cone = sp.hstack([sp.csc_matrix((bounded, free)), -sp.eye(bounded)])
    return Block(coupling, cost, cone, np.zeros((len(unit), bounded)), [("row", bounded)] if bounded else [], read)


def _of_ball(ball: Ball, unit: Array, force: Array) -> Block:
    import scipy.sparse as sp

    size = ball.centre.shape[-1]
    length = _lengths(ball.matrix).max(axis=-1)[:, None]
    centre, radius = ball.centre / (unit * length), ball.radius[:, None] / (unit * length)
    vacuous = radius > FAR + norm(centre)[:, None]

    def read(v: Array, slack: Array) -> Array:
        room = slack[:, :1] - norm(slack[:, 1:])[:, None]
        inactive = vacuous | (norm(v[:, :-1])[:, None] <= INACTIVE * room)
        return np.where(inactive, 0.0, v[:, :-1] * force / length)

    coupling = np.where(vacuous[..., None], 0.0, ball.matrix / length[..., None])
    coupling = np.concatenate([coupling, np.zeros_like(coupling[:, :1])], axis=1)
    cost = np.where(vacuous, np.eye(size + 1)[size], np.concatenate([centre, radius], axis=1))
    cone = sp.bmat([[None, -sp.eye(1)], [-sp.eye(size), None]])
    return Block(coupling, cost, cone, np.zeros((len(unit), size + 1)), [("ball", size + 1)], read)
