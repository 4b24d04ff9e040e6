"""Batched linear least squares: by SVD of the column-scaled matrix, and by the normal equations."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..arrays import Array, BoolArray, matvec, transpose
from .inverse import spd_inverse

__all__ = ["LstsqSolution", "gram_condition", "null_combinations", "solve", "solve_normal_equations", "solve_svd"]

EPS = float(np.finfo(float).eps)
#: Up to this condition number one refinement gives the Gram route the accuracy of the SVD.
GRAM_LIMIT = 1e3
#: Problems that are worked on together: so many that calls cost little, so few that arrays stay in the cache.
CHUNK = 512


@dataclass(frozen=True)
class LstsqSolution:
    """Solutions of ``min |A x − y|²`` and what is known of them.

    Attributes
    ----------
    values : ndarray, shape (..., p)
        NaN where the matrix is rank deficient.
    full_rank : ndarray of bool, shape (...)
    condition : ndarray, shape (...)
        Condition number of the matrix with columns scaled to unit length, times its `cancellation`.
    inverse : ndarray, shape (..., p, m)
        The pseudo-inverse; NaN where rank deficient.
    objective : ndarray, shape (...)
        ``|A x − y|²/2`` at the returned values.
    gap : ndarray, shape (...)
        Objective minus the dual bound from the returned residual: ``|U'(A x − y)|²/2``.
    residual : ndarray, shape (..., m)
        ``A x − y``.
    imbalance : ndarray, shape (...)
        The largest entry of ``A'(A x − y)``, for columns of unit length (or of ``U'(A x − y)``).
    """

    values: Array
    full_rank: BoolArray
    condition: Array
    inverse: Array
    objective: Array
    gap: Array
    residual: Array
    imbalance: Array


def _column_scale(matrix: Array) -> Array:
    scale = np.sqrt(np.einsum("...mp,...mp->...p", matrix, matrix))
    scale[scale == 0] = 1.0
    return scale


def rank_tolerance(rows: int, columns: int) -> float:
    """Singular values below this share of the largest are rounding."""
    return 4.0 * max(rows, columns) * EPS


def solve_svd(matrix: Array, rhs: Array, cancellation: Array | float = 1.0, *, inverse: bool = True) -> LstsqSolution:
    r"""Least squares by the singular values of the column-scaled matrix, batched.

    Parameters
    ----------
    matrix : ndarray, shape (..., m, p)
        With m ≥ p.
    rhs : ndarray, shape (..., m)
    cancellation : ndarray, shape (...), default 1
        By how much the subtractions that made the matrix shortened its columns, at worst. The rounding of its
        entries, and so the condition number and the smallest singular value that counts, grow by that much.
    inverse : bool, default True
        As in :func:`solve`.

    Notes
    -----
    With :math:`A = U \Sigma V^T T` (T the column lengths), :math:`x = T^{-1} V \Sigma^{-1} U^T y`. The
    dual of least squares is :math:`\max_\nu -\tfrac12|\nu|^2 - \nu^T y` with :math:`A^T\nu = 0`; the
    returned residual r, projected on that null space, is feasible and leaves the gap
    :math:`\tfrac12|U^T r|^2`.
    """
    scale = _column_scale(matrix)
    u, s, vt = np.linalg.svd(matrix / scale[..., None, :], full_matrices=False)
    full_rank: BoolArray = s[..., -1] > rank_tolerance(*matrix.shape[-2:]) * cancellation * s[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(full_rank, cancellation * s[..., 0] / s[..., -1], np.inf)
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
        back @ left if inverse else np.empty((*values.shape, 0)),
        0.5 * np.einsum("...m,...m->...", residual, residual),
        0.5 * np.einsum("...p,...p->...", projected, projected),
        residual,
        np.abs(projected).max(axis=-1),
    )


def solve(matrix: Array, rhs: Array, cancellation: Array | float = 1.0, *, inverse: bool = True) -> LstsqSolution:
    r"""Least squares to the accuracy of an orthogonal factorisation, as fast as the condition allows.

    Where the condition number :math:`\kappa` of the column-scaled matrix is below 1000, its Gram matrix G
    is inverted and the solution refined once with the residual: the first error :math:`\epsilon\kappa^2`
    is squared, which leaves :math:`\epsilon\kappa`. Elsewhere :func:`solve_svd` takes over, problem by
    problem. Here `condition` is :math:`\sqrt{\lVert G\rVert_F \lVert G^{-1}\rVert_F}`, which lies between
    :math:`\kappa` and :math:`\sqrt{p}\,\kappa`.

    Parameters
    ----------
    matrix, rhs : ndarray, shape (..., m, p) and (..., m)
    cancellation : ndarray, shape (...), default 1
        As in :func:`solve_svd`.
    inverse : bool, default True
        Whether to form the pseudo-inverse; without it that field is empty, (..., p, 0).
    """
    rows, size = matrix.shape[-2:]
    count = int(np.prod(rhs.shape[:-1]))
    flat, right = matrix.reshape(count, rows, size), rhs.reshape(count, rows)
    shapes = {"values": (size,), "condition": (), "inverse": (size, rows if inverse else 0)}
    shapes |= {"objective": (), "gap": (), "residual": (rows,), "imbalance": ()}
    out = {name: np.empty((len(flat), *shape)) for name, shape in shapes.items()}
    for start in range(0, len(flat), CHUNK):
        part = slice(start, start + CHUNK)
        _solve_gram(flat[part], right[part], **{name: array[part] for name, array in out.items()})
    out = {name: array.reshape(rhs.shape[:-1] + shapes[name]) for name, array in out.items()}
    condition = out["condition"] = cancellation * out["condition"]
    good: BoolArray = np.asarray(
        (condition < GRAM_LIMIT * cancellation) & (condition * rank_tolerance(rows, size) < 1.0)
    )
    solution = LstsqSolution(full_rank=good, **out)
    if good.all():
        return solution
    lost = np.broadcast_to(cancellation, good.shape)[~good]
    return _replaced(solution, ~good, solve_svd(matrix[~good], rhs[~good], lost, inverse=inverse))


def _solve_gram(
    matrix: Array,
    rhs: Array,
    *,
    values: Array,
    condition: Array,
    inverse: Array,
    objective: Array,
    gap: Array,
    residual: Array,
    imbalance: Array,
) -> None:
    """Fill in what is known of a flat batch, by the refined Gram matrix; `inverse` may be empty."""
    columns = np.ascontiguousarray(transpose(matrix))
    gram = columns @ matrix
    scale = np.sqrt(np.einsum("...pp->...p", gram))
    scale[scale == 0] = 1.0
    gram /= scale[:, :, None] * scale[:, None, :]
    inner = spd_inverse(gram)

    def back(rows: Array) -> tuple[Array, Array]:
        """The scaled gradient A'r of rows, and the scaled step that it asks for."""
        gradient = (columns @ rows[..., None])[..., 0] / scale
        return gradient, matvec(inner, gradient)

    with np.errstate(invalid="ignore", over="ignore"):
        condition[:] = gram_condition(gram, inner)
        values[:] = back(rhs)[1] / scale
        values -= back((values[:, None, :] @ columns)[:, 0] - rhs)[1] / scale
        residual[:] = (values[:, None, :] @ columns)[:, 0] - rhs
        gradient, step = back(residual)
        if inverse.size:
            np.matmul(inner / (scale[:, None, :] * scale[:, :, None]), columns, out=inverse)
        objective[:] = 0.5 * np.einsum("...m,...m->...", residual, residual)
        gap[:] = 0.5 * np.einsum("...p,...p->...", gradient, step)
        imbalance[:] = np.abs(gradient).max(axis=-1)


