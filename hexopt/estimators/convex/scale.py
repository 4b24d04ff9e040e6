"""A robust scale of rows whose noise is unknown."""

from __future__ import annotations

import warnings

import numpy as np

from ...arrays import Array, matvec
from ...errors import InputError
from ...losses import L1
from ...numerics.interior import solve_interior
from ...numerics.programme import Programme, Term

__all__ = ["mad_scale"]

#: Standard deviation of a normal distribution over the median of its absolute value.
NORMAL = 1.4826022185056018
#: The L1 fit needs no more digits than the noise has.
TOLERANCE = 1e-6


def mad_scale(matrix: Array, rhs: Array, name: str) -> Array:
    r"""1.4826 times the median absolute residual of the L1 fit of rows (..., m, p), shape (...).

    An L1 fit makes p residuals zero; they are left out. NaN where the fit fails, 1 where every residual is zero.

    Raises
    ------
    InputError
        If there are no more rows than unknowns.
    """
    rows, size = matrix.shape[-2:]
    if rows <= size:
        raise InputError(f"{name}: scale='mad' needs more than {size} equations, there are {rows}; give a number")
    count = int(np.prod(rhs.shape[:-1]))
    flat, right = matrix.reshape(count, rows, size), rhs.reshape(count, rows)
    free = np.full((len(flat), size), np.inf)
    scaled, length = Programme((Term(L1(), flat, right),), -free, free).scaled()
    values = solve_interior(scaled, TOLERANCE).values / length
    residual = np.abs(matvec(flat, values) - right)
    residual[(flat == 0).all(axis=-1) & (right == 0)] = np.nan  # rows of weight zero; they sort last
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a member of which nothing is left has no scale
        scale = NORMAL * np.nanmedian(np.sort(residual, axis=-1)[:, size:], axis=-1)
    zero = scale <= 1e-12 * np.abs(right).max(axis=-1)  # exact readings
    return np.asarray(np.where(zero, 1.0, scale)).reshape(rhs.shape[:-1])
