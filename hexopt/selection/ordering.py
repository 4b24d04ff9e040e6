"""In which order to measure: a short way through the poses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import brief, norm
from ..errors import InputError
from ..geometry import Hexapod
from ..geometry.units import length_factor
from ..kinematics import leg_lengths
from ..measurements import LegMeasurements, Measurements
from ..simulation import check_robot
from .design import Design

__all__ = ["measuring_order"]


def measuring_order(robot: Hexapod, poses: LegMeasurements | Measurements | Design) -> npt.NDArray[np.intp]:
    r"""A short way through poses: from home to the nearest, then always on to the nearest that is left.

    How near two poses are is how much the six legs change their true lengths, :math:`\lVert\ell_i - \ell_j\rVert`, so
    that positions and angles need no common scale.

    Parameters
    ----------
    robot : Hexapod
    poses : Measurements, LegMeasurements or Design
        One set of n poses; their readings are not used.

    Returns
    -------
    ndarray of int, shape (n,)
        Indices of the poses, in the order of measuring; of poses that are as near, the first in the list goes first.

    Raises
    ------
    InputError
        For a batch of sets, or a design over several.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> heights = [[0.0, 0.0, z] for z in (21.0, 19.5, 18.0, 20.0)]
    >>> pool = hx.candidates_at(robot, heights, [np.eye(3)] * 4)
    >>> hx.measuring_order(robot, pool)
    array([1, 3, 0, 2])
    """
    check_robot(robot)
    data = poses.poses if isinstance(poses, Design) else poses
    if not isinstance(data, (LegMeasurements, Measurements)):
        raise InputError(f"poses: expected Measurements, LegMeasurements or a Design over one set, got {brief(poses)}")
    if data.batch_shape:
        raise InputError(f"poses: expected one set, got a batch of {data.batch_shape}; take one, such as poses[0]")
    lengths = leg_lengths(robot, data.position * length_factor(data.length_unit, robot.length_unit), data.rotation)
    here, left, order = robot.home_lengths, list(range(data.n_poses)), []
    while left:
        nearest = left.pop(int(np.argmin(norm(lengths[left] - here))))
        order.append(nearest)
        here = lengths[nearest]
    return np.array(order, dtype=np.intp)
