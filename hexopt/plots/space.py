"""A hexapod in space, and the poses that were chosen among many."""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]  # has no types

from ..arrays import Array, as_array, as_count, norm
from ..geometry import Hexapod
from ..geometry.leg import check_leg_number
from ..measurements import LegMeasurements, Measurements
from ..rotations import check_rotation
from ..selection.design import Design
from ..simulation import check_robot
from .look import ACCENT, BASE, COLOURS, FAINT, INK, Axes3D, fit_limits, space_axes
from .taking import Shown, shown

__all__ = ["draw_hexapod", "hexapod", "platform_joints", "poses"]

MOST_DOTS = 5000  # more candidates than these are not told apart in a picture
CLOSE = 0.06  # of the robot's size: numbers that stand nearer are written together


def hexapod(
    robot: Hexapod,
    position: npt.ArrayLike | None = None,
    rotation: npt.ArrayLike | None = None,
    ax: Any = None,
    leg: int | None = None,
) -> Axes3D:
    r"""A hexapod in a pose: legs from :math:`a_k` to :math:`P + R\,b_k`, base, platform and joints.

    Legs carry their numbers. All axes have the same scale, in the robot's length unit.

    Parameters
    ----------
    robot : Hexapod
    position : array_like, shape (3,), optional
        :math:`P`, length units; by default home's.
    rotation : array_like, shape (3, 3), optional
        :math:`R`, platform to base; by default home's.
    ax : matplotlib Axes3D, optional
        Where it is drawn; by default in a new figure.
    leg : int, optional
        The locked leg, 1…6, which is drawn in another colour.

    Returns
    -------
    matplotlib Axes3D

    Raises
    ------
    InputError
        For wrong shapes, a matrix that is no rotation, an unknown leg, or axes that are not in space.

    Examples
    --------
    >>> import hexopt as hx
    >>> ax = hx.plots.hexapod(hx.robots.left_hand(), position=[1.0, 0.0, 20.0], leg=3)
    >>> ax.get_xlabel()
    'x (cm)'
    """
    check_robot(robot)
    place = robot.home_position if position is None else as_array("position", position, (3,), batch=False)
    turn = robot.home_rotation if rotation is None else as_array("rotation", rotation, (3, 3), batch=False)
    held = None if leg is None else check_leg_number(leg)
    ends = platform_joints(robot, place, check_rotation("rotation", turn))
    ax = space_axes(ax)
    draw_hexapod(ax, robot, ends, held)
    fit_limits(ax, np.vstack([robot.base_points, ends]), robot.length_unit)
    ax.set_title(robot.name, loc="left")
    if held:
        ax.legend(loc="upper right", frameon=False)
    return ax


