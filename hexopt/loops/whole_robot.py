"""Everything that was measured of a robot, in one likelihood: sets under any lock, the legs of a pose coupled."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Self

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError, UnitError
from ..geometry import Hexapod, Leg
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements, Lock, Measurements
from ..numerics.lstsq import solve
from ..parameters import Block, Parameters
from ..result import Estimate
from .base import Loop
from .fixed_direction import FixedDirection
from .fixed_leg import FixedLeg
from .fixed_length import FixedLength
from .implicit import Implicit
from .known import chosen_unknown
from .leg_length import hidden_from_all
from .legs import leg_parameters, leg_values
from .parts import numbered, share_a_pose
from .robot_set import RobotSet
from .rows import Members, Place
from .set_equation import SetEquation

__all__ = ["WholeRobot"]


class WholeRobot(Implicit):
    r"""All loop equations of all legs over all sets: :math:`g_{si}(\theta, \nu_s, m_{si}) = 0` of pose i in set s.

    A free leg gives :math:`\lVert P + R b_k - a_k\rVert - \gamma_k\rho_k - \delta_k`; the leg that is locked gives its
    own equations: Type I as in :class:`FixedDirection`, Types II and III with their reading as in :class:`ReadLeg` and
    :class:`ReadLength` (or without, as in :class:`FixedLeg` and :class:`FixedLength`). The legs seen in one pose share
    its error; parameters are shared by all sets, and every set has its own nuisance :math:`\nu_s`.

    Parameters
    ----------
    *sets : Measurements or LegMeasurements
        Six readings a pose, or those of one leg; different poses, under any lock. Batches broadcast.
    unknown : sequence of str, default ("platform_point", "base_point", "offset")
        What is estimated of every measured leg: with "gain" too, Model 48.
    nominal : Hexapod, optional
        Lends what is not unknown, and a start. By default the nominals of the sets.

    Raises
    ------
    InputError
        For no sets, no nominal, or batches that do not fit.
    UnitError
        For sets in two units.

    Notes
    -----
    Parameters are "leg1.platform_point", "leg1.base_point", and so on of every measured leg, then the nuisances:
    "direction" (a unit vector), "fixed_point" or "locked_length"; where several sets have the same, "direction.1",
    "direction.2", in the order of the sets. One leg's direction alone does not see its offset; several do.

    References
    ----------
    Daney (1998), section 3, leaves the readings of the other five legs unused, and treats each leg by itself.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> sets = [hx.simulate(robot, "direction", n_poses=7, leg=k, rng=k) for k in range(1, 7)]
    >>> loop = hx.loops.WholeRobot(*sets, nominal=robot.perturbed(0.1, rng=0))
    >>> loop.parameters.names[:3], loop.parameters.names[-1]
    (('leg1.platform_point', 'leg1.base_point', 'leg1.offset'), 'direction.6')
    """

    def __init__(
        self,
        *sets: Measurements | LegMeasurements,
        unknown: Sequence[str] = ("platform_point", "base_point", "offset"),
        nominal: Hexapod | None = None,
    ) -> None:
        _check_sets(sets, nominal)
        self.sets = sets
        self.unknown = chosen_unknown("WholeRobot", tuple(LEG_BLOCKS), unknown, dict.fromkeys(LEG_BLOCKS))
        self.nominal = _nominal_legs(sets, nominal)
        #: The equations of every set.
        self.equations = tuple(RobotSet(data, self.unknown, self.nominal) for data in sets)
        legs = sorted({k for equation in self.equations for k in equation.legs})
        main = leg_parameters(self.unknown, legs, sets[0].length_unit)
        renamed, nuisance = _nuisances(self.equations)
        self.parameters = Parameters((*main.blocks, *nuisance))
        self._places = [
            np.concatenate([np.r_[self.parameters[own.get(name, name)]] for name in equation.parameters.names])
            for equation, own in zip(self.equations, renamed, strict=True)
        ]
        self.unit_vectors = tuple(
            own[name] for equation, own in zip(self.equations, renamed, strict=True) for name in equation.unit_vectors
        )

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions, broadcast over the sets: () for one robot."""
        return np.broadcast_shapes(*(equation.batch_shape for equation in self.equations))

    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same sets of some members of a batch."""
        taken = copy.copy(self)
        taken.equations = tuple(equation.take(which, batch) for equation in self.equations)
        taken.sets = tuple(equation.data for equation in taken.equations)
        return taken

    def over(self, *sets: Measurements | LegMeasurements) -> Self:
        """The same equations, about the same known legs, over other poses of every set, under the same clamps."""
        other = copy.copy(self)
        other.equations = tuple(equation.over(data) for equation, data in zip(self.equations, sets, strict=True))
        other.sets = sets
        return other

    @property
    def parts(self) -> Sequence[tuple[SetEquation, Place]]:
        """The sets, and where their parameters stand."""
        return list(zip(self.equations, self._places, strict=True))

    @property
    def minimum_poses(self) -> int:
        """7 unlocked poses for Model 42; 0 where the locks of the sets decide."""
        free = all(data.lock is Lock.NONE for data in self.sets)
        return sum(size for name, size in LEG_BLOCKS.items() if name in self.unknown) * free

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """What no set sees of a leg, by its number: as a rule, offset against gain of one that was never free."""
        found = []
        for k in self.nominal:
            loops = [equation.legs[k] for equation in self.equations if k in equation.legs]
            found += [f"leg{k}.{words}" for words in hidden_from_all(loops)]
        return tuple(found)

    def values(self, x: npt.ArrayLike | Hexapod | Leg | Estimate) -> Array:
        """A full vector of values (..., p) from values, a robot or an estimate.

        What `x` does not say of the nuisances is filled in with what fits the poses best.
        """
        if isinstance(x, Estimate) and x.parameters.names == self.parameters.names:
            x = x.values
        if not isinstance(x, (Hexapod, Leg, Estimate)):
            vector = np.asarray(x, dtype=float)
            if vector.shape[-1:] == (self.parameters.size,):
                return vector
        return self._filled(leg_values(x, self.parameters, self.sets[0].length_unit))

    def _filled(self, main: Array) -> Array:
        size = main.shape[-1]
        out = np.zeros((*np.broadcast_shapes(main.shape[:-1], self.batch_shape), self.parameters.size))
        out[..., :size] = main
        for equation, place in self.parts:
            out[..., place] = equation.values(out[..., place[place < size]])
        return out

    def start(self) -> Array:
        """The linear solutions of legs that have locked sets for it, where the data agree better; else the nominal.

        Of a leg with a DIRECTION set a and b need no guess; with a LEG set b, and with a LENGTH set a by that b.
        """
        known = np.zeros((*self.batch_shape, self.parameters.main.size))
        for name in self.parameters.main.names:
            prefix, _, block = name.rpartition(".")
            known[..., self.parameters[name]] = self.nominal[int(prefix.removeprefix("leg"))].block(block)
        linear = known.copy()
        for lock, kind in ((Lock.DIRECTION, FixedDirection), (Lock.LEG, FixedLeg), (Lock.LENGTH, FixedLength)):
            for equation in self.equations:
                for number, loop in equation.legs.items():
                    if loop.data.lock is lock:
                        self._take(linear, number, kind, loop.data)
        one, two = self._filled(known), self._filled(linear)
        return np.where((self._misfit(two) <= self._misfit(one))[..., None], two, one)

    def _misfit(self, values: Array) -> Array:
        """The sum of squares of all misclosures, shape (...)."""
        return np.asarray(sum(np.square(rows).sum(axis=(-2, -1)) for rows in self.residual(values)))

    def _take(self, out: Array, number: int, kind: type[Loop], data: LegMeasurements) -> None:
        """Put the linear solution of one leg's set among the values, where the set determines it."""
        names = {name: f"leg{number}.{name}" for name in kind.default_unknown if name in self.unknown}
        if not names:
            return
        known = {}
        if kind is FixedLength and "platform_point" in self.unknown:
            known["platform_point"] = out[..., self.parameters[f"leg{number}.platform_point"]]
        loop = kind(replace(data, nominal=self.nominal[number]), unknown=tuple(names), **known)
        if loop.data.n_poses < loop.minimum_poses:
            return
        problem = loop.linear()
        solution = solve(problem.matrix, problem.rhs, inverse=False)
        for name, joined in names.items():
            found = solution.values[..., problem.parameters[name]]
            place = self.parameters[joined]
            out[..., place] = np.where(solution.full_rank[..., None], found, out[..., place])

    def residual(self, x: npt.ArrayLike | Hexapod | Leg | Estimate) -> tuple[Array, ...]:
        """The misclosures of every set, each (..., n, d): the rows of free legs by number, with the locked leg's."""
        values = self.values(x)
        return tuple(equation.residual(values[..., place]) for equation, place in self.parts)


