"""The report of the comparison, from the rows alone."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

import hexopt as hx
from studies.estimators import figures, tables
from studies.estimators.claims import TYPES, claims, coverage, efficiency, robustness, trials
from studies.estimators.run import AXES, BOX, GLS, GROUP_HUBER, HUBER_BOX, LASSO, PAPER, POINTS, PRIOR
from studies.estimators.scenarios import ERR, SCENARIOS, SHIFT, TOLERANCE, Tracker
from studies.harness import aggregate, read_manifest
from studies.harness.figures import use_style
from studies.harness.html import Report, provenance

VALUES = [
    *(f"{short}_{what}" for short in POINTS for what in ("error", "square", "bound", "linear_bound", "covered")),
    *(f"{short}_{axis}" for short in POINTS for axis in AXES),
    "joint_covered",
]
CASES = {
    "uniform": "uniform errors, ± 0.01 cm and °",
    "normal": "normal errors of the same variance",
    "5 % bad": "5 % bad poses",
    "15 % bad": "15 % bad poses",
    "tracker": "a tracker's correlated errors",
}


def write(out: Path) -> Path | None:
    """Figures into ``out/figures`` and the page ``out/report.html``, from the rows in `out`.

    None, and a line on stderr, where `out` holds only some of the scenarios (``--only``).
    """
    if not is_whole(out):
        lacking = f"{out} lacks some of the {len(SCENARIOS)} scenarios; run without --only"
        print(f"no report: {lacking}", file=sys.stderr)
        return None
    use_style()
    table, many = _statistics(out), trials(out)
    robot = hx.robots.left_hand()
    ranges = robot.ranges.describe(robot.length_unit)
    report = Report(
        "Estimators on identical data",
        (
            "One leg of the Left Hand is calibrated from the same readings by the paper's estimator and by the convex "
            "family: weights, robust losses, priors and bounds. Some readings are as the model says, some are not.",
            f"Ranges of the random poses: {ranges}. Leg 3, input error {ERR} cm and degrees.",
        ),
    )
    _claims_section(report, table, many)
    _error_sections(report, table, out, ranges)
    _nominal_section(report, table, out, ranges)
    _coverage_section(report, table, many, out, ranges)
    _bias_section(report, table)
    _failure_section(report, out)
    _cost_section(report, out)
    return report.write(out / "report.html", provenance(out))


def is_whole(out: Path) -> bool:
    """Whether `out` holds all scenarios."""
    return len(read_manifest(out)["scenarios"]) == len(SCENARIOS)


def _statistics(out: Path) -> pd.DataFrame:
    """A row for each scenario, method and value, with the scenario's settings."""
    table = aggregate(out, ["scenario", "method"], VALUES, ok="ok", quantiles=(0.5, 0.99)).reset_index()
    settings = [{"scenario": s.key, "case": s.case, "kind": s.kind, "n_poses": s.n_poses} for s in SCENARIOS]
    return table.merge(pd.DataFrame(settings), on="scenario", validate="many_to_one")


def _claims_section(report: Report, table: pd.DataFrame, many: pd.DataFrame) -> None:
    found = claims(table, many)
    section = report.section(
        "Three claims",
        "Each is stated with the figure that it needs, and with what was found ± 1 Monte-Carlo standard error. A claim "
        "on coverage holds where the worst coordinate, too, is within a percentage point.",
    )
    section.table(
        pd.DataFrame(
            {
                "claim": found.claim,
                "sets": found["sets"],
                "wanted": found.wanted,
                "found": tables.measured(found, "found", "error"),
                "holds": np.where(found.holds, "yes", "no"),
            }
        ),
        "The claims, measured.",
    )
    for claim, part in found.groupby("claim", sort=False):
        held = f"{int(part['holds'].sum())} of {len(part)} hold"
        report.fact(f"{part['found'].min():.3g} to {part['found'].max():.3g}", f"{claim} ({held})")
    ratios = robustness(table)
    section.table(
        pd.DataFrame(
            {
                "method": ratios.method,
                "point": ratios.kind.map(TYPES) + ", " + ratios.value.str.removesuffix("_error"),
                "ratio of means": tables.measured(ratios, "ratio", "ratio_error"),
                "of medians": ratios["median"],
                "of 99 % quantiles": ratios["highest"],
                "failures": ratios.failures,
            }
        ).sort_values("point", kind="stable"),
        "Error with 15 % bad poses over the error with none, N = 20.",
    )


