"""The look that the figures share: colours, axes, and labels with units."""

from __future__ import annotations

from typing import Any, Literal

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import Axes3D  # type: ignore[import-untyped]  # this part of matplotlib has no types

from ..arrays import Array
from ..errors import InputError

__all__ = [
    "ACCENT",
    "BASE",
    "COLOURS",
    "FAINT",
    "INK",
    "Axes3D",
    "block_of",
    "fit_limits",
    "flat_axes",
    "quantity",
    "space_axes",
    "unit_text",
]

#: Okabe and Ito (2008); in grey, markers, line styles and hatches tell them apart.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
ACCENT, BASE, FAINT, INK = "#D55E00", "#5b6470", "#aab2bb", "#20262d"
GRID = "#e3e6ea"
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_text(unit: str) -> str:
    """A unit as it is printed: "µm" for "um", nothing where none is stated."""
    return "" if unit == "unstated" else "µ" + unit[1:] if unit.startswith("um") else unit


def quantity(name: str, unit: str, scale: str = "") -> str:
    """What an axis shows, with its unit: "x (cm)"."""
    text = (scale + unit_text(unit)).strip()
    return f"{name} ({text})" if text else name


def block_of(label: str) -> str:
    """The block of a scalar: "leg3.base_point" of "leg3.base_point.x"."""
    head, _, tail = label.rpartition(".")
    return head if head and (tail in "xyz" or tail.isdigit()) else label


def flat_axes(ax: Axes | None, size: tuple[float, float], grid: Literal["", "both", "x", "y"] = "both") -> Axes:
    """The given axes, or those of a new figure (inches), with a light grid."""
    if ax is None:
        ax = plt.figure(figsize=size, layout="constrained").add_subplot()
    if not isinstance(ax, Axes) or isinstance(ax, Axes3D):
        raise InputError(f"ax: expected flat axes of matplotlib, got {type(ax).__name__}")
    ax.set_axisbelow(True)
    ax.grid(False)
    if grid:
        ax.grid(True, axis=grid, color=GRID, linewidth=0.8)
    ax.spines[["top", "right"]].set_visible(False)
    return ax


def space_axes(ax: Any, size: tuple[float, float] = (6.4, 5.2)) -> Axes3D:
    """The given axes in space, or those of a new figure (inches), without panes."""
    if ax is None:
        ax = plt.figure(figsize=size, layout="constrained").add_subplot(projection="3d")
    if not isinstance(ax, Axes3D):
        raise InputError(
            f'ax: expected axes in space, got {type(ax).__name__}; make them with figure.add_subplot(projection="3d")'
        )
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MaxNLocator(4))
    ax.view_init(elev=30, azim=-70)
    return ax


def fit_limits(ax: Axes3D, points: Array, unit: str, zoom: float = 1.0) -> None:
    """Limits that hold all points (n, 3) with a margin, the same scale on all axes, and their labels."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.06 * float((high - low).max())
    power = int(np.floor(np.log10(np.abs(points).max())))
    power = power if power >= 4 or power <= -3 else 0  # 0.01 to 9999 are readable as they are
    scale = f"10{str(power).translate(RAISED)} " if power else ""
    for name, axis, least, most in zip("xyz", (ax.xaxis, ax.yaxis, ax.zaxis), low - margin, high + margin, strict=True):
        ax.set(**{f"{name}lim": (least, most)})
        axis.set_label_text(quantity(name, unit, scale))
        if power:
            axis.set_major_formatter(lambda value, _: f"{value / 10**power:.3g}".replace("-", "−"))
    ax.set_box_aspect(tuple(high - low + 2 * margin), zoom=zoom)
