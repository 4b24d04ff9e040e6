"""What every noise model offers, and what the built-in ones share."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..arrays import Array, as_array, transpose
from ..errors import InputError
from ..rotations import euler_jacobian, euler_to_matrix, rotation_vector_to_matrix
from ..rotations.euler import euler_angles

__all__ = ["IndexedNoise", "Noise", "angle_jacobian", "check_amounts", "structured_covariance", "turn"]

ROTATION_VECTOR = "rotation_vector"


@runtime_checkable
class Noise(Protocol):
    """What a noise model offers; write a class with these four methods to add your own."""

    def apply(
        self, position: Array, rotation: Array, length: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Noisy copies of exact readings; `length` is (..., n) for one leg or (..., n, 6)."""
        ...

    def covariance(self, position: Array, rotation: Array, n_readings: int = 1) -> Array:
        """Covariance of e per pose, (..., n, 6 + n_readings, 6 + n_readings)."""
        ...

    def common(self, n_readings: int = 1) -> Array | None:
        """Covariance of an error that all poses of a set share, or None."""
        ...

    def for_leg(self, number: int) -> Noise:
        """The same noise as one leg sees it, with one reading a pose."""
        ...


@runtime_checkable
class IndexedNoise(Protocol):
    """A noise model that differs between poses; it is asked for its part when some of them are taken."""

    def indexed(self, shape: tuple[int, ...], index: Any) -> Noise:
        """The noise of poses ``[index]`` out of poses of `shape`, (..., n); covariances have two dimensions more."""
        ...


def turn(rotation: Array, error: Array, coordinates: str) -> Array:
    """`rotation` with an error of its angles, in the named coordinates."""
    if coordinates == ROTATION_VECTOR:
        return rotation_vector_to_matrix(error) @ rotation
    return euler_to_matrix(euler_angles(rotation, coordinates) + error, coordinates)


def angle_jacobian(rotation: Array, coordinates: str) -> Array:
    """δω per unit error of the angles."""
    if coordinates == ROTATION_VECTOR:
        return np.broadcast_to(np.eye(3), rotation.shape)
    return euler_jacobian(euler_angles(rotation, coordinates), coordinates)


def check_amounts(noise: Any) -> None:
    """Check and normalise the fields position, angle, length and coordinates of a noise model."""
    for name in ("position", "angle", "length"):
        value = float(as_array(name, getattr(noise, name), (), batch=False))
        if value < 0:
            raise InputError(f"{name}: expected a noise level >= 0, got {value}")
        object.__setattr__(noise, name, value)
    if noise.angle > 1.0:
        raise InputError(f"angle: {noise.angle} rad of noise; angles are radians: numpy.deg2rad(…)")
    if noise.coordinates != ROTATION_VECTOR:
        euler_to_matrix(np.zeros(3), noise.coordinates)


def structured_covariance(
    variances: tuple[float, float, float], coordinates: str, rotation: Array, n_readings: int
) -> Array:
    """Covariance of e from the variances of position, angles and reading."""
    position, angle, length = variances
    jacobian = angle_jacobian(rotation, coordinates)
    out = np.zeros((*rotation.shape[:-2], 6 + n_readings, 6 + n_readings))
    axis = np.arange(3)
    out[..., axis, axis] = position
    out[..., 3:6, 3:6] = angle * (jacobian @ transpose(jacobian))
    readings = np.arange(6, 6 + n_readings)
    out[..., readings, readings] = length
    return out
