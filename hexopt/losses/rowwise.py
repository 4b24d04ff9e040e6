"""Losses of single rows: least squares, Huber's, and least absolute values."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array
from .base import Loss, check_positive, factor_into

__all__ = ["L1", "Huber", "Quadratic"]


@dataclass(frozen=True)
class Quadratic(Loss):
    r"""Least squares: :math:`\rho(z) = z^2/2`.

    Examples
    --------
    >>> import numpy as np
    >>> Quadratic().rho(np.array([[2.0]]))
    array([[2.]])
    """

    degree = 2
    curvature = 1

    @property
    def bound(self) -> float:
        """Infinite."""
        return float("inf")

    def rho(self, z: Array) -> Array:
        """z²/2."""
        return 0.5 * np.square(z)

    def psi(self, z: Array) -> Array:
        """z."""
        return z

    def psi_prime(self, z: Array) -> Array:
        """1."""
        return np.ones(z.shape)

    def conjugate(self, u: Array) -> Array:
        """u²/2."""
        return 0.5 * np.square(u)

    def expression(self, z: Any) -> Any:
        """½‖z‖², as cvxpy's sum of squares."""
        import cvxpy as cp

        return 0.5 * cp.sum_squares(z)

    def curved(self, z: Array, rows: Array) -> Array:
        """The rows themselves."""
        return rows

    def excess(self, z: Array, u: Array) -> Array:
        """½‖z − u‖²."""
        apart = z - u
        return 0.5 * np.einsum("...kd,...kd->...", apart, apart)


@dataclass(frozen=True)
class Huber(Loss):
    r"""Huber's loss: :math:`z^2/2` up to the threshold t, :math:`t|z| - t^2/2` beyond it, row by row.

    Parameters
    ----------
    threshold : float, default 1.345
        In standard deviations; 1.345 keeps 95 % of the efficiency under normal noise.

    Notes
    -----
    ``cvxpy.huber`` is twice this.

    References
    ----------
    Huber, P. J. (1964), Robust estimation of a location parameter, Ann. Math. Statist. 35.
    """

    threshold: float = 1.345

    curvature = 1

    def __post_init__(self) -> None:
        check_positive(self, self.threshold)

    @property
    def bound(self) -> float:
        """The threshold."""
        return self.threshold

    def rho(self, z: Array) -> Array:
        """z²/2, or ``t|z| − t²/2``."""
        size = np.abs(z)
        near = np.minimum(size, self.threshold)
        return near * (size - 0.5 * near)

    def psi(self, z: Array) -> Array:
        """z, clipped to ±t."""
        return np.clip(z, -self.threshold, self.threshold)

    def psi_prime(self, z: Array) -> Array:
        """1 up to the threshold, 0 beyond."""
        return (np.abs(z) <= self.threshold).astype(float)

    def conjugate(self, u: Array) -> Array:
        """u²/2 for ``|u| ≤ t``."""
        return np.where(np.abs(u) <= self.threshold, 0.5 * np.square(u), np.inf)

    def expression(self, z: Any) -> Any:
        """Half of cvxpy's huber, summed."""
        import cvxpy as cp

        return 0.5 * cp.sum(cp.huber(z, self.threshold))

    def excess(self, z: Array, u: Array) -> Array:
        """½(z − u)² within the threshold, ``δ(|z| − t) + δ²/2`` with δ = t − u sign z beyond it."""
        beyond = np.maximum(np.abs(z) - self.threshold, 0.0)
        apart = np.clip(z, -self.threshold, self.threshold) - u
        return np.einsum("...kd,...kd->...", np.abs(apart), 0.5 * np.abs(apart) + beyond)

    def shrink(self, u: Array) -> Array:
        """t over the largest ``|u|``, where that is above t."""
        return factor_into(np.abs(u).max(axis=(-2, -1)), self.threshold)


@dataclass(frozen=True)
class L1(Loss):
    r"""Least absolute values: :math:`\rho(z) = s|z|`, row by row.

    Parameters
    ----------
    scale : float, default 1
        s; it matters only beside another term, such as a prior.
    """

    scale: float = 1.0

    smooth = False
    degree = 1
    curvature = 0

    def __post_init__(self) -> None:
        check_positive(self, self.scale, "scale")

    @property
    def bound(self) -> float:
        """The scale."""
        return self.scale

    def rho(self, z: Array) -> Array:
        """``s|z|``."""
        return self.scale * np.abs(z)

    def psi(self, z: Array) -> Array:
        """s sign z."""
        return self.scale * np.sign(z)

    def psi_prime(self, z: Array) -> Array:
        """0."""
        return np.zeros(z.shape)

    def conjugate(self, u: Array) -> Array:
        """0 for ``|u| ≤ s``."""
        return np.where(np.abs(u) <= self.scale, 0.0, np.inf)

    def expression(self, z: Any) -> Any:
        """s times cvxpy's 1-norm."""
        import cvxpy as cp

        return self.scale * cp.sum(cp.abs(z))

    def excess(self, z: Array, u: Array) -> Array:
        """``|z|(s − u sign z)``."""
        return np.einsum("...kd,...kd->...", np.abs(z), self.scale - np.sign(z) * u)

    def shrink(self, u: Array) -> Array:
        """s over the largest ``|u|``, where that is above s."""
        return factor_into(np.abs(u).max(axis=(-2, -1)), self.scale)

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows times the share by which ``|u|`` stays below s."""
        return np.maximum(1 - np.abs(u) / self.scale, 0.0)[..., None] * rows
