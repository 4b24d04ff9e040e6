"""Figures of the comparison: methods down the side, a colour and a marker for each number of poses."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from studies.estimators.run import METHODS, PAPER, UNWEIGHTED
from studies.estimators.scenarios import ERR
from studies.harness.figures import MARKERS, OKABE_ITO

__all__ = ["PANELS", "coverage_over_cases", "errors", "nominals", "over_bound", "trial_coverage"]

#: The estimated points: lock, short name, title.
PANELS = (
    ("direction", "base", "Type I: base point a"),
    ("direction", "platform", "Type I: platform point b"),
    ("leg", "platform", "Type II: platform point b"),
)
COUNTS = (2, 5, 7, 20, 50)
_Z95 = 1.96


def _dots(axes: Axes, rows: pd.DataFrame, names: Sequence[str], x: str, error: str, by: str = "method") -> None:
    """One dot a row of the table, with its 95 % Monte-Carlo interval; those of one name lie close together."""
    counts = [n for n in COUNTS if n in set(rows.n_poses)]
    for place, n in enumerate(counts):
        part = rows[rows.n_poses == n].set_index(by).reindex(list(names))
        index = COUNTS.index(n)
        axes.errorbar(
            part[x], np.arange(len(names)) + 0.17 * (place - (len(counts) - 1) / 2), xerr=_Z95 * part[error],
            color=OKABE_ITO[index], marker=MARKERS[index], linestyle="none", elinewidth=1.2, label=f"N = {n}",
        )  # fmt: skip
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    for edge in np.arange(0.5, len(names) - 1):
        axes.axhline(edge, color="#e3e6ea", linewidth=0.8, zorder=0)


def _three(height: float) -> tuple[Figure, Sequence[Axes]]:
    figure, panels = plt.subplots(1, 3, figsize=(11.5, height), sharey=True)
    return figure, panels


def _finish(figure: Figure, panels: Sequence[Axes], title: str, xlabel: str) -> Figure:
    figure.suptitle(title, x=0.01, ha="left")
    figure.supxlabel(xlabel, fontsize=11)
    handles = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    labels = [f"N = {n}" for n in COUNTS if f"N = {n}" in handles]
    figure.legend([handles[label] for label in labels], labels, loc="outside upper right", ncols=len(labels))
    return figure


def _methods(rows: pd.DataFrame) -> list[str]:
    present = set(rows[rows["count"] > 0].method)
    return [name for name in METHODS if name in present]


def _plain_log(axes: Axes) -> None:
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(lambda v, _: f"{v:g}")
    low, high = axes.get_xlim()
    few = high / low < 30
    axes.tick_params(axis="x", which="minor", pad=5)
    axes.xaxis.set_minor_formatter(lambda v, _: f"{v:g}" if few and f"{v:.0e}"[0] in "235" else "")


def over_bound(table: pd.DataFrame, case: str, title: str) -> Figure:
    """RMS error over the Cramér–Rao bound."""
    rows = table[table.case == case].copy()
    names = _methods(rows)
    figure, panels = _three(4.8)
    for axes, (kind, short, name) in zip(panels, PANELS, strict=True):
        here = rows[rows.kind == kind]
        bound = here.loc[here.value == f"{short}_bound", ["scenario", "method", "rms"]]
        part = here[here.value == f"{short}_square"].merge(bound, on=["scenario", "method"], suffixes=("", "_bound"))
        part["ratio"] = np.sqrt(part["mean"]) / part["rms_bound"]
        part["ratio_error"] = part["ratio"] * part["sem"] / part["mean"] / 2
        _dots(axes, part, names, "ratio", "ratio_error")
        axes.axvline(1.0, color="#5b6470", linestyle=":", linewidth=1.2)
        axes.set_title(name, fontsize=10.5)
    return _finish(figure, panels, title, "RMS error / Cramér–Rao bound (dotted: the bound)")


def errors(table: pd.DataFrame, case: str, title: str) -> Figure:
    """Mean error over the input error, with the same method's error on uniform noise as an open ring at N = 20."""
    rows = table[table.case == case]
    clean = table[(table.case == "uniform") & (table.n_poses == 20)]
    names = _methods(rows)
    figure, panels = _three(4.8)
    for axes, (kind, short, name) in zip(panels, PANELS, strict=True):
        part = rows[(rows.kind == kind) & (rows.value == f"{short}_error")].copy()
        part["factor"], part["factor_error"] = part["mean"] / ERR, part["sem"] / ERR
        _dots(axes, part, names, "factor", "factor_error")
        ring = clean[(clean.kind == kind) & (clean.value == f"{short}_error")].set_index("method").reindex(names)
        label = "N = 20 without bad poses"
        axes.plot(
            ring["mean"] / ERR, range(len(names)), "o", color="black", fillstyle="none", markersize=8, label=label
        )
        axes.set_title(name, fontsize=10.5)
        _plain_log(axes)
    _finish(figure, panels, title, "mean error / input error (0.01 cm); rings: N = 20 without bad poses")
    return figure


