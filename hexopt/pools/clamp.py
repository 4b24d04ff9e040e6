r"""What a clamp holds of one leg: a direction n, a point c, or a true length ℓ, and how far poses are off it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, norm
from ..errors import InputError
from ..geometry import Hexapod, Leg
from ..geometry.leg import check_leg_number
from ..kinematics import leg_vector
from ..measurements import Lock

__all__ = ["Clamp"]


@dataclass(frozen=True, eq=False)
class Clamp:
    """One lock of one leg, with the direction (3,) and the true length that it holds, each None where it is free."""

    leg: Leg
    lock: Lock
    direction: Array | None = None
    length: float | None = None
    of_home: bool = False

    @classmethod
    def at_home(cls, robot: Hexapod, number: int, lock: Lock) -> Self:
        """The clamp that holds the leg as it is at home."""
        clamp = cls._through(robot.leg(check_leg_number(number)), lock, robot.home_vectors[number - 1])
        return cls(clamp.leg, lock, clamp.direction, clamp.length, of_home=True)

    @classmethod
    def given(cls, robot: Hexapod, number: int, lock: Lock, value: npt.ArrayLike) -> Self:
        """The clamp at a direction, a point c in the base frame, or a true length, as the lock has it."""
        leg = robot.leg(check_leg_number(number))
        if lock is Lock.NONE:
            raise InputError("given: the lock 'none' holds nothing, so nothing can be given; leave it out")
        if lock is Lock.LENGTH:
            length = float(as_array("given (the true length)", value, (), batch=False))
            if length <= 0:
                raise InputError(f"given (the true length): expected a length > 0, got {length:g}")
            return cls(leg, lock, length=length)
        name = "given (the direction)" if lock is Lock.DIRECTION else "given (the fixed point)"
        vector = as_array(name, value, (3,), batch=False)
        if lock is Lock.LEG:
            vector = vector - leg.base_point
        if norm(vector) <= 1e-9 * (robot.size if lock is Lock.LEG else 1.0):
            what = "a vector other than zero" if lock is Lock.DIRECTION else "a point away from the leg's base joint"
            raise InputError(f"{name}: expected {what}, got {np.asarray(value).tolist()}")
        return cls._through(leg, lock, vector)

    @classmethod
    def of_poses(cls, robot: Hexapod, number: int, lock: Lock, position: Array, rotation: Array) -> Self:
        """The clamp that most of the poses (n, 3), (n, 3, 3) share: the median of what each holds."""
        leg = robot.leg(check_leg_number(number))
        vectors = leg_vector(leg.platform_point, leg.base_point, position, rotation)
        if lock is Lock.LENGTH:
            return cls(leg, lock, length=float(np.median(norm(vectors))))
        if lock is Lock.DIRECTION:
            vectors = vectors / np.maximum(norm(vectors), np.finfo(float).tiny)[:, None]
        return cls._through(leg, lock, np.median(vectors, axis=0))

    @classmethod
    def _through(cls, leg: Leg, lock: Lock, vector: Array) -> Self:
        """The clamp that holds a leg vector, or what the lock holds of it."""
        length = float(norm(vector))
        if lock is not Lock.NONE and length == 0:
            raise InputError(f"the poses share no direction of leg {leg.number}; say which one is held: given=")
        direction = vector / length if lock in (Lock.DIRECTION, Lock.LEG) else None
        return cls(leg, lock, direction, length if lock in (Lock.LENGTH, Lock.LEG) else None)

    @property
    def held(self) -> tuple[Array | None, Array | None]:
        """The direction (1, 1, 3) and the length (1, 1), as one set of random poses has them."""
        direction = None if self.direction is None else self.direction[None, None]
        return direction, None if self.length is None else np.full((1, 1), self.length)

    def distance(self, position: Array, rotation: Array) -> Array:
        """How far the leg's platform joint is from where the clamp lets it be, (n,), length units.

        That is a ray for a direction, the point c, or a sphere for a length.
        """
        vectors = leg_vector(self.leg.platform_point, self.leg.base_point, position, rotation)
        if self.direction is None:
            return np.zeros(len(vectors)) if self.length is None else np.abs(norm(vectors) - self.length)
        along = np.maximum(vectors @ self.direction, 0.0) if self.length is None else self.length
        return norm(vectors - np.asarray(along)[..., None] * self.direction)

    @property
    def kind(self) -> str:
        """The word for what is held."""
        words = {Lock.NONE: "nothing", Lock.DIRECTION: "direction", Lock.LEG: "fixed point", Lock.LENGTH: "true length"}
        return words[self.lock]

    @property
    def value(self) -> Array:
        """What is held, as `given` takes it: a direction (3,), a point (3,) or a true length ()."""
        held = self.length if self.direction is None else self.direction
        if self.lock is Lock.LEG:
            held = self.leg.base_point + self.length * np.asarray(self.direction)
        return np.asarray(held, dtype=float)

    def describe(self) -> str:
        """What is held, in words: "direction (0.1, 0.2, 0.97)"."""
        digits = 4 if self.lock is Lock.DIRECTION else 6
        text = ", ".join(f"{x:.{digits}g}" for x in np.round(np.atleast_1d(self.value), 9) + 0.0)
        unit = "" if self.lock is Lock.DIRECTION or self.leg.length_unit == "unstated" else f" {self.leg.length_unit}"
        return f"{self.kind} {text if self.lock is Lock.LENGTH else f'({text})'}{unit}"

    def __str__(self) -> str:
        if self.lock is Lock.NONE:
            return f"no lock, built from leg {self.leg.number}"
        place = f"the lock {str(self.lock)!r} of leg {self.leg.number}, at the {self.describe()}"
        return place + (" of home" if self.of_home else "")
