r"""Losses of whitened residuals, each with a NumPy face and a cvxpy face.

One convention: :math:`\rho(z) = z^2/2` near zero, thresholds in standard deviations. Every built-in loss is
the support function of a ball, smoothed (M = 1) or not (M = 0),

.. math:: \rho(z) = \sup_{u \in U} u^T z - \tfrac{M}{2}\lVert u\rVert^2,

so that three attributes say it all: what the ball holds together (`per`: a row, the block of a pose, or all
rows), its radius (`bound`) and M (`curvature`). U is the ball of the dual norm: an interval per row, a
Euclidean ball per pose, and for the largest residual :math:`\lVert u\rVert_1 \le 1`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar, Literal

import numpy as np

from .arrays import Array, norm
from .errors import InputError

__all__ = ["L1", "Chebyshev", "GroupHuber", "GroupL1", "Huber", "Loss", "Quadratic"]

#: How many trailing dimensions ρ has: (k, d) of rows, (k,) of poses, or none.
_DIMENSIONS = {"row": 2, "pose": 1, "all": 0}


class Loss(ABC):
    r"""A convex loss :math:`\rho` of residuals z, shape (..., k, d): k poses of d rows each.

    To write your own, give `per` and the five abstract methods. A smooth loss is then solved by the batched
    Newton route, another by cvxpy, and every estimate carries its gap.

    Examples
    --------
    >>> import numpy as np
    >>> Huber(1.345).rho(np.array([[0.5, 2.0]])).round(4)
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


def _threshold(loss: Loss, value: object, name: str = "threshold") -> None:
    if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < float("inf"):
        raise InputError(f"{type(loss).__name__}: {name} must be a number > 0 (in σ), got {value!r}")


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
        _threshold(self, self.threshold)

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
        return np.minimum(1.0, self.threshold / np.maximum(np.abs(u).max(axis=(-2, -1)), 1e-300))


