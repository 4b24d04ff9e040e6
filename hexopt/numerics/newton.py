r"""Batched projected Newton for smooth losses: least squares, Huber's losses, priors and boxes.

.. math:: x \leftarrow \Pi_{[l, h]}\bigl(x - t H_F^{-1} g_F\bigr),\quad
          g = \sum_j A_j^T\psi_j(z_j),\quad H = \sum_j A_j^T\psi_j'(z_j) A_j,

where F are the coordinates that no bound holds against the gradient (Bertsekas 1982). For losses that are
quadratic piece by piece the iteration ends after finitely many steps (Madsen and Nielsen 1990). The gradient is
taken from the residuals themselves at every step, so that each step also refines the one before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray
from .programme import Programme, Solution, Term

__all__ = ["newton_solves", "solve_newton"]

Index = npt.NDArray[np.int64]

#: Half the squared Newton decrement, relative to max(1, objective), at which the iteration ends.
TOLERANCE = 1e-15
MAX_ITERATIONS = 100
#: How often a step is halved before it is dropped.
MAX_HALVINGS = 6
#: Share of the predicted decrease that a step must reach, and the rounding of the objective that it may lose.
DECREASE, ROUNDING = 1e-4, 1e-14
#: A matrix is compacted when fewer than this share of its members still iterate.
COMPACT = 0.75


def newton_solves(programme: Programme) -> bool:
    """Whether all losses are smooth, and the only constraint is a box."""
    return all(term.loss.smooth for term in programme.terms) and not (programme.intervals or programme.balls)


def solve_newton(programme: Programme, start: Array | None = None) -> Solution:
    """Minimise a programme of smooth losses in a box, each member of the batch by itself; use scaled variables.

    Parameters
    ----------
    programme : Programme
    start : ndarray, shape (B, p), optional
        By default the least-squares solution of all rows; members that are not finite there start at zero.
    """
    x = np.nan_to_num(_least_squares(programme) if start is None else start)
    x = np.clip(x, programme.lower, programme.upper)
    values, converged = x.copy(), np.zeros(programme.batch, dtype=bool)
    iterations = np.zeros(programme.batch, dtype=np.int64)
    state = _at(programme, np.arange(programme.batch), x)
    for _ in range(MAX_ITERATIONS if programme.batch else 0):
        gradient, step = _newton_step(state)
        decrement = -0.5 * np.einsum("...p,...p->...", gradient, step)
        settled = decrement <= TOLERANCE * np.maximum(1.0, state.objective)
        moved, found = _advanced(state, gradient, step)
        values[state.index], converged[state.index] = moved.x, settled
        iterations[state.index] += 1
        keep = ~settled & (found | ~state.cautious)
        if not keep.any():
            break
        state = moved if keep.mean() > COMPACT else moved.chosen(keep)
    return Solution(values, converged, iterations)


@dataclass(eq=False)
class _State:
    """Where the members that still iterate are."""

    programme: Programme
    index: Index  # their places in the chunk
    x: Array
    z: list[Array]
    objective: Array
    cautious: BoolArray  # whose last full step did not decrease the objective

    def chosen(self, keep: BoolArray) -> _State:
        return _State(
            self.programme.take(keep),
            self.index[keep],
            self.x[keep],
            [z[keep] for z in self.z],
            self.objective[keep],
            self.cautious[keep],
        )


def _at(programme: Programme, index: Index, x: Array) -> _State:
    z = [term.residual(x) for term in programme.terms]
    total = sum(term.loss.total(part) for term, part in zip(programme.terms, z, strict=True))
    return _State(programme, index, x, z, np.asarray(total), np.zeros(len(x), dtype=bool))


def _least_squares(programme: Programme) -> Array:
    """The least-squares solution of all rows."""
    gram = sum(term.columns @ term.matrix for term in programme.terms)
    back = sum(term.pulled(term.rhs) for term in programme.terms)
    return np.linalg.solve(_regular(np.asarray(gram)), np.asarray(back)[..., None])[..., 0]


def _newton_step(state: _State) -> tuple[Array, Array]:
    """The gradient and the step in the coordinates that no bound holds; both zero in the others."""
    terms, z = state.programme.terms, state.z
    gradient = np.asarray(sum(term.pulled(term.loss.psi(part)) for term, part in zip(terms, z, strict=True)))
    hessian = np.asarray(sum(term.gram(part) for term, part in zip(terms, z, strict=True)))
    if state.cautious.any():
        bad = state.cautious
        hessian[bad] = sum(_majorant(term, part, bad) for term, part in zip(terms, z, strict=True))
    held = (state.x >= state.programme.upper) & (gradient < 0) | (state.x <= state.programme.lower) & (gradient > 0)
    gradient = np.where(held, 0.0, gradient)
    if held.any():
        free = ~held
        hessian = np.where(free[:, :, None] & free[:, None, :], hessian, 0.0) + held[:, :, None] * np.eye(held.shape[1])
    return gradient, -np.linalg.solve(_regular(hessian), gradient[..., None])[..., 0]


def _majorant(term: Term, z: Array, which: BoolArray) -> Array:
    """AᵀwA with the weights of re-weighted least squares, whose full step never increases the objective."""
    weight = term.loss.weight(z[which])
    matrix = term.matrix[which]
    weights = np.broadcast_to(weight.reshape(*weight.shape, *(1,) * (3 - weight.ndim)), z[which].shape)
    return np.asarray(np.swapaxes(matrix, -1, -2) @ (weights.reshape(matrix.shape[:-1])[..., None] * matrix))


def _regular(hessian: Array) -> Array:
    """With a diagonal too small to matter, so that no member is exactly singular; columns have unit length."""
    finite = np.asarray(np.isfinite(hessian).all(axis=(-2, -1)))
    eye = np.eye(hessian.shape[-1])
    if not finite.all():
        hessian = np.where(finite[:, None, None], hessian, eye)
    return hessian + 1e-13 * eye


def _advanced(state: _State, gradient: Array, step: Array) -> tuple[_State, BoolArray]:
    """The state after a step, halved where the objective asks for it, and whether one was found."""
    box = state.programme
    moved = _at(box, state.index, np.clip(state.x + step, box.lower, box.upper))
    good = _decreased(state, moved, gradient)
    moved.cautious = ~good
    for halving in range(1, MAX_HALVINGS + 1):
        if good.all():
            break
        bad = np.flatnonzero(~good)
        part = box.take(bad)
        tried = _at(part, state.index[bad], np.clip(state.x[bad] + 0.5**halving * step[bad], part.lower, part.upper))
        for target, source in zip(
            [moved.x, moved.objective, *moved.z], [tried.x, tried.objective, *tried.z], strict=True
        ):
            target[bad] = source
        good[bad] = _decreased(state, moved, gradient)[bad]
    if not good.all():
        for target, source in zip(
            [moved.x, moved.objective, *moved.z], [state.x, state.objective, *state.z], strict=True
        ):
            target[~good] = source[~good]
    return moved, good


def _decreased(before: _State, after: _State, gradient: Array) -> BoolArray:
    slope = np.einsum("...p,...p->...", gradient, after.x - before.x)
    allowed = before.objective + DECREASE * slope + ROUNDING * np.abs(before.objective)
    return np.asarray(after.objective <= allowed)