def _error_sections(report: Report, table: pd.DataFrame, out: Path, ranges: str) -> None:
    tracker = Tracker()
    said = {
        "uniform": "The noise model that the weighted methods know is the true one. ",
        "normal": "The noise model is the true one, and the bound holds for every unbiased estimator. ",
        "5 % bad": f"Bad poses are off by {SHIFT[0]:g}–{SHIFT[1]:g} cm; no method is told of them. ",
        "15 % bad": f"Bad poses are off by {SHIFT[0]:g}–{SHIFT[1]:g} cm; no method is told of them. ",
        "tracker": f"Orientation errors of {np.rad2deg(tracker.angle):.2g}° (1 σ) turn a target on an arm of "
        f"{tracker.arm[2]:g} cm, and so move the position; the weighted methods know it. ",
    }
    for case, words in CASES.items():
        section = report.section(words[0].upper() + words[1:])
        name, title = f"errors-{case.replace(' % ', '-')}", f"Error under {words}"
        bad = case.endswith("bad")
        figure = (figures.errors if bad else figures.over_bound)(table, case, title)
        bars = "Bars are 95 % Monte-Carlo intervals. "
        if not bad:
            bars += "Type I: the bound takes the direction as a unit vector, which no method here does; where it does "
            bars += "not, the bound is " + _free_direction(table, case) + " times as large for a. "
        caption = f"{said[case]}{bars}Ranges: {ranges}."
        section.drawn(figure, out, name, caption, f"Dot chart: {title}, by method and number of poses.")
        section.table(
            tables.mean_errors(table, case), f"Mean error over {ERR} cm, ± 1 Monte-Carlo standard error; [failures]."
        )


def _free_direction(table: pd.DataFrame, case: str) -> str:
    rows = table[(table.case == case) & (table.kind == "direction") & (table.method == GLS)]
    rms = rows.pivot(index="n_poses", columns="value", values="rms")
    ratio = rms["base_linear_bound"] / rms["base_bound"]
    return f"{ratio.min():.2f}–{ratio.max():.2f}"


def _nominal_section(report: Report, table: pd.DataFrame, out: Path, ranges: str) -> None:
    section = report.section(
        "Nominals: too few poses, wrong priors, and one joint that moved",
        f"Right nominals are normal about the truth, {TOLERANCE:g} cm a coordinate, as the prior says; wrong ones are "
        f"off by {5 * TOLERANCE:g} cm in a random direction. Two poses do not determine the unknowns: whatever is "
        "shown there the nominal has decided.",
    )
    caption = (
        "Without a nominal there is no estimate from N = 2; in a box there is one in few sets (table 8). The nominals "
        f"themselves are off by {TOLERANCE * np.sqrt(8 / np.pi) / ERR:.0f} (right) and {5 * TOLERANCE / ERR:.0f} "
        f"(wrong) times the input error. Bars are 95 % Monte-Carlo intervals. Ranges: {ranges}."
    )
    figure = figures.nominals(table, (GLS, GROUP_HUBER), (PRIOR, BOX, HUBER_BOX, LASSO))
    section.drawn(figure, out, "nominals", caption, "Dot chart: error by method with right and wrong nominals.")
    for case, words in (
        ("two poses", "Two poses, right nominals"),
        ("wrong nominal", "Nominals off by five tolerances"),
        ("one joint moved", "The platform point is off by five tolerances, the base point is where the nominal says"),
    ):
        section.table(
            tables.mean_errors(table, case).dropna(axis="columns", how="all"), f"{words}: mean error over {ERR} cm."
        )


