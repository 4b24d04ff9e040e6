"""Normal noise: standard deviations or full covariances, and a part that all poses share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, matvec, transpose
from ..errors import InputError
from ..rotations import rotation_vector_to_matrix
from .base import check_amounts, structured_covariance, turn

__all__ = ["NormalNoise"]


@dataclass(frozen=True, eq=False)
class NormalNoise:
    r"""Normal errors: three standard deviations, or one covariance of :math:`e`; plus a shared part.

    Parameters
    ----------
    position, angle, length : float
        Standard deviations (length units, radians, reading units), as in :class:`UniformNoise`.
    coordinates : str, default "ZXZ"
    pose_covariance : array_like, shape (..., 7, 7) or (..., 12, 12), optional
        The covariance of :math:`e = (\delta P, \delta\omega, \delta\rho)`, instead of the three
        numbers; trackers correlate δP with δω through the lever arm. Leading dimensions: one a pose.
    common_covariance : array_like, shape (7, 7) or (12, 12), optional
        Covariance of an error that all poses of a set share (a tracker's constant offset, say).

    Raises
    ------
    InputError
        If a covariance is not symmetric and positive semidefinite, or both kinds are given.
    """

    position: float = 0.0
    angle: float = 0.0
    length: float = 0.0
    coordinates: str = "ZXZ"
    pose_covariance: Array | None = None
    common_covariance: Array | None = None

    def __post_init__(self) -> None:
        check_amounts(self)
        if self.pose_covariance is not None and (self.position or self.angle or self.length):
            raise InputError("give either pose_covariance or position, angle and length, not both")
        for name in ("pose_covariance", "common_covariance"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, _check_covariance(name, getattr(self, name)))

    def apply(
        self, position: Array, rotation: Array, length: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Add normal errors; the shared error, if any, is drawn once a set."""
        n_readings = 1 if length.ndim == position.ndim - 1 else length.shape[-1]
        flat = length[..., None] if n_readings == 1 else length
        if self.pose_covariance is None:
            dp = self.position * rng.standard_normal(position.shape)
            dq = self.angle * rng.standard_normal(position.shape)
            dl = self.length * rng.standard_normal(flat.shape)
            turned = turn(rotation, dq, self.coordinates) if self.angle else rotation
        else:
            root = _root(self.covariance(position, rotation, n_readings))
            error = matvec(root, rng.standard_normal(root.shape[:-1]))
            dp, dl = error[..., :3], error[..., 6:]
            turned = rotation_vector_to_matrix(error[..., 3:6]) @ rotation
        shared = self.common(n_readings)
        if shared is not None:
            error = matvec(_root(shared), rng.standard_normal((*position.shape[:-2], 1, 6 + n_readings)))
            dp, dl = dp + error[..., :3], dl + error[..., 6:]
            turned = rotation_vector_to_matrix(error[..., 3:6]) @ turned
        return position + dp, turned, length + (dl[..., 0] if n_readings == 1 else dl)

    def covariance(self, position: Array, rotation: Array, n_readings: int = 1) -> Array:
        """Covariance of e at the given rotations, (..., n, 6 + r, 6 + r)."""
        if self.pose_covariance is None:
            variances = (self.position**2, self.angle**2, self.length**2)
            return structured_covariance(variances, self.coordinates, rotation, n_readings)
        size = 6 + n_readings
        covariance = _for_readings(self.pose_covariance, n_readings)
        try:
            return np.broadcast_to(covariance, (*rotation.shape[:-2], size, size))
        except ValueError:
            raise InputError(
                f"pose_covariance: shape {self.pose_covariance.shape} does not fit poses of shape {rotation.shape[:-2]}"
            ) from None

    def common(self, n_readings: int = 1) -> Array | None:
        """Covariance of the shared error, or None."""
        if self.common_covariance is None:
            return None
        return _for_readings(self.common_covariance, n_readings)

    def indexed(self, shape: tuple[int, ...], index: Any) -> NormalNoise:
        """The noise of some poses: a covariance for each pose goes with its pose."""
        if self.pose_covariance is None or self.pose_covariance.ndim == 2:
            return self
        each = np.broadcast_to(self.pose_covariance, (*shape, *self.pose_covariance.shape[-2:]))
        return replace(self, pose_covariance=each[index])

    def for_leg(self, number: int) -> NormalNoise:
        """The rows of the pose and of this leg's reading, where a covariance has all six."""
        rows = np.array([0, 1, 2, 3, 4, 5, 5 + number])
        parts = {
            name: value[..., rows[:, None], rows]
            for name in ("pose_covariance", "common_covariance")
            if (value := getattr(self, name)) is not None and value.shape[-1] == 12
        }
        return replace(self, **parts)


def _check_covariance(name: str, value: npt.ArrayLike) -> Array:
    covariance = as_array(name, value, ("r", "r"), batch=name == "pose_covariance")
    if covariance.shape[-2:] not in ((7, 7), (12, 12)):
        raise InputError(
            f"{name}: expected shape (..., 7, 7) (one leg) or (..., 12, 12) (six readings), got {covariance.shape}"
        )
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", covariance), 1e-300))
    scaled = covariance / scale[..., :, None] / scale[..., None, :]
    if np.abs(scaled - transpose(scaled)).max() > 1e-9:
        raise InputError(f"{name}: expected a symmetric matrix")
    if np.linalg.eigvalsh(scaled).min() < -1e-9:
        raise InputError(f"{name}: expected a positive semidefinite matrix, found a negative eigenvalue")
    return covariance


def _for_readings(covariance: Array, n_readings: int) -> Array:
    size = covariance.shape[-1]
    if size == 6 + n_readings:
        return covariance
    raise InputError(
        f"the covariance has {size} rows: {size - 6} reading(s), but the data has {n_readings}; "
        f"expected {6 + n_readings} rows"
    )


def _root(covariance: Array) -> Array:
    """The symmetric square root of positive semidefinite matrices."""
    values, vectors = np.linalg.eigh(covariance)
    root: Array = (vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ transpose(vectors)
    return root
