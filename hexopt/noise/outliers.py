"""Outliers: a share of bad poses on top of another noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array, as_array
from ..errors import InputError
from .base import IndexedNoise, Noise

__all__ = ["Outliers"]


@dataclass(frozen=True)
class Outliers:
    """A share of bad poses: `noise` on every pose, and a jump of position on some.

    Estimators are told of `noise` only: an outlier is what the model does not know.

    Parameters
    ----------
    noise : Noise
        The noise of good poses, and the covariance that is assumed.
    fraction : float
        Probability that a pose is bad, in [0, 1].
    shift : (float, float)
        Smallest and largest length of the jump, in a random direction, length units.

    Examples
    --------
    >>> from hexopt import UniformNoise
    >>> Outliers(UniformNoise(0.01), fraction=0.15, shift=(0.5, 2.0)).fraction
    0.15
    """

    noise: Noise
    fraction: float
    shift: tuple[float, float]

    def __post_init__(self) -> None:
        if not isinstance(self.noise, Noise):
            raise InputError(f"noise: expected a noise model such as UniformNoise, got {self.noise!r}")
        if not 0 <= self.fraction <= 1:
            raise InputError(f"fraction: expected a probability in [0, 1], got {self.fraction}")
        low, high = (float(v) for v in as_array("shift", self.shift, (2,), batch=False))
        if not 0 <= low <= high:
            raise InputError(f"shift: expected 0 <= low <= high, got {self.shift}")
        object.__setattr__(self, "shift", (low, high))

    def apply(
        self, position: Array, rotation: Array, length: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """The base noise, then the jumps."""
        position, rotation, length = self.noise.apply(position, rotation, length, rng)
        bad = rng.uniform(size=position.shape[:-1]) < self.fraction
        direction = rng.standard_normal(position.shape)
        direction /= np.sqrt((direction**2).sum(axis=-1, keepdims=True))
        jump = rng.uniform(*self.shift, size=position.shape[:-1])
        return position + (bad * jump)[..., None] * direction, rotation, length

    def covariance(self, position: Array, rotation: Array, n_readings: int = 1) -> Array:
        """The covariance of the good poses."""
        return self.noise.covariance(position, rotation, n_readings)

    def common(self, n_readings: int = 1) -> Array | None:
        """The shared error of the base noise."""
        return self.noise.common(n_readings)

    def indexed(self, shape: tuple[int, ...], index: Any) -> Outliers:
        """The same, with the part of the base noise that belongs to these poses."""
        noise = self.noise
        return replace(self, noise=noise.indexed(shape, index)) if isinstance(noise, IndexedNoise) else self

    def for_leg(self, number: int) -> Outliers:
        """The same, with the base noise as the leg sees it."""
        return replace(self, noise=self.noise.for_leg(number))