def poses(
    robot: Hexapod,
    poses: LegMeasurements | Measurements | Design,
    chosen: Design | npt.ArrayLike | None = None,
    leg: int | None = None,
    ax: Any = None,
    most: int = 8,
) -> Axes3D:
    r"""The chosen poses among all: their platforms, with the hexapod at home behind them.

    Every position :math:`P_i` is a dot (of more than 5000, evenly spaced ones). The chosen are larger and carry their
    colour by their order, from dark to light; the first `most` of them are drawn as platforms :math:`P_i + R_i b_k`
    with their number from 1, and the locked leg in each.

    Parameters
    ----------
    robot : Hexapod
    poses : LegMeasurements, Measurements or Design
        One set of poses. Those of a design are all chosen.
    chosen : Design or array_like of int, optional
        Which of the poses, counted from 0; by default all.
    leg : int, optional
        The locked leg, 1…6; by default that of the measurements.
    ax : matplotlib Axes3D, optional
        Where it is drawn; by default in a new figure.
    most : int, default 8
        So many platforms are drawn at most.

    Returns
    -------
    matplotlib Axes3D

    Raises
    ------
    InputError
        For a batch of sets, a design without poses, indices that do not exist, or axes that are not in space.
    UnitError
        If the poses' length unit cannot be turned into the robot's.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate(robot, "direction", 100, leg=3, rng=0)
    >>> ax = hx.plots.poses(robot, data, chosen=[4, 17, 60, 81])
    >>> ax.get_title(loc="left")
    'Left Hand: 4 of 100 poses'
    """
    data = shown(robot, poses, chosen, leg)
    most = as_count("most", most)
    ax = space_axes(ax, (7.4, 6.4))
    home = platform_joints(robot, robot.home_position, robot.home_rotation)
    draw_hexapod(ax, robot, home, data.leg, faint=True)
    rest = np.setdiff1d(np.arange(len(data.position)), data.chosen)
    step = max(1, -(-len(rest) // MOST_DOTS))
    if rest.size:
        ax.scatter(*data.position[rest[::step]].T, s=3, color=FAINT, depthshade=False, linewidths=0)
        ax.scatter([], [], [], s=14, color=FAINT, label="candidates")  # the dots are too small for a legend
    ends = platform_joints(robot, data.position, data.rotation)
    _draw_chosen(ax, robot, data, ends, most)
    everything = [robot.base_points, home, data.position, ends[data.chosen[:most]].reshape(-1, 3)]
    fit_limits(ax, np.vstack(everything), robot.length_unit)
    count = f"{len(data.chosen)} of {len(data.position)} poses" if rest.size else f"{len(data.chosen)} poses"
    more = f", platforms of the first {most}" if len(data.chosen) > most else ""
    ax.set_title(f"{robot.name}: {count}{more}", loc="left")
    ax.legend(loc="upper right", frameon=False)
    return ax


def _draw_chosen(ax: Axes3D, robot: Hexapod, data: Shown, ends: Array, most: int) -> None:
    """The positions of the chosen poses, and the platforms, locked leg and numbers of the first."""
    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(data.chosen)))
    spread = ends[data.chosen].var(axis=0).sum(axis=-1)
    numbers: list[tuple[Array, list[str]]] = []
    for number, (index, colour) in enumerate(zip(data.chosen[:most], colours, strict=False), start=1):
        _polygon(ax, ends[index], colour, alpha=0.2)
        place = ends[index, spread.argmax()]
        near = [names for other, names in numbers if norm(place - other) < CLOSE * robot.size]
        if near:
            near[0].append(str(number))
        else:
            numbers.append((place, [str(number)]))
        leg = data.legs[index]
        if leg:
            line = np.stack([robot.base_points[leg - 1], ends[index, leg - 1]])
            ax.plot(*line.T, color=ACCENT, linewidth=1.2, alpha=0.8)
    for place, names in numbers:  # at the joint where the platforms differ most
        ax.text(*place, ", ".join(names), ha="right", va="bottom", fontsize=9, color=INK, zorder=6)
    label = f"chosen, 1 (dark) to {len(data.chosen)} (light)" if len(data.chosen) > 1 else "chosen"
    style = {"s": 22, "edgecolors": "white", "linewidths": 0.6, "depthshade": False, "zorder": 5}
    ax.scatter(*data.position[data.chosen].T, c=colours, label=label, **style)


def platform_joints(robot: Hexapod, position: Array, rotation: Array) -> Array:
    r""":math:`P + R\,b_k`, shape (..., 6, 3)."""
    joints: Array = position[..., None, :] + robot.platform_points @ np.swapaxes(rotation, -1, -2)
    return joints


def draw_hexapod(
    ax: Axes3D, robot: Hexapod, ends: Array, leg: int | None, faint: bool = False, weight: float = 1.0
) -> None:
    """Base, platform (joints at `ends`) and six legs, numbered unless faint, the locked one in another colour."""
    starts = robot.base_points
    strength = 0.35 if faint else 1.0
    _polygon(ax, starts, BASE, alpha=0.18 * strength)
    _polygon(ax, ends, BASE if faint else COLOURS[0], alpha=0.3 * strength)
    for number, (start, end) in enumerate(zip(starts, ends, strict=True), start=1):
        held = number == leg
        colour = ACCENT if held else INK
        ax.plot(
            *np.stack([start, end]).T,
            marker="o",
            markersize=4 * weight,
            color=colour,
            linewidth=weight * (2.8 if held else 1.5),
            alpha=strength,
            label=f"leg {number}, locked" if held else None,
        )
        if not faint:
            plate = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": "none"}
            style = {"color": colour, "fontweight": "bold" if held else "normal", "bbox": plate}
            place = start + 0.3 * (end - start)
            ax.text(*place, str(number), ha="center", va="center", fontsize=9 * weight, **style)


def _polygon(ax: Axes3D, corners: Array, colour: Any, alpha: float) -> None:
    """The corners (6, 3) as a filled polygon, joined in the order in which they stand around their centre."""
    around = corners - corners.mean(axis=0)
    plane = np.linalg.svd(around)[2][:2]
    order = np.argsort(np.arctan2(*(plane @ around.T)))
    face = Poly3DCollection([corners[order]], facecolor=colour, alpha=alpha)
    edge = Poly3DCollection(
        [corners[order]], facecolor="none", edgecolor=colour, linewidth=1.2, alpha=min(1, 3 * alpha)
    )
    ax.add_collection3d(face)
    ax.add_collection3d(edge)
