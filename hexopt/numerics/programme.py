r"""Convex programmes of a batch in one standard form, and what solvers claim of them.

.. math:: \min_x \sum_j \rho_j(A_j x - y_j) \quad\text{s.t.}\quad l \le x \le h,\;
          l_i \le C_i x \le h_i,\; \lVert E_k x - c_k\rVert \le r_k .

Its dual has one vector :math:`u_j` per term, multipliers β of the box, :math:`w_i` of the intervals and
:math:`v_k` of the balls (positive towards the upper bound), which balance:
:math:`\sum A_j^T u_j + \beta + \sum C_i^T w_i + \sum E_k^T v_k = 0`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, matvec, transpose

__all__ = ["Ball", "Interval", "Penalty", "Programme", "Solution", "Term", "transposed_product"]


class Penalty(Protocol):
    """What the numerics ask of a loss; residuals z have the shape (..., k, d)."""

    @property
    def per(self) -> str:
        """What it looks at together: "row", "pose" (a block) or "all"."""
        ...

    @property
    def smooth(self) -> bool:
        """Whether ψ is continuous."""
        ...

    @property
    def curvature(self) -> int | None:
        """M, of a support function sup u'z − M|u|²/2 over a ball; None for other losses."""
        ...

    @property
    def bound(self) -> float:
        """The radius of that ball."""
        ...

    def total(self, z: Array) -> Array:
        """The loss of each problem, (...)."""
        ...

    def psi(self, z: Array) -> Array:
        """A subgradient, (..., k, d)."""
        ...

    def weight(self, z: Array) -> Array:
        """The w of ψ(z) = w z, (..., k, d) or (..., k)."""
        ...

    def curved(self, z: Array, rows: Array) -> Array:
        """ψ′(z) times rows (..., k, d, p)."""
        ...

    def excess(self, z: Array, u: Array) -> Array:
        """ρ(z) + ρ*(u) − u'z, (...)."""
        ...

    def shrink(self, u: Array) -> Array:
        """A factor that brings u into the domain of ρ*, (...)."""
        ...

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows (..., k, d, p) times how freely the duals u may move."""
        ...


def transposed_product(matrix: Array, vector: Array) -> Array:
    """Aᵀv of a batch, ``(..., m, p)`` and ``(..., m)``."""
    product: Array = (vector[..., None, :] @ matrix)[..., 0, :]
    return product


@dataclass(frozen=True, eq=False)
class Term:
    """A loss of the residual A x − y; arrays lead with the batch, and `size` rows make a block."""

    loss: Penalty
    matrix: Array  # (B, m, p)
    rhs: Array  # (B, m)
    size: int = 1

    @cached_property
    def columns(self) -> Array:
        """Aᵀ with its entries in a row, (B, p, m): products with it are the fastest."""
        return np.ascontiguousarray(transpose(self.matrix))

    def residual(self, values: Array) -> Array:
        """A x − y in blocks, (B, k, size)."""
        return self.blocks((values[:, None, :] @ self.columns)[:, 0] - self.rhs)

    def pulled(self, blocks: Array) -> Array:
        """Aᵀu of blocks (B, k, size), shape (B, p)."""
        product: Array = (self.columns @ blocks.reshape(*self.rhs.shape, 1))[..., 0]
        return product

    def blocks(self, rows: Array) -> Array:
        """Rows (B, m) as (B, k, size)."""
        return rows.reshape(*rows.shape[:-1], rows.shape[-1] // self.size, self.size)

    def acted(self, action: Callable[[Array], Array]) -> Array:
        """(D A)ᵀ for a symmetric D that acts on rows (B, k, size, c), such as ψ′; shape (B, p, m).

        Of a quadratic loss D is taken to be 1.
        """
        if self.is_quadratic:
            return self.columns
        shape = (*self.rhs.shape[:-1], self.rhs.shape[-1] // self.size, self.size)
        if self.loss.per == "pose":
            rows = action(self.matrix.reshape(*shape, self.matrix.shape[-1]))
            return transpose(rows.reshape(self.matrix.shape))
        factor = action(np.ones((*shape, 1)))  # diagonal
        return self.columns * factor.reshape(len(self.rhs), 1, self.rhs.shape[-1])

    @property
    def is_quadratic(self) -> bool:
        """Whether the loss is z²/2 everywhere."""
        return self.loss.curvature == 1 and self.loss.bound == np.inf

    @cached_property
    def _own_gram(self) -> Array:
        return self.columns @ self.matrix

    def gram(self, z: Array) -> Array:
        """AᵀψʹA at residuals z, (B, p, p)."""
        if self.is_quadratic:
            return self._own_gram
        product: Array = self.acted(lambda rows: self.loss.curved(z, rows)) @ self.matrix
        return product


@dataclass(frozen=True, eq=False)
class Interval:
    """lower ≤ C x ≤ upper, either side possibly infinite; an equation has both alike."""

    matrix: Array  # (B, q, p)
    lower: Array  # (B, q)
    upper: Array  # (B, q)


@dataclass(frozen=True, eq=False)
class Ball:
    """‖E x − c‖ ≤ r."""

    matrix: Array  # (B, q, p)
    centre: Array  # (B, q)
    radius: Array  # (B,)


@dataclass(frozen=True, eq=False)
class Programme:
    """A batch of convex programmes of one structure; every array leads with the batch."""

    terms: tuple[Term, ...]
    lower: Array  # (B, p)
    upper: Array  # (B, p)
    intervals: tuple[Interval, ...] = ()
    balls: tuple[Ball, ...] = ()

    @property
    def batch(self) -> int:
        """How many problems."""
        return len(self.lower)

    @property
    def size(self) -> int:
        """How many unknowns."""
        return self.lower.shape[-1]

    @property
    def is_boxed(self) -> bool:
        """Whether any bound of the box is finite."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    @property
    def is_free(self) -> bool:
        """Whether there is no constraint at all."""
        return not (self.intervals or self.balls or self.is_boxed)

    def objective(self, values: Array) -> Array:
        """The objective, (B,)."""
        return np.asarray(sum(term.loss.total(term.residual(values)) for term in self.terms))

    def mapped(self, change: Callable[[Array], Array]) -> Programme:
        """With every array changed; for choosing members of the batch."""
        return Programme(
            tuple(replace(term, matrix=change(term.matrix), rhs=change(term.rhs)) for term in self.terms),
            change(self.lower),
            change(self.upper),
            tuple(Interval(change(one.matrix), change(one.lower), change(one.upper)) for one in self.intervals),
            tuple(Ball(change(one.matrix), change(one.centre), change(one.radius)) for one in self.balls),
        )

    def take(self, which: Any) -> Programme:
        """Some members of the batch, by an index array or a slice."""
        return self.mapped(lambda array: array[which])

    def scaled(self) -> tuple[Programme, Array]:
        """In variables whose columns have unit length, and those lengths (B, p): x = scaled / lengths."""
        square = np.asarray(sum(np.einsum("...mp,...mp->...p", term.matrix, term.matrix) for term in self.terms))
        length = np.sqrt(square)
        length[length == 0] = 1.0
        columns = length[:, None, :]
        return Programme(
            tuple(replace(term, matrix=term.matrix / columns) for term in self.terms),
            self.lower * length,
            self.upper * length,
            tuple(replace(one, matrix=one.matrix / columns) for one in self.intervals),
            tuple(replace(one, matrix=one.matrix / columns) for one in self.balls),
        ), length

    def about(self, centre: Array) -> Programme:
        """In the change of x from a centre (B, p)."""
        return Programme(
            tuple(replace(term, rhs=term.rhs - matvec(term.matrix, centre)) for term in self.terms),
            self.lower - centre,
            self.upper - centre,
            tuple(
                Interval(one.matrix, one.lower - matvec(one.matrix, centre), one.upper - matvec(one.matrix, centre))
                for one in self.intervals
            ),
            tuple(replace(one, centre=one.centre - matvec(one.matrix, centre)) for one in self.balls),
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """What a solver claims; duals are None where they follow from x (smooth losses, and the box always)."""

    values: Array  # (B, p)
    converged: BoolArray  # (B,)
    iterations: npt.NDArray[np.int64]  # (B,)
    rows: tuple[Array, ...] | None = None  # u of each term, (B, m)
    intervals: tuple[Array, ...] = ()  # w, (B, q)
    balls: tuple[Array, ...] = ()  # v, (B, q)
    infeasible: BoolArray | None = None  # (B,), proven