def nominals(table: pd.DataFrame, without: Sequence[str], names: Sequence[str]) -> Figure:
    """Mean error of methods without a nominal, and of others with a right one and with a wrong one."""
    cases = {"two poses": "right", "uniform": "right", "wrong nominal": "wrong"}
    rows = table[table.case.isin(list(cases)) & table.n_poses.isin([2, 7, 20])].copy()
    rows = rows[rows.method.isin(list(names)) | (rows.method.isin(list(without)) & (rows.case != "wrong nominal"))]
    rows["line"] = rows.method + ": " + rows.case.map(cases).mask(rows.method.isin(list(without)), "no nominal")
    lines = [f"{name}: no nominal" for name in without]
    lines += [f"{name}: {what}" for name in names for what in ("right", "wrong")]
    rows["factor"], rows["factor_error"] = rows["mean"] / ERR, rows["sem"] / ERR
    figure, panels = _three(5.0)
    for axes, (kind, short, name) in zip(panels, PANELS, strict=True):
        part = rows[(rows.kind == kind) & (rows.value == f"{short}_error") & (rows["count"] > 0)]
        _dots(axes, part, lines, "factor", "factor_error", by="line")
        axes.set_title(name, fontsize=10.5)
        _plain_log(axes)
    return _finish(figure, panels, "Nominals, right and wrong", "mean error / input error (0.01 cm)")


def coverage_over_cases(table: pd.DataFrame, cases: dict[str, str]) -> Figure:
    """How often the stated 95 % intervals contain the truth, pooled over both locks and all coordinates."""
    figure, panels = plt.subplots(1, len(cases), figsize=(11.5, 4.8), sharey=True)
    rows = table[table.value.isin(["base_covered", "platform_covered"]) & (table["count"] > 0)].copy()
    rows["mean"] *= 100
    rows["variance"] = (100 * rows["sem"]) ** 2
    names = _methods(rows)
    for axes, (case, title) in zip(panels, cases.items(), strict=True):
        groups = rows[rows.case == case].groupby(["method", "n_poses"], observed=True)
        part = groups.agg(covered=("mean", "mean"), variance=("variance", "sum"), parts=("mean", "size")).reset_index()
        part["covered_error"] = np.sqrt(part["variance"]) / part["parts"]
        _dots(axes, part, names, "covered", "covered_error")
        axes.axvline(95, color="#5b6470", linestyle=":", linewidth=1.2)
        axes.set_title(title, fontsize=10.5)
    return _finish(figure, panels, "Coverage of the stated 95 % intervals", "truth inside, per cent (dotted: 95)")


def trial_coverage(covered: pd.DataFrame) -> Figure:
    """Coverage of three least-squares estimators under normal errors, from many sets."""
    figure, panels = plt.subplots(1, 2, figsize=(9.5, 4.2), sharey=True)
    labels = {PAPER: "consecutive (paper), sandwich", UNWEIGHTED: "direct, unweighted, sandwich"}
    for axes, (kind, title) in zip(panels, (("direction", "Type I"), ("leg", "Type II")), strict=True):
        for index, (method, part) in enumerate(covered[covered.kind == kind].groupby("method", observed=True)):
            place = np.arange(len(part)) + 0.16 * (index - 1)
            axes.errorbar(
                place, part.pooled, yerr=_Z95 * part.pooled_error, color=OKABE_ITO[index], marker=MARKERS[index],
                linestyle="none", label=labels.get(str(method), f"{method}, model"),
            )  # fmt: skip
            axes.set_xticks(range(len(part)), [f"{n}" for n in part.n_poses])
        axes.axhspan(94, 96, color="#5b6470", alpha=0.12, linewidth=0)
        axes.axhline(95, color="#5b6470", linestyle=":", linewidth=1.2)
        axes.set(title=title, xlabel="poses N")
    panels[0].yaxis.set_major_locator(MultipleLocator(0.5))
    panels[0].set_ylabel("truth inside 95 % interval (%)")
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3)
    return figure
