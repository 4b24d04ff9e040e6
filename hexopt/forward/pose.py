"""The forward kinematics of a robot."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import EstimationError, InputError, RankDeficientError
from ..geometry import Hexapod
from ..numerics.lstsq import null_combinations
from ..parameters import Block, Parameters
from ..result import Status
from ..rotations import check_rotation
from .equations import LegEquations, robot_blocks
from .newton import MAX_ITERATIONS, PoseSolution, solve_poses

__all__ = ["forward_kinematics"]


def forward_kinematics(
    robot: Hexapod,
    length: npt.ArrayLike,
    position: npt.ArrayLike | None = None,
    rotation: npt.ArrayLike | None = None,
    *,
    max_iterations: int = MAX_ITERATIONS,
    throw: bool | None = None,
) -> PoseSolution:
    r"""The pose (P, R) with :math:`\lVert P + R\,b_k - a_k\rVert = \gamma_k\rho_k + \delta_k`, k = 1…6.

    Up to 40 poses have the same lengths. The one that is returned is reached from the start by damped Newton steps,
    :math:`R \to \exp([\delta\omega]_\times) R`, that lower the misclosure and keep the sign of the Jacobian's
    determinant; as a rule it is the one to which the pose goes as the readings go straight from the start's to the
    given ones, though far from the start another of that sign may be nearer.

    Parameters
    ----------
    robot : Hexapod
    length : array_like, shape (..., 6)
        The sensor readings :math:`\rho_k`, reading units.
    position : array_like, shape (..., 3), optional
        Where the iteration starts, length units; by default the robot's home.
    rotation : array_like, shape (..., 3, 3), optional
        The same.
    max_iterations : int, default 50
    throw : bool, optional
        Raise if a pose has no trustworthy answer (True), or return NaN and a status (False). By default raise for a
        single pose, not for a batch. A wrong call always raises.

    Returns
    -------
    PoseSolution

    Raises
    ------
    InputError
        For wrong shapes, values that are not finite, or a start that is no rotation.
    RankDeficientError
        If the legs do not hold the platform; the message names the motion that they leave free.
    EstimationError
        If no solution was found, under `throw`.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> reading = hx.inverse_kinematics(robot, [1.0, 0.5, 20.0], np.eye(3))
    >>> hx.forward_kinematics(robot, reading).position.round(9)
    array([ 1. ,  0.5, 20. ])
    """
    if not isinstance(robot, Hexapod):
        raise InputError(f"robot: expected a Hexapod, got {type(robot).__name__}")
    if max_iterations < 1:
        raise InputError(f"max_iterations: expected at least 1, got {max_iterations}")
    reading = as_array("length", length, (6,))
    p = as_array("position", robot.home_position if position is None else position, (3,))
    r = check_rotation("rotation", robot.home_rotation if rotation is None else rotation)
    try:
        batch = np.broadcast_shapes(reading.shape[:-1], p.shape[:-1], r.shape[:-2])
    except ValueError:
        raise InputError(
            f"length, position and rotation disagree: shapes {reading.shape}, {p.shape} and {r.shape}"
        ) from None
    blocks = robot_blocks(robot)
    found = solve_poses(blocks, reading, p, r, max_iterations=max_iterations)
    if (throw or (throw is None and not batch)) and not np.all(found.ok):
        _raise(found, blocks, np.broadcast_to(p, (*batch, 3)), np.broadcast_to(r, (*batch, 3, 3)), robot.length_unit)
    return found


def _raise(found: PoseSolution, blocks: Mapping[str, Array], position: Array, rotation: Array, unit: str) -> None:
    bad = np.argwhere(~np.asarray(found.ok))[0]
    where = tuple(int(i) for i in bad)
    share = f" in {int(np.sum(~np.asarray(found.ok)))} of {found.codes.size} poses" if where else ""
    if found.codes[where] != Status.RANK_DEFICIENT:
        raise EstimationError(
            f"forward_kinematics: ended with status {Status(int(found.codes[where])).name}{share}; these readings "
            "may be out of reach, or start nearer by position=… and rotation=…"
        )
    equations = LegEquations.of(blocks, np.zeros((1, 6)), (1,))
    jacobian = equations(position[where][None], rotation[where][None])[1][0]
    motion = Parameters((Block("position", 3, unit), Block("turn", 3, "radius")))
    free = tuple(motion.combination(v, threshold=0.0) for v in null_combinations(jacobian, threshold=0.05, at_least=1))
    raise RankDeficientError(
        f"forward_kinematics: the legs{share} do not hold the platform; free to first order, turns in radians times "
        f"the platform's radius: {'; '.join(free)}. The robot, or the pose, is singular",
        free,
    )
