r"""The criterion G: the worst error that the calibrated model makes where it will be used.

The model predicts the length of a leg, :math:`\ell = \lVert P + R b - a\rVert - \delta`, or its reading times γ. At a
task pose j its error is :math:`g_j^T\,\delta\theta`, with :math:`g_j` the derivatives of the leg-length equation, and
its variance :math:`g_j^T C g_j`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, brief, norm
from ..errors import InputError, UnitError
from ..geometry import Hexapod, Leg
from ..geometry.leg import LEG_BLOCKS
from ..information import PoseInformation, scenario_values
from ..kinematics import leg_vector
from ..loops.implicit import Implicit
from ..loops.leg_length import LegLength
from ..loops.whole_robot import WholeRobot
from ..measurements import LegMeasurements, Lock, Measurements
from ..parameters import Parameters
from .criteria import Criterion

__all__ = ["GOptimal"]


@dataclass(frozen=True, eq=False)
class GOptimal(Criterion):
    r"""The worst predicted variance of a leg's length over a task: :math:`\max_j g_j^T C g_j`.

    The rows :math:`g_j` are the derivatives of the leg-length equation by the parameters of interest, for every task
    pose and every leg whose parameters are unknown. What is estimated on the way, and parameters that are known or not
    of interest, have no part in the predicted error. Units are those of length squared.

    Parameters
    ----------
    task : Measurements or LegMeasurements
        The poses at which the robot will work, in one set; only position and rotation are used.
    rows : ndarray, shape (S, j, k), optional
        Derivatives in units of the spread, for every scenario: by default :meth:`on` makes them.

    Raises
    ------
    InputError
        For a task that is no set of poses.

    References
    ----------
    Kiefer and Wolfowitz (1960); Pukelsheim (1993), chapter 9.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> task = hx.GOptimal(hx.simulate(robot, n_poses=50, rng=0))
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> loop = hx.loops.FixedDirection(hx.simulate_leg(robot, 3, "direction", n_poses=200, noise=noise, rng=0))
    >>> design = hx.select_poses(loop, 8, criterion=task)
    >>> print(f"worst predicted error of leg 3: {design.value**0.5:.4f} cm, at best {design.bound**0.5:.4f}")
    worst predicted error of leg 3: 0.0146 cm, at best 0.0145
    """

    task: Measurements | LegMeasurements
    rows: Array | None = field(default=None, repr=False)

    name = "G"
    curved = "linear"
    least = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.task, (Measurements, LegMeasurements)):
            raise InputError(f"task: expected Measurements or LegMeasurements, got {brief(self.task)}")
        if self.task.batch_shape or self.task.n_poses == 0:
            raise InputError(
                f"task: expected one set of poses, got a batch of {self.task.batch_shape} "
                f"with {self.task.n_poses} poses each; take one, such as data[0]"
            )

    def on(self, target: Any, at: Any, information: PoseInformation) -> GOptimal:
        """The same with its rows, for a loop evaluated somewhere, in the coordinates of its information.

        Raises
        ------
        InputError
            If the target is no loop, or knows of a leg too little: the leg needs a nominal.
        UnitError
            If the task is in another unit.
        """
        if not isinstance(target, Implicit):
            raise InputError(f"GOptimal needs a loop, which says where parameters enter; got {brief(target)}")
        units = {part.data.length_unit for part, _ in target.parts}
        if units != {self.task.length_unit}:
            raise UnitError(f"task: in {self.task.length_unit}, but the candidates are in {' and '.join(units)}")
        values = scenario_values(target, at)
        legs = _nominals(target)
        rows = []
        for prefix, names in _prefixes(target.parameters).items():
            if prefix not in legs:
                raise InputError("GOptimal: the candidates need a nominal leg; give the measurements nominal=…")
            wide = np.zeros((len(values), self.task.n_poses, target.parameters.size))
            given = {name: values[:, target.parameters[prefix + name]] for name in names}
            for name, columns in _derivatives(self.task, legs[prefix], given).items():
                wide[..., target.parameters[prefix + name]] = columns
            rows.append(wide)
        places = [target.parameters.labels.index(label) for label in information.labels]
        stacked = np.concatenate(rows, axis=1)[..., places] * information.spread
        return replace(self, rows=stacked[:, (stacked != 0).any(axis=(0, 2))])

    def pieces(self, covariance: Array) -> Array:
        """The predicted variance of every row."""
        finite = np.isfinite(np.einsum("...ii->...", covariance))[..., None]
        safe = np.where(finite[..., None], covariance, 0.0)
        out = np.empty((*covariance.shape[:-2], self._bound().shape[-2]))
        for where, columns, part in self._legs:
            own = safe[..., columns[:, None], columns]
            out[..., where] = np.einsum("...jk,...jk->...j", part @ own, part)
        return np.where(finite, out, np.inf)

    @cached_property
    def _legs(self) -> list[tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], Array]]:
        """Rows that have the same columns, as those of one leg have: where they stand, these columns, their entries."""
        rows = self._bound()
        used, group = np.unique((rows != 0).any(axis=tuple(range(rows.ndim - 2))), axis=0, return_inverse=True)
        found = []
        for g, columns in enumerate(used):
            where, own = np.flatnonzero(group.ravel() == g), np.flatnonzero(columns)
            found.append((where, own, rows[..., where[:, None], own]))
        return found

    def slopes(self, covariance: Array) -> Array:
        r""":math:`g_j g_j^T`, whatever C is."""
        rows = self._bound()
        both = rows[..., :, None] * rows[..., None, :]
        return np.broadcast_to(both, (*covariance.shape[:-2], *both.shape[-3:]))

    def _bound(self) -> Array:
        if self.rows is None:
            raise InputError("GOptimal has no rows yet: write GOptimal(task).on(loop, at, information)")
        return self.rows


def _prefixes(parameters: Parameters) -> dict[str, list[str]]:
    """The blocks of every leg, by what stands before their names: "leg3.", or nothing for a single leg."""
    found: dict[str, list[str]] = {}
    for block in parameters.main:
        before, dot, name = block.name.rpartition(".")
        if name in LEG_BLOCKS:
            found.setdefault(before + dot, []).append(name)
    return found


def _nominals(target: Implicit) -> dict[str, Leg]:
    """The nominal legs, by the same prefix."""
    if isinstance(target, WholeRobot):
        return {f"leg{k}.": leg for k, leg in target.nominal.items()}
    found: dict[str, Leg] = {}
    for part, _ in target.parts:
        nominal = part.data.nominal
        legs = nominal.legs if isinstance(nominal, Hexapod) else () if nominal is None else (nominal,)
        found |= {f"leg{leg.number}.": leg for leg in legs}
        if isinstance(nominal, Leg):
            found[""] = nominal
    return found


def _derivatives(task: Measurements | LegMeasurements, nominal: Leg, given: Mapping[str, Array]) -> dict[str, Array]:
    """The derivatives of a leg's length by its unknown blocks (S, size), each (S, poses, size)."""
    leg = nominal.replaced(**{name: value if LEG_BLOCKS[name] > 1 else value[:, 0] for name, value in given.items()})
    length = norm(leg_vector(leg.platform_point, leg.base_point, task.position, task.rotation))
    shape = (*length.shape, 3)
    data = LegMeasurements(
        np.broadcast_to(task.position, shape),
        np.broadcast_to(task.rotation, (*shape, 3)),
        leg.reading(length),
        Lock.NONE,
        None,
        leg,
        task.length_unit,
    )
    loop = LegLength(data, unknown=tuple(given))
    jacobian = loop.jacobian(leg)[..., 0, :]
    return {name: jacobian[..., loop.parameters[name]] for name in given}
