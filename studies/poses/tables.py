"""Tables of the report."""

from __future__ import annotations

import math

import pandas as pd

from studies.baselines.summaries import each
from studies.harness.tables import with_error
from studies.poses.claims import LETTER, TITLES
from studies.poses.data import BEST
from studies.poses.designs import DESIGNS
from studies.poses.nominals import AT_ONCE, AVERAGE, SEQUENTIAL, SINGLE, WORST
from studies.poses.scenarios import SETTINGS

__all__ = ["by_leg", "counts", "nominal", "random_errors", "sequential", "units"]


def by_leg(table: pd.DataFrame, robot: str, estimator: str) -> pd.DataFrame:
    """Designs by setting and point: the median random error over theirs, least and largest of the six legs."""
    part = table[(table.experiment == "legs") & (table.robot == robot) & (table.estimator == estimator)]
    part = part.assign(point=part.setting.map(SETTINGS) + ", " + part.block.map(LETTER))
    gain = part.groupby(["design", "point"], sort=False).gain
    cells = (gain.min().map("{:.2f}".format) + "–" + gain.max().map("{:.2f}".format)).unstack()
    return cells.reindex([name for name in DESIGNS if name in cells.index])[list(part.point.unique())]


def random_errors(table: pd.DataFrame, unit: str, robot: str) -> pd.DataFrame:
    """The median random error by leg, both estimators."""
    part = table[(table.experiment == "legs") & (table.robot == robot) & (table.design == "A")].copy()
    part["estimator"] = part["estimator"].map({"paper": "plain", BEST: "best"})
    part["of"] = part["setting"].map(SETTINGS) + ", " + part["block"].map(LETTER)
    wide = part.pivot(index=["of", "estimator"], columns="leg", values="usual")
    wide = wide.reindex(pd.MultiIndex.from_frame(part[["of", "estimator"]].drop_duplicates()))
    wide.columns = [f"leg {k} ({unit})" for k in wide.columns]
    return wide


def units(table: pd.DataFrame) -> pd.DataFrame:
    """Error over the median random one: mean of six legs, and the worst."""
    part = table[(table.experiment == "units") & (table.estimator == BEST)]
    part = part.assign(
        worse=1 / part.gain,
        robot=part.robot.map(TITLES),
        point=part.setting.map(SETTINGS) + ", N = " + part.n_poses.astype(str) + ", " + part.block.map(LETTER),
    )
    worse = part.groupby(["robot", "point", "design"], sort=False).worse
    cells = (worse.mean().map("{:.2f}".format) + " (" + worse.max().map("{:.2f}".format) + ")").unstack()
    return cells[[name for name in DESIGNS if name in cells.columns]]


def counts(knees: pd.DataFrame) -> pd.DataFrame:
    """How many poses are enough."""
    return pd.DataFrame(
        {
            "robot": knees.robot.map(TITLES),
            "setting": knees.setting.map(SETTINGS),
            "of": knees.block.map(LETTER),
            "knee, median random set": knees.random,
            "knee, A": knees.chosen,
            "fewest chosen": knees.fewest,
            "as many random": ["–" if math.isnan(n) else f"{n:.0f}" for n in knees["as good"]],
        }
    )


def nominal(table: pd.DataFrame) -> pd.DataFrame:
    """A-efficiency lost at wrong nominals, per cent: mean, and in brackets the most."""
    part = table.copy()
    part["cell"] = [
        f"{with_error(100 - 100 * row.mean, 100 * row.error)} ({100 - 100 * row.least:.1f})" for row in each(part)
    ]
    part["setting"], part["nominal off by"] = part["setting"].map(SETTINGS), [f"{off:g} cm" for off in part["off"]]
    wide = part.pivot(index=["setting", "nominal off by"], columns="design", values="cell")
    wide = wide.reindex(pd.MultiIndex.from_frame(part[["setting", "nominal off by"]].drop_duplicates()))
    return wide[[SINGLE, AVERAGE, WORST]]


def sequential(table: pd.DataFrame) -> pd.DataFrame:
    """Efficiencies and errors of poses chosen at once and one by one."""
    columns = {
        "setting": table.setting.map(SETTINGS),
        "nominal off by (cm)": table.off,
        "design": table.design,
        "A-efficiency (%)": [with_error(100 * row.mean, 100 * row.error) for row in each(table)],
        "least (%)": [f"{100 * least:.1f}" for least in table.least],
        "nominals": table["sets"],
    }
    for short, letter in LETTER.items():
        if f"{short}_rms" in table:
            columns[f"RMS error of {letter} (cm)"] = table[f"{short}_rms"]
    order = {AT_ONCE: 0, SEQUENTIAL: 1}
    return pd.DataFrame(columns).sort_values("design", key=lambda names: names.map(order), kind="stable")
