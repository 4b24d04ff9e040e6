"""The report of the choice of poses, from the rows alone."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

from studies.baselines.tables import claimed
from studies.harness import read_manifest
from studies.harness.figures import use_style
from studies.harness.html import Report, provenance
from studies.poses import figures, tables
from studies.poses.claims import LETTER, WANTED, claims
from studies.poses.data import BEST, PAPER
from studies.poses.designs import A
from studies.poses.real import FOLDER, NOISE, N
from studies.poses.scenarios import SCENARIOS, SETTINGS, ranges_of
from studies.poses.summaries import against_random, efficiencies, knees, promises, real, rows_of

__all__ = ["is_whole", "write"]

_UNITS = {"hand": "cm", "rubin": "µm"}


def write(out: Path) -> Path | None:
    """Figures into ``out/figures`` and the page ``out/report.html``, from the rows in `out`.

    None, and a line on stderr, where `out` holds only some of the scenarios (``--only``).
    """
    if not is_whole(out):
        lacking = f"{out} lacks some of the {len(SCENARIOS)} scenarios; run without --only"
        print(f"no report: {lacking}", file=sys.stderr)
        return None
    use_style()
    rows = rows_of(out)
    table, measured = against_random(rows), real(out)
    report = Report(
        "Which poses?",
        (
            "Poses are chosen from the same candidates at random, by condition numbers, by observability indices, and "
            "by the criteria A, D and E. What counts is the error of the estimates that they lead to, over noisy "
            "copies of every set, against that of the median random set.",
            f"{ranges_of('hand')}. Uniform errors of ± 0.01 cm and ± 0.01°.",
        ),
    )
    for (setting, block), least in WANTED.items():
        own = table[(table.experiment == "legs") & (table.robot == "hand") & (table.setting == setting)]
        own = own[(own.block == block) & (own.design == A) & (own.estimator == BEST)]
        label = (
            f"{SETTINGS[setting].split(' (')[0]}, {LETTER[block]}, N = 7: random over A, six legs (wanted: {least:g})"
        )
        report.fact(f"{own.gain.min():.2f}–{own.gain.max():.2f}", label)
    section = report.section("The claims, measured")
    section.table(claimed(claims(rows, measured)), "Claims, with Monte-Carlo errors of one standard deviation.")
    _legs_sections(report, table, out)
    _counts_section(report, table, rows, out)
    _units_section(report, table, out)
    _nominal_section(report, rows, out)
    _promise_section(report, rows, out)
    _real_section(report, measured, out)
    return report.write(out / "report.html", provenance(out))


def is_whole(out: Path) -> bool:
    """Whether `out` holds all scenarios."""
    return len(read_manifest(out)["scenarios"]) == len(SCENARIOS)


def _legs_sections(report: Report, table: pd.DataFrame, out: Path) -> None:
    for robot, words in (("hand", "Six legs of the Left Hand"), ("rubin", "Six legs of Rubin's camera hexapod")):
        section = report.section(
            words,
            "N = 7 under a lock, 10 without. O1 chooses as D does and O3 as E; without a nuisance "
            "(unlocked) O2 chooses as κ.",
        )
        if robot == "rubin":
            section.text(
                "This platform tilts by 0.36° and its legs by 1.5°: whatever the poses, errors are 100 to 10 000 times "
                "those of the readings. How designs compare is meaningful all the same."
            )
        figure = figures.legs(table, robot, words)
        caption = f"Right of the line: better than the median random set. {ranges_of(robot)}."
        section.drawn(figure, out, f"legs-{robot}", caption, f"Dot chart: {words}, gain over random sets by design.")
        said = {BEST: "maximum likelihood (I, unlocked) or weighted least squares (II, III)"}
        said[PAPER] = "the paper's estimator, and unlocked unweighted least squares on leg length"
        for estimator, name in said.items():
            caption = f"Median random error over that of the design, least and largest of six legs; {name}."
            section.table(tables.by_leg(table, robot, estimator), caption)
        section.table(
            tables.random_errors(table, _UNITS[robot], robot),
            f"RMS error of the median random set. {ranges_of(robot)}.",
        )


def _counts_section(report: Report, table: pd.DataFrame, rows: pd.DataFrame, out: Path) -> None:
    section = report.section(
        "How many poses?",
        "Leg 3. Where poses are random, errors fall fast until the poses are spread over what the parameters need, and "
        "from that knee on as 1/√N, as if they were repeated. Chosen poses are spread from the start.",
    )
    for robot, words in (("hand", "Left Hand, leg 3"), ("rubin", "Rubin, leg 3")):
        figure = figures.counts(table, rows, robot, f"Error against the number of poses: {words}", _UNITS[robot])
        caption = f"Predicted for unbiased estimates, and for A also found. {ranges_of(robot)}."
        section.drawn(figure, out, f"counts-{robot}", caption, f"Line chart: error against N, {words}.")
    section.table(
        tables.counts(knees(rows, A)),
        "From the knee on, error × √N is within a tenth of its value at N = 30. The last two columns: the fewest poses "
        "chosen, and how many random ones (of those tried) the median set needs to err as little; –: more than 30.",
    )


def _units_section(report: Report, table: pd.DataFrame, out: Path) -> None:
    section = report.section(
        "Where the condition number misleads",
        "κ says nothing of the size of errors, and it changes with the scaling of columns. The direct rows are taken "
        "as they are: without weights, columns in their own units, lengths in m, cm or µm. The same poses and errors "
        "then lead to other designs by κ, and to the same by A. “Weighted and scaled” has the rows whitened and every "
        "parameter in units of its expected spread.",
    )
    figure = figures.units(table)
    caption = f"Right of the line: worse than the median random set. {ranges_of('hand')}. {ranges_of('rubin')}."
    section.drawn(figure, out, "units", caption, "Dot chart: error over the median random one, by design.")
    section.table(
        tables.units(table),
        "Error over that of the median random set, best estimator: mean of six legs, and in brackets the worst.",
    )


def _nominal_section(report: Report, rows: pd.DataFrame, out: Path) -> None:
    section = report.section(
        "A wrong nominal",
        "The nominal's a and b are off in every coordinate, with random signs. The design is made there, and judged at "
        "the truth, against the A-optimal design at the truth (of which exchanges find the best to a per cent or two).",
    )
    lost = efficiencies(rows, "nominal")
    caption = f"{ranges_of('hand')}."
    section.drawn(
        figures.nominal(lost), out, "nominal", caption, "Line chart: A-efficiency lost against the nominal's error."
    )
    section.table(tables.nominal(lost), "A-efficiency lost, per cent: mean ± its error, and in brackets the most.")
    section.text(
        "Poses one by one: the fewest at the nominal, then measure, estimate again, and choose the next. Against it "
        "all poses at once at the nominal."
    )
    section.table(tables.sequential(efficiencies(rows, "sequential")), "N = 7: efficiency at the truth, and errors.")


def _promise_section(report: Report, rows: pd.DataFrame, out: Path) -> None:
    section = report.section(
        "Are promises kept?",
        "The predicted error is the Cramér–Rao bound at the chosen poses; the real one that of 500 noisy copies.",
    )
    table = promises(rows)
    caption = f"{len(table)} points of all designs of all experiments. {ranges_of('hand')}. {ranges_of('rubin')}."
    section.drawn(figures.promised(table), out, "promised", caption, "Histogram: real over predicted error.")


def _real_section(report: Report, measured: pd.DataFrame | None, out: Path) -> None:
    section = report.section("Real measurements")
    if measured is None:
        section.note(f"Not run: {FOLDER} does not name a folder with real measurements.")
        return
    section.text(
        f"{N} of the 108 measured poses of Jugglebot, a cable-driven hexapod without locks, are chosen for all legs at "
        "once, or for every leg by itself, at its design geometry. Every leg is fitted to them (a, b, offset, gain; "
        "least squares on its length), and predicts its lengths in the other 96 poses. G is the worst predicted length "
        "over all 108 poses. Assumed for the design are normal errors of "
        f"{NOISE.position:g} mm, {1e3 * NOISE.angle:g} mrad and 0.2 mm; residuals play no part."
    )
    caption = "RMS over six legs and 96 poses; a fit that fails would count as infinitely bad."
    section.drawn(figures.real(measured), out, "real", caption, "Histogram: prediction errors of twelves of poses.")
