r"""The certificate of any point of a programme: its duals balanced, and the gap that they leave.

With the duals of :mod:`hexopt.numerics.programme`, for every x inside the constraints and every balanced dual,
objective minus dual value is a sum of terms that are none negative,

.. math:: \sum_j \rho_j(z_j) + \rho_j^*(u_j) - u_j^T z_j
          + \sum \beta^+ (h - x) + \beta^- (x - l) + \dots + \sum_k r_k \lVert v_k\rVert - v_k^T(E_k x - c_k),

so it is computed without cancellation, and it bounds how far x is from optimal whoever found x.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, BoolArray, matvec, norm, transpose
from .inverse import spd_inverse
from .programme import Programme, Solution, Term, transposed_product

__all__ = ["NEAR", "Certificate", "certify"]

#: Rounds of restoring the balance: the first does it, the others take away its rounding.
ROUNDS = 3
#: An imbalance of this share of the largest force is rounding, in columns of unit length.
ROUNDING = 1e-14
#: How near a bound, relative to 1 + |x|, a multiplier may stand there.
NEAR = 1e-8
#: The least freedom of a dual: it moves where nothing else can.
ROOM = 1e-10


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven of a point.

    Attributes
    ----------
    gap : ndarray, shape (B,)
        Objective minus the dual value.
    primal_residual : ndarray, shape (B,)
        The largest violation of a constraint.
    dual_residual : ndarray, shape (B,)
        The largest imbalance that is left of the duals.
    imbalance : ndarray, shape (B, p)
        What is left, entry by entry.
    rows, box, intervals, balls
        The balanced duals.
    """

    gap: Array
    primal_residual: Array
    dual_residual: Array
    imbalance: Array
    rows: tuple[Array, ...]
    box: Array
    intervals: tuple[Array, ...]
    balls: tuple[Array, ...]


def certify(programme: Programme, solution: Solution) -> Certificate:
    """Balance the duals of a solution, and bound its distance from optimal; use scaled variables.

    The claimed duals (or ψ of the residuals) are first brought into balance where that costs least: along
    rows whose dual is inside its domain, and along active constraints. Then all are shrunk into the domain.
    """
    x = solution.values
    z = [term.residual(x) for term in programme.terms]
    if solution.rows is None:
        u = [term.loss.psi(part) for term, part in zip(programme.terms, z, strict=True)]
    else:
        u = [term.blocks(part) for term, part in zip(programme.terms, solution.rows, strict=True)]
    sides = [one.matrix for one in programme.intervals] + [one.matrix for one in programme.balls]
    w = [*solution.intervals, *solution.balls] or [np.zeros(side.shape[:-1]) for side in sides]
    u, w, left = _balanced(programme, x, z, u, w, sides)
    box = np.where(_absorbs(programme, x, left), -left, 0.0)
    shrink = np.min([term.loss.shrink(part) for term, part in zip(programme.terms, u, strict=True)], axis=0)
    u = [shrink[:, None, None] * part for part in u]
    w = [shrink[:, None] * part for part in w]
    box = shrink[:, None] * box
    left = shrink[:, None] * left + box
    gap = np.asarray(sum(t.loss.excess(a, b) for t, a, b in zip(programme.terms, z, u, strict=True)))
    gap = gap + _slackness(box, x, programme.lower, programme.upper)
    violation = _violation(x, programme.lower, programme.upper)
    count = len(programme.intervals)
    for one, multiplier in zip(programme.intervals, w[:count], strict=True):
        side = matvec(one.matrix, x)
        gap = gap + _slackness(multiplier, side, one.lower, one.upper)
        violation = np.maximum(violation, _violation(side, one.lower, one.upper))
    for ball, multiplier in zip(programme.balls, w[count:], strict=True):
        side = matvec(ball.matrix, x) - ball.centre
        along = np.einsum("...q,...q->...", multiplier, side)
        gap = gap + np.abs(ball.radius * norm(multiplier) - along)
        violation = np.maximum(violation, norm(side) - ball.radius)
    return Certificate(
        gap,
        np.maximum(violation, 0.0),
        np.abs(left).max(axis=-1, initial=0.0),
        left,
        tuple(part.reshape(term.rhs.shape) for term, part in zip(programme.terms, u, strict=True)),
        box,
        tuple(w[:count]),
        tuple(w[count:]),
    )


