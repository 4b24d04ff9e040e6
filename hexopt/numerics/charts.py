"""Vectors of unknowns in which some blocks of three are unit vectors: free coordinates about a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, BoolArray, matvec, norm

__all__ = ["Chart", "across"]


@dataclass(frozen=True)
class Chart:
    r"""Free coordinates about x: :math:`x \oplus s = x + T s`, with every unit vector brought back to unit length.

    The columns of T are orthonormal and lie across the unit vectors, so that each of these counts two.

    Parameters
    ----------
    size : int
        Number of values p.
    units : tuple of slice
        Where the unit vectors stand, each of three values.
    """

    size: int
    units: tuple[slice, ...] = ()

    @property
    def free(self) -> int:
        """Number of free coordinates, q."""
        return self.size - len(self.units)

    @property
    def turning(self) -> BoolArray:
        """Which free coordinates turn a unit vector, shape (q,)."""
        return np.arange(self.free) >= self.size - 3 * len(self.units)

    def normalised(self, x: Array) -> Array:
        """`x` (..., p) with unit vectors of unit length."""
        if not self.units:
            return x
        out = np.array(x)
        for unit in self.units:
            out[..., unit] /= norm(out[..., unit])[..., None]
        return out

    def basis(self, x: Array) -> Array:
        r""":math:`T = \partial(x \oplus s)/\partial s` at s = 0, shape (..., p, q)."""
        out = np.zeros((*x.shape, self.free))
        bound = {place for unit in self.units for place in range(unit.start, unit.stop)}
        free = [place for place in range(self.size) if place not in bound]
        out[..., free, np.arange(len(free))] = 1.0
        for k, unit in enumerate(self.units):
            first = len(free) + 2 * k
            out[..., unit, first : first + 2] = across(x[..., unit])
        return out

    def coordinates(self, x: Array) -> Array:
        """x itself in free coordinates, T'x: zero across unit vectors."""
        return np.einsum("...pq,...p->...q", self.basis(x), x) if self.units else x

    def reduced(self, columns: Array, x: Array) -> Array:
        """Columns by values (..., m, p) as columns by free coordinates (..., m, q): times T."""
        return columns @ self.basis(x) if self.units else columns

    def moved(self, x: Array, step: Array) -> Array:
        r""":math:`x \oplus s` for a step (..., q)."""
        return self.normalised(x + matvec(self.basis(x), step)) if self.units else x + step


def across(n: Array) -> Array:
    """Two orthonormal columns across a unit vector, shape (..., 3, 2), by the formula of Duff et al. (2017)."""
    x, y, z = n[..., 0], n[..., 1], n[..., 2]
    sign = np.where(z < 0, -1.0, 1.0)
    a = -1.0 / (sign + z)
    b = x * y * a
    out = np.empty((*n.shape, 2))
    out[..., 0, 0], out[..., 1, 0], out[..., 2, 0] = 1.0 + sign * x * x * a, sign * b, -sign * x
    out[..., 0, 1], out[..., 1, 1], out[..., 2, 1] = b, sign + y * y * a, -y
    return out
