"""How sure a calibrated geometry makes the platform's pose."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, transpose
from ..errors import InputError
from ..forward import pose_derivatives, robot_blocks
from ..geometry import Hexapod
from ..loops.legs import leg_columns
from ..parameters import Parameters
from ..rotations import check_rotation

__all__ = ["pose_covariance"]


def pose_covariance(
    robot: Hexapod,
    parameters: Parameters,
    covariance: npt.ArrayLike,
    position: npt.ArrayLike | None = None,
    rotation: npt.ArrayLike | None = None,
) -> Array:
    r"""Covariance of the pose that a robot takes where its calibrated geometry says (P, R): :math:`J C_\theta J^T`.

    The readings are those of (P, R) by the calibrated geometry; J is the derivative of the forward kinematics by
    the geometry, by the implicit-function theorem. The error of the readings on that day is not in it.

    Parameters
    ----------
    robot : Hexapod
        The calibrated geometry.
    parameters : Parameters
        "leg1.platform_point" and so on, in the order of `covariance`; what it lacks is taken as known.
    covariance : array_like, shape (..., p, p)
        Of the main parameters: those of legs that were seen in the same poses are correlated.
    position, rotation : array_like, shape (3,) and (3, 3), optional
        By default the home pose.

    Returns
    -------
    ndarray, shape (..., 6, 6)
        Of :math:`(\delta P, \delta\omega)`, length units and radians.

    Raises
    ------
    InputError
        For shapes that do not fit, or a pose where the robot is singular.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate(robot, n_poses=40, noise=hx.UniformNoise(0.01, 1e-4, 0.01), rng=0)
    >>> found = hx.calibrate(robot.perturbed(0.1, rng=1), data)
    >>> bool(np.sqrt(np.diag(found.pose_covariance()))[:3].max() < 0.02)
    True
    """
    main = parameters.main
    wide = as_array("covariance", covariance, (main.size, main.size))
    p = as_array("position", robot.home_position if position is None else position, (3,), batch=False)
    r = check_rotation("rotation", robot.home_rotation if rotation is None else rotation)
    if r.shape != (3, 3):
        raise InputError(f"rotation: expected shape (3, 3), got {r.shape}")
    by = pose_derivatives(robot_blocks(robot), p, r)
    if not all(np.isfinite(column).all() for column in by.values()):
        raise InputError("the robot is singular at this pose: its readings do not determine it")
    numbers = sorted({int(name.removeprefix("leg").partition(".")[0]) for name in main.names})
    rows = np.array(numbers) - 1
    jacobian = leg_columns(
        {name: column[..., rows, :] for name, column in by.items() if name != "reading"}, main, numbers
    )
    return jacobian @ wide @ transpose(jacobian)