def _balanced(
    programme: Programme, x: Array, z: list[Array], u: list[Array], w: list[Array], sides: list[Array]
) -> tuple[list[Array], list[Array], Array]:
    """The duals moved until they balance but for what the box takes, and what is left."""

    def imbalance() -> Array:
        pulled = [term.pulled(part) for term, part in zip(programme.terms, u, strict=True)]
        pulled += [transposed_product(side, part) for side, part in zip(sides, w, strict=True)]
        return np.asarray(sum(pulled))

    left = imbalance()
    taken = _absorbs(programme, x, left)
    if _is_rounding(np.where(taken, 0.0, left), u):
        return u, w, left
    freed = [_freed(t, a, b) for t, a, b in zip(programme.terms, z, u, strict=True)]
    held = [transpose(share[..., None] * side) for side, share in zip(sides, _held(programme, x, w), strict=True)]
    matrices = [term.matrix for term in programme.terms] + sides
    gram = np.asarray(sum(free @ matrix for matrix, free in zip(matrices, freed + held, strict=True)))
    inverse = _regular_inverse(gram, taken)
    for _ in range(ROUNDS):
        step = matvec(inverse, np.where(taken, 0.0, left))
        u = [part - (step[:, None, :] @ free).reshape(part.shape) for part, free in zip(u, freed, strict=True)]
        w = [part - (step[:, None, :] @ free)[:, 0] for part, free in zip(w, held, strict=True)]
        w = _signed(programme, w)
        left = imbalance()
    return u, w, left


def _is_rounding(left: Array, u: list[Array]) -> bool:
    """Whether an imbalance is no more than what the sums of the forces round."""
    force = np.max([np.abs(part).max(initial=0.0) for part in u])
    return bool(np.abs(left).max(initial=0.0) <= ROUNDING * (1 + force))


def _held(programme: Programme, x: Array, w: list[Array]) -> list[Array]:
    """How surely each constraint holds x, between 0 and 1, (B, q): its multiplier beside its slack."""
    shares = []
    for one, force in zip(programme.intervals, w, strict=False):
        side = matvec(one.matrix, x)
        slack = np.where(force > 0, one.upper - side, side - one.lower)
        share = _share(np.abs(force), np.abs(slack))
        shares.append(np.where(one.lower == one.upper, 1.0, share))
    for ball, force in zip(programme.balls, w[len(programme.intervals) :], strict=True):
        slack = np.abs(ball.radius - norm(matvec(ball.matrix, x) - ball.centre))
        shares.append(np.broadcast_to(_share(norm(force), slack)[:, None], force.shape))
    return shares


def _share(force: Array, slack: Array) -> Array:
    """f²/(f² + s²), and 0 where both are 0."""
    ratio = np.divide(slack, force, out=np.full(force.shape, np.inf), where=force > 0)
    share: Array = 1.0 / (1.0 + np.square(ratio))
    return share


def _signed(programme: Programme, w: list[Array]) -> list[Array]:
    """Multipliers without those of a side that has no bound."""
    out = list(w)
    for i, one in enumerate(programme.intervals):
        out[i] = np.where(np.isfinite(one.upper), w[i], np.minimum(w[i], 0.0))
        out[i] = np.where(np.isfinite(one.lower), out[i], np.maximum(out[i], 0.0))
    return out


def _freed(term: Term, z: Array, u: Array) -> Array:
    """The columns of a term times how freely its duals move, (B, p, m)."""
    return term.acted(lambda rows: term.loss.freed(z, u, rows) + ROOM * rows)


def _regular_inverse(gram: Array, taken: BoolArray) -> Array:
    """Inverse of a Gram matrix without the coordinates that are taken, regularised where it is singular."""
    size = gram.shape[-1]
    keep = ~taken
    part = np.where(keep[:, :, None] & keep[:, None, :], gram, 0.0)
    level = np.maximum(np.einsum("...ii->...i", part).max(axis=-1), 1e-300)
    part = part + np.where(keep, 1e-14, 1.0)[:, :, None] * np.eye(size) * level[:, None, None]
    return np.where(keep[:, :, None] & keep[:, None, :], spd_inverse(part), 0.0)


def _absorbs(programme: Programme, x: Array, left: Array) -> BoolArray:
    """Coordinates near a bound whose multiplier −left has that bound's sign; how near counts in the gap."""
    near = NEAR * (1 + np.abs(x))
    at_upper, at_lower = x >= programme.upper - near, x <= programme.lower + near
    return (at_upper & (left <= 0)) | (at_lower & (left >= 0))


def _slackness(multiplier: Array, side: Array, lower: Array, upper: Array) -> Array:
    """Σ w⁺|upper − side| + w⁻|side − lower|, where an infinite bound costs nothing without a multiplier."""
    room = np.where(multiplier > 0, upper - side, side - lower)
    return np.abs(np.multiply(multiplier, room, out=np.zeros(room.shape), where=multiplier != 0)).sum(axis=-1)


def _violation(side: Array, lower: Array, upper: Array) -> Array:
    return np.maximum(lower - side, side - upper).max(axis=-1, initial=0.0)
