"""The six equations of a pose, for many poses at once, and their Jacobian."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, norm, transpose
from ..geometry import Hexapod
from ..rotations import rotation_vector_to_matrix

__all__ = ["LegEquations", "condition_of", "inverses", "robot_blocks"]


def robot_blocks(robot: Hexapod) -> dict[str, Array]:
    """A robot's legs as stacked arrays: points (6, 3), offset and gain (6,)."""
    return {
        "platform_point": robot.platform_points,
        "base_point": robot.base_points,
        "offset": robot.offsets,
        "gain": robot.gains,
    }


@dataclass(frozen=True)
class LegEquations:
    """The six misclosures of k poses; turns count as lengths, times the platform's radius."""

    platform: Array  # (k, 6, 3)
    base: Array  # (k, 6, 3)
    length: Array  # (k, 6), true lengths
    radius: Array  # (k,)

    @classmethod
    def of(cls, blocks: Mapping[str, Array], reading: Array, batch: tuple[int, ...]) -> LegEquations:
        """The equations of a flat batch."""
        parts = [blocks["platform_point"], blocks["base_point"], blocks["gain"] * reading + blocks["offset"]]
        shapes = [(*batch, 6, 3), (*batch, 6, 3), (*batch, 6)]
        platform, base, length = (
            np.broadcast_to(part, shape).reshape(-1, *shape[len(batch) :])
            for part, shape in zip(parts, shapes, strict=True)
        )
        radius = norm(platform).max(axis=-1)
        return cls(platform, base, length, np.where(radius > 0, radius, 1.0))

    def __getitem__(self, index: Any) -> LegEquations:
        return LegEquations(self.platform[index], self.base[index], self.length[index], self.radius[index])

    @property
    def size(self) -> Array:
        """The largest coordinate or length, shape (k,)."""
        parts = (norm(self.platform), norm(self.base), np.abs(self.length))
        return np.maximum.reduce([part.max(axis=-1) for part in parts])

    def __call__(self, position: Array, rotation: Array) -> tuple[Array, Array]:
        """Misclosures (k, 6), and their derivatives by (δP, radius·δω), (k, 6, 6)."""
        arm = self.platform @ transpose(rotation)
        vector = position[:, None, :] + arm - self.base
        distance = norm(vector)
        unit = vector / np.where(distance > 0, distance, 1.0)[..., None]
        arm /= self.radius[:, None, None]
        jacobian = np.empty((*distance.shape, 6))
        jacobian[..., :3] = unit
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # Rb × n
            jacobian[..., 3 + i] = arm[..., j] * unit[..., k] - arm[..., k] * unit[..., j]
        return distance - self.length, jacobian

    def moved(self, position: Array, rotation: Array, step: Array) -> tuple[Array, Array]:
        """The poses after a step (δP, radius·δω)."""
        turned = rotation_vector_to_matrix(step[:, 3:] / self.radius[:, None]) @ rotation
        return position + step[:, :3], turned


def inverses(matrix: Array) -> tuple[Array, Array]:
    """Inverses, NaN where there is none, and determinants; NumPy would raise for all if one is singular."""
    with np.errstate(invalid="ignore"):
        determinant = np.linalg.det(matrix)
    regular = np.isfinite(determinant) & (determinant != 0)
    inverse = np.linalg.inv(np.where(regular[..., None, None], matrix, np.eye(matrix.shape[-1])))
    return np.where(regular[..., None, None], inverse, np.nan), determinant


def condition_of(matrix: Array) -> Array:
    """The product of the Frobenius norms of matrices and their inverses; infinite where there is none."""
    inverse = inverses(matrix)[0]
    product = np.sqrt(np.einsum("...ij,...ij->...", matrix, matrix) * np.einsum("...ij,...ij->...", inverse, inverse))
    return np.nan_to_num(product, nan=np.inf, posinf=np.inf)
