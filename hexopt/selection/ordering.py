"""In which order to measure: a short way through the poses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import norm
from ..errors import InputError
from ..geometry import Hexapod
from ..geometry.units import length_factor
from ..kinematics import leg_lengths
from ..measurements import LegMeasurements, Measurements

__all__ = ["measuring_order"]


def measuring_order(robot: Hexapod, poses: LegMeasurements | Measurements) -> npt.NDArray[np.intp]:
    r"""A short way through poses: from home to the nearest, then always on to the nearest that is left.

    How near two poses are is how much the six legs change their true lengths, :math:`\lVert\ell_i - \ell_j\rVert`, so
    that positions and angles need no common scale.

    Parameters
    ----------
    robot : Hexapod
    poses : Measurements or LegMeasurements
        One set of n poses; their readings are not used.

    Returns
    -------
    ndarray of int, shape (n,)
        Indices of the poses, in the order of measuring; of poses that are as near, the first in the list goes first.

    Raises
    ------
    InputError
        For a batch of sets.

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
    if poses.batch_shape:
        raise InputError(f"poses: expected one set, got a batch of {poses.batch_shape}; take one, such as poses[0]")
    lengths = leg_lengths(robot, poses.position * length_factor(poses.length_unit, robot.length_unit), poses.rotation)
    here, left, order = robot.home_lengths, list(range(poses.n_poses)), []
    while left:
        nearest = left.pop(int(np.argmin(norm(lengths[left] - here))))
        order.append(nearest)
        here = lengths[nearest]
    return np.array(order, dtype=np.intp)
