"""Several sets of one leg as one implicit model, for estimators that take loops."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Self

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError
from ..geometry import Hexapod, Leg
from ..problem import LinearProblem
from ..result import Estimate
from .base import Loop
from .implicit import Implicit
from .joining import join
from .leg_length import hidden_from_all
from .parts import Part, check_alike, joined_names, joined_parameters, places_of
from .rows import Members, Place, picked
from .set_equation import SetEquation

__all__ = ["Sets"]


class Sets(Implicit):
    r"""Loops of one leg over different poses: :math:`g_{ki}(\theta, \nu_k) = 0`, of the sets k and their poses i.

    The leg's parameters :math:`\theta` are shared, every set keeps its own nuisance :math:`\nu_k`. Unlike
    :func:`~hexopt.join`, which makes a linear problem, the loops may be nonlinear, and of different locks.

    Parameters
    ----------
    *loops : Loop
        Of one leg, as far as their nominals number it; all with a noise model or none. Batches broadcast.

    Attributes
    ----------
    loops : tuple of Loop
    parameters : Parameters
        Names as they are ("base_point"); nuisances that several sets have are "direction.1", "direction.2".

    Raises
    ------
    InputError
        For sets of different legs, with a pose in common, or that do not fit each other.
    UnitError
        For sets in different units.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> one, two = (hx.simulate_leg(robot, 3, "direction", n_poses=6, rng=k) for k in (0, 1))
    >>> sets = hx.loops.Sets(hx.loops.FixedDirection(one), hx.loops.FixedDirection(two))
    >>> sets.parameters.names
    ('platform_point', 'base_point', 'direction.1', 'direction.2')
    >>> sets.residual(robot.leg(3)).shape, bool(abs(sets.residual(robot.leg(3))).max() < 1e-12)
    ((36,), True)
    """

    def __init__(self, *loops: Loop) -> None:
        for k, loop in enumerate(loops, start=1):
            if not isinstance(loop, Loop):
                raise InputError(
                    f"Sets: argument {k}: expected a loop, got {type(loop).__name__}; write Sets(one, two)"
                )
        if not loops:
            raise InputError("Sets: expected loops, got nothing; write Sets(one, two)")
        parts = [Part(loop, f"argument {k} ({type(loop).__name__})") for k, loop in enumerate(loops, start=1)]
        legs = sorted(set().union(*(part.legs for part in parts)))
        if len(legs) > 1:
            raise InputError(f"Sets: the loops are of the legs {', '.join(map(str, legs))}; give those of one leg")
        check_alike("Sets", parts)
        names = joined_names("Sets", parts)
        self.loops = loops
        self.uncarried = "; ".join(dict.fromkeys(loop.uncarried for loop in loops if loop.uncarried))
        self.failed = np.asarray(sum(np.asarray(loop.failed) for loop in loops) > 0)
        self.parameters = joined_parameters("Sets", parts, names)
        self._places = places_of(parts, names, self.parameters)
        self.unit_vectors = tuple(
            own[unit] for own, loop in zip(names, loops, strict=True) for unit in loop.unit_vectors
        )

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one problem."""
        return np.broadcast_shapes(*(loop.batch_shape for loop in self.loops))

    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same loops of some members of a batch."""
        taken = copy.copy(self)
        taken.loops = tuple(loop.take(which, batch) for loop in self.loops)
        taken.failed = picked(self.failed, 0, batch, which)
        return taken

    @property
    def parts(self) -> Sequence[tuple[SetEquation, Place]]:
        """The loops, and where their parameters stand among the joined ones."""
        return tuple(zip(self.loops, self._places, strict=True))

    @property
    def is_linear(self) -> bool:
        """Whether all loops are linear in their unknowns, with as many rows a pose."""
        return all(loop.is_linear for loop in self.loops) and len({loop.rows for loop in self.loops}) == 1

    def linear(self) -> LinearProblem:
        """All direct equations in one linear problem, as :func:`~hexopt.join` makes it."""
        return join(*self.loops)

    def start(self) -> Array:
        """The values of the nominal of each set, the last one's where they differ, with the nuisances that fit it."""
        return self._joined([loop.start() for loop in self.loops])

    @property
    def minimum_poses(self) -> int:
        """The least number that any of the sets needs by itself."""
        return min(loop.minimum_poses for loop in self.loops)

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """What no set sees, nor all of them."""
        return hidden_from_all(self.loops)

    def values(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
        """A full vector of values (..., p); what `x` does not say of the nuisances is what fits each set best."""
        if isinstance(x, (Leg, Hexapod, Estimate)):
            own = [loop.values(x) for loop in self.loops]
        else:
            vector = np.asarray(x, dtype=float)
            if vector.shape[-1:] == (self.parameters.size,):
                return vector
            if vector.shape[-1:] != (self.parameters.main.size,):
                raise InputError(
                    f"values: expected {self.parameters.size} ({', '.join(self.parameters.names)}) or "
                    f"{self.parameters.main.size} without the nuisances, got shape {vector.shape}"
                )
            own = [
                loop.values(vector[..., place[: loop.parameters.main.size]])
                for loop, place in zip(self.loops, self._places, strict=True)
            ]
        out = self._joined(own)
        if isinstance(x, Estimate):
            for name in self.parameters.names:
                if name in x.parameters:
                    out[..., self.parameters[name]] = x.params[name]
        return out

    def _joined(self, own: Sequence[Array]) -> Array:
        """The values of all parameters from those of each set."""
        batch = np.broadcast_shapes(*(values.shape[:-1] for values in own))
        out = np.empty((*batch, self.parameters.size))
        for values, place in zip(own, self._places, strict=True):
            out[..., place] = values
        return out

    def residual(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
        """The direct misclosures of all sets, one below the other, shape (..., rows)."""
        return self.direct_rows(self.values(x))[0]

    def jacobian(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
        """Their derivatives by all parameters, shape (..., rows, p)."""
        return self.direct_rows(self.values(x))[1]