def gram_condition(gram: Array, inner: Array | None = None) -> Array:
    r"""The condition number of the columns whose Gram matrices (B, p, p) these are, or somewhat more.

    It is :math:`\sqrt{\lVert G\rVert_F \lVert G^{-1}\rVert_F}`; `inner` is the inverse, where that is there already.
    """
    inner = spd_inverse(gram) if inner is None else inner
    with np.errstate(invalid="ignore", over="ignore"):
        return np.nan_to_num(np.sqrt(_frobenius(gram) * _frobenius(inner)), nan=np.inf, posinf=np.inf)


def _frobenius(matrix: Array) -> Array:
    return np.sqrt(np.einsum("...pq,...pq->...", matrix, matrix))


def _replaced(solution: LstsqSolution, where: BoolArray, other: LstsqSolution) -> LstsqSolution:
    """`solution` with the members at `where` taken from `other`."""
    parts = {item.name: np.array(getattr(solution, item.name)) for item in fields(solution)}
    for name, part in parts.items():
        part[where] = getattr(other, name)
    return LstsqSolution(**parts)


def solve_normal_equations(
    matrix: Array, rhs: Array, cancellation: Array | float = 1.0, *, inverse: bool = True
) -> LstsqSolution:
    r"""Least squares as the paper writes it, :math:`x = (A^T A)^{-1} A^T y`, batched.

    The condition number is squared on the way: where :math:`\kappa^2` reaches 1/eps, no digit is left.
    """
    transposed = transpose(matrix)
    gram = transposed @ matrix
    scale = _column_scale(matrix)
    eigenvalues = np.linalg.eigvalsh(gram / scale[..., None, :] / scale[..., :, None])
    share = rank_tolerance(*matrix.shape[-2:])
    full_rank: BoolArray = eigenvalues[..., 0] > np.maximum(share, (share * cancellation) ** 2) * eigenvalues[..., -1]
    safe = np.where(full_rank[..., None, None], gram, np.eye(matrix.shape[-1]))
    inner = np.linalg.inv(safe)
    inner[~full_rank] = np.nan
    values = matvec(inner, matvec(transposed, rhs))
    residual = matvec(matrix, values) - rhs
    gradient = matvec(transposed, residual)
    with np.errstate(divide="ignore", invalid="ignore"):
        condition = np.where(full_rank, cancellation * np.sqrt(eigenvalues[..., -1] / eigenvalues[..., 0]), np.inf)
    return LstsqSolution(
        values,
        full_rank,
        condition,
        inner @ transposed if inverse else np.empty((*values.shape, 0)),
        0.5 * np.einsum("...m,...m->...", residual, residual),
        0.5 * np.abs(np.einsum("...p,...pq,...q->...", gradient, inner, gradient)),
        residual,
        np.abs(gradient / scale).max(axis=-1),
    )


