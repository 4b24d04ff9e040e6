"""Inverse and forward kinematics of one robot by CasADi: the reference of the batched routes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, as_count, frozen
from ..geometry import Hexapod
from ..geometry.leg import LEG_BLOCKS
from ..rotations import check_rotation, rotation_vector_to_matrix
from .evaluation import mapped
from .models import pose_function

__all__ = ["Root", "forward_kinematics", "geometry_arguments", "inverse_kinematics"]

#: A root has no closure larger than this share of the robot's size.
TOLERANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Root:
    """A pose found from six readings.

    Attributes
    ----------
    position : ndarray, shape (3,)
        NaN without success, as the rotation.
    rotation : ndarray, shape (3, 3)
    closure : float
        The largest misclosure of a leg at the last iterate, in length units; NaN where that is no pose.
    success : bool
        Whether that is rounding: the solver's own word is not taken.
    iterations : int
    """

    position: Array
    rotation: Array
    closure: float
    success: bool
    iterations: int


def geometry_arguments(robot: Hexapod) -> dict[str, Array]:
    """The robot's blocks as :func:`pose_function` takes them: leg after leg."""
    return {name: np.ravel(getattr(robot, f"{name}s")) for name in LEG_BLOCKS}


def inverse_kinematics(robot: Hexapod, position: npt.ArrayLike, rotation: npt.ArrayLike) -> Array:
    r"""Readings :math:`(\lVert P + R\,b_k - a_k\rVert - \delta_k)/\gamma_k` by CasADi, shape (..., 6).

    Parameters
    ----------
    robot : Hexapod
    position : array_like, shape (..., 3)
    rotation : array_like, shape (..., 3, 3)

    Examples
    --------
    >>> import hexopt as hx
    >>> hx.symbolic.inverse_kinematics(hx.robots.left_hand(), [0.0, 0.0, 19.0], np.eye(3)).round(3)
    array([4.977, 4.977, 4.996, 4.996, 4.996, 4.996])
    """
    p, r = as_array("position", position, (3,)), check_rotation("rotation", rotation)
    shape = np.broadcast_shapes(p.shape[:-1], r.shape[:-2])
    p, r = np.broadcast_to(p, (*shape, 3)).reshape(-1, 3), np.broadcast_to(r, (*shape, 3, 3)).reshape(-1, 3, 3)
    given = [np.broadcast_to(value, (len(p), *value.shape)) for value in geometry_arguments(robot).values()]
    _, readings = mapped(pose_function(), [*given, p, r, np.zeros((len(p), 6)), np.zeros((len(p), 12))])
    return readings.reshape(*shape, 6)


def forward_kinematics(
    robot: Hexapod,
    length: npt.ArrayLike,
    position: npt.ArrayLike | None = None,
    rotation: npt.ArrayLike | None = None,
    *,
    max_iterations: int = 50,
) -> Root:
    r"""The pose of six readings: Newton's method on :math:`\lVert P + R b_k - a_k\rVert = \gamma_k\rho_k + \delta_k`.

    ``casadi.rootfinder("newton")`` in the increments of the pose, :math:`\exp([\delta\omega]_\times) R_0`, about a
    start. Which of the up to 40 poses it finds is the start's; a root is checked by its misclosure.

    Parameters
    ----------
    robot : Hexapod
    length : array_like, shape (6,)
        The readings.
    position, rotation : array_like, shape (3,) and (3, 3), optional
        The start; by default home.
    max_iterations : int, default 50

    Returns
    -------
    Root

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> found = hx.symbolic.forward_kinematics(robot, hx.inverse_kinematics(robot, [1.0, -2.0, 20.0], np.eye(3)))
    >>> found.success, found.position.round(9)
    (True, array([ 1., -2., 20.]))
    """
    start = robot.home_position if position is None else as_array("position", position, (3,), batch=False)
    turn = robot.home_rotation if rotation is None else check_rotation("rotation", rotation)
    readings = as_array("length", length, (6,), batch=False)
    step = ca.SX.sym("step", 6)  # in units of the robot's size, and radians
    error = ca.vertcat(robot.size * step[:3], step[3:], ca.SX.zeros(6))
    given = [ca.DM(value) for value in geometry_arguments(robot).values()]
    closure, _ = pose_function().call([*given, ca.DM(start), ca.DM(turn), ca.DM(readings), error])
    equations = ca.Function("closure", [step], [closure / robot.size])
    options: dict[str, Any] = {"error_on_fail": False, "show_eval_warnings": False}
    options |= {"abstol": 1e-15, "abstolStep": 1e-15, "max_iter": as_count("max_iterations", max_iterations)}
    newton = ca.rootfinder("newton", "newton", equations, options)
    found = np.ravel(newton(ca.DM.zeros(6)).full())
    rest = float(np.abs(equations(found).full()).max())
    success = rest <= TOLERANCE  # False for NaN
    if not success:
        found = np.full(6, np.nan)
    moved = rotation_vector_to_matrix(found[3:]) @ turn if success else np.full((3, 3), np.nan)
    at, iterations = start + robot.size * found[:3], int(newton.stats()["iter_count"])
    return Root(frozen(at), frozen(moved), rest * robot.size, success, iterations)
