"""One look for the figures of all studies: safe for the colour-blind, readable in print, equal bytes for equal data."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
from cycler import cycler
from matplotlib.figure import Figure
from matplotlib.typing import RcKeyType

OKABE_ITO = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#F0E442")
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")

STYLE: dict[RcKeyType, Any] = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.edgecolor": "#5b6470",
    "axes.labelsize": 11,
    "axes.prop_cycle": cycler(color=OKABE_ITO),
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 11.5,
    "axes.titleweight": "bold",
    "figure.constrained_layout.use": True,
    "figure.dpi": 100,
    "figure.figsize": (7.2, 4.2),
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same figure everywhere
    "font.size": 10.5,
    "grid.color": "#e3e6ea",
    "grid.linewidth": 0.8,
    "legend.fontsize": 10,
    "legend.frameon": False,
    "lines.linewidth": 1.8,
    "lines.markersize": 5,
    "svg.hashsalt": "studies",
    "xtick.color": "#3c444d",
    "xtick.labelsize": 10,
    "ytick.color": "#3c444d",
    "ytick.labelsize": 10,
}


def use_style() -> None:
    """Draw in this style from now on, without a screen."""
    mpl.use("Agg")
    mpl.rcParams.update(STYLE)


def save_figure(figure: Figure, out: str | Path, name: str) -> Path:
    """Write a figure as ``name.svg`` and, with 150 dots per inch, ``name.png``.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        What to write.
    out : path
        The folder, which is made if need be.
    name : str
        The file name, without a suffix.

    Returns
    -------
    pathlib.Path
        The SVG file.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"svg.hashsalt": name}):
        figure.savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": None})
        figure.savefig(folder / f"{name}.png", dpi=150, metadata={"Software": None})
    return folder / f"{name}.svg"
