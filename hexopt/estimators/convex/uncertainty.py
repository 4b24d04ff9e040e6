r"""Covariance and influence of an estimate of the convex family, to first order about the answer.

With data rows A (whitened), residuals z, :math:`H_d = A^T \psi'(z) A` and the curvature :math:`H_p` of
normal priors, the answer moves by :math:`-K A^T\psi'\,dz`, where K is :math:`(H_d + H_p)^{-1}` with the active
constraints kept as equations. Normal rows then leave the covariance

.. math:: K (\overline{\psi^2} A^T A + H_p) K ,\quad
          \overline{\psi^2} = \max\Bigl(E\psi^2, \frac{\sum\psi^2}{m - \mathrm{tr}\,K H_d}\Bigr)

which is :math:`(A^T A)^{-1}` for least squares, and Huber's asymptotic covariance with the observed curvature: rows
beyond the threshold add no information, and their forces add variance.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from ...arrays import Array, matvec, transpose
from ...losses import Chebyshev, Loss
from ...numerics.inverse import spd_inverse
from ...numerics.lstsq import LstsqSolution
from ...numerics.programme import Programme, Term
from ...problem import LinearProblem
from .posed import Posed, in_batch
from .routes import Answer
from .uniqueness import holding

__all__ = ["normal_moments", "uncertainty"]


def normal_moments(loss: Loss, size: int) -> tuple[float, float]:
    r""":math:`E\psi'` and :math:`E\psi^2` of one row, of standard normal blocks of `size` rows.

    By the midpoint rule over the length r of a block, and Stein's identity
    :math:`E\,\partial\psi_i/\partial z_i = E\,z_i\psi_i`.
    """
    try:
        return _cached_moments(loss, size)
    except TypeError:  # a loss that cannot be hashed
        return _moments(loss, size)


@lru_cache(maxsize=64)
def _cached_moments(loss: Loss, size: int) -> tuple[float, float]:
    return _moments(loss, size)


def _moments(loss: Loss, size: int) -> tuple[float, float]:
    d = size if loss.per == "pose" else 1
    r = (np.arange(20000) + 0.5) * 5e-4
    density = r ** (d - 1) * np.exp(-0.5 * np.square(r))
    density /= density.sum()
    blocks = np.zeros((len(r), 1, d))
    blocks[:, 0, 0] = r
    psi = loss.psi(blocks)[:, 0, 0]
    return float((density * r * psi).sum() / d), float((density * np.square(psi)).sum() / d)


def uncertainty(problem: LinearProblem, posed: Posed, answer: Answer, kind: str) -> dict[str, Any]:
    """Covariance, its kind (or the reason for none) and influence.

    `kind` names the covariance of rows in σ; "propagated" carries the noise of raw rows through the influence; the
    empty kind has no noise to speak of.
    """
    assembly, batch = posed.assembly, problem.batch_shape
    programme = assembly.programme
    data = programme.terms[0]
    loss: Any = data.loss
    if isinstance(loss, Chebyshev):
        return _none("the largest residual has no normal limit")
    if set(range(1, len(programme.terms))) - set(assembly.gaussian):
        return _none("a lasso is biased by design, and has no standard errors")
    z: Any = None if data.is_quadratic else data.residual(answer.values)  # whose curvature is 1 everywhere
    slope, square = normal_moments(loss, data.size)
    curved = data.acted((lambda rows: loss.curved(z, rows)) if loss.smooth else (lambda rows: slope * rows))
    own = curved @ data.matrix
    prior = np.zeros(own.shape)
    for i in assembly.gaussian:
        prior = prior + programme.terms[i].columns @ programme.terms[i].matrix
    inner = _constrained_inverse(own + prior, programme, answer)
    gain = in_batch(posed.undivided(inner @ curved), batch)
    influence = problem.direct_gain(gain if posed.root is None else posed.root.after(gain))
    if data.is_quadratic:
        covariance = inner
    else:
        share = _seen_share(data, z, slope)
        own = share[:, None, None] * own
        if (share < 1).any():
            inner = _constrained_inverse(own + prior, programme, answer)
        used = np.einsum("...pq,...qp->...", inner, own)
        force = _mean_square(answer.certificate.rows[0], used, square)
        covariance = inner @ (force[:, None, None] * (data.columns @ data.matrix) + prior) @ inner
    return {"influence": influence if loss.smooth else None} | _covariance(
        problem,
        posed,
        answer,
        "posterior" if assembly.gaussian and kind != "propagated" else kind,
        covariance,
        influence,
    )


def _seen_share(data: Term, z: Array, expected: float) -> Array:
    """How much of the observed curvature counts, (B,): not more than normal rows have on average.

    Rows that a fit with a small threshold interpolates are no evidence that rows are near.
    """
    loss: Any = data.loss
    if not loss.smooth:
        return np.ones(len(z))
    slope = loss.psi_prime(z)
    total = slope.sum(axis=(-2, -1)) if loss.per == "row" else np.einsum("...kii->...", slope)
    return np.minimum(1.0, expected * data.rhs.shape[-1] / np.maximum(total, 1e-300))


def _mean_square(forces: Array, used: Array, expected: float) -> Array:
    """The mean square of forces (B, m), of which the fit used up so many, but no less than of standard normal rows."""
    left = forces.shape[-1] - used
    observed = np.square(forces).sum(axis=-1) / np.maximum(left, 0.5)
    return np.where(left > 0.5, np.maximum(observed, expected), expected)


def least_squares_uncertainty(
    problem: LinearProblem, posed: Posed, answer: Answer, known: LstsqSolution, kind: str
) -> dict[str, Any]:
    """The same for plain least squares, whose pseudo-inverse is known."""
    gain = in_batch(posed.undivided(known.inverse), problem.batch_shape)
    influence = problem.direct_gain(gain if posed.root is None else posed.root.after(gain))
    covariance = known.inverse @ transpose(known.inverse)
    return {"influence": influence} | _covariance(problem, posed, answer, kind, covariance, influence)


def _covariance(
    problem: LinearProblem, posed: Posed, answer: Answer, kind: str, covariance: Array, influence: Array
) -> dict[str, Any]:
    """The covariance by its kind: of rows in σ, with the error that all poses share, or propagated from raw rows."""
    if problem.uncarried:
        return _none(problem.uncarried)
    if kind == "":
        return _none("the rows are not whitened; use weights='model', or a scale")
    if kind == "propagated":
        propagated = _own_covariance(problem, answer).propagated(influence)
        return {"covariance": propagated, "covariance_kind": "sandwich"}
    covariance = in_batch(covariance, problem.batch_shape)
    if not posed.shared and problem.noise is not None:
        rows = _own_covariance(problem, answer)
        if rows.common is not None:
            common = np.einsum("...pni,...nir->...pr", influence, rows.common)
            covariance = covariance + common @ transpose(common)
    return {"covariance": covariance, "covariance_kind": kind}


def _none(reason: str) -> dict[str, Any]:
    return {"covariance": None, "covariance_kind": reason}


def _own_covariance(problem: LinearProblem, answer: Answer) -> Any:
    return problem.row_covariance(in_batch(answer.values, problem.batch_shape))


def _constrained_inverse(hessian: Array, programme: Programme, answer: Answer) -> Array:
    """K: the inverse with active constraints as equations, the upper left block of a KKT matrix; NaN where singular."""
    size = programme.size
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", hessian), 1e-300))
    box, intervals, balls = holding(programme, answer)
    both = ~box[:, :, None] & ~box[:, None, :]
    scaled = np.where(both, hessian / scale[:, :, None] / scale[:, None, :], np.eye(size))
    normals = [
        np.where(held[:, :, None], part.matrix, 0.0) for part, held in zip(programme.intervals, intervals, strict=True)
    ]
    for ball, force, held in zip(programme.balls, answer.certificate.balls, balls, strict=True):
        normal = np.where(held[:, None], matvec(transpose(ball.matrix), force), 0.0)
        normals.append(normal[:, None, :])
    if not normals:
        return np.where(both, _definite_inverse(scaled), 0.0) / scale[:, :, None] / scale[:, None, :]
    rows = np.where(~box[:, None, :], np.concatenate(normals, axis=-2) / scale[:, None, :], 0.0)
    length = np.sqrt(np.einsum("...qp,...qp->...q", rows, rows))
    rows = rows / np.where(length > 0, length, 1.0)[..., None]
    corner = np.where(length > 0, 0.0, 1.0)[..., None] * np.eye(rows.shape[-2])
    kkt = np.concatenate(
        [
            np.concatenate([scaled, transpose(rows)], axis=-1),
            np.concatenate([rows, corner], axis=-1),
        ],
        axis=-2,
    )
    block = _safe_inverse(kkt)[:, :size, :size]
    fixed = np.einsum("...ii->...i", block) <= 1e-12  # of one: what the equations leave is rounding
    both &= ~(fixed[:, :, None] | fixed[:, None, :])
    return np.where(both, block, 0.0) / scale[:, :, None] / scale[:, None, :]


def _definite_inverse(matrix: Array) -> Array:
    """Inverses of a batch, NaN where a member is not positive definite beyond rounding."""
    inverse = spd_inverse(matrix)
    with np.errstate(invalid="ignore"):
        good = np.asarray(
            np.isfinite(inverse).all(axis=(-2, -1)) & (np.einsum("...ii->...i", inverse) > 0).all(axis=-1)
        )
    return np.where(good[:, None, None], inverse, np.nan)


def _safe_inverse(matrix: Array) -> Array:
    """Inverses of a batch of KKT matrices, NaN where a member is singular or not finite."""
    finite = np.asarray(np.isfinite(matrix).all(axis=(-2, -1)))
    safe = np.where(finite[:, None, None], matrix, np.eye(matrix.shape[-1]))
    try:
        inverse = np.linalg.inv(safe)
    except np.linalg.LinAlgError:
        inverse = np.full(matrix.shape, np.nan)
        for i, one in enumerate(safe):
            if np.linalg.matrix_rank(one) == len(one):
                inverse[i] = np.linalg.inv(one)
    return np.where(finite[:, None, None], inverse, np.nan)
