"""Uniform noise, as the paper adds it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from .base import check_amounts, structured_covariance, turn

__all__ = ["UniformNoise"]


@dataclass(frozen=True)
class UniformNoise:
    r"""Independent uniform errors in ±err on every coordinate; variance :math:`\mathrm{err}^2/3`.

    Parameters
    ----------
    position : float
        :math:`err_p`, length units, on x, y and z.
    angle : float
        :math:`err_a`, **radians**, on the three angles of `coordinates`.
    length : float
        :math:`err_l`, units of the sensor reading.
    coordinates : str, default "ZXZ"
        The Euler sequence whose angles are in error, or ``"rotation_vector"``.

    References
    ----------
    Daney (1998), section 4.

    Examples
    --------
    >>> import numpy as np
    >>> noise = UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> noise.covariance(np.zeros((1, 3)), np.eye(3)[None]).shape
    (1, 7, 7)
    """

    position: float = 0.0
    angle: float = 0.0
    length: float = 0.0
    coordinates: str = "ZXZ"

    def __post_init__(self) -> None:
        check_amounts(self)

    def apply(
        self, position: Array, rotation: Array, length: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Add uniform errors; the stream is used in the order position, angles, length."""
        dp = rng.uniform(-self.position, self.position, position.shape)
        dq = rng.uniform(-self.angle, self.angle, position.shape)
        dl = rng.uniform(-self.length, self.length, length.shape)
        turned = turn(rotation, dq, self.coordinates) if self.angle else rotation
        return position + dp, turned, length + dl

    def covariance(self, position: Array, rotation: Array, n_readings: int = 1) -> Array:
        """First-order covariance of e at the given rotations, (..., n, 6 + r, 6 + r)."""
        variances = (self.position**2 / 3, self.angle**2 / 3, self.length**2 / 3)
        return structured_covariance(variances, self.coordinates, rotation, n_readings)

    def common(self, n_readings: int = 1) -> None:
        """No shared error."""

    def for_leg(self, number: int) -> UniformNoise:
        """The same: all readings are alike."""
        return self
