"""Measured poses and leg readings, with their lock, their assumed noise, and the nominal geometry."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from .arrays import Array, as_array
from .errors import InputError, LockError, UnitError
from .geometry import Hexapod, Leg, check_length_unit
from .geometry.leg import check_leg_number
from .noise import IndexedNoise, Noise
from .rotations import check_rotation, rotation_vector_to_matrix

__all__ = ["LegMeasurements", "Lock", "Measurements"]


class Lock(StrEnum):
    """How the clamp holds a leg while a set of poses is measured (Daney 1998, section 3.1)."""

    NONE = "none"  #: any pose
    DIRECTION = "direction"  #: Type I: constant direction, free length
    LEG = "leg"  #: Type II: constant direction and length
    LENGTH = "length"  #: Type III: constant length, free direction

    @classmethod
    def of(cls, value: object) -> Lock:
        """The lock named by `value`, or a :class:`LockError` that lists the known names."""
        try:
            return cls(value)  # type: ignore[arg-type]  # a wrong type is the error below
        except ValueError:
            raise LockError(f"lock: expected one of {', '.join(cls)}; got {value!r}") from None


def _check_poses(position: npt.ArrayLike, rotation: npt.ArrayLike) -> tuple[Array, Array]:
    p = as_array("position", position, ("n", 3), own=True)
    r = as_array("rotation", rotation, ("n", 3, 3), own=True)
    if r.shape[:-1] != p.shape:
        raise InputError(
            f"position and rotation disagree: {p.shape} needs rotations of shape {(*p.shape, 3)}, got {r.shape}"
        )
    return p, check_rotation("rotation", r)


def _check_noise(noise: object) -> None:
    if noise is not None and (isinstance(noise, type) or not isinstance(noise, Noise)):
        raise InputError(f"noise: expected a noise model such as UniformNoise(…), or None; got {noise!r}")


def _check_unit(unit: str, nominal: Leg | Hexapod | None) -> str:
    label = check_length_unit("length_unit", unit or (nominal.length_unit if nominal is not None else "unstated"))
    if nominal is not None and nominal.length_unit != label:
        raise UnitError(f"the measurements are in {label}, the nominal geometry in {nominal.length_unit}")
    return label


def _indices(index: Any) -> npt.NDArray[Any]:
    """An array that indexes; an empty list is one of whole numbers."""
    array = np.atleast_1d(index)
    return array if array.size else array.astype(int)


class _Poses:
    """What both kinds of measurements share: the batch of sets, and views of it."""

    position: Array
    rotation: Array
    length: Array | None
    noise: Noise | None

    @property
    def n_poses(self) -> int:
        """Poses in a set."""
        return int(self.position.shape[-2])

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one set, (n_sets,) for many."""
        return self.position.shape[:-2]

    def _noise_at(self, index: Any) -> Noise | None:
        """The noise of some of the poses: a covariance for each pose goes with its pose."""
        if isinstance(self.noise, IndexedNoise):
            return self.noise.indexed(self.position.shape[:-1], index)
        return self.noise

    def _sliced(self, **arrays: Any) -> Any:
        return replace(self, **arrays)  # type: ignore[type-var]  # both users are dataclasses

    def shifted(self, error: Array) -> Self:
        r"""The measurements moved by errors :math:`e = (\delta P, \delta\omega, \delta\rho)`, (..., n, 6 + readings).

        Every pose becomes :math:`P + \delta P`, :math:`\exp([\delta\omega]_\times) R`, :math:`\rho + \delta\rho`.
        """
        length = self.length
        if length is not None:
            length = length + (error[..., 6:] if length.ndim == self.position.ndim else error[..., 6])
        turned = rotation_vector_to_matrix(error[..., 3:6]) @ self.rotation
        return self.moved_to(self.position + error[..., :3], turned, length)

    def moved_to(self, position: Array, rotation: Array, length: Array | None) -> Self:
        """The same with other values, which are not checked again."""
        moved = copy.copy(self)
        for name, array in (("position", position), ("rotation", rotation), ("length", length)):
            object.__setattr__(moved, name, array)
        return moved


