"""The report of the paper's study: every number that the paper prints beside ours."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import hexopt as hx
from studies.harness import aggregate, read_manifest
from studies.harness.figures import save_figure, use_style
from studies.harness.html import Report, Section, provenance
from studies.paper.figures import PAPER, factors_over_ranges, figure_5_and_6, figure_7_and_8, figure_9_and_10
from studies.paper.published import B_PRINTED, FACTORS, INNOCENTI
from studies.paper.scenarios import N1, SCENARIOS

SETTINGS = ("experiment", "kind", "leg", "n_poses", "level", "source", "varied", "setting")
VALUES = ["base_error", "platform_error", "offset_error"]
NAMES = {"direction": "Type I", "leg": "Type II", "length": "Type III"}
POINT = {"base_error": "base point a", "platform_error": "platform point b", "offset_error": "offset δ"}


def write(out: Path) -> Path | None:
    """Figures into ``out/figures`` and the page ``out/report.html``, from the rows in `out` alone.

    None, and a line on stderr, where `out` holds only some of the scenarios (``--only``).
    """
    missing = len(SCENARIOS) - len(read_manifest(out)["scenarios"])
    if missing:
        print(f"no report: {out} lacks {missing} of {len(SCENARIOS)} scenarios; run without --only", file=sys.stderr)
        return None
    use_style()
    table = _statistics(out)
    robot = hx.robots.left_hand()
    ranges = robot.ranges.describe(robot.length_unit)
    report = Report(
        "Daney (1998): the published figures, run again",
        (
            "The Left Hand robot is calibrated with one leg's direction and/or length locked, as in sections 4 and 5 "
            "of the paper: uniform noise on position, Euler angles and leg length, least squares on consecutive "
            "differences, mean error over random sets of poses.",
            f"Ranges of the random poses, which the paper does not print: {ranges}. One set of ranges serves all "
            "figures below.",
        ),
    )
    factors = _factor_table(table)
    for row in factors.itertuples():
        report.fact(
            f"{row.ours:.3g} ± {row.monte_carlo_error:.2g}", f"{row.equation}, {row.point}: paper {row.paper:g}"
        )
    _published_section(report, table, factors, ranges)
    _figure_sections(report, table, out, ranges)
    _offset_section(report, table)
    _legs_section(report, table)
    _exactness_section(report, table, robot)
    _reading_section(report, table)
    return report.write(out / "report.html", provenance(out))


def _statistics(out: Path) -> pd.DataFrame:
    """A row for each scenario, method and estimated value."""
    table = aggregate(out, ["scenario", "method"], VALUES, ok="ok", quantiles=(0.05, 0.5, 0.95)).reset_index()
    settings = pd.DataFrame([{"scenario": s.key, **{name: getattr(s, name) for name in SETTINGS}} for s in SCENARIOS])
    table = table.merge(settings, on="scenario", validate="many_to_one")
    return table[~_never_estimated(table)]


def _never_estimated(table: pd.DataFrame) -> pd.Series:
    """Values that a kind of experiment does not estimate at all, such as a from a LEG set: no failure."""
    return table.groupby(["kind", "method", "value"])["count"].transform("sum") == 0


def _at(table: pd.DataFrame, kind: str, n: int, value: str, level: float = 0.01, method: str = PAPER) -> pd.Series:
    rows = table[
        (table.experiment == "poses")
        & (table.kind == kind)
        & (table.n_poses == n)
        & (table.value == value)
        & (table.level == level)
        & (table.method == method)
    ]
    return rows.iloc[0]


def _factor_table(table: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for (kind, n, value), paper in FACTORS.items():
        ours = _at(table, kind, n, value)
        mean, error = ours["mean"] / ours["level"], ours["sem"] / ours["level"]
        rows.append(
            {
                "equation": NAMES[kind],
                "point": POINT[value],
                "poses": f"N = {n}" if kind != "length" else f"N1 = {N1}, N2 = {n}",
                "paper": paper,
                "ours": mean,
                "monte_carlo_error": error,
                "difference": mean / paper - 1,
                "median": ours["q0.5"] / ours["level"],
                "sets": int(ours["count"]),
                "failures": int(ours["failures"]),
            }
        )
    return pd.DataFrame(rows)


def _published_section(report: Report, table: pd.DataFrame, factors: pd.DataFrame, ranges: str) -> None:
    section = report.section(
        "Published numbers and ours",
        "A factor is the mean error of a point (cm) over the input error (err = 0.01 cm and 0.01 degrees). The paper "
        "prints rounded factors and no ranges; ± is the Monte-Carlo standard error of our mean.",
    )
    shown = factors.rename(columns={"monte_carlo_error": "± (1 s.e.)", "difference": "ours against paper"})
    section.table(
        shown,
        f"Factors at leg 3. Ranges: {ranges}.",
        formats={
            "paper": "g", "ours": ".2f", "± (1 s.e.)": ".2f", "ours against paper": "+.1%", "median": ".2f",
        },
    )  # fmt: skip
    section.text(
        f"Not run here: for Innocenti's algorithm on the same noise the paper prints a factor near {INNOCENTI:g} for "
        "both points.",
        "Equation (5) is printed with a sign error in the column of a, and would return −a; everything here uses the "
        "corrected sign.",
    )
    _printed_b(section, table)


def _printed_b(section: Section, table: pd.DataFrame) -> None:
    truth = hx.robots.left_hand().leg(3).platform_point
    rows = []
    for level, printed in B_PRINTED.items():
        error = float(np.linalg.norm(printed - truth))
        ours = _at(table, "leg", 7, "platform_error", level)
        rows.append(
            {
                "err": level,
                "b printed in the paper": ", ".join(f"{value:g}" for value in printed),
                "its error": error,
                "our mean error": ours["mean"],
                "5 % of ours below": ours["q0.05"],
                "95 % of ours below": ours["q0.95"],
                "within": "yes" if ours["q0.05"] <= error <= ours["q0.95"] else "no",
            }
        )
    section.table(
        pd.DataFrame(rows),
        "The two b of section 5.2 (Type II, N1 = 7): single draws, so they are held against the spread of ours.",
        units={"err": "cm, °", "its error": "cm", "our mean error": "cm"},
        formats={"err": "g"},
    )


def _figure_sections(report: Report, table: pd.DataFrame, out: Path, ranges: str) -> None:
    one = {value: FACTORS["direction", 7, value] for value in ("base_error", "platform_error")}
    two = {"platform_error": FACTORS["leg", 7, "platform_error"], "base_error": FACTORS["length", 7, "base_error"]}
    ratio = _at(table, "direction", 7, "base_error")["mean"] / _at(table, "direction", 7, "platform_error")["mean"]
    captions = {
        "figure-5": "The paper's figure 5: noise weighs most on the base point.",
        "figure-6": f"The paper's figure 6: at N = 7 the error is {ratio:.1f} times smaller than the base point's.",
        "figure-7": "The paper's figure 7: position noise leads, orientation noise hardly counts.",
        "figure-8": "The paper's figure 8: the same order of the three sources for the platform point.",
        "figure-9": "The paper's figure 9. The leg's reading is not used.",
        "figure-10": f"The paper's figure 10. b comes from a LEG set of N1 = {N1} poses, drawn anew for every set.",
    }
    section = report.section(
        "Figures 5 to 10",
        "Bands are 95 % Monte-Carlo intervals of the mean. The direct form uses the same readings and the same "
        "unweighted least squares, without differences of neighbours.",
    )
    drawn = {**figure_5_and_6(table, one), **figure_7_and_8(table), **figure_9_and_10(table, two)}
    for name, figure in drawn.items():
        save_figure(figure, out / "figures", name)
        title = figure.axes[0].get_title(loc="left")
        section.figure(figure, f"{captions[name]} Ranges: {ranges}.", alt=f"Line chart: {title}.")
    section = report.section(
        "How the factors depend on the ranges",
        "Each panel varies one range and keeps the others. The error of b goes as one over the range of rotations, the "
        "Type I error of a as one over the spread of leg length, the Type III error of a nearly as one over the "
        "square of the cone of directions: no factor means anything without its ranges.",
    )
    own = hx.robots.left_hand().ranges
    default = {
        "rotation range, ± degrees": float(np.rad2deg(own.angles[0])),
        "spread of leg length, cm": own.length[1] - own.length[0],
        "cone of directions, ± degrees": float(np.rad2deg(own.cone)),
    }
    figure = factors_over_ranges(table, default)
    save_figure(figure, out / "figures", "ranges")
    section.figure(
        figure,
        "Factors of the paper's estimator at N = 7 (III: N1 = N2 = 7), err = 0.01, leg 3.",
        alt="Three line charts: the four factors against rotation range, spread of length, and cone of directions.",
    )


def _offset_section(report: Report, table: pd.DataFrame) -> None:
    rows = table[(table.experiment == "offset") & (table.value == "offset_error")]
    steps = table[
        (table.experiment == "offset") & (table.value == "base_error") & table.method.str.contains("all LENGTH")
    ]
    biggest = (steps["mean"] / steps["level"]).mean()
    section = report.section(
        "The offset",
        "The paper: “the mean error on the offset is close to the biggest noise applied on measurement or processed "
        "through algorithm (b, a)”. Its own test adds err to b and a; at the end of the three steps the biggest is the "
        f"error of a, here {biggest:.2g} err.",
    )
    section.table(
        pd.DataFrame(
            {
                "err": rows.level,
                "method": rows.method,
                "mean error": rows["mean"],
                "over err": rows["mean"] / rows.level,
                "± (1 s.e.)": rows["sem"] / rows.level,
                "failures": rows.failures,
            }
        ),
        "Offset by equation (19), leg 3.",
        units={"err": "cm, °", "mean error": "cm"},
        formats={"err": "g", "over err": ".2f", "± (1 s.e.)": ".2f"},
    )


def _legs_section(report: Report, table: pd.DataFrame) -> None:
    rows = table[(table.experiment == "legs") & (table.method == PAPER)]
    method = rows["kind"].map({"direction": "one step", "three-step": "three steps"})
    short = {"base_error": "a", "platform_error": "b", "offset_error": "δ"}
    wide = pd.DataFrame(
        {
            "leg": rows["leg"],
            "column": method + ": " + rows["value"].map(short),
            "cell": (rows["mean"] / rows["level"]).map("{:.2f}".format)
            + " ± "
            + (rows["sem"] / rows["level"]).map("{:.2f}".format),
        }
    ).pivot(index="leg", columns="column", values="cell")
    section = report.section("All six legs", "Both methods on every leg in turn, N = 7 (three steps: N1 = N2 = 7).")
    section.table(wide.reset_index(), "Mean error over err = 0.01, ± 1 Monte-Carlo standard error.")


def _exactness_section(report: Report, table: pd.DataFrame, robot: hx.Hexapod) -> None:
    rows = table[table.experiment == "no noise"]
    worst = (
        rows.groupby(["kind", "n_poses", "value"], sort=False)
        .agg(worst=("max", "max"), median=("q0.5", "median"), sets=("count", "sum"), failures=("failures", "sum"))
        .reset_index()
    )
    worst["worst over the robot's size"] = worst.pop("worst") / robot.size
    worst["median"] /= robot.size
    worst["kind"] = worst["kind"].replace({**NAMES, "three-step": "three steps"})
    worst["value"] = worst["value"].replace(POINT)
    section = report.section(
        "Without noise",
        "The paper: “the parameters are exactly determined”. Ours are, to rounding: the largest errors belong to sets "
        "at the minimal number of poses that happen to be nearly degenerate (large condition number).",
    )
    section.table(
        worst.rename(columns={"kind": "method", "n_poses": "poses", "value": "point", "median": "median, relative"}),
        f"Largest relative error over all six legs and both forms (size {robot.size:g} cm).",
        formats={"median, relative": ".0e", "worst over the robot's size": ".0e"},
    )


def _reading_section(report: Report, table: pd.DataFrame) -> None:
    failures = int(table.failures.sum())
    section = report.section("Reading these numbers")
    section.items(
        "Every row of the sweep is kept under chunks/, one for each set and method, with its seed and status; this "
        "page is made from them alone.",
        f"Failures (estimates whose status is not OPTIMAL): {failures} in all. They would be left out of the means.",
        "Offset and gain are known in Type I, as in the paper. No initial guess is used anywhere.",
    )
