r"""Noise models: what is added to exact readings, and the covariance that estimators assume.

One pose has the error :math:`e = (\delta P, \delta\omega, \delta\rho)`: position, spatial rotation
(:math:`R = \exp([\delta\omega]_\times) R_\text{true}`) and reading; 7 numbers for one leg, 12 for the
six readings of a robot. A noise model is a value that travels with the data; it is what is *assumed*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from .arrays import Array, as_array, matvec, transpose
from .errors import InputError
from .rotations import euler_jacobian, euler_to_matrix, matrix_to_euler, rotation_vector_to_matrix

__all__ = ["Noise", "NormalNoise", "Outliers", "UniformNoise"]

ROTATION_VECTOR = "rotation_vector"


@runtime_checkable
class Noise(Protocol):
    """What a noise model offers; write a class with these three methods to add your own."""

    def apply(
        self, position: Array, rotation: Array, length: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Noisy copies of exact readings; `length` is (..., n) for one leg or (..., n, 6)."""
        ...

    def covariance(self, rotation: Array, n_readings: int = 1) -> Array:
        """Covariance of e per pose, (..., n, 6 + n_readings, 6 + n_readings)."""
        ...

    def common(self, n_readings: int = 1) -> Array | None:
        """Covariance of an error that all poses of a set share, or None."""
        ...

    def for_leg(self, number: int) -> Noise:
        """The same noise as one leg sees it, with one reading a pose."""
        ...


def _turned(rotation: Array, error: Array, coordinates: str) -> Array:
    """`rotation` with an error of its angles, in the named coordinates."""
    if coordinates == ROTATION_VECTOR:
        return rotation_vector_to_matrix(error) @ rotation
    return euler_to_matrix(matrix_to_euler(rotation, coordinates) + error, coordinates)


def _angle_jacobian(rotation: Array, coordinates: str) -> Array:
    """δω per unit error of the angles."""
    if coordinates == ROTATION_VECTOR:
        return np.broadcast_to(np.eye(3), rotation.shape)
    return euler_jacobian(matrix_to_euler(rotation, coordinates), coordinates)


def _check_amounts(noise: UniformNoise | NormalNoise) -> None:
    for name in ("position", "angle", "length"):
        value = float(as_array(name, getattr(noise, name), (), batch=False))
        if value < 0:
            raise InputError(f"{name}: expected a noise level >= 0, got {value}")
        object.__setattr__(noise, name, value)
    if noise.angle > 1.0:
        raise InputError(f"angle: {noise.angle} rad of noise; angles are radians: numpy.deg2rad(…)")
    if noise.coordinates != ROTATION_VECTOR:
        euler_to_matrix(np.zeros(3), noise.coordinates)


def _structured_covariance(
    variances: tuple[float, float, float], coordinates: str, rotation: Array, n_readings: int
) -> Array:
    position, angle, length = variances
    jacobian = _angle_jacobian(rotation, coordinates)
    out = np.zeros((*rotation.shape[:-2], 6 + n_readings, 6 + n_readings))
    axis = np.arange(3)
    out[..., axis, axis] = position
    out[..., 3:6, 3:6] = angle * (jacobian @ transpose(jacobian))
    readings = np.arange(6, 6 + n_readings)
    out[..., readings, readings] = length
    return out


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
    >>> noise.covariance(np.eye(3)[None]).shape
    (1, 7, 7)
    """

    position: float = 0.0
    angle: float = 0.0
    length: float = 0.0
    coordinates: str = "ZXZ"

    def __post_init__(self) -> None:
        _check_amounts(self)

    def apply(
        self, position: Array, rotation: Array, length: Array, rng: np.random.Generator
    ) -> tuple[Array, Array, Array]:
        """Add uniform errors; the stream is used in the order position, angles, length."""
        dp = rng.uniform(-self.position, self.position, position.shape)
        dq = rng.uniform(-self.angle, self.angle, position.shape)
        dl = rng.uniform(-self.length, self.length, length.shape)
        turned = _turned(rotation, dq, self.coordinates) if self.angle else rotation
        return position + dp, turned, length + dl

    def covariance(self, rotation: Array, n_readings: int = 1) -> Array:
        """First-order covariance of e at the given rotations, (..., n, 6 + r, 6 + r)."""
        variances = (self.position**2 / 3, self.angle**2 / 3, self.length**2 / 3)
        return _structured_covariance(variances, self.coordinates, rotation, n_readings)

    def common(self, n_readings: int = 1) -> None:
        """No shared error."""

    def for_leg(self, number: int) -> UniformNoise:
        """The same: all readings are alike."""
        return self


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
        _check_amounts(self)
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
            turned = _turned(rotation, dq, self.coordinates) if self.angle else rotation
        else:
            root = _root(self.covariance(rotation, n_readings))
            error = matvec(root, rng.standard_normal(root.shape[:-1]))
            dp, dl = error[..., :3], error[..., 6:]
            turned = rotation_vector_to_matrix(error[..., 3:6]) @ rotation
        shared = self.common(n_readings)
        if shared is not None:
            error = matvec(_root(shared), rng.standard_normal((*position.shape[:-2], 1, 6 + n_readings)))
            dp, dl = dp + error[..., :3], dl + error[..., 6:]
            turned = rotation_vector_to_matrix(error[..., 3:6]) @ turned
        return position + dp, turned, length + (dl[..., 0] if n_readings == 1 else dl)

    def covariance(self, rotation: Array, n_readings: int = 1) -> Array:
        """Covariance of e at the given rotations, (..., n, 6 + r, 6 + r)."""
        if self.pose_covariance is None:
            variances = (self.position**2, self.angle**2, self.length**2)
            return _structured_covariance(variances, self.coordinates, rotation, n_readings)
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

    def for_leg(self, number: int) -> NormalNoise:
        """The rows of the pose and of this leg's reading, where a covariance has all six."""
        rows = np.array([0, 1, 2, 3, 4, 5, 5 + number])
        parts = {
            name: value[..., rows[:, None], rows]
            for name in ("pose_covariance", "common_covariance")
            if (value := getattr(self, name)) is not None and value.shape[-1] == 12
        }
        return replace(self, **parts)


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

    def covariance(self, rotation: Array, n_readings: int = 1) -> Array:
        """The covariance of the good poses."""
        return self.noise.covariance(rotation, n_readings)

    def common(self, n_readings: int = 1) -> Array | None:
        """The shared error of the base noise."""
        return self.noise.common(n_readings)

    def for_leg(self, number: int) -> Outliers:
        """The same, with the base noise as the leg sees it."""
        return replace(self, noise=self.noise.for_leg(number))


def _check_covariance(name: str, value: npt.ArrayLike) -> Array:
    matrix = np.asarray(value)
    if matrix.shape[-2:] not in ((7, 7), (12, 12)):
        raise InputError(
            f"{name}: expected shape (..., 7, 7) (one leg) or (..., 12, 12) (six readings), got {matrix.shape}"
        )
    covariance = as_array(name, value, matrix.shape[-2:])
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
