"""One set of poses of a whole robot: the equations of its legs side by side, which share the error of the pose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Self

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..geometry import Leg
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements, Lock, Measurements
from ..parameters import Parameters
from .base import Loop
from .fixed_direction import FixedDirection
from .fixed_leg import FixedLeg
from .fixed_length import FixedLength
from .leg_length import LegLength
from .legs import leg_parameters
from .read_lock import ReadLeg, ReadLength
from .rows import Members, Place
from .set_equation import SetEquation

__all__ = ["RobotSet"]

_READ: Mapping[Lock, type[Loop]] = {
    Lock.NONE: LegLength,
    Lock.DIRECTION: FixedDirection,
    Lock.LEG: ReadLeg,
    Lock.LENGTH: ReadLength,
}
#: Without readings; offset and gain do not enter.
_UNREAD: Mapping[Lock, type[Loop]] = {Lock.LEG: FixedLeg, Lock.LENGTH: FixedLength}


class RobotSet(SetEquation):
    r"""The loop equations of all legs that were read in a set: one row for a free leg, more for the locked one.

    The error of a pose, :math:`e = (\delta P, \delta\omega, \delta\rho_1, …)`, enters the rows of all its legs,
    so that :math:`S_i = B_i\Sigma_i B_i^T` couples them.

    Parameters
    ----------
    data : Measurements or LegMeasurements
    unknown : sequence of str
        The blocks to estimate, of every leg in the set.
    known : mapping of int to Leg
        Lends what is not unknown, and a start.
    """

    title = "WholeRobot"
    minimum_poses = 1  # what one set lacks, others may bring

    def __init__(self, data: Measurements | LegMeasurements, unknown: Sequence[str], known: Mapping[int, Leg]) -> None:
        self.data = data
        #: The equation of every leg, by its number.
        self.legs = {k: _leg_equation(data, k, unknown, known[k]) for k in data.legs}
        main = leg_parameters(unknown, data.legs, data.length_unit)
        nuisance = [block for loop in self.legs.values() for block in loop.parameters if block.nuisance]
        self.parameters = Parameters((*main.blocks, *nuisance))
        self.n_readings = len(self.legs)
        self.places = [_places(self.parameters, k, loop) for k, loop in self.legs.items()]
        self.unit_vectors = tuple(name for loop in self.legs.values() for name in loop.unit_vectors)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one set."""
        return self.data.batch_shape

    def values(self, x: Array) -> Array:
        """Full values (..., p), or main values, to which the nuisance is added that fits the poses best."""
        if x.shape[-1] == self.parameters.size:
            return x
        size = self.parameters.main.size
        out = np.zeros((*np.broadcast_shapes(x.shape[:-1], self.batch_shape), self.parameters.size))
        out[..., :size] = x
        for loop, place in zip(self.legs.values(), self.places, strict=True):
            if loop.parameters.size > loop.parameters.main.size:
                out[..., place] = loop.values(out[..., place[: loop.parameters.main.size]])
        return out

    def start(self) -> Array:
        """The known legs, with the nuisance that fits them best."""
        out = np.zeros((*self.batch_shape, self.parameters.size))
        for loop, place in zip(self.legs.values(), self.places, strict=True):
            out[..., place] = loop.start()
        return out

    # --- the equation -----------------------------------------------------------------------------

    def residual(self, x: Array) -> Array:
        """The misclosures of the legs side by side, shape (..., n, d)."""
        batch = np.broadcast_shapes(x.shape[:-1], self.batch_shape)
        out = np.empty((*batch, self.data.n_poses, self.rows))
        for loop, place, rows in self._each():
            out[..., rows] = loop.residual(x[..., place])
        return out

    def jacobian(self, x: Array) -> Array:
        """Their derivatives by the parameters, shape (..., n, d, p)."""
        batch = np.broadcast_shapes(x.shape[:-1], self.batch_shape)
        out = np.zeros((*batch, self.data.n_poses, self.rows, self.parameters.size))
        for loop, place, rows in self._each():
            out[..., rows, place] = loop.jacobian(x[..., place])
        return out

    def noise_jacobian(self, x: Array) -> Array:
        """Their derivatives by the error of the pose and the readings of its legs, shape (..., n, d, 6 + L)."""
        batch = np.broadcast_shapes(x.shape[:-1], self.batch_shape)
        out = np.zeros((*batch, self.data.n_poses, self.rows, 6 + len(self.legs)))
        for k, (loop, place, rows) in enumerate(self._each()):
            columns = loop.noise_jacobian(x[..., place])
            out[..., rows, :6] = columns[..., :6]
            out[..., rows, 6 + k] = columns[..., 6]
        return out

    @cached_property
    def rows(self) -> int:
        """Rows of a pose, d."""
        return sum(loop.rows for loop in self.legs.values())

    def _each(self) -> list[tuple[Loop, Place, slice]]:
        """Every leg's equation, the places of its parameters, and its rows."""
        ends = np.cumsum([loop.rows for loop in self.legs.values()]).tolist()
        rows = [slice(end - loop.rows, end) for end, loop in zip(ends, self.legs.values(), strict=True)]
        return list(zip(self.legs.values(), self.places, rows, strict=True))

    def known_otherwise(self, other: RobotSet) -> tuple[str, ...]:
        """Names of what is known otherwise of some leg."""
        return tuple(f"leg{k}.{name}" for k, loop in self.legs.items() for name in loop.known_otherwise(other.legs[k]))

    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same equations of some members of a batch."""
        taken = super().take(which, batch)
        taken.legs = {k: loop.take(which, batch) for k, loop in self.legs.items()}
        return taken

    def on(self, data: Measurements | LegMeasurements) -> Self:
        """The same equations of other values of the measurements."""
        moved = super().on(data)
        moved.legs = {}
        for k, loop in self.legs.items():
            length = (
                data.length if data.length is None or isinstance(data, LegMeasurements) else data.length[..., k - 1]
            )
            moved.legs[k] = loop.on(loop.data.moved_to(data.position, data.rotation, length))
        return moved


def _leg_equation(data: Measurements | LegMeasurements, number: int, unknown: Sequence[str], known: Leg) -> Loop:
    """What a set says of one leg."""
    view = data if isinstance(data, LegMeasurements) else data.leg(number)
    kinds = _READ if view.length is not None else _UNREAD
    if view.lock not in kinds:
        raise InputError(f"leg {number}: a set under the lock {str(view.lock)!r} needs readings; give length=…")
    kind = kinds[view.lock]
    given = {name: known.block(name) for name in kind.involved if name not in unknown}
    values = {name: value if LEG_BLOCKS[name] > 1 else value[..., 0] for name, value in given.items()}
    return kind(view, unknown=[name for name in unknown if name in kind.involved], **values)


def _places(parameters: Parameters, number: int, loop: Loop) -> Place:
    names = [block.name if block.nuisance else f"leg{number}.{block.name}" for block in loop.parameters]
    return np.concatenate([np.r_[parameters[name]] for name in names])
