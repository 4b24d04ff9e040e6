"""Inverse Cholesky factors of many small covariances."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

__all__ = ["inverse_cholesky"]

#: A pivot below this share of its diagonal entry is none.
DEFINITE = 1e-13


def inverse_cholesky(covariance: Array) -> Array:
    r"""Lower triangular W with :math:`W S W^T = I`, shape (..., d, d), by rows of the whole batch at once.

    Only the lower triangle of S is read. A member that is not positive definite to 13 digits gives NaN instead of an
    error for the whole batch.
    """
    size = covariance.shape[-1]
    factor = np.zeros_like(covariance)
    inverse = np.zeros_like(covariance)
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(size):
            row = covariance[..., j:, j] - np.einsum("...ik,...k->...i", factor[..., j:, :j], factor[..., j, :j])
            definite = row[..., 0] > DEFINITE * covariance[..., j, j]
            pivot = 1.0 / np.sqrt(np.where(definite, row[..., 0], np.nan))
            factor[..., j:, j] = row * pivot[..., None]
            inverse[..., j, j] = pivot
            if j:
                inverse[..., j, :j] = -pivot[..., None] * np.einsum(
                    "...k,...kl->...l", factor[..., j, :j], inverse[..., :j, :j]
                )
    return inverse
