"""What iterative fits share: settings, a first guess, a form, the minimisation of a batch, the estimate at its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, as_count
from ..errors import InputError
from ..geometry import Leg
from ..loops import Loop
from ..numerics.forms import cancellation
from ..numerics.lm import LMResult, levenberg_marquardt
from ..numerics.lstsq import solve_svd
from ..parameters import Parameters
from ..problem import LinearProblem
from ..result import Estimate, Status
from .least_squares import linear_uncertainty, unseen_combinations

__all__ = ["AgainstFirst", "check_settings", "first_guess", "local_estimate", "minimise"]


def check_settings(start: Leg | None, max_iterations: int) -> None:
    """The settings that every iteration from a leg has."""
    if start is not None and not isinstance(start, Leg):
        raise InputError(f"start: expected a Leg, got {type(start).__name__}")
    as_count("max_iterations", max_iterations)


def first_guess(
    estimator: object, start: Leg | None, loop: Loop, parameters: Parameters, batch: tuple[int, ...]
) -> Array:
    """The values (..., p) of a leg's blocks that an iteration starts at: of `start`, or of the loop's nominal."""
    leg = start or loop.data.nominal
    if leg is None:
        raise InputError(f"{type(estimator).__name__} needs an initial guess: give start=Leg(…) or data with a nominal")
    loop._check_leg(leg)
    blocks = [leg.block(name) for name in parameters.names]
    return np.concatenate([np.broadcast_to(block, (*batch, block.shape[-1])) for block in blocks], axis=-1)


@dataclass(frozen=True)
class AgainstFirst:
    """A form: in every set, each pose minus the first, which eliminates what they have in common.

    Parameters
    ----------
    counts : tuple of int
        The poses of each set.
    """

    counts: tuple[int, ...]

    def _sets(self, rows: Array, axis: int, counts: tuple[int, ...]) -> list[Array]:
        return np.split(rows, np.cumsum(counts)[:-1], axis=axis)

    def apply(self, rows: Array) -> Array:
        """Rows minus those of the first pose."""
        parts = self._sets(rows, -3, self.counts)
        return np.concatenate([part[..., 1:, :, :] - part[..., :1, :, :] for part in parts], axis=-3)

    def differences(self, residual: Array, jacobian: Array) -> tuple[Array, Array, Array]:
        """Residual (..., m), matrix (..., m, p) and what the differences lost of its columns (..., p).

        Of the residual (..., n, d) and the Jacobian (..., n, d, p) of all poses.
        """
        matrix, rhs = self.apply(jacobian), self.apply(residual[..., None])
        flat = (*matrix.shape[:-3], matrix.shape[-3] * matrix.shape[-2])
        return rhs.reshape(flat), matrix.reshape(*flat, matrix.shape[-1]), cancellation(self, jacobian, matrix)

    def adjoint(self, rows: Array) -> Array:
        """The transpose of :meth:`apply`."""
        parts = self._sets(rows, -3, tuple(count - 1 for count in self.counts))
        return np.concatenate([side for part in parts for side in (-part.sum(axis=-3, keepdims=True), part)], axis=-3)

    def before(self, squares: Array) -> Array:
        """The sum over both terms of every difference."""
        parts = self._sets(squares, -2, self.counts)
        total: Array = sum(part[..., 1:, :].sum(axis=-2) + (part.shape[-2] - 1) * part[..., 0, :] for part in parts)
        return total


def minimise(rows: Callable[[Array], tuple[Array, Array]], start: Array, max_iterations: int) -> LMResult:
    r"""Levenberg–Marquardt on a batch of any shape.

    Parameters
    ----------
    rows : callable
        Values (..., p) to residuals (..., m) and Jacobians (..., m, p).
    start : ndarray, shape (..., p)
    max_iterations : int
    """
    batch, size = start.shape[:-1], start.shape[-1]

    def evaluate(flat: Array) -> tuple[Array, Array]:
        residual, jacobian = rows(flat.reshape(*batch, size))
        count = residual.shape[-1]
        return residual.reshape(-1, count), jacobian.reshape(-1, count, size)

    found = levenberg_marquardt(evaluate, start.reshape(-1, size), max_iterations=max_iterations)
    return LMResult(found.values.reshape(*batch, size), found.converged.reshape(batch), found.iterations.reshape(batch))


def local_estimate(
    problem: LinearProblem,
    values: Array,
    converged: BoolArray,
    iterations: npt.NDArray[np.int64],
    estimator: object,
    blind: tuple[str, ...] = (),
) -> Estimate:
    """The estimate where an unweighted iteration ended, from the rows to first order there.

    Parameters
    ----------
    problem : LinearProblem
        In the unknown change of the values; its right-hand side is minus the residual.
    values : ndarray, shape (..., p)
    converged : ndarray of bool, shape (...)
    iterations : ndarray of int, shape (...)
    estimator : object
        Whose name and settings the estimate bears.
    blind : tuple of str
        What no set of this kind sees.
    """
    local = solve_svd(problem.matrix, problem.rhs, problem.worst_cancellation)
    codes = np.where(converged, Status.OPTIMAL, Status.NOT_CONVERGED)
    codes = np.where(local.full_rank & (not blind), codes, Status.RANK_DEFICIENT).astype(np.int8)
    good = codes == Status.OPTIMAL
    unseen = blind or unseen_combinations(problem, local)
    local = replace(local, inverse=np.where(good[..., None, None], local.inverse, np.nan))
    return Estimate(
        values=np.where(good[..., None], values, np.nan),
        parameters=problem.parameters,
        codes=codes,
        objective=np.where(good, 0.5 * np.einsum("...m,...m->...", problem.rhs, problem.rhs), np.nan),
        gap=np.full(codes.shape, np.nan),
        condition=local.condition,
        iterations=iterations,
        estimator=f"{problem.name} by {estimator!r}",
        unseen=unseen,
        **linear_uncertainty(problem, local, None, values),
    )
