"""The rows of a model as expressions: of any loop, of several sets, of all legs of a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..loops import LegLength, Loop, PlatformPose
from ..loops.implicit import Implicit
from ..loops.robot_set import RobotSet
from ..loops.rows import Place
from ..loops.set_equation import SetEquation
from .evaluation import pose_arguments
from .models import loop_function

__all__ = ["Roots", "Standard", "implicit_rows", "leg_equations", "row_expressions"]

#: Roots of the covariances of a set's errors: (n, e, r) of what each pose has for itself, (e, s) of what all share.
Roots = tuple[Array, Array | None]


class Standard:
    """Standard errors z, made as they are needed."""

    def __init__(self) -> None:
        self.parts: list[ca.SX] = []

    def __call__(self, root: Array) -> ca.SX:
        """root z with a z of its own."""
        self.parts.append(ca.SX.sym(f"z{len(self.parts)}", root.shape[-1]))
        return ca.DM(root) @ self.parts[-1]


def leg_equations(part: SetEquation) -> list[tuple[Loop, Place]]:
    """The loops of a set's legs in the order of its readings, and where their parameters stand among the set's."""
    if isinstance(part, Loop):
        return [(part, np.arange(part.parameters.size))]
    if isinstance(part, RobotSet):
        return list(zip(part.legs.values(), part.places, strict=True))
    if isinstance(part, PlatformPose):
        loops = [LegLength(part.data.leg(k), unknown=part.unknown) for k in range(1, 7)]
        names = [[f"leg{k}.{name}" for name in part.unknown] for k in range(1, 7)]
        places = [np.concatenate([np.r_[part.parameters[name]] for name in own]) for own in names]
        return list(zip(loops, places, strict=True))
    raise InputError(f"{type(part).__name__} has no symbolic equations; expected a loop, or several in WholeRobot")


def row_expressions(
    loop: Loop, given: Mapping[str, ca.SX], values: Array, errors: Sequence[ca.SX] | None = None
) -> list[ca.SX]:
    """g of every pose in symbolic blocks, the others as at `values`; at errors (7,) of the poses, by default none."""
    function = loop_function(loop)
    numbers, shape = pose_arguments(loop, values)
    (n_poses,) = shape
    names = [name for name in function.name_in() if name != "error"]
    rows = []
    for i in range(n_poses):
        inputs = [given[name] if name in given else ca.DM(numbers[name][i]) for name in names]
        rows.append(function(*inputs, ca.DM.zeros(7) if errors is None else errors[i]))
    return rows


def implicit_rows(
    target: Implicit, x: ca.SX, values: Array, roots: Sequence[Roots], standard: Standard
) -> tuple[ca.SX, list[ca.SX]]:
    """All rows in symbolic values, and the errors (n, e) of every set, by roots of their covariances."""
    rows, errors = [], []
    for (part, place), (each, common) in zip(target.parts, roots, strict=True):
        shared = 0.0 if common is None else standard(common)
        own = [standard(root) + shared for root in each]
        for k, (loop, where) in enumerate(leg_equations(part)):
            of_leg = [ca.vertcat(error[:6], error[6 + k]) for error in own]
            blocks = {
                name: x[place[where[loop.parameters[name]]].tolist()] for name in loop.parameters.names
            } | _known_in_error(loop, standard)
            rows += row_expressions(loop, blocks, values[place[where]], of_leg)
        errors.append(ca.horzcat(*own).T)
    return ca.vertcat(*rows), errors


def _known_in_error(loop: Loop, standard: Standard) -> dict[str, ca.SX]:
    """The known blocks that come with a covariance, in error; those of one estimate share its error."""
    found: dict[str, ca.SX] = {}
    for source in {id(source): source for source in loop._sources.values()}.values():
        names = [name for name, other in loop._sources.items() if other is source]
        error = standard(np.concatenate([loop._known_roots[name] for name in names]))
        ends = np.cumsum([0, *(len(loop._known[name]) for name in names)])
        parts = ca.vertsplit(error, ends.tolist())
        found |= {name: ca.DM(loop._known[name]) + part for name, part in zip(names, parts, strict=True)}
    return found
