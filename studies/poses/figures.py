"""Figures of the choice of poses."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.baselines.summaries import each
from studies.harness.figures import MARKERS, OKABE_ITO
from studies.poses.claims import LETTER, TITLES
from studies.poses.data import BEST, PAPER
from studies.poses.designs import DESIGNS, KAPPA, RANDOM, REFINED, A
from studies.poses.nominals import AVERAGE, SINGLE, WORST
from studies.poses.scenarios import SETTINGS

__all__ = ["counts", "legs", "nominal", "promised", "real", "units"]

#: What is shown of every setting.
PANELS = (("I", "base"), ("I", "platform"), ("II", "platform"), ("III", "base"), ("free", "base"), ("free", "platform"))
GREY = "#8a929b"
_ESTIMATORS = {PAPER: "the paper's estimator (unlocked: least squares on length)", BEST: "the best estimator"}


def _title(setting: str, block: str = "") -> str:
    name = SETTINGS[setting].split(" (")[0]
    return f"{name[0].upper()}{name[1:]}" + (f": {LETTER[block]}" if block else "")


def _plain(axes: Axes, axis: str, ticks: Sequence[float] | None = None) -> None:
    """Powers written out, on a logarithmic axis."""
    scale = axes.xaxis if axis == "x" else axes.yaxis
    (axes.set_xscale if axis == "x" else axes.set_yscale)("log")
    if ticks is not None:
        scale.set_ticks(ticks)
    scale.set_major_formatter(lambda value, _: f"{value:g}")
    low, high = axes.get_xlim() if axis == "x" else axes.get_ylim()
    few = ticks is None and high < 100 * low
    scale.set_minor_formatter(lambda value, _: f"{value:g}" if few and f"{value:.0e}"[0] in "25" else "")


def legs(table: pd.DataFrame, robot: str, title: str) -> Figure:
    """By design: the median random error over its own, a dot a leg."""
    part = table[(table.experiment == "legs") & (table.robot == robot)]
    names = [name for name in DESIGNS if name in set(part.design)]
    figure, panels = plt.subplots(2, 3, figsize=(11.5, 1.6 + 0.56 * len(names)), sharey=True)
    for axes, (setting, block) in zip(panels.flat, PANELS, strict=True):
        for place, (estimator, label) in enumerate(_ESTIMATORS.items()):
            here = part[(part.setting == setting) & (part.block == block) & (part.estimator == estimator)]
            height = here.design.map(names.index) + 0.26 * (place - 0.5)
            axes.plot(
                here.gain, height, MARKERS[place], color=OKABE_ITO[1 - place], alpha=0.75, label=label, linestyle="none"
            )
        axes.axvline(1, color="black", linewidth=1)
        axes.set_title(_title(setting, block))
        _plain(axes, "x", (0.5, 0.7, 1, 1.5, 2, 3, 4, 6))
        axes.set_xlim(0.55, max(2.5, 1.1 * part[(part.setting == setting) & (part.block == block)].gain.max()))
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
    return _finish(figure, panels[1], title, "median random error over its own")


def _finish(figure: Figure, panels: Sequence[Axes], title: str, xlabel: str) -> Figure:
    """Title, labels of the last row of panels, and one legend for all."""
    figure.suptitle(title, x=0.01, ha="left")
    for axes in panels:
        axes.set_xlabel(xlabel)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure


def counts(table: pd.DataFrame, rows: pd.DataFrame, robot: str, title: str, unit: str) -> Figure:
    """Error against the number of poses: random sets, κ, D, A, A refined; dots are real errors of A."""
    part = table[(table.experiment == "counts") & (table.robot == robot) & (table.estimator == BEST)]
    drawn = rows[(rows.experiment == "counts") & (rows.robot == robot)]
    drawn = drawn[(drawn.design == RANDOM) & (drawn.estimator == BEST)]
    figure, panels = plt.subplots(2, 3, figsize=(11.5, 6.6))
    for axes, (setting, block) in zip(panels.flat, PANELS, strict=True):
        random = drawn[drawn.setting == setting].groupby("n_poses")[f"{block}_predicted"]
        low, middle, high = (random.quantile(share) for share in (0.05, 0.5, 0.95))
        axes.fill_between(low.index, low, high, color="#dde2e8", label="random sets, 90 % of them")
        axes.plot(middle.index, middle, color=GREY, label="the median random set")
        here = part[(part.setting == setting) & (part.block == block)]
        for place, name in enumerate((KAPPA, "D (O1)", A, REFINED)):
            line = here[here.design == name].sort_values("n_poses")
            if len(line):
                axes.plot(line.n_poses, line.predicted, color=OKABE_ITO[place], label=name)
        real = here[here.design == A]
        axes.plot(real.n_poses, real.rms, "o", color=OKABE_ITO[2], label="A, real error", linestyle="none")
        axes.set_title(_title(setting, block))
        _plain(axes, "x", (4, 5, 7, 10, 14, 20, 30))
        _plain(axes, "y")
    figure.supylabel(f"predicted error ({unit})", fontsize=11)
    return _finish(figure, panels[1], title, "number of poses")


def units(table: pd.DataFrame) -> Figure:
    """Condition numbers in several units: error over the median random one, a dot a leg."""
    part = table[(table.experiment == "units") & (table.estimator == BEST)]
    names = [name for name in DESIGNS if name in set(part.design)]
    shown = [
        (robot, *rest) for robot in TITLES for rest in (("III", 5, "base"), ("III", 7, "base"), ("gain", 10, "gain"))
    ]
    figure, panels = plt.subplots(2, 3, figsize=(11.5, 5.6), sharey=True)
    for axes, (robot, setting, n, block) in zip(panels.flat, shown, strict=True):
        here = part[(part.robot == robot) & (part.setting == setting) & (part.n_poses == n) & (part.block == block)]
        for place, name in enumerate(names):
            worse = 1 / here[here.design == name].gain
            colour = OKABE_ITO[2] if name == A else OKABE_ITO[0] if name == KAPPA else OKABE_ITO[1]
            axes.plot(worse, np.full(len(worse), place), "o", color=colour, alpha=0.75)
        axes.axvline(1, color="black", linewidth=1)
        axes.set_title(
            f"{TITLES[robot].removesuffix(' camera hexapod')}, {_title(setting, block)}, N = {n}", fontsize=10.5
        )
        _plain(axes, "x", (0.2, 0.5, 1, 2, 5, 10, 20))
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
    figure.suptitle("Condition numbers, and the units that they depend on", x=0.01, ha="left")
    figure.supxlabel("error over that of the median random set", fontsize=11)
    return figure


def nominal(table: pd.DataFrame) -> Figure:
    """A-efficiency lost by designs at a wrong nominal: the mean, and the worst."""
    figure, panels = plt.subplots(1, 4, figsize=(11.5, 3.6), sharey=True)
    for axes, (setting, part) in zip(panels, table.groupby("setting", sort=False), strict=True):
        for place, name in enumerate((SINGLE, AVERAGE, WORST)):
            line = part[part.design == name].sort_values("off")
            style = {"color": OKABE_ITO[place], "marker": MARKERS[place]}
            axes.plot(line.off, 100 - 100 * line["mean"], label=name, **style)
            axes.plot(line.off, 100 - 100 * line["least"], linestyle=":", linewidth=1.2, **style)
        axes.set_title(_title(str(setting)))
        axes.set_xticks((0.1, 0.5, 1.0))
    panels[0].set_ylabel("A-efficiency lost (%)")
    return _finish(
        figure, panels, "Designs at a wrong nominal: mean, and dotted the worst", "every coordinate off by (cm)"
    )


def promised(table: pd.DataFrame) -> Figure:
    """Real over predicted error of every design."""
    figure, axes = plt.subplots(figsize=(7.2, 3.4))
    for place, (robot, title) in enumerate(TITLES.items()):
        here = table[table.robot == robot]
        axes.hist(
            here.ratio,
            bins=list(np.arange(0.85, 1.151, 0.0125)),
            histtype="step",
            linewidth=1.8,
            color=OKABE_ITO[place],
            label=title,
        )
    axes.axvline(1, color="black", linewidth=1)
    axes.set(xlabel="real error over predicted error", ylabel="how many")
    axes.legend(loc="upper left")
    axes.set_title("Are the predicted errors kept?")
    return figure


def real(measured: pd.DataFrame) -> Figure:
    """Prediction errors of random and chosen twelves of measured poses."""
    random = measured[measured.design == "random"].rms.to_numpy()
    figure, axes = plt.subplots(figsize=(7.2, 3.4))
    finite = random[np.isfinite(random)]
    axes.hist(finite, bins=30, color="#c9ced4", label=f"{len(random)} random twelves")
    axes.axvline(float(np.median(random)), color=GREY, linestyle="--", label="their median")
    for place, row in enumerate(each(measured[measured.design != "random"])):
        style = "--" if "leg" in row.design else "-"
        axes.axvline(row.rms, color=OKABE_ITO[place], linestyle=style, label=f"{row.design}: {row.rms:.3f} mm")
    axes.set(xlabel="RMS error of the lengths in the other 96 poses (mm)", ylabel="how many")
    axes.set_title("Twelve of 108 measured poses")
    axes.legend()
    return figure
