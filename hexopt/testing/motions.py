"""The same measurements from other frames, in other units, on other scales; and where the answer goes along."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..geometry import Leg, length_factor
from ..measurements import LegMeasurements
from ..noise import NormalNoise
from ..problem import RowCovariance, RowNoise
from ..rotations import euler_to_matrix, skew

__all__ = ["Motion", "ScaledNoise", "base_motion", "platform_motion", "unit_change"]


@dataclass(frozen=True)
class Motion:
    r"""Other frames and another unit: :math:`P' = f(Q (P + R u) + t)`, :math:`R' = Q R U`.

    Attributes
    ----------
    turn, shift : ndarray, shape (3, 3) and (3,)
        Q and t, of the base frame.
    platform_turn, platform_shift : ndarray, shape (3, 3) and (3,)
        U and u, of the platform frame.
    unit : str
        The new length unit.
    factor : float
        f, new length units in one old.
    """

    turn: Array
    shift: Array
    platform_turn: Array
    platform_shift: Array
    unit: str
    factor: float

    def block(self, name: str, values: Array) -> Array:
        """Where the values of one block of a leg go: :math:`a' = f(Q a + t)`, :math:`b' = f U^T(b - u)`."""
        if name == "base_point":
            values = values @ self.turn.T + self.shift
        elif name == "platform_point":
            values = (values - self.platform_shift) @ self.platform_turn
        return values if name == "gain" else self.factor * values

    def leg(self, leg: Leg) -> Leg:
        """The same leg, seen from there; it reads in the new unit, too."""
        platform, base, offset = (
            self.block(name, getattr(leg, name)) for name in ("platform_point", "base_point", "offset")
        )
        return Leg(leg.number, platform, base, offset, leg.gain, self.unit)

    def data(self, data: LegMeasurements) -> LegMeasurements:
        """The same measurements, seen from there: poses, readings, the noise of each pose, the nominal."""
        lever = data.rotation @ self.platform_shift
        noise = None
        if data.noise is not None:
            error = np.zeros((*lever.shape[:-1], 7, 7))  # how the errors of a pose are seen from there
            error[..., :3, :3] = self.factor * self.turn
            error[..., :3, 3:6] = -self.factor * self.turn @ skew(lever)
            error[..., 3:6, 3:6] = self.turn
            error[..., 6, 6] = self.factor
            covariance = error @ data.noise.covariance(data.position, data.rotation) @ np.swapaxes(error, -1, -2)
            noise = NormalNoise(pose_covariance=0.5 * (covariance + np.swapaxes(covariance, -1, -2)))
        return LegMeasurements(
            self.factor * ((data.position + lever) @ self.turn.T + self.shift),
            self.turn @ data.rotation @ self.platform_turn,
            self.factor * data.readings(),
            data.lock,
            noise,
            None if data.nominal is None else self.leg(data.nominal),
            self.unit,
        )


def base_motion(unit: str, size: float) -> Motion:
    """A turn and a shift of the base frame, for a robot of the given size."""
    turn, shift = euler_to_matrix([0.4, -1.1, 2.0]), size * np.array([0.3, -0.7, 0.2])
    return Motion(turn, shift, np.eye(3), np.zeros(3), unit, 1.0)


def platform_motion(unit: str, size: float) -> Motion:
    """A turn and a shift of the platform frame, for a robot of the given size."""
    turn, shift = euler_to_matrix([-1.3, 0.8, 0.5]), size * np.array([-0.1, 0.05, 0.2])
    return Motion(np.eye(3), np.zeros(3), turn, shift, unit, 1.0)


def unit_change(unit: str) -> Motion:
    """From one length unit to another; "um" and "unstated" stay what they are."""
    smaller = {"m": "dm", "dm": "cm", "cm": "mm", "mm": "um", "in": "mm"}.get(unit, unit)
    return Motion(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), smaller, length_factor(unit, smaller))


@dataclass(frozen=True)
class ScaledNoise:
    """The row noise of a problem whose columns were multiplied by `scale`, and its unknowns divided."""

    noise: RowNoise
    scale: Array

    def covariance(self, values: Array) -> RowCovariance:
        """The covariance of the rows at the scaled values."""
        return self.noise.covariance(values * self.scale)