def _coverage_section(report: Report, table: pd.DataFrame, many: pd.DataFrame, out: Path, ranges: str) -> None:
    section = report.section(
        "What the standard errors are worth",
        "An interval is an estimate ± 1.96 of its standard errors. Chebyshev and the lasso state none.",
    )
    cases = {"uniform": "uniform errors", "tracker": "a tracker's errors", "15 % bad": "15 % bad poses"}
    figure = figures.coverage_over_cases(table, cases)
    caption = f"Pooled over both locks, points and coordinates. Bars are 95 % Monte-Carlo intervals. Ranges: {ranges}."
    section.drawn(figure, out, "coverage", caption, "Dot chart: coverage by method in three cases.")
    covered, near = coverage(many), efficiency(many)
    figure = figures.trial_coverage(covered)
    caption = f"Normal errors, {int(covered.sets.min())} sets a dot; grey: 95 ± 1. Ranges: {ranges}."
    section.drawn(figure, out, "trials", caption, "Dot chart: coverage of three least-squares estimators against N.")
    section.table(
        pd.DataFrame(
            {
                "method": covered.method,
                "type": covered.kind.map(TYPES),
                "N": covered.n_poses,
                "all coordinates": tables.measured(covered, "pooled", "pooled_error"),
                "worst coordinate": tables.measured(covered, "worst", "worst_error"),
                "joint region": tables.measured(covered, "joint", "joint_error"),
                "sets": covered.sets,
                "failures": covered.failures,
            }
        ),
        "Coverage of 95 % intervals, and of the joint 95 % region of the points, under normal errors.",
        units={"all coordinates": "%", "worst coordinate": "%", "joint region": "%"},
    )
    near = near[near.method.isin([PAPER, GLS])]
    near = near.assign(cell=tables.measured(near, "ratio", "ratio_error"))
    near["point"] = near["kind"].map(TYPES) + ", " + near["point"]
    near["against"] = near["against"].map({"bound": "bound", "linear_bound": "bound, n free"})
    wide = near.pivot(index=["point", "method", "against"], columns="n_poses", values="cell").reset_index()
    wide = wide[wide.point.str.startswith("Type I,") | (wide.against == "bound")]
    wide.columns = [f"N = {name}" if isinstance(name, int) else str(name) for name in wide.columns]
    section.table(wide, "RMS error over the Cramér–Rao bound, normal errors; of Type I also where ‖n‖ = 1 is not used.")


def _bias_section(report: Report, table: pd.DataFrame) -> None:
    section = report.section(
        "Bias",
        "The length of the mean signed error over the input error, N = 20; in brackets its Monte-Carlo error, the root "
        "of the summed squares of the three coordinates' standard errors.",
    )
    section.table(tables.bias(table, ("uniform", "tracker", "15 % bad")), "Bias over input error.")


def _failure_section(report: Report, out: Path) -> None:
    failed, total = tables.failures(out)
    section = report.section(
        "Failures",
        "An estimate whose status is not OPTIMAL has no values, and enters no mean. Two poses do not determine "
        "the unknowns: without a prior that is RANK_DEFICIENT, as it should be.",
    )
    if failed.empty:
        section.text(f"There were none in {total} estimates.")
        return
    caption = f"Failures by status: {int(failed.estimates.sum())} of {total} estimates."
    section.table(failed, caption, formats={"share": ".2%"})


def _cost_section(report: Report, out: Path) -> None:
    measured = tables.cost(out)
    if measured is None:
        return
    section = report.section(
        "Cost",
        "Time per set in batches, covariance included, on one thread of the machine that made this page; measured "
        "after the sweep, and no part of its rows.",
    )
    section.table(measured, "Microseconds a set, median of three batches.")
