"""What a loss is: its value, ψ, ψ′, conjugate and cvxpy face, and what solvers and certificates ask."""

from __future__ import annotations

from abc import ABC, abstractmethod
from numbers import Real
from typing import Any, ClassVar, Literal

import numpy as np

from ..arrays import Array, norm
from ..errors import InputError

__all__ = ["Loss", "across", "check_positive", "factor_into"]

#: How many trailing dimensions ρ has: (k, d) of rows, (k,) of poses, or none.
_DIMENSIONS = {"row": 2, "pose": 1, "all": 0}


class Loss(ABC):
    r"""A convex loss :math:`\rho` of residuals z, shape (..., k, d): k poses of d rows each.

    To write your own, give `per` and the five abstract methods. A smooth loss is then solved by the batched
    Newton route, another by cvxpy, and every estimate carries its gap.

    Examples
    --------
    >>> import hexopt as hx
    >>> import numpy as np
    >>> hx.Huber(1.345).rho(np.array([[0.5, 2.0]])).round(4)
    array([[0.125 , 1.7855]])
    """

    #: What the loss looks at together: each row, the block of each pose, or all rows.
    per: ClassVar[Literal["row", "pose", "all"]] = "row"
    #: Whether ψ is continuous.
    smooth: ClassVar[bool] = True
    #: k if ρ(s z) = sᵏρ(z), so that the unit of z does not matter to the minimiser; None for a loss with a threshold.
    degree: ClassVar[int | None] = None
    #: M; None for losses that are no support function of a ball.
    curvature: ClassVar[int | None] = None

    @property
    def bound(self) -> float:
        """The radius of U."""
        return float("nan")

    @abstractmethod
    def rho(self, z: Array) -> Array:
        """The loss: (..., k, d) per row, (..., k) per pose, (...) of all."""

    @abstractmethod
    def psi(self, z: Array) -> Array:
        """The gradient of the summed loss, shape (..., k, d); one subgradient where there are several."""

    @abstractmethod
    def psi_prime(self, z: Array) -> Array:
        """The derivative of ψ: (..., k, d) per row, blocks (..., k, d, d) per pose."""

    @abstractmethod
    def conjugate(self, u: Array) -> Array:
        r""":math:`\rho^*(u) = \sup_z u^T z - \rho(z)`, shaped as :meth:`rho`; infinite outside its domain."""

    @abstractmethod
    def expression(self, z: Any) -> Any:
        """The summed loss of a cvxpy expression z, shape (k, d)."""

    def weight(self, z: Array) -> Array:
        """The weight w of re-weighted least squares, ψ(z) = w z, shaped as :meth:`rho`; 1 at zero."""
        size, force = (np.abs(part) if self.per == "row" else norm(part) for part in (z, self.psi(z)))
        return np.divide(force, size, out=np.ones(size.shape), where=size > 0)

    # --- what solvers and certificates ask ------------------------------------------------------------

    def total(self, z: Array) -> Array:
        """The loss of each problem, shape (...)."""
        return self._summed(self.rho(z))

    def curved(self, z: Array, rows: Array) -> Array:
        """ψ′(z) times rows (..., k, d, p)."""
        slope = self.psi_prime(z)
        return slope[..., None] * rows if self.per == "row" else slope @ rows

    def excess(self, z: Array, u: Array) -> Array:
        r""":math:`\rho(z) + \rho^*(u) - u^T z \ge 0`, shape (...): zero exactly where u is a subgradient at z."""
        value = self.total(z) + self._summed(self.conjugate(u)) - np.einsum("...kd,...kd->...", u, z)
        return np.maximum(value, 0.0)

    def shrink(self, u: Array) -> Array:
        """A factor ≤ 1, shape (...), that brings u into the domain of ρ*."""
        less = np.full(u.shape[:-2], 0.0)
        for _ in range(50):
            outside = ~np.isfinite(self._summed(self.conjugate((1 - less)[..., None, None] * u)))
            if not outside.any():
                break
            less = np.where(outside, np.minimum(2 * less + 1e-14, 1.0), less)
        return 1 - less

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows (..., k, d, p) times how freely the duals u may move at little cost, between 0 and 1."""
        return self.curved(z, rows)

    def _summed(self, value: Array) -> Array:
        axes = _DIMENSIONS[self.per]
        return value.sum(axis=tuple(range(-axes, 0))) if axes else value


def check_positive(loss: Loss, value: object, name: str = "threshold") -> None:
    """A threshold or scale must be a finite number > 0."""
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < float("inf"):
        raise InputError(f"{type(loss).__name__}: {name} must be a number > 0 (in σ), got {value!r}")


def factor_into(size: Array, radius: float) -> Array:
    """A factor ≤ 1 that brings a largest size (...) below a radius."""
    return np.minimum(1.0, radius / np.maximum(size, 1e-300))


def across(unit: Array, rows: Array) -> Array:
    """The rows (..., k, d, p) without their part along unit vectors (..., k, d)."""
    radial = np.einsum("...kd,...kdp->...kp", unit, rows)
    return rows - unit[..., None] * radial[..., None, :]
