"""All chosen poses, each in a picture of its own: the sheet to measure by."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from ..arrays import Array, as_count
from ..geometry import Hexapod
from ..measurements import LegMeasurements, Measurements
from ..rotations import matrix_to_euler
from ..selection.design import Design
from .look import fit_limits, space_axes, unit_text
from .space import draw_hexapod, platform_joints
from .taking import shown

__all__ = ["pose_gallery"]

SIDE = 3.1  # of a picture, inches
RIGHT = 0.3  # what axes in space have for the label of z is not enough, inches


def pose_gallery(
    robot: Hexapod,
    poses: LegMeasurements | Measurements | Design,
    leg: int | None = None,
    sequence: str | None = None,
    columns: int = 4,
) -> Figure:
    r"""Every pose as a small hexapod, with its number, position and angles: the sheet to measure by.

    All pictures have the same view and scale. Their titles hold the pose's number from 1 (and its candidate, counted
    from 0, where a design is given), :math:`P` in the robot's length unit, and the angles of :math:`R` in degrees.

    Parameters
    ----------
    robot : Hexapod
    poses : LegMeasurements, Measurements or Design
        One set of poses.
    leg : int, optional
        The locked leg, 1…6; by default that of the measurements.
    sequence : str, optional
        The Euler sequence of the angles, as in :mod:`hexopt.rotations`; by default that of the robot's limits.
    columns : int, default 4
        So many pictures stand side by side at most.

    Returns
    -------
    matplotlib Figure
        With one axes a pose.

    Raises
    ------
    InputError
        For a batch of sets, a design without poses, or an unknown sequence.
    UnitError
        If the poses' length unit cannot be turned into the robot's.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> figure = hx.plots.pose_gallery(robot, hx.simulate(robot, "leg", 6, leg=3, rng=0))
    >>> len(figure.axes)
    6
    """
    data = shown(robot, poses, None, leg)
    order = robot.limits.sequence if sequence is None else sequence
    angles = np.rad2deg(matrix_to_euler(data.rotation, order))
    ends = platform_joints(robot, data.position, data.rotation)
    everything = np.vstack([robot.base_points, ends.reshape(-1, 3)])
    columns = min(as_count("columns", columns), len(data.chosen))
    rows = -(-len(data.chosen) // columns)
    width = SIDE * columns + RIGHT
    layout = ConstrainedLayoutEngine(rect=(0, 0, 1 - RIGHT / width, 1))
    figure = plt.figure(figsize=(width, SIDE * rows + 0.4), layout=layout)
    unit = unit_text(robot.length_unit)
    for i, name in enumerate(data.names):
        ax = space_axes(figure.add_subplot(rows, columns, i + 1, projection="3d"))
        draw_hexapod(ax, robot, ends[i], data.legs[i], weight=0.75)
        fit_limits(ax, everything, robot.length_unit, zoom=0.85)
        ax.tick_params(labelsize=7, pad=-2)
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            axis.label.set_size(8)
        title = f"{i + 1}" + f" · {name}" * bool(name)
        place = f"P = {_triple(data.position[i], _decimals(robot.size))} {unit}".rstrip()
        ax.set_title(f"{title}\n{place}\nangles = {_triple(angles[i], 3)}°", loc="left", fontsize=9, y=0.92)
    held = f", leg {data.leg} locked" if data.leg else ""
    figure.suptitle(f"{robot.name}: {len(data.chosen)} poses{held}; angles {order}", x=0.01, ha="left")
    return figure


def _decimals(size: float) -> int:
    """So many that a position is exact to 1e-5 of the robot's size or better."""
    return max(0, 5 - int(np.ceil(np.log10(size))))


def _triple(values: Array, decimals: int) -> str:
    rounded = np.round(values, decimals) + 0.0  # no −0
    return "(" + ", ".join(f"{value:.{decimals}f}".replace("-", "−") for value in rounded) + ")"