@dataclass(frozen=True)
class GroupHuber(Loss):
    r"""Huber's loss of whole poses: :math:`\rho(\lVert z_i\rVert)` of each pose's whitened block.

    An outlier is a bad pose: it hits all rows of its block at once. Takes the direct form only.

    Parameters
    ----------
    threshold : float, default 2.5
        In standard deviations of one row; a clean block of three is longer than 2.5 in 10 % of all poses.
    """

    threshold: float = 2.5

    per = "pose"
    curvature = 1

    def __post_init__(self) -> None:
        _threshold(self, self.threshold)

    @property
    def bound(self) -> float:
        """The threshold."""
        return self.threshold

    def rho(self, z: Array) -> Array:
        """‖z‖²/2, or t‖z‖ − t²/2, shape (..., k)."""
        size = norm(z)
        near = np.minimum(size, self.threshold)
        return near * (size - 0.5 * near)

    def weight(self, z: Array) -> Array:
        """min(1, t/‖z‖), shape (..., k)."""
        return self.threshold / np.maximum(norm(z), self.threshold)

    def psi(self, z: Array) -> Array:
        """z min(1, t/‖z‖)."""
        return z * self.weight(z)[..., None]

    def psi_prime(self, z: Array) -> Array:
        """I, or t/‖z‖ (I − z zᵀ/‖z‖²), shape (..., k, d, d)."""
        return self.curved(z, np.broadcast_to(np.eye(z.shape[-1]), (*z.shape, z.shape[-1])))

    def curved(self, z: Array, rows: Array) -> Array:
        """w (rows − ẑ ẑᵀ rows) beyond the threshold."""
        size = norm(z)
        weight = self.threshold / np.maximum(size, self.threshold)
        unit = z * (np.where(size <= self.threshold, 0.0, weight) / self.threshold)[..., None]
        radial = np.einsum("...kd,...kdp->...kp", unit, rows)
        out = rows - unit[..., None] * radial[..., None, :]
        out *= weight[..., None, None]
        return out

    def conjugate(self, u: Array) -> Array:
        """‖u‖²/2 for ‖u‖ ≤ t."""
        size = norm(u)
        return np.where(size <= self.threshold, 0.5 * np.square(size), np.inf)

    def expression(self, z: Any) -> Any:
        """Half of cvxpy's huber of each block's norm, summed."""
        import cvxpy as cp

        return 0.5 * cp.sum(cp.huber(cp.norm(z, 2, axis=1), self.threshold))

    def excess(self, z: Array, u: Array) -> Array:
        """½‖ψ − u‖² + (ψ − u)ᵀ(z − ψ)."""
        psi = self.psi(z)
        apart = psi - u
        along = np.einsum("...kd,...kd->...k", apart, z - psi)
        return (0.5 * np.square(apart).sum(axis=-1) + np.maximum(along, 0.0)).sum(axis=-1)

    def shrink(self, u: Array) -> Array:
        """t over the longest block, where that is above t."""
        return np.minimum(1.0, self.threshold / np.maximum(norm(u).max(axis=-1), 1e-300))


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
        _threshold(self, self.scale, "scale")

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
        return np.minimum(1.0, self.scale / np.maximum(np.abs(u).max(axis=(-2, -1)), 1e-300))

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows times the share by which ``|u|`` stays below s."""
        return np.maximum(1 - np.abs(u) / self.scale, 0.0)[..., None] * rows


@dataclass(frozen=True)
class GroupL1(Loss):
    r"""The length of each pose's block: :math:`\rho(z_i) = s\lVert z_i\rVert`.

    Parameters
    ----------
    scale : float, default 1
        s; it matters only beside another term, such as a prior.
    """

    scale: float = 1.0

    per = "pose"
    smooth = False
    degree = 1
    curvature = 0

    def __post_init__(self) -> None:
        _threshold(self, self.scale, "scale")

    @property
    def bound(self) -> float:
        """The scale."""
        return self.scale

    def rho(self, z: Array) -> Array:
        """s‖z‖, shape (..., k)."""
        return self.scale * norm(z)

    def psi(self, z: Array) -> Array:
        """s z/‖z‖."""
        return self.scale * z / np.maximum(norm(z), 1e-300)[..., None]

    def psi_prime(self, z: Array) -> Array:
        """s(I − z zᵀ/‖z‖²)/‖z‖, and 0 at 0: shape (..., k, d, d)."""
        size = norm(z)[..., None, None]
        unit = z / np.maximum(size[..., 0], 1e-300)
        across = np.eye(z.shape[-1]) - unit[..., :, None] * unit[..., None, :]
        return np.divide(self.scale * across, size, out=np.zeros(across.shape), where=size > 0)

    def conjugate(self, u: Array) -> Array:
        """0 for ‖u‖ ≤ s."""
        return np.where(norm(u) <= self.scale, 0.0, np.inf)

    def expression(self, z: Any) -> Any:
        """s times the sum of cvxpy's norms."""
        import cvxpy as cp

        return self.scale * cp.sum(cp.norm(z, 2, axis=1))

    def excess(self, z: Array, u: Array) -> Array:
        """s‖z‖ − uᵀz."""
        return np.maximum(self.scale * norm(z) - np.einsum("...kd,...kd->...k", u, z), 0.0).sum(axis=-1)

    def shrink(self, u: Array) -> Array:
        """s over the longest block, where that is above s."""
        return np.minimum(1.0, self.scale / np.maximum(norm(u).max(axis=-1), 1e-300))

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows times the share by which ‖u‖ stays below s, or across z, where u may turn with it."""
        inside = np.maximum(1 - norm(u) / self.scale, 0.0)[..., None, None] * rows
        size = np.maximum(norm(z), 1e-300)[..., None]
        unit = z / size
        across = rows - unit[..., None] * np.einsum("...kd,...kdp->...kp", unit, rows)[..., None, :]
        return inside + np.minimum(self.scale / size, 1.0)[..., None] * across


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
