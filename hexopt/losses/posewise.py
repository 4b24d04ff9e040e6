"""Losses of the block of a pose: Huber's of its length, and its length itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, norm
from .base import Loss, across, check_positive, factor_into

__all__ = ["GroupHuber", "GroupL1"]


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
        check_positive(self, self.threshold)

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
        out = across(unit, rows)
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
        return factor_into(norm(u).max(axis=-1), self.threshold)


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
        check_positive(self, self.scale, "scale")

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
        return factor_into(norm(u).max(axis=-1), self.scale)

    def freed(self, z: Array, u: Array, rows: Array) -> Array:
        """Rows times the share by which ‖u‖ stays below s, or across z, where u may turn with it."""
        inside = np.maximum(1 - norm(u) / self.scale, 0.0)[..., None, None] * rows
        size = np.maximum(norm(z), 1e-300)[..., None]
        return inside + np.minimum(self.scale / size, 1.0)[..., None] * across(z / size, rows)
