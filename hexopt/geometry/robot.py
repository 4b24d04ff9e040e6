"""A hexapod: six legs, a home pose, limits, ranges."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..arrays import Array, as_array, as_generator, norm
from ..errors import FileFormatError, HexoptError, InputError
from ..rotations import check_rotation
from .leg import Leg, check_leg_number
from .limits import Limits, PoseRanges
from .toml import read_fields, write_fields
from .units import check_length_unit

__all__ = ["Hexapod"]


@dataclass(frozen=True, eq=False)
class Hexapod:
    r"""A Gough–Stewart platform: :math:`\gamma_k\rho_k + \delta_k = \lVert P + R\,b_k - a_k\rVert`, k = 1…6.

    Parameters
    ----------
    name : str
    base_points : array_like, shape (6, 3)
        :math:`a_k` in the base frame.
    platform_points : array_like, shape (6, 3)
        :math:`b_k` in the platform frame.
    offsets : array_like, shape (6,), default 0
        :math:`\delta_k`.
    gains : array_like, shape (6,), default 1
        :math:`\gamma_k`, length units per reading unit.
    length_unit : str, default "cm"
        A checked label: m, dm, cm, mm, um, in, or "unstated".
    reading_unit : str, optional
        What the leg sensors report; a free label (e.g. "rev"); by default the length unit.
    home_position, home_rotation : array_like, shape (3,) and (3, 3)
        The home pose, by default the origin and the identity.
    limits : Limits
        What all six legs can reach.
    ranges : PoseRanges, optional
        The default ranges of random poses of one leg; by default derived from the home pose.

    Raises
    ------
    InputError
        For anything but six legs, values that are not finite, or joints that coincide at home.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> robot.leg(3).platform_point
    array([ 7.822, -1.052,  0.   ])
    """

    name: str
    base_points: Array
    platform_points: Array
    offsets: Array = field(default_factory=lambda: np.zeros(6))
    gains: Array = field(default_factory=lambda: np.ones(6))
    length_unit: str = "cm"
    reading_unit: str = ""
    home_position: Array = field(default_factory=lambda: np.zeros(3))
    home_rotation: Array = field(default_factory=lambda: np.eye(3))
    limits: Limits = field(default_factory=Limits)
    ranges: PoseRanges = None  # type: ignore[assignment]  # derived below

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"name: expected a non-empty text, got {self.name!r}")
        for name, shape in (
            ("base_points", (6, 3)),
            ("platform_points", (6, 3)),
            ("offsets", (6,)),
            ("gains", (6,)),
        ):
            value = as_array(name, getattr(self, name), ("6", *shape[1:]), batch=False, own=True)
            if value.shape[0] != 6:
                raise InputError(f"{name}: a hexapod has 6 legs, got {value.shape[0]}")
            object.__setattr__(self, name, value)
        if (self.gains == 0).any():
            raise InputError("gains: expected values other than 0 (negative where a reading falls as the leg grows)")
        object.__setattr__(self, "length_unit", check_length_unit("length_unit", self.length_unit))
        if not isinstance(self.reading_unit, str):
            raise InputError(f"reading_unit: expected a text, got {self.reading_unit!r}")
        object.__setattr__(self, "reading_unit", self.reading_unit or self.length_unit)
        for name, kind in (("limits", Limits), ("ranges", PoseRanges)):
            if not isinstance(getattr(self, name), (kind, type(None))) or (name == "limits" and self.limits is None):
                raise InputError(f"{name}: expected {kind.__name__}(…), got {getattr(self, name)!r}")
        object.__setattr__(self, "home_position", as_array("home_position", self.home_position, (3,), batch=False))
        rotation = check_rotation("home_rotation", as_array("home_rotation", self.home_rotation, (3, 3), batch=False))
        object.__setattr__(self, "home_rotation", rotation)
        if self.home_lengths.min() <= 1e-9 * self.size:
            raise InputError("the base and platform joints of a leg coincide at home; give home_position")
        if self.ranges is None:
            object.__setattr__(self, "ranges", self._default_ranges())

    def _default_ranges(self) -> PoseRanges:
        """±10 % of the mean home length, ±35°, as for the Left Hand, unless the limits say less."""
        mean = float(self.home_lengths.mean())
        length = self.limits.leg_length or (0.9 * mean, 1.1 * mean)
        angle = np.deg2rad(35.0)
        angles = self.limits.angles or (angle, angle, angle)
        sequence = self.limits.sequence if self.limits.angles else "ZXZ"
        cone = self.limits.leg_tilt if self.limits.leg_tilt is not None else np.deg2rad(60.0)
        return PoseRanges(angles, length, cone, min(cone, np.deg2rad(20.0)), sequence)

    # --- views ------------------------------------------------------------------------------------

    def leg(self, number: int) -> Leg:
        """Leg `number` (1…6)."""
        k = check_leg_number(number) - 1
        return Leg(
            k + 1,
            self.platform_points[k],
            self.base_points[k],
            self.offsets[k],
            self.gains[k],
            self.length_unit,
        )

    @property
    def legs(self) -> tuple[Leg, ...]:
        """The six legs in order."""
        return tuple(self.leg(k) for k in range(1, 7))

    @property
    def home_vectors(self) -> Array:
        """Leg vectors :math:`P + R b_k - a_k` at home, shape (6, 3)."""
        vectors: Array = self.home_position + self.platform_points @ self.home_rotation.T - self.base_points
        return vectors

    @property
    def home_lengths(self) -> Array:
        """True leg lengths at home, shape (6,)."""
        return norm(self.home_vectors)

    @property
    def size(self) -> float:
        """A length scale: the largest distance of a joint from its frame's origin, or of home from the base's."""
        points = np.vstack([self.base_points, self.platform_points, self.home_position[None]])
        return float(norm(points).max())

    # --- new robots -------------------------------------------------------------------------------

    def with_legs(self, legs: Sequence[Leg] | Mapping[int, Leg], name: str | None = None) -> Hexapod:
        """The robot with some legs replaced, each by its own number."""
        base, platform = np.array(self.base_points), np.array(self.platform_points)
        offsets, gains = np.array(self.offsets), np.array(self.gains)
        for leg in legs.values() if isinstance(legs, Mapping) else legs:
            if leg.length_unit != self.length_unit:
                raise InputError(f"leg {leg.number} is in {leg.length_unit}, the robot in {self.length_unit}")
            if leg.base_point.ndim > 1 or leg.platform_point.ndim > 1 or leg.offset.ndim or leg.gain.ndim:
                raise InputError(f"leg {leg.number}: a robot has one leg of each number, got a batch")
            k = leg.number - 1
            base[k], platform[k] = leg.base_point, leg.platform_point
            offsets[k], gains[k] = leg.offset, leg.gain
        return replace(
            self,
            name=self.name if name is None else name,
            base_points=base,
            platform_points=platform,
            offsets=offsets,
            gains=gains,
        )

    def perturbed(self, amount: float, *, offsets: float = 0.0, rng: int | np.random.Generator) -> Hexapod:
        """A nominal that is off: every joint coordinate moved by a uniform error in ±`amount`.

        Parameters
        ----------
        amount : float
            Half-width of the error of each coordinate of a and b, in length units.
        offsets : float, default 0
            The same for the leg offsets; by default they (and the gains) are kept.
        rng : int or numpy.random.Generator

        Examples
        --------
        >>> import hexopt as hx
        >>> robot = hx.robots.left_hand()
        >>> bool(abs(robot.perturbed(0.1, rng=0).base_points - robot.base_points).max() <= 0.1)
        True
        """
        for name, value in (("amount", amount), ("offsets", offsets)):
            if float(as_array(name, value, (), batch=False)) < 0:
                raise InputError(f"{name}: expected a half-width >= 0, got {value}")
        generator = as_generator(rng)
        return replace(
            self,
            name=f"{self.name} (perturbed)",
            base_points=self.base_points + generator.uniform(-amount, amount, (6, 3)),
            platform_points=self.platform_points + generator.uniform(-amount, amount, (6, 3)),
            offsets=self.offsets + generator.uniform(-offsets, offsets, 6),
        )

    # --- files ------------------------------------------------------------------------------------

    @classmethod
    def from_toml(cls, path: str | Path) -> Hexapod:
        """Read a robot from a TOML file.

        Keys: name, length_unit, base_points and platform_points (six rows of three); optional offsets, gains,
        reading_unit, home_position, home_rotation, and tables [limits] and [ranges] with the fields of
        :class:`Limits` and :class:`PoseRanges` (angles in radians).

        Raises
        ------
        FileFormatError
            If the file cannot be read, is no TOML, misses a key, or has a wrong or unknown one.
        """
        settings = read_fields(Path(path))
        try:
            return cls(**settings)
        except HexoptError as error:
            raise FileFormatError(f"{path}: {error}") from None

    def to_toml(self, path: str | Path) -> Path:
        """Write the robot to a TOML file, whole or not at all; numbers survive the round trip to the bit."""
        return write_fields(Path(path), vars(self))