def null_combinations(
    matrix: Array, cancellation: Array | float = 1.0, threshold: float = 1e-9, at_least: int = 0
) -> Array:
    """Directions that one matrix (m, p) does not see, in the units of its parameters, shape (k, p).

    The basis is brought to row-echelon form, so that unseen combinations that involve few
    parameters are shown as such. Entries below `threshold` are left out; what is small is judged with
    columns of unit length, whatever the units are. Columns that differences shortened by `cancellation`
    (a number, or one a column) have lost that much: what is left may be rounding. `at_least` so many
    directions are returned, the least seen ones.
    """
    scale = _column_scale(matrix) * cancellation
    _, s, vt = np.linalg.svd(matrix / scale)
    tolerance = rank_tolerance(*matrix.shape) * (max(s[0], 1.0) if s.size else 1.0)
    rank = min(int((s > tolerance).sum()), len(vt) - at_least)
    basis = vt[rank:]
    for row in range(len(basis)):
        pivot = int(np.argmax(np.abs(basis[row])))
        basis[row] /= basis[row, pivot]
        others = [other for other in range(len(basis)) if other != row]
        basis[others] -= basis[others, pivot : pivot + 1] * basis[row]
    basis[np.abs(basis) < threshold * np.abs(basis).max(axis=1, keepdims=True, initial=1e-300)] = 0.0
    basis = basis / scale
    basis /= np.abs(basis).max(axis=1, keepdims=True, initial=1e-300)
    return basis[np.argsort(np.argmax(basis != 0, axis=1), kind="stable")]
