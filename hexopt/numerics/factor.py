r"""The factorisation :math:`L D L^T` of many small positive semidefinite matrices, and solves with it.

Elimination without pivoting: with :math:`g^{(1)} = G`,

.. math:: d_j = g^{(j)}_{jj}, \qquad l_{ij} = g^{(j)}_{ij} / d_j, \qquad
          g^{(j+1)}_{ik} = g^{(j)}_{ik} - l_{ij}\, g^{(j)}_{jk} \quad (i, k > j).

All arrays have the batch last, so that every operation is one pass over the batch. A right-hand side is solved more
accurately than by :func:`hexopt.numerics.inverse.spd_inverse`, and matrices may be singular.
"""

from __future__ import annotations

import numpy as np

from ..arrays import Array

__all__ = ["Factor", "factored", "solved"]

#: Pivots below this share of their diagonal are rounding: that direction rests.
PIVOT = 1e-15

#: L below the diagonal (p, p, B), and 1 / D, or 0 for a direction that rests, (p, B).
Factor = tuple[Array, Array]


def factored(gram: Array) -> Factor:
    """The factors of matrices (p, p, B)."""
    lower = np.array(gram, order="C")
    floor = PIVOT * np.einsum("iib->ib", lower)
    inverse = np.zeros(floor.shape)
    for j in range(len(lower)):
        np.divide(1.0, lower[j, j], out=inverse[j], where=lower[j, j] > floor[j])
        row = lower[j + 1 :, j].copy()
        lower[j + 1 :, j] *= inverse[j]
        lower[j + 1 :, j + 1 :] -= lower[j + 1 :, j, None] * row
    return lower, inverse


def solved(factor: Factor, right: Array) -> Array:
    """The solution for one right-hand side of each member, (p, B)."""
    lower, inverse = factor
    out = np.array(right, order="C")
    for j in range(len(out) - 1):
        out[j + 1 :] -= lower[j + 1 :, j] * out[j]
    out *= inverse
    for j in range(len(out) - 2, -1, -1):
        out[j] -= np.einsum("ib,ib->b", lower[j + 1 :, j], out[j + 1 :])
    return out
