r"""Forms of the same equations: left multipliers D of the direct rows, one block row a pose.

A form takes block rows (..., n, d, c) to new block rows (..., k, d, c) and acts on the pose index
alone: :math:`D \otimes I_d`. It never changes what the equations say, only how errors are shared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..arrays import Array

__all__ = ["Centred", "Consecutive", "Direct", "Form", "cancellation"]


class Form(Protocol):
    """A left multiplier, with its adjoint."""

    def apply(self, rows: Array) -> Array:
        """D rows, for rows (..., n, d, c)."""
        ...

    def adjoint(self, rows: Array) -> Array:
        """D' rows, for rows (..., k, d, c)."""
        ...

    def before(self, squares: Array) -> Array:
        """Squared column lengths (..., c) of the terms that D subtracts, from those of each block (..., n, c)."""
        ...


@dataclass(frozen=True)
class Direct:
    """The identity: rows of different poses are independent."""

    def apply(self, rows: Array) -> Array:
        """The rows themselves."""
        return rows

    def adjoint(self, rows: Array) -> Array:
        """The rows themselves."""
        return rows

    def before(self, squares: Array) -> Array:
        """Their sum: nothing is subtracted."""
        total: Array = squares.sum(axis=-2)
        return total


@dataclass(frozen=True)
class Centred:
    """Minus the mean over poses; the covariance of the result is singular."""

    def apply(self, rows: Array) -> Array:
        """Rows minus their mean."""
        return rows - rows.mean(axis=-3, keepdims=True)

    def adjoint(self, rows: Array) -> Array:
        """The same: the projection is symmetric."""
        return self.apply(rows)

    def before(self, squares: Array) -> Array:
        """The sum over the rows that the mean is subtracted from."""
        total: Array = squares.sum(axis=-2)
        return total


@dataclass(frozen=True, eq=False)
class Consecutive:
    """The paper's differences: row i is ``later_i · g_{i+1} − earlier_i · g_i``.

    Parameters
    ----------
    later, earlier : ndarray, shape (..., n − 1)
        Weights; both 1 for Types II and III, the neighbours' lengths for Type I (eq. 5).
    """

    later: Array
    earlier: Array

    def apply(self, rows: Array) -> Array:
        """Weighted differences of neighbours."""
        difference: Array = self.later[..., None, None] * rows[..., 1:, :, :]
        difference -= self.earlier[..., None, None] * rows[..., :-1, :, :]
        return difference

    def adjoint(self, rows: Array) -> Array:
        """The transpose of :meth:`apply`."""
        shape = np.broadcast_shapes(rows.shape[:-2], self.later.shape)
        out = np.zeros((*shape[:-1], shape[-1] + 1, *rows.shape[-2:]))
        out[..., 1:, :, :] += self.later[..., None, None] * rows
        out[..., :-1, :, :] -= self.earlier[..., None, None] * rows
        return out

    def before(self, squares: Array) -> Array:
        """The sum over both terms of every difference."""
        terms = self.later[..., None] ** 2 * squares[..., 1:, :] + self.earlier[..., None] ** 2 * squares[..., :-1, :]
        total: Array = terms.sum(axis=-2)
        return total


def cancellation(form: Form, direct: Array, formed: Array) -> Array:
    """By how much a form's differences shortened each column of the direct rows, shape (..., p)."""
    if isinstance(form, Direct):
        return np.ones(direct.shape[-1])
    before = form.before(np.einsum("...ndp,...ndp->...np", direct, direct))
    after = np.einsum("...ndp,...ndp->...p", formed, formed)
    ratio = np.divide(before, after, out=np.ones(after.shape), where=after > 0)  # no column at all is seen as such
    factor: Array = np.sqrt(np.maximum(ratio, 1.0))
    return factor
