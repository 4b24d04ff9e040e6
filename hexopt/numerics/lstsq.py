"""Batched linear least squares: by SVD of the column-scaled matrix, and by the normal equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, BoolArray, matvec, transpose

__all__ = ["LstsqSolution", "null_combinations", "solve_normal_equations", "solve_svd"]

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class LstsqSolution:
    """Solutions of ``min |A x − y|²`` and what is known of them.

    Attributes
    ----------
    values : ndarray, shape (..., p)
        NaN where the matrix is rank deficient.
    full_rank : ndarray of bool, shape (...)
    condition : ndarray, shape (...)
        Condition number of the matrix with columns scaled to unit length.
    inverse : ndarray, shape (..., p, m)
        The pseudo-inverse; NaN where rank deficient.
    objective : ndarray, shape (...)
        ``|A x − y|²/2`` at the returned values.
    gap : ndarray, shape (...)
        Objective minus the dual bound from the returned residual: ``|U'(A x − y)|²/2``.
    """

    values: Array
    full_rank: BoolArray
    condition: Array
    inverse: Array
    objective: Array
    gap: Array


def _column_scale(matrix: Array) -> Array:
    scale = np.sqrt(np.einsum("...mp,...mp->...p", matrix, matrix))
    scale[scale == 0] = 1.0
    return scale


def rank_tolerance(rows: int, columns: int) -> float:
    """Singular values below this share of the largest are rounding."""
    return 4.0 * max(rows, columns) * EPS


def solve_svd(matrix: Array, rhs: Array) -> LstsqSolution:
    r"""Least squares by the singular values of the column-scaled matrix, batched.

    Parameters
    ----------
    matrix : ndarray, shape (..., m, p)
        With m ≥ p.
    rhs : ndarray, shape (..., m)

    Notes
    -----
    With :math:`A = U \Sigma V^T T` (T the column lengths), :math:`x = T^{-1} V \Sigma^{-1} U^T y`. The
    dual of least squares is :math:`\max_\nu -\tfrac12|\nu|^2 - \nu^T y` with :math:`A^T\nu = 0`; the
    returned residual r, projected on that null space, is feasible and leaves the gap
    :math:`\tfrac12|U^T r|^2`.
    """
    scale = _column_scale(matrix)
    u, s, vt = np.linalg.svd(matrix / scale[..., None, :], full_matrices=False)
    full_rank: BoolArray = s[..., -1] > rank_tolerance(*matrix.shape[-2:]) * s[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(full_rank, s[..., 0] / s[..., -1], np.inf)
        weights = np.where(full_rank[..., None], 1.0 / s, np.nan)
    left = transpose(u)
    back = transpose(vt) * weights[..., None, :] / scale[..., :, None]
    values = matvec(back, matvec(left, rhs))
    residual = matvec(matrix, values) - rhs
    projected = matvec(left, residual)
    return LstsqSolution(
        values,
        full_rank,
        condition,
        back @ left,
        0.5 * np.einsum("...m,...m->...", residual, residual),
        0.5 * np.einsum("...p,...p->...", projected, projected),
    )


def solve_normal_equations(matrix: Array, rhs: Array) -> LstsqSolution:
    r"""Least squares as the paper writes it, :math:`x = (A^T A)^{-1} A^T y`, batched.

    The condition number is squared on the way: where :math:`\kappa^2` reaches 1/eps, no digit is left.
    """
    transposed = transpose(matrix)
    gram = transposed @ matrix
    scale = _column_scale(matrix)
    eigenvalues = np.linalg.eigvalsh(gram / scale[..., None, :] / scale[..., :, None])
    full_rank: BoolArray = eigenvalues[..., 0] > rank_tolerance(*matrix.shape[-2:]) * eigenvalues[..., -1]
    safe = np.where(full_rank[..., None, None], gram, np.eye(matrix.shape[-1]))
    inverse = np.linalg.inv(safe)
    inverse[~full_rank] = np.nan
    values = matvec(inverse, matvec(transposed, rhs))
    residual = matvec(matrix, values) - rhs
    gradient = matvec(transposed, residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(full_rank, np.sqrt(eigenvalues[..., -1] / eigenvalues[..., 0]), np.inf)
    return LstsqSolution(
        values,
        full_rank,
        condition,
        inverse @ transposed,
        0.5 * np.einsum("...m,...m->...", residual, residual),
        0.5 * np.abs(np.einsum("...p,...pq,...q->...", gradient, inverse, gradient)),
    )


def null_combinations(matrix: Array) -> Array:
    """Directions that one matrix (m, p) does not see, in the units of its parameters, shape (k, p).

    The basis is brought to row-echelon form, so that unseen combinations that involve few
    parameters are shown as such.
    """
    scale = _column_scale(matrix)
    _, s, vt = np.linalg.svd(matrix / scale)
    tolerance = rank_tolerance(*matrix.shape) * (s[0] if s.size else 1.0)
    rank = int((s > tolerance).sum())
    basis = vt[rank:] / scale
    basis /= np.abs(basis).max(axis=1, keepdims=True, initial=1e-300)
    for row in range(len(basis)):
        pivot = int(np.argmax(np.abs(basis[row])))
        basis[row] /= basis[row, pivot]
        others = [other for other in range(len(basis)) if other != row]
        basis[others] -= basis[others, pivot : pivot + 1] * basis[row]
    basis[np.abs(basis) < 1e-9] = 0.0
    return basis
