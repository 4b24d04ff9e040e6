r"""Newton's method on the constraints and kinks that hold an answer: the last digits that conic solvers leave.

An interior-point answer of cone programmes is right to about 1e-9. It shows which constraints are active, which
residuals of nonsmooth losses are zero, and roughly how strong their forces are. With these as equations h(x) = 0 the
rest f is smooth, and the step

.. math:: \begin{pmatrix} \nabla^2 f + \sum_k \mu_k E_k^T E_k & N^T\\ N & 0\end{pmatrix}
          \begin{pmatrix} \Delta x\\ \lambda\end{pmatrix} = -\begin{pmatrix}\nabla f\\ h\end{pmatrix},
          \quad N = \nabla h,

converges quadratically; :math:`\mu_k` are the multipliers of active balls. Nothing is trusted: the polished answer
counts only if its certificate is the better one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ..arrays import Array, BoolArray, norm
from .certificate import NEAR
from .programme import Ball, Programme, Solution, Term

__all__ = ["polish"]

STEPS = 4


@dataclass(eq=False)
class _Equations:
    """Active constraints of one member at x: their rows (q, p), what they miss (q,), who takes their forces."""

    rows: list[Array] = field(default_factory=list)
    missing: list[Array] = field(default_factory=list)
    takers: list[Callable[[Array, Array], None]] = field(default_factory=list)

    def add(self, rows: Array, missing: Array, taker: Callable[[Array, Array], None]) -> None:
        """Equations rows · Δx = −missing; `taker` is called with their multipliers and the new x."""
        if len(rows):
            self.rows.append(rows)
            self.missing.append(missing)
            self.takers.append(taker)


def _into(dual: Array, where: BoolArray) -> Callable[[Array, Array], None]:
    def take(force: Array, x: Array) -> None:
        dual[where] = force

    return take


def _along(dual: Array, ball: Ball) -> Callable[[Array, Array], None]:
    def take(force: Array, x: Array) -> None:
        dual[:] = force[0] * (ball.matrix[0] @ x - ball.centre[0]) / ball.radius[0]

    return take


def polish(programme: Programme, solution: Solution) -> Solution:
    """The solution after a few Newton steps of every member, one by one; members without claimed duals stay."""
    if solution.rows is None or any(term.loss.per == "all" for term in programme.terms):
        return solution
    duals = [np.array(part) for part in (*solution.rows, *solution.intervals, *solution.balls)]
    values = np.array(solution.values)
    for i in np.flatnonzero(np.isfinite(values).all(axis=-1)):
        one = programme.take(slice(i, i + 1))
        own = [part[i].copy() for part in duals]
        x = values[i]
        for _ in range(STEPS):
            if np.isfinite(x).all():
                x, own = _step(one, x, own)
        if np.isfinite(x).all() and all(np.isfinite(part).all() for part in own):
            values[i] = np.clip(x, programme.lower[i], programme.upper[i])
            for target, source in zip(duals, own, strict=True):
                target[i] = source
    ends = np.cumsum([len(programme.terms), len(programme.intervals)])
    return replace(
        solution,
        values=values,
        rows=tuple(duals[: ends[0]]),
        intervals=tuple(duals[ends[0] : ends[1]]),
        balls=tuple(duals[ends[1] :]),
    )


def _step(one: Programme, x: Array, duals: list[Array]) -> tuple[Array, list[Array]]:
    """One step of one member, and its duals after it."""
    held, count = _Equations(), len(one.terms)
    gradient, hessian = np.zeros(one.size), np.zeros((one.size, one.size))
    fresh = [np.zeros_like(part) for part in duals]
    for term, old, new in zip(one.terms, duals, fresh, strict=False):
        slope, curvature = _term(term, x, old, new, held)
        gradient, hessian = gradient + slope, hessian + curvature
    for part, old, new in zip(one.intervals, duals[count:], fresh[count:], strict=False):
        side, target = part.matrix[0] @ x, np.where(old > 0, part.upper[0], part.lower[0])
        slack = np.abs(np.where(np.isfinite(target), side - target, np.inf))
        active = (np.abs(old) > slack) | (part.lower[0] == part.upper[0])
        held.add(part.matrix[0][active], (side - target)[active], _into(new, active))
    last = count + len(one.intervals)
    for ball, old, new in zip(one.balls, duals[last:], fresh[last:], strict=True):
        side, radius, force = ball.matrix[0] @ x - ball.centre[0], ball.radius[0], float(norm(old))
        if force > abs(radius - norm(side)):
            hessian = hessian + force / radius * ball.matrix[0].T @ ball.matrix[0]
            miss = np.array([(side @ side - radius**2) / (2 * radius)])
            held.add((side @ ball.matrix[0])[None] / radius, miss, _along(new, ball))
    _box(one, x, duals, held)
    x = _solved(x, gradient, hessian, held)
    return x, fresh


def _term(term: Term, x: Array, old: Array, new: Array, held: _Equations) -> tuple[Array, Array]:
    """Gradient and Hessian of the smooth part of a term; its kinks become equations, its other duals are set."""
    z = term.residual(x[None])
    u = term.loss.psi(z)
    smooth = np.ones(z.shape[1:], dtype=bool)
    if not term.loss.smooth:
        away, force = _sizes(term, z[0]), _sizes(term, old.reshape(z.shape[1:]))
        smooth = away > np.maximum(1 - force / term.loss.bound, 0.0)
        held.add(term.matrix[0][~smooth.ravel()], z[0][~smooth], _into(new, ~smooth.ravel()))
    u = np.where(smooth, u, 0.0)
    new[:] = u.ravel()
    blocks = term.matrix.reshape(*z.shape, term.matrix.shape[-1])
    curved = np.where(smooth[None, :, :, None], term.loss.curved(z, blocks), 0.0).reshape(term.matrix.shape)
    return term.pulled(u)[0], term.matrix[0].T @ curved[0]


def _sizes(term: Term, blocks: Array) -> Array:
    """What a nonsmooth loss looks at: the size of each row, or of each block, shape (k, d)."""
    if term.loss.per == "pose":
        return np.broadcast_to(norm(blocks)[:, None], blocks.shape)
    return np.abs(blocks)


def _box(one: Programme, x: Array, duals: list[Array], held: _Equations) -> None:
    """Bounds near which x stands, with a force towards them."""
    matrices = [term.matrix[0] for term in one.terms] + [part.matrix[0] for part in one.intervals]
    matrices += [ball.matrix[0] for ball in one.balls]
    force = -np.asarray(sum(part @ matrix for matrix, part in zip(matrices, duals, strict=True)))
    near = NEAR * (1 + np.abs(x))
    for bound, active in (
        (one.upper[0], (x >= one.upper[0] - near) & (force > 0)),
        (one.lower[0], (x <= one.lower[0] + near) & (force < 0)),
    ):
        held.add(np.eye(one.size)[active], (x - bound)[active], lambda force, x: None)


def _solved(x: Array, gradient: Array, hessian: Array, held: _Equations) -> Array:
    """x after the step, whose multipliers are handed out; by least squares, as active constraints may repeat."""
    rows = np.concatenate([np.zeros((0, len(x))), *held.rows])
    missing = np.concatenate([np.zeros(0), *held.missing])
    matrix = np.block([[hessian, rows.T], [rows, np.zeros((len(rows), len(rows)))]])
    if not np.isfinite(matrix).all():
        return np.full(x.shape, np.nan)
    answer = np.linalg.lstsq(matrix, -np.concatenate([gradient, missing]), rcond=None)[0]
    x = x + answer[: len(x)]
    ends = np.cumsum([len(part) for part in held.rows])
    for taker, force in zip(held.takers, np.split(answer[len(x) :], ends)[: len(ends)], strict=True):
        taker(force, x)
    return x
