"""Figures of the baselines: efficiency, convergence, coverage, running estimates, and the ranges behind a factor."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.baselines.methods import METHODS, ML
from studies.baselines.running import FIRST_FIT, PRIOR, RECURSIVE
from studies.baselines.scenarios import AMOUNTS, ERR, SETTINGS
from studies.baselines.together import CARRIED, IGNORED, JOINTLY, PAPER_STEPS, SEPARATE, TOGETHER
from studies.harness.figures import MARKERS, OKABE_ITO

__all__ = ["basin", "coverage", "efficiency", "innocenti", "running"]

_Z95 = 1.959963984540054
_GREY = "#5b6470"
_COLOURS = OKABE_ITO[:7]  # yellow lines are hard to see
_NARROW = (0.6, 0.7, 0.8, 0.9, 1, 1.1, 1.2, 1.3, 1.5, 1.7, 2, 2.5, 3)
_WIDE = (0.1, 0.3, 1, 3, 10, 30, 100, 300, 1000)


def _style(index: int) -> dict[str, Any]:
    """A colour and a marker; of more than seven lines the later ones are hollow, then dashed."""
    turn = index // len(_COLOURS)
    style = {"color": _COLOURS[index % len(_COLOURS)], "marker": MARKERS[(index + turn) % len(MARKERS)]}
    return style | ({"fillstyle": "none"} if turn == 1 else {"linestyle": "--"} if turn else {})


#: Of methods: the same in all panels.
_STYLES = {name: _style(index) for index, name in enumerate([ML, *(name for name in METHODS if name != ML)])}


def _plain_log(axes: Axes, places: Sequence[float]) -> None:
    axes.set_xscale("log")
    axes.set_xticks(list(places), [f"{place:g}" for place in places])
    axes.set_xticks([], minor=True)


def _log_values(axes: Axes) -> None:
    """A logarithmic axis upwards, with plain numbers."""
    axes.set_yscale("log")
    low, high = axes.get_ylim()
    axes.set_yticks([tick for tick in (_NARROW if high / low < 4 else _WIDE) if low <= tick <= high])
    axes.set_yticks([], minor=True)
    axes.yaxis.set_major_formatter(lambda v, _: f"{v:g}")


def efficiency(table: pd.DataFrame, block: str, title: str) -> Figure:
    """RMS error over the Cramér–Rao bound against N: a panel for each setting that estimates the block."""
    rows = table[(table.block == block) & table.ratio.notna()]
    settings = [name for name in SETTINGS if name in set(rows.setting)]
    figure, panels = plt.subplots(2, 3, figsize=(11.5, 7.4), squeeze=False)
    for axes, setting in zip(panels.flat, settings, strict=False):
        here = rows[rows.setting == setting]
        names = [name for name in METHODS if name in set(here.method)]
        for index, name in enumerate(names):
            part = here[here.method == name]
            shift = 1.012 ** (index - len(names) / 2)  # bars side by side
            axes.errorbar(
                part.n_poses * shift, part.ratio, yerr=_Z95 * part.ratio_error, label=name, elinewidth=1.0,
                linewidth=1.2, **_STYLES[name],
            )  # fmt: skip
        axes.axhline(1.0, color=_GREY, linestyle=":", linewidth=1.2)
        axes.set_title(SETTINGS[setting], fontsize=10.5)
        _plain_log(axes, sorted(set(here.n_poses)))
        _log_values(axes)
    for axes in panels.flat[len(settings) :]:
        axes.set_axis_off()
    handles = {
        label: line for axes in panels.flat for line, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    names = [name for name in METHODS if name in handles]
    panels.flat[-1].legend([handles[name] for name in names], names, fontsize=8.5, loc="center left")
    figure.suptitle(title, x=0.01, ha="left")
    figure.supxlabel("poses N (of two Type I sets: in each)", fontsize=11)
    figure.supylabel("RMS error / Cramér–Rao bound", fontsize=11)
    return figure


def basin(table: pd.DataFrame) -> Figure:
    """The share of starts that lead to the truth against how far off the nominal is."""
    settings = [name for name in SETTINGS if name in set(table.setting)]
    figure, panels = plt.subplots(1, len(settings), figsize=(11.5, 4.6), sharey=True, squeeze=False)
    for axes, setting in zip(panels[0], settings, strict=True):
        here = table[table.setting == setting]
        for index, name in enumerate(name for name in METHODS if name in set(here.method)):
            part = here[here.method == name]
            axes.errorbar(
                part.off * 1.02 ** (index - 3), 100 * part.reached, yerr=_Z95 * 100 * part.reached_error, label=name,
                elinewidth=1.0, linewidth=1.2, **_STYLES[name],
            )  # fmt: skip
        axes.set_title(SETTINGS[setting], fontsize=10.5)
        _plain_log(axes, AMOUNTS)
        axes.set_ylim(-3, 103)
        axes.legend(fontsize=8, loc="lower left")
    figure.supxlabel("every coordinate of the nominal is off by (cm)", fontsize=11)
    panels[0, 0].set_ylabel("starts that lead to the truth (%)")
    return figure


def coverage(at_home: pd.DataFrame, steps: pd.DataFrame) -> Figure:
    """How often stated 95 % intervals contain the truth, with and without what couples the errors."""
    figure, panels = plt.subplots(1, 2, figsize=(10.5, 4.2), width_ratios=(1, 1.6))
    for index, name in enumerate((TOGETHER, SEPARATE)):
        part = at_home[at_home.method == name]
        panels[0].errorbar([index], part.covered, yerr=_Z95 * part.covered_error, linestyle="none", **_style(index))
    panels[0].set_xticks([0, 1], ["legs coupled", "coupling dropped"])
    panels[0].set(xlim=(-0.5, 1.5), title="Platform position at home", ylabel="truth inside 95 % interval (%)")
    for index, name in enumerate((JOINTLY, CARRIED, PAPER_STEPS, IGNORED)):
        part = steps[steps.method == name]
        place = np.arange(len(part)) + 0.1 * (index - 1.5)
        panels[1].errorbar(
            place, part.covered, yerr=_Z95 * part.covered_error, linestyle="none", label=name, **_style(index)
        )
        panels[1].set_xticks(range(len(part)), [f"{n}" for n in part.second])
    panels[1].set(title="Base point of II + III, N1 = 7", xlabel="poses N2 of the LENGTH set")
    panels[1].legend(fontsize=8.5, loc="lower left")
    for axes in panels:
        axes.axhspan(94, 96, color=_GREY, alpha=0.12, linewidth=0)
        axes.axhline(95, color=_GREY, linestyle=":", linewidth=1.2)
    return figure


def running(rows: pd.DataFrame) -> Figure:
    """The error of a after every pose, and what the filters say of it."""
    panels_of = [("I", RECURSIVE, 0.1), ("free", FIRST_FIT, 0.1), ("free", PRIOR, 0.1), ("free", PRIOR, 0.5)]
    figure, panels = plt.subplots(1, 4, figsize=(12.5, 4.4), sharey=True)
    for axes, (setting, method, off) in zip(panels, panels_of, strict=True):
        part = rows[(rows.setting == setting) & (rows.off == off)]
        here = part[(part.method == method) & part.base_predicted.notna()]
        for _, one in here.groupby(["scenario", "repetition"]):
            axes.plot(one.poses_seen, one.base_error / ERR, color="#b9c0c8", linewidth=0.5, zorder=1)
        middle = (here[["base_error", "base_predicted"]] / ERR).groupby(here.poses_seen).median()
        axes.plot(middle.index, middle["base_error"], label="error, median", **_style(0))
        axes.plot(middle.index, middle["base_predicted"], linestyle="--", label="predicted, median", **_style(1))
        bound = (part.base_bound / ERR).median()
        axes.axhline(bound, color="black", linestyle=":", linewidth=1.2, label="bound, all poses")
        prior = f",\nprior {off:g} cm" if method == PRIOR else ""
        axes.set_title(f"{SETTINGS[setting]}\n{method}{prior}", fontsize=9)
        axes.set_ylim(0.5, 1000)
        _log_values(axes)
        axes.set_xlim(0, 20.5)
    panels[0].set_ylabel("error of a / input error")
    panels[0].legend(fontsize=8.5)
    figure.supxlabel("poses seen", fontsize=11)
    return figure


def innocenti(rows: pd.DataFrame) -> Figure:
    """Error factors of Innocenti's method by the cone of directions: quantiles, median and mean, beside "near 15"."""
    figure, axes = plt.subplots(figsize=(7.2, 4.2))
    cones = sorted(set(rows.cone))
    for index, (short, label) in enumerate((("base", "base point a"), ("platform", "platform point b"))):
        place = np.arange(len(cones)) + 0.14 * (2 * index - 1)
        parts = [rows.loc[(rows.cone == cone) & rows.ok, f"{short}_error"] / ERR for cone in cones]
        low, median, high = np.array([part.quantile([0.05, 0.5, 0.95]) for part in parts]).T
        spread = np.array([median - low, high - median])
        axes.errorbar(place, median, yerr=spread, linestyle="none", label=f"{label}: median, 5–95 %", **_style(index))
        axes.plot(
            place, [part.mean() for part in parts], "_", markersize=16, color=OKABE_ITO[index], label=f"{label}: mean"
        )
    axes.axhline(15, color=_GREY, linestyle=":", linewidth=1.2, label="the paper: near 15")
    axes.set_xticks(range(len(cones)), [f"{cone:g}°" for cone in cones])
    axes.set(xlabel="directions of the leg within this cone of home", ylabel="error / input error")
    _log_values(axes)
    figure.legend(fontsize=8.5, loc="outside upper right", ncols=3)
    return figure
