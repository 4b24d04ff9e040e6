"""The paper's figures 5–10, and what it does not show: how the factors depend on the pose ranges."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from studies.harness.figures import MARKERS, OKABE_ITO

__all__ = ["factors_over_ranges", "figure_5_and_6", "figure_7_and_8", "figure_9_and_10"]

PAPER, DIRECT = "consecutive (paper)", "direct"
POINTS = {"base_error": "base point a", "platform_error": "platform point b"}
_Z95 = 1.96


def _curve(axes: Axes, x: Any, rows: pd.DataFrame, scale: Any, index: int, label: str, dashed: bool = False) -> None:
    """A mean with its 95 % Monte-Carlo band."""
    mean, error = rows["mean"].to_numpy() / scale, _Z95 * rows["sem"].to_numpy() / scale
    colour = OKABE_ITO[index]
    marker = MARKERS[index] if len(rows) < 20 else None
    axes.plot(x, mean, color=colour, label=label, marker=marker, linestyle="--" if dashed else "-")
    axes.fill_between(x, mean - error, mean + error, color=colour, alpha=0.2, linewidth=0)


def _published(axes: Axes, factor: float, level: float, count: str) -> None:
    axes.plot(
        7, factor * level, marker="*", markersize=15, color="black", markerfacecolor="#F0E442", linestyle="none",
        label=f"the paper: {factor:g} × err at {count} = 7", zorder=5,
    )  # fmt: skip


def _over_poses(
    table: pd.DataFrame, kind: str, value: str, title: str, xlabel: str, factor: float, err: float = 0.01
) -> Figure:
    """Error against the number of poses at one noise level, both forms; the other level scaled to it."""
    figure, axes = plt.subplots()
    rows = table[(table.experiment == "poses") & (table.kind == kind) & (table.value == value)]
    for index, (method, label) in enumerate(((PAPER, "the paper's consecutive differences"), (DIRECT, "direct form"))):
        part = rows[(rows.method == method) & (rows.level == err)].sort_values("n_poses")
        _curve(axes, part.n_poses, part, 1.0, index, f"{label}, err = {err} cm, {err}°")
    low = rows[(rows.method == PAPER) & (rows.level == 0.001)].sort_values("n_poses")
    _curve(axes, low.n_poses, low, 0.1, 2, "consecutive, err = 0.001, shown × 10", dashed=True)
    _published(axes, factor, err, xlabel.split()[-1])
    axes.set(title=title, xlabel=xlabel, ylabel="mean error (cm)", yscale="log")
    axes.yaxis.set_major_formatter(lambda v, _: f"{v:g}")
    axes.yaxis.set_minor_formatter(lambda v, _: f"{v:g}" if str(f"{v:.0e}")[0] in "25" else "")
    axes.legend()
    return figure


def figure_5_and_6(table: pd.DataFrame, factors: dict[str, float]) -> dict[str, Figure]:
    """Type I: errors of a and b against N."""
    return {
        f"figure-{number}": _over_poses(
            table, "direction", value, f"Type I: error of the {POINTS[value]}, leg 3", "poses N", factors[value]
        )
        for number, value in ((5, "base_error"), (6, "platform_error"))
    }


def figure_7_and_8(table: pd.DataFrame) -> dict[str, Figure]:
    """Type I, N = 7: errors of a and b against the noise level, the three sources apart."""
    labels = {
        "all": "all three together",
        "position": "position only",
        "angle": "orientation only",
        "length": "leg length only",
    }
    figures = {}
    for number, value in ((7, "base_error"), (8, "platform_error")):
        figure, axes = plt.subplots()
        rows = table[(table.experiment == "noise") & (table.method == PAPER) & (table.value == value)]
        for index, (source, label) in enumerate(labels.items()):
            part = rows[rows.source == source].sort_values("level")
            _curve(axes, part.level, part, 1.0, index, label)
        axes.set(
            title=f"Type I, N = 7: error of the {POINTS[value]} by source of noise, leg 3",
            xlabel="half-width of the uniform noise (cm, degrees, cm)",
            ylabel="mean error (cm)",
            xscale="log",
            yscale="log",
        )
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter(lambda v, _: f"{v:g}")
        axes.legend()
        figures[f"figure-{number}"] = figure
    return figures


def figure_9_and_10(table: pd.DataFrame, factors: dict[str, float]) -> dict[str, Figure]:
    """Types II and III: error of b against N1, of a against N2."""
    return {
        "figure-9": _over_poses(
            table, "leg", "platform_error", "Type II: error of the platform point b, leg 3", "poses N1",
            factors["platform_error"],
        ),
        "figure-10": _over_poses(
            table, "length", "base_error", "Type III: error of the base point a, with b from N1 = 7, leg 3", "poses N2",
            factors["base_error"],
        ),
    }  # fmt: skip


def factors_over_ranges(table: pd.DataFrame, default: dict[str, float]) -> Figure:
    """The five factors at N = 7 against each range, the others at their defaults."""
    rows = table[(table.experiment == "ranges") & (table.method == PAPER)]
    curves = (
        ("direction", "base_error", "Type I: a"),
        ("direction", "platform_error", "Type I: b"),
        ("leg", "platform_error", "Type II: b"),
        ("length", "base_error", "Type III: a"),
    )
    names = list(dict.fromkeys(rows.varied))
    figure, panels = plt.subplots(1, len(names), figsize=(10.5, 4.4), sharey=True)
    for axes, name in zip(panels, names, strict=True):
        for index, (kind, value, label) in enumerate(curves):
            part = rows[(rows.varied == name) & (rows.kind == kind) & (rows.value == value)].sort_values("setting")
            _curve(axes, part.setting, part, part.level.to_numpy(), index, label)
        axes.axvline(default[name], color="#5b6470", linestyle=":", linewidth=1.2)
        ticks = sorted(set(rows[rows.varied == name].setting))
        axes.set(xlabel=name, xscale="log", yscale="log")
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.xaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(lambda v, _: f"{v:g}")
    panels[0].set_ylabel("mean error / input error")
    figure.suptitle(
        "How the factors at N = 7 depend on the ranges of the poses (dotted: this study's)", x=0.01, ha="left"
    )
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return figure
