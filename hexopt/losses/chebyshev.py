"""The loss of all rows at once: the largest residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from ..errors import InputError
from .base import Loss

__all__ = ["Chebyshev"]


@dataclass(frozen=True)
class Chebyshev(Loss):
    r"""The largest residual: :math:`\rho(z) = \max_i |z_i|` over all rows of a problem."""

    per = "all"
    smooth = False
    degree = 1
    curvature = 0

    @property
    def bound(self) -> float:
        """1, of the sum of ``|u|``."""
        return 1.0

    def rho(self, z: Array) -> Array:
        """``max |z|``, shape (...)."""
        return np.abs(z).max(axis=(-2, -1))

    def psi(self, z: Array) -> Array:
        """The sign of the largest residual, at that residual (shared where several are largest)."""
        size = np.abs(z)
        top = size == size.max(axis=(-2, -1), keepdims=True)
        return np.sign(z) * top / top.sum(axis=(-2, -1), keepdims=True)

    def psi_prime(self, z: Array) -> Array:
        """0."""
        return np.zeros(z.shape)

    def curved(self, z: Array, rows: Array) -> Array:
        """0."""
        return np.zeros(rows.shape)

    def weight(self, z: Array) -> Array:
        """No single weight serves all rows."""
        raise InputError("Chebyshev has no weights: it is no sum over rows")

    def conjugate(self, u: Array) -> Array:
        """0 for ``Σ|u| ≤ 1``."""
        return np.where(np.abs(u).sum(axis=(-2, -1)) <= 1.0, 0.0, np.inf)

    def expression(self, z: Any) -> Any:
        """cvxpy's maximum of absolute values."""
        import cvxpy as cp

        return cp.max(cp.abs(z))

    def excess(self, z: Array, u: Array) -> Array:
        """``Σ|u|(max|z| − z sign u) + (1 − Σ|u|) max|z|``."""
        top = self.rho(z)
        below = top[..., None, None] - np.sign(u) * z
        rest = np.maximum(1 - np.abs(u).sum(axis=(-2, -1)), 0.0)
        return np.einsum("...kd,...kd->...", np.abs(u), below) + rest * top

    def shrink(self, u: Array) -> Array:
        """One over ``Σ|u|``, where that is above 1."""
        return 1.0 / np.maximum(np.abs(u).sum(axis=(-2, -1)), 1.0)

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows times ``|u|`` as a share of the largest: what is zero stays zero."""
        size = np.abs(u)
        share = size / np.maximum(size.max(axis=(-2, -1), keepdims=True), 1e-300)
        return share[..., None] * rows