@dataclass(frozen=True, eq=False)
class LegMeasurements(_Poses):
    r"""One leg seen in `n` poses, or in a batch of such sets.

    Parameters
    ----------
    position : array_like, shape (..., n, 3)
        :math:`P_i`, length units.
    rotation : array_like, shape (..., n, 3, 3)
        :math:`R_i`, platform to base; orthonormal and right-handed to 1e-6.
    length : array_like, shape (..., n), or None
        The sensor reading :math:`\rho_i` (true length :math:`\gamma\rho + \delta`); None if not read.
    lock : Lock or str
        "none", "direction" (Type I), "leg" (II) or "length" (III).
    noise : Noise, optional
        What is assumed of the errors; None: unknown.
    nominal : Leg, optional
        The numbered leg that lends offset, gain and a start to nonlinear methods.
    length_unit : str, optional
        By default the nominal's, else "unstated".

    Raises
    ------
    InputError
        For shapes that disagree, values that are not finite, matrices that are no rotations.
    LockError
        For an unknown lock.

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), leg=3, lock="direction", n_poses=7, n_sets=10, rng=0)
    >>> data.batch_shape, data.n_poses, data[0].position.shape
    ((10,), 7, (7, 3))
    """

    position: Array
    rotation: Array
    length: Array | None
    lock: Lock
    noise: Noise | None = None
    nominal: Leg | None = None
    length_unit: str = ""

    def __post_init__(self) -> None:
        position, rotation = _check_poses(self.position, self.rotation)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "rotation", rotation)
        if self.length is not None:
            length = as_array("length", self.length, ("n",), own=True)
            if length.shape != position.shape[:-1]:
                raise InputError(
                    f"position and length disagree: {position.shape[:-1]} poses, readings of shape {length.shape}"
                )
            object.__setattr__(self, "length", length)
        object.__setattr__(self, "lock", Lock.of(self.lock))
        _check_noise(self.noise)
        if self.nominal is not None and not isinstance(self.nominal, Leg):
            raise InputError(f"nominal: expected a Leg (robot.leg(k)), got {type(self.nominal).__name__}")
        object.__setattr__(self, "length_unit", _check_unit(self.length_unit, self.nominal))

    @property
    def leg(self) -> int:
        """The number of the measured leg, which the nominal knows."""
        if self.nominal is None:
            raise InputError("which leg was measured? give nominal=robot.leg(k)")
        return self.nominal.number

    @property
    def legs(self) -> tuple[int, ...]:
        """The numbers of the legs that were measured: this one."""
        return (self.leg,)

    def readings(self) -> Array:
        """The sensor readings; an error where none were taken."""
        if self.length is None:
            raise InputError("length: this loop equation needs the leg's readings, and none were given")
        return self.length

    def __getitem__(self, sets: Any) -> LegMeasurements:
        """Some sets of the batch."""
        if not self.batch_shape:
            raise InputError("these measurements are one set, not a batch; use .poses(…) to choose poses")
        length = None if self.length is None else self.length[sets]
        result: LegMeasurements = self._sliced(
            position=self.position[sets],
            rotation=self.rotation[sets],
            length=length,
            noise=self._noise_at(sets),
        )
        return result

    def poses(self, index: Any) -> LegMeasurements:
        """Some poses of every set: an integer array, a list or a slice."""
        index = index if isinstance(index, slice) else _indices(index)
        length = None if self.length is None else self.length[..., index]
        result: LegMeasurements = self._sliced(
            position=self.position[..., index, :],
            rotation=self.rotation[..., index, :, :],
            length=length,
            noise=self._noise_at((..., index, slice(None), slice(None))),
        )
        return result


@dataclass(frozen=True, eq=False)
class Measurements(_Poses):
    """All six readings in `n` poses, or in a batch of such sets.

    Parameters
    ----------
    position, rotation : array_like, shape (..., n, 3) and (..., n, 3, 3)
    length : array_like, shape (..., n, 6)
        The readings of legs 1…6.
    lock : Lock or str
        The lock of `locked_leg`; the other legs are free.
    locked_leg : int, optional
        1…6; needed unless `lock` is "none".
    noise : Noise, optional
    nominal : Hexapod, optional
    length_unit : str, optional
    """

    legs: ClassVar[tuple[int, ...]] = (1, 2, 3, 4, 5, 6)

    position: Array
    rotation: Array
    length: Array
    lock: Lock = Lock.NONE
    locked_leg: int | None = None
    noise: Noise | None = None
    nominal: Hexapod | None = None
    length_unit: str = ""

    def __post_init__(self) -> None:
        position, rotation = _check_poses(self.position, self.rotation)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "rotation", rotation)
        length = as_array("length", self.length, ("n", 6), own=True)
        if length.shape[:-1] != position.shape[:-1]:
            raise InputError(
                f"position and length disagree: {position.shape[:-1]} poses, readings of shape {length.shape}"
            )
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "lock", Lock.of(self.lock))
        if self.lock is Lock.NONE:
            if self.locked_leg is not None:
                raise LockError(f"locked_leg: {self.locked_leg} is named, but the lock is 'none'")
        elif self.locked_leg is None:
            raise LockError(f"locked_leg: which leg (1…6) has the lock {str(self.lock)!r}?")
        else:
            object.__setattr__(self, "locked_leg", check_leg_number(self.locked_leg))
        _check_noise(self.noise)
        if self.nominal is not None and not isinstance(self.nominal, Hexapod):
            raise InputError(f"nominal: expected a Hexapod, got {type(self.nominal).__name__}")
        object.__setattr__(self, "length_unit", _check_unit(self.length_unit, self.nominal))

    def leg(self, number: int) -> LegMeasurements:
        """The measurements as leg `number` sees them; a leg that is not the locked one is free."""
        k = check_leg_number(number)
        return LegMeasurements(
            self.position,
            self.rotation,
            self.length[..., k - 1],
            self.lock if k == self.locked_leg else Lock.NONE,
            None if self.noise is None else self.noise.for_leg(k),
            None if self.nominal is None else self.nominal.leg(k),
            self.length_unit,
        )

    def __getitem__(self, sets: Any) -> Measurements:
        """Some sets of the batch."""
        if not self.batch_shape:
            raise InputError("these measurements are one set, not a batch; use .poses(…) to choose poses")
        result: Measurements = self._sliced(
            position=self.position[sets],
            rotation=self.rotation[sets],
            length=self.length[sets],
            noise=self._noise_at(sets),
        )
        return result

    def poses(self, index: Any) -> Measurements:
        """Some poses of every set: an integer array, a list or a slice."""
        index = index if isinstance(index, slice) else _indices(index)
        result: Measurements = self._sliced(
            position=self.position[..., index, :],
            rotation=self.rotation[..., index, :, :],
            length=self.length[..., index, :],
            noise=self._noise_at((..., index, slice(None), slice(None))),
        )
        return result
