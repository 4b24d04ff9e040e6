"""Batched Levenberg–Marquardt for small dense problems."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Array, BoolArray, matvec, transpose
from .lstsq import solve_svd

__all__ = ["LMResult", "levenberg_marquardt"]

#: A step below this share of the scaled parameters ends the iteration; the polishing step follows.
STEP_TOLERANCE = 1e-9


@dataclass(frozen=True)
class LMResult:
    """Where each problem ended.

    Attributes
    ----------
    values : ndarray, shape (k, p)
    converged : ndarray of bool, shape (k,)
    iterations : ndarray of int, shape (k,)
    """

    values: Array
    converged: BoolArray
    iterations: np.ndarray


def levenberg_marquardt(
    evaluate: Callable[[Array], tuple[Array, Array]], start: Array, *, max_iterations: int = 100
) -> LMResult:
    r"""Minimise :math:`\tfrac12\lVert r(x)\rVert^2` for a batch of problems.

    Parameters
    ----------
    evaluate : callable
        Values (k, p) to residuals (k, m) and Jacobians (k, m, p).
    start : ndarray, shape (k, p)
    max_iterations : int, default 100

    Notes
    -----
    Marquardt's scaling by column lengths, damping by Nielsen's rule. Converged members are frozen. At
    the end one undamped step by SVD polishes every converged member: it is kept where it is small, and
    brings the accuracy of an orthogonal factorisation.
    """
    x = np.array(start, dtype=float)
    residual, jacobian = evaluate(x)
    cost = 0.5 * np.einsum("km,km->k", residual, residual)
    damping = np.full(len(x), 1e-3)
    growth = np.full(len(x), 2.0)
    converged = np.zeros(len(x), dtype=bool)
    iterations = np.zeros(len(x), dtype=int)
    for _ in range(max_iterations):
        active = ~converged & np.isfinite(cost)
        if not active.any():
            break
        step, relative, predicted = _damped_step(x, residual, jacobian, damping)
        trial = np.where(active[:, None], x + step, x)
        new_residual, new_jacobian = evaluate(trial)
        new_cost = 0.5 * np.einsum("km,km->k", new_residual, new_residual)
        small = active & (relative < STEP_TOLERANCE)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = (cost - new_cost) / predicted
        better = active & (new_cost <= cost) & np.isfinite(new_cost)
        x[better], residual[better], jacobian[better] = (
            trial[better],
            new_residual[better],
            new_jacobian[better],
        )
        cost = np.where(better, new_cost, cost)
        shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * np.clip(np.nan_to_num(ratio), 0.0, 1.0) - 1.0) ** 3)
        damping = np.where(better, np.maximum(damping * shrink, 1e-15), np.minimum(damping * growth, 1e15))
        growth = np.where(better, 2.0, np.minimum(2.0 * growth, 1e9))
        iterations += active
        converged |= small
    return LMResult(_polished(evaluate, x, residual, jacobian, converged), converged, iterations)


def _column_lengths(jacobian: Array) -> Array:
    lengths = np.sqrt(np.einsum("kmp,kmp->kp", jacobian, jacobian))
    lengths[~(lengths > 0)] = 1.0
    return lengths


def _damped_step(x: Array, residual: Array, jacobian: Array, damping: Array) -> tuple[Array, Array, Array]:
    """The step, its size relative to the scaled parameters, and the decrease that it predicts."""
    scale = _column_lengths(jacobian)
    scaled = jacobian / scale[:, None, :]
    gram = transpose(scaled) @ scaled
    gradient = matvec(transpose(scaled), residual)
    diagonal = np.arange(x.shape[1])
    gram[:, diagonal, diagonal] += damping[:, None]
    finite = np.isfinite(gram).all(axis=(1, 2))
    gram[~finite], gradient[~finite] = np.eye(x.shape[1]), 0.0
    scaled_step = -np.linalg.solve(gram, gradient[..., None])[..., 0]
    predicted = 0.5 * np.einsum("kp,kp->k", scaled_step, damping[:, None] * scaled_step - gradient)
    size = np.sqrt(np.einsum("kp,kp->k", scaled_step, scaled_step))
    reference = np.sqrt(np.einsum("kp,kp->k", scale * x, scale * x))
    return scaled_step / scale, size / (reference + 1e-300), predicted


def _polished(
    evaluate: Callable[[Array], tuple[Array, Array]],
    x: Array,
    residual: Array,
    jacobian: Array,
    converged: BoolArray,
) -> Array:
    finite = np.isfinite(jacobian).all(axis=(1, 2)) & np.isfinite(residual).all(axis=1)
    usable = converged & finite
    if not usable.any():
        return x
    solution = solve_svd(jacobian[usable], -residual[usable])
    scale = _column_lengths(jacobian[usable])
    step = np.where(solution.full_rank[:, None], solution.values, 0.0)
    reference = np.sqrt(((scale * x[usable]) ** 2).sum(axis=1))
    small = np.sqrt(((scale * step) ** 2).sum(axis=1)) < 1e-5 * reference
    out = x.copy()
    out[usable] += np.where(small[:, None], step, 0.0)
    return out
