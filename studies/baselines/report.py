"""The report of the baselines, from the rows alone."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

import hexopt as hx
from studies.baselines import figures, summaries, tables
from studies.baselines.claims import claims
from studies.baselines.methods import FK, IK, INNOCENTI
from studies.baselines.scenarios import ERR, NOISES, OFF, SCENARIOS
from studies.baselines.summaries import Rows
from studies.harness import read_manifest
from studies.harness.figures import use_style
from studies.harness.html import Report, provenance

__all__ = ["is_whole", "write"]


def write(out: Path) -> Path | None:
    """Figures into ``out/figures`` and the page ``out/report.html``, from the rows in `out`.

    None, and a line on stderr, where `out` holds only some of the scenarios (``--only``).
    """
    if not is_whole(out):
        lacking = f"{out} lacks some of the {len(SCENARIOS)} scenarios; run without --only"
        print(f"no report: {lacking}", file=sys.stderr)
        return None
    use_style()
    rows = summaries.rows_of(out)
    robot = hx.robots.left_hand()
    ranges = robot.ranges.describe(robot.length_unit)
    report = Report(
        "Every baseline, and the bound that none can beat",
        (
            "The second part of the comparison of estimators: every method that the paper names, and maximum "
            "likelihood, on the same readings of the Left Hand's leg 3, against the Cramér–Rao bound (CRLB).",
            f"Ranges of the random poses of one locked leg: {ranges}. Unlocked poses are those that all six legs reach "
            f"within the robot's limits. Input error {ERR} cm and degrees unless said otherwise.",
        ),
    )
    _claims_section(report, rows)
    _error_section(report, rows, out, ranges)
    _basin_section(report, rows, out, ranges)
    _together_section(report, rows, out)
    _innocenti_section(report, rows, out)
    _running_section(report, rows, out, ranges)
    _failure_section(report, rows)
    _cost_section(report, out)
    return report.write(out / "report.html", provenance(out))


def is_whole(out: Path) -> bool:
    """Whether `out` holds every point of the study; of equal scenarios one part is enough."""
    return {scenario.key for scenario in SCENARIOS if not scenario.part} <= set(read_manifest(out)["scenarios"])


def _claims_section(report: Report, every: Rows) -> None:
    found = claims(every)
    held = [claim.holds for claim in found]
    section = report.section(
        "What was claimed, and what was found",
        "Each figure ± 1 Monte-Carlo standard error. Ratios are of root mean squares on the same sets. "
        "A dash: shown for comparison, nothing was claimed.",
    )
    section.table(tables.claimed(found), "The claims, measured.")
    report.fact(f"{held.count('yes')} of {len(held) - held.count('–')}", "claims that hold")


def _error_section(report: Report, every: Rows, out: Path, ranges: str) -> None:
    rows = every["methods"]
    table = summaries.efficiency(rows)
    section = report.section(
        "Error against the bound",
        "Error over the CRLB of one leg's own readings, set by set, as a root mean square; failures are left out (and "
        "counted below). “ML, whole robot” "
        "and weighted FK use the other five legs' readings of the same poses too, so they may pass that bound. Slow "
        "methods are run on the first tenth of the sets.",
    )
    normal = table[(table.errors == "normal")]
    for block, name in (("base", "base point a"), ("platform", "platform point b")):
        figure = figures.efficiency(normal, block, f"Efficiency: {name}, normal errors")
        caption = f"Bars are 95 % Monte-Carlo intervals; dotted: the bound. Ranges: {ranges}."
        alt = (
            f"RMS error of the {name} over the Cramér–Rao bound against the number of poses, a panel for each setting."
        )
        section.drawn(figure, out, f"efficiency-{block}", caption, alt)
    for noise, (_, level) in NOISES.items():
        section.table(
            tables.errors(table, noise),
            f"{noise.capitalize()} errors, {level:g} cm and °: RMS error over err, in brackets its ratio to the CRLB ± "
            "1 Monte-Carlo standard error; [failures/sets].",
        )
    size = normal.drop_duplicates(["setting", "n_poses", "method"])[
        ["setting", "n_poses", "method", "normalised", "normalised_error", "sets", "failures"]
    ]
    section.table(size, "Mean of eᵀC⁻¹e/p, C being the CRLB: 1 for an estimator that reaches it. Normal errors.")
    large = rows[(rows.level == 10 * ERR)]
    section.table(
        tables.biases(summaries.bias(large, ["setting", "n_poses", "level"])),
        f"Bias over err, uniform errors of {10 * ERR:g} cm and °: mean error, length ± Monte-Carlo error.",
    )


def _basin_section(report: Report, every: Rows, out: Path, ranges: str) -> None:
    table = summaries.shares(every["basin"])
    section = report.section(
        "How far off may the nominal be?",
        "Every coordinate of the nominal (and the offset, where it is unknown) is off by the same amount, signs are "
        "random. Measurements are without error, so that nothing but the start decides: it leads to the truth where "
        "the method succeeds, and is off by less than a tenth of what errors of 0.01 cm and ° make unavoidable. "
        "ML needs no guess for two Type I sets, nor does any linear method.",
    )
    caption = f"Bars are 95 % Monte-Carlo intervals. N = 10 (of two Type I sets: 5 each). Ranges: {ranges}."
    section.drawn(figures.basin(table), out, "basin", caption, "Share of good starts against the error of the nominal.")
    section.table(
        tables.convergence(table),
        "Per cent of starts that lead to the truth; in brackets: that end elsewhere with the status of a success.",
    )


def _together_section(report: Report, every: Rows, out: Path) -> None:
    at_home = summaries.covered(every["home"], ["n_poses"], "home_covered")
    rows = every["chain"]
    steps = summaries.covered(rows, ["second"], "base_covered")
    section = report.section(
        "What is said of the error",
        "Left: six legs that are seen in the same poses share their errors. All six readings of 30 unlocked poses, "
        "encoders ten times better than the tracker. The robot goes where its calibrated geometry says home is; is its "
        "true position inside the stated intervals? Right: b of a LEG set is used to find a from a LENGTH set.",
    )
    caption = f"Bars are 95 % Monte-Carlo intervals; grey: 95 ± 1. {at_home.sets.min()} and {steps.sets.min()} sets."
    section.drawn(figures.coverage(at_home, steps), out, "coverage", caption, "Coverage with and without coupling.")


def _innocenti_section(report: Report, every: Rows, out: Path) -> None:
    rows = every["ranges"]
    rows = rows[rows.method == INNOCENTI]
    section = report.section(
        "Innocenti: near 15?",
        "The paper gives a factor near 15 for both points and no ranges. It follows from these: here are angles within "
        "± 35°, length 17–20.3 cm, and three cones of directions. The errors have heavy tails, so that the mean says "
        f"less than the median. Failures are left out: {(~rows.ok).mean():.1%} of {len(rows)} sets.",
    )
    section.drawn(figures.innocenti(rows), out, "innocenti", "Seven poses of one length.", "Error factors by cone.")


def _running_section(report: Report, every: Rows, out: Path, ranges: str) -> None:
    rows = every["running"]
    section = report.section(
        "Estimates that run",
        "After every pose: the error of a, and the error that the filter states (the root of its covariance's trace). "
        "Priors are normal about the truth. A filter that starts from a wide prior is too sure of itself: NEES, the "
        "normalised error, should be as large as the number of unknowns; a status INACCURATE says so.",
    )
    caption = f"Grey: single sets; thick: root mean square. Sets whose status is a success. Ranges: {ranges}."
    section.drawn(figures.running(rows), out, "running", caption, "Running error and predicted error against poses.")
    last = rows[(rows.poses_seen == rows.n_poses) & rows.nees.notna()]
    groups = last.groupby(["setting", "method", "off"], sort=False)
    table = groups.agg(
        nees=("nees", "median"), high=("nees", lambda v: v.quantile(0.95)), failed=("ok", lambda v: 1 - v.mean())
    )
    table.columns = pd.Index(["NEES, median", "NEES, 95 %", "no success"])
    section.table(
        table.reset_index(), "After 20 poses; 6 unknowns of Type I, 7 of unlocked poses.", formats={"no success": ".0%"}
    )


def _failure_section(report: Report, every: Rows) -> None:
    rows = pd.concat([part for experiment, part in every.items() if experiment != "running"], ignore_index=True)
    lost = summaries.failures(rows)
    section = report.section("Failures", "An estimate whose status is not OPTIMAL has no values, and enters no mean.")
    section.text("Starts that are off by up to 5 cm are among them (“basin”).")
    if lost.empty:
        section.text(f"There were none in {len(rows)} estimates.")
        return
    section.table(lost, f"{int(lost.estimates.sum())} of {len(rows)} estimates.", formats={"share": ".2%"})


def _cost_section(report: Report, out: Path) -> None:
    measured = tables.cost(out)
    if measured is None:
        return
    section = report.section(
        "Cost",
        "Time per set in batches, covariance included, on one thread of the machine that made this page; measured "
        "after the sweep, and no part of its rows. Indicative. FK and “ML, whole robot” estimate all six legs, "
        f"the others one. Nominals off by {OFF:g} cm.",
    )
    ratio = (measured.loc[FK] / measured.loc[IK] / 6).dropna()
    section.text(
        "The paper says that forward kinematics is slower and less sure than inverse kinematics. It takes, here, "
        f"{ratio.min():.1f} to {ratio.max():.1f} times as long as IK of six legs; how much less sure it is, the "
        "section on nominals has."
    )
    section.table(measured, "Milliseconds a set, median of three.")
