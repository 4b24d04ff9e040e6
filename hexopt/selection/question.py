"""What is asked of a choice of poses, apart from which candidates there are: a value that can be asked again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, brief, norm
from ..errors import InputError
from ..information import PoseInformation, pose_information
from ..loops.implicit import Implicit
from ..loops.set_equation import SetEquation
from ..loops.whole_robot import WholeRobot
from ..problem import LinearProblem
from ..result import Estimate
from .criteria import AOptimal, Criterion, DOptimal, EOptimal
from .indices import ConditionNumber, ObservabilityIndex
from .objective import Objective

__all__ = ["Question", "criterion_of"]

#: A candidate within so many standard errors of a measured pose, in every coordinate, is that pose again.
SIGMAS = 5.0
#: Positions, in sizes of the robot, and rotations that differ by less were written to a file in between.
ROUNDING = 1e-9

_NAMED: dict[str, Criterion] = {
    "A": AOptimal(),
    "D": DOptimal(),
    "E": EOptimal(),
    "kappa": ConditionNumber(),
    **{f"O{k}": ObservabilityIndex(k) for k in range(1, 6)},
}


def criterion_of(criterion: str | Criterion) -> Criterion:
    """A criterion by its name, or as it is."""
    if isinstance(criterion, Criterion):
        return criterion
    if not isinstance(criterion, str) or criterion not in _NAMED:
        raise InputError(
            f"criterion: expected {', '.join(_NAMED)}, or a Criterion such as GOptimal(task); got {brief(criterion)}"
        )
    return _NAMED[criterion]


@dataclass(frozen=True, eq=False)
class Question:
    """Candidates, and what of them should be small.

    Attributes
    ----------
    target : loop, LinearProblem or PoseInformation
        Over the candidates.
    criterion : Criterion
    worst : bool
    at, of, spread, measured
        As :func:`~hexopt.information.pose_information` takes them.
    """

    target: Implicit | LinearProblem | PoseInformation
    criterion: Criterion
    worst: bool = False
    at: Any = None
    of: Sequence[str] | None = None
    spread: Mapping[str, float] | None = None
    measured: Implicit | Estimate | Sequence[Implicit | Estimate] | None = None

    def __post_init__(self) -> None:
        given = self.at is not None or self.of is not None or self.spread is not None or self.measured is not None
        if isinstance(self.target, PoseInformation) and given:
            raise InputError("at, of, spread, measured: bare information has them in it; give them to pose_information")

    def objective(self) -> Objective:
        """The objective, which holds the information of every candidate."""
        information = (
            self.target
            if isinstance(self.target, PoseInformation)
            else pose_information(self.target, self.at, self.of, self.spread, self.measured)
        )
        return Objective(information, self.criterion.on(self.target, self.at, information), self.worst)

    def over(self, data: Any) -> Question:
        """The same asked of other poses under the same clamp."""
        if not isinstance(self.target, (SetEquation, WholeRobot)) or len(self.target.parts) > 1:
            raise InputError(f"poses can be changed for a loop over one set, not for {type(self.target).__name__}")
        values = self.target.start() if self.at is None else self.at  # what the lock holds stays where it was
        return replace(self, target=self.target.over(data), at=values)

    def sets(self) -> list[Any]:
        """The measurements of every set of candidates, in order; none of a linear problem."""
        return [part.data for part, _ in self.target.parts] if isinstance(self.target, Implicit) else []

    def same_pose(self) -> tuple[int, int] | None:
        """The first two candidates that are one pose, if any are."""
        before = 0
        for data in self.sets():
            rows = _as_rows(data)
            _, first, inverse = np.unique(rows, return_index=True, return_inverse=True)
            again = np.flatnonzero(first[inverse] != np.arange(len(rows)))
            if again.size:
                return before + int(first[inverse[again[0]]]), before + int(again[0])
            before += len(rows)
        return None

    def measured_before(self) -> BoolArray:
        """Which candidates are poses measured before, as far as the instruments can tell, (n,)."""
        if not isinstance(self.target, Implicit):
            return np.zeros(1, dtype=bool)
        known = self.measured if isinstance(self.measured, (list, tuple)) else (self.measured,)
        loops = [one for one in known if isinstance(one, Implicit)]
        again = []
        for k, data in enumerate(self.sets()):
            parts = [_near(data, loop.parts[k][0]) for loop in loops]
            again.append(np.any([np.zeros(data.n_poses, bool), *parts], axis=0))
        return np.concatenate(again)


def _near(data: Any, measured: SetEquation) -> BoolArray:
    """Which poses (n,) lie within so many standard errors of one that was measured."""
    out = np.zeros(data.n_poses, dtype=bool)
    size = float(norm(data.position).max())
    spread = SIGMAS * measured.error_scale
    for position, rotation, error in zip(measured.data.position, measured.data.rotation, spread, strict=True):
        near = np.flatnonzero((np.abs(data.position - position) <= error[:3] + ROUNDING * size).all(axis=-1))
        chord = np.sqrt(np.square(data.rotation[near] - rotation).sum(axis=(-2, -1)) / 2)  # the angle, while small
        out[near] |= chord <= norm(error[3:6]) + ROUNDING
    return out


def _as_rows(data: Any) -> npt.NDArray[np.void]:
    """Every pose as one value that can be compared, (n,)."""
    flat = np.concatenate([data.position, data.rotation.reshape(*data.position.shape[:-1], 9)], axis=-1) + 0.0
    return np.ascontiguousarray(flat).view([("", flat.dtype)] * flat.shape[-1]).ravel()