def _check_sets(sets: Sequence[Measurements | LegMeasurements], nominal: Hexapod | None) -> None:
    if not sets:
        raise InputError("WholeRobot: there are no measurements; write WholeRobot(*sets)")
    for k, data in enumerate(sets, start=1):
        if not isinstance(data, (Measurements, LegMeasurements)):
            raise InputError(
                f"WholeRobot: set {k}: expected Measurements or LegMeasurements, got {type(data).__name__}"
            )
        if data.n_poses == 0:
            raise InputError(f"WholeRobot: set {k} has no poses")
    units = sorted({data.length_unit for data in sets} | ({nominal.length_unit} if nominal is not None else set()))
    if len(units) > 1:
        raise UnitError(f"WholeRobot: the sets and the nominal are in {' and '.join(units)}; convert them to one unit")
    shapes = [data.batch_shape for data in sets]
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(f"WholeRobot: the batches {', '.join(map(str, shapes))} do not fit each other") from None
    for i, two in enumerate(sets):
        for k, one in enumerate(sets[:i]):
            if share_a_pose(one, two):
                raise InputError(
                    f"WholeRobot: sets {k + 1} and {i + 1} have a pose in common; give each pose once, with all its "
                    "readings as Measurements"
                )


def _nominal_legs(sets: Sequence[Measurements | LegMeasurements], nominal: Hexapod | None) -> dict[int, Leg]:
    """A leg for every number that is measured."""
    legs: dict[int, Leg] = {}
    for data in sets:
        for k in data.legs:
            lender = nominal or data.nominal
            if lender is None:
                raise InputError("WholeRobot needs a nominal robot, for what is known and for a start; give nominal=…")
            legs.setdefault(k, lender.leg(k) if isinstance(lender, Hexapod) else lender)
    return legs


def _nuisances(equations: Sequence[RobotSet]) -> tuple[list[dict[str, str]], list[Block]]:
    """The joined names of every set's nuisances, and their blocks; names that several sets have are numbered."""
    own = [[block for block in equation.parameters if block.nuisance] for equation in equations]
    names = iter(numbered([block.name for blocks in own for block in blocks]))
    joined = [[replace(block, name=next(names)) for block in blocks] for blocks in own]
    renamed = [{old.name: new.name for old, new in zip(*both, strict=True)} for both in zip(own, joined, strict=True)]
    return renamed, [block for blocks in joined for block in blocks]
