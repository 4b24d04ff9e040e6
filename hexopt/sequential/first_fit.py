"""The maximum-likelihood fit of the first poses, with a prior or without: where a nonlinear filter starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, matvec, transpose
from ..loops import Loop
from ..numerics.charts import Chart
from ..numerics.lm import levenberg_marquardt
from ..numerics.lstsq import solve_svd
from ..priors import PriorRows
from ..result import Status

__all__ = ["FirstFit", "determined", "first_fit"]

#: How often measurements are moved at most, so that the equations hold.
ADJUSTMENTS = 10
MAX_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class FirstFit:
    """What the first poses and the prior say.

    Attributes
    ----------
    values : ndarray, shape (..., p)
    spread : ndarray, shape (..., q, q)
        Covariance in free coordinates about the values.
    codes : ndarray of int, shape (...)
    chi2 : ndarray, shape (...)
    rows : int
        Equations, of the prior too.
    unseen : tuple of str
    """

    values: Array
    spread: Array
    codes: npt.NDArray[np.int8]
    chi2: Array
    rows: int
    unseen: tuple[str, ...]


def first_fit(
    loop: Loop, chart: Chart, guess: Array, prior: Sequence[PriorRows], *, with_poses: bool = True
) -> FirstFit:
    r"""Minimise :math:`\sum_i\lVert S_i^{-1/2} g_i(x)\rVert^2 + \lVert C x - d\rVert^2` over values x in a chart.

    Parameters
    ----------
    loop : Loop
        The equation over the first poses.
    chart : Chart
    guess : ndarray, shape (..., p)
        Where the iteration starts.
    prior : sequence of PriorRows
        Quadratic rows C x − d; none without a prior.
    with_poses : bool, default True
        Whether the poses of the loop count; else the prior speaks alone.
    """
    batch, size = loop.batch_shape, chart.size
    start = chart.normalised(np.broadcast_to(guess, (*batch, size)))

    def rows(x: Array) -> tuple[Array, Array]:
        parts = []
        for part in prior:
            matrix = np.broadcast_to(part.matrix, (*batch, *part.matrix.shape[-2:]))
            parts.append((matvec(matrix, x) - part.rhs, matrix))
        if with_poses:
            white = loop.whitened(x, adjust=ADJUSTMENTS)
            m = white.misclosure.shape[-2] * white.misclosure.shape[-1]
            misclosure = white.misclosure.reshape(*white.misclosure.shape[:-2], m)
            parts.append((misclosure, white.jacobian.reshape(*white.jacobian.shape[:-3], m, size)))
        misclosure = np.concatenate([np.broadcast_to(g, (*batch, g.shape[-1])) for g, _ in parts], axis=-1)
        jacobian = np.concatenate([np.broadcast_to(j, (*batch, *j.shape[-2:])) for _, j in parts], axis=-2)
        return misclosure, chart.reduced(jacobian, x)

    def evaluate(flat: Array) -> tuple[Array, Array]:
        misclosure, jacobian = rows(flat.reshape(*batch, size))
        return misclosure.reshape(-1, misclosure.shape[-1]), jacobian.reshape(-1, *jacobian.shape[-2:])

    count = rows(start)[0].shape[-1]
    tries = MAX_ITERATIONS if count >= chart.free else 1  # there is nothing to find
    found = levenberg_marquardt(evaluate, start.reshape(-1, size), max_iterations=tries, chart=chart)
    values = found.values.reshape(*batch, size)
    misclosure, jacobian = rows(values)
    finite = np.asarray(np.isfinite(jacobian).all(axis=(-2, -1)) & np.isfinite(misclosure).all(axis=-1))
    jacobian = np.where(finite[..., None, None], jacobian, 0.0)
    jacobian = padded(jacobian)
    local = solve_svd(jacobian, np.zeros(jacobian.shape[:-1]))
    seen = local.full_rank & (bool(prior) | (not loop.blind_spots))
    codes = np.where(found.converged.reshape(batch), Status.OPTIMAL, Status.NOT_CONVERGED)
    codes = np.where(seen | ~finite, codes, Status.RANK_DEFICIENT)
    unseen: tuple[str, ...] = () if prior else loop.blind_spots
    if not seen.all() and not unseen:
        worst = np.unravel_index(int(np.argmin(seen)), batch)
        unseen = loop.combinations(jacobian[worst], chart.basis(values[worst]))
    return FirstFit(
        values=np.where(finite[..., None], values, np.nan),
        spread=local.inverse @ transpose(local.inverse),
        codes=np.where(finite, codes, Status.FAILED).astype(np.int8),
        chi2=np.einsum("...m,...m->...", misclosure, misclosure),
        rows=count,
        unseen=unseen,
    )


def padded(matrix: Array) -> Array:
    """At least as many rows as columns, by rows of zeros."""
    m, q = matrix.shape[-2:]
    return np.concatenate([matrix, np.zeros((*matrix.shape[:-2], max(q - m, 0), q))], axis=-2)


def determined(matrix: Array) -> BoolArray:
    """Which matrices (..., m, q) have full column rank."""
    rows = padded(matrix)
    return np.asarray(solve_svd(rows, np.zeros(rows.shape[:-1]), inverse=False).full_rank)
