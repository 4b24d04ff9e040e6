"""Statistics of the rows: how designs compare with random sets, and what wrong nominals cost."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from studies.baselines.summaries import each, mean_of
from studies.harness import load
from studies.poses.data import BLOCKS
from studies.poses.designs import RANDOM
from studies.poses.real import FILE
from studies.poses.scenarios import SCENARIOS, Array

__all__ = ["SETTLED", "against_random", "efficiencies", "knees", "promises", "real", "rows_of"]

#: What rows say of their scenario.
SETTLED = ("experiment", "setting", "robot", "leg", "n_poses", "off")
#: Beyond the knee errors fall as 1/√N: to within this share.
KNEE = 1.1


def rows_of(out: Path) -> pd.DataFrame:
    """All rows, with the settings of their scenarios."""
    settings = pd.DataFrame([{"scenario": s.key} | {name: getattr(s, name) for name in SETTLED} for s in SCENARIOS])
    return load(out).merge(settings, on="scenario", validate="many_to_one")


def against_random(rows: pd.DataFrame) -> pd.DataFrame:
    """For every scenario, estimator, design and block: its error, the median random one, and their ratio with error.

    `gain` is the median over the design's, `promised` the same of predicted errors, `better` the share of random sets
    with a smaller error.
    """
    found = []
    rows = rows[rows.estimator.notna()] if "estimator" in rows else rows.iloc[:0]
    for _, part in rows.groupby(["scenario", "estimator"], sort=False):
        drawn = part[part.design == RANDOM]
        settings = {name: part[name].iloc[0] for name in ("scenario", *SETTLED, "estimator")}
        for short in BLOCKS:
            if f"{short}_rms" not in part or drawn[f"{short}_rms"].isna().all():
                continue
            values = drawn[f"{short}_rms"].dropna().to_numpy()
            usual, unsure = median_of(values)
            promised = float(np.median(drawn[f"{short}_predicted"]))
            for row in each(part[part.design != RANDOM]):
                rms, predicted = getattr(row, f"{short}_rms"), getattr(row, f"{short}_predicted")
                own = getattr(row, f"{short}_rms_error") / rms
                found.append(
                    settings
                    | {
                        "design": row.design, "block": short, "rms": rms, "predicted": predicted, "usual": usual,
                        "gain": usual / rms, "gain_error": usual / rms * np.hypot(own, unsure),
                        "promised": promised / predicted, "better": (values < rms).mean(), "failed": row.failed,
                    }
                )  # fmt: skip
    return pd.DataFrame(found)


def median_of(values: Array) -> tuple[float, float]:
    """The median and its relative error, by the order statistics half a standard deviation of their rank away."""
    half = 0.5 / np.sqrt(len(values))
    low, middle, high = np.quantile(values, [max(0.0, 0.5 - half), 0.5, min(1.0, 0.5 + half)])
    return float(middle), float((high - low) / 2 / middle)


def promises(rows: pd.DataFrame) -> pd.DataFrame:
    """Real over predicted error of every design and block, of the best estimator."""
    found = []
    part = rows[(rows.estimator == "best") & (rows.design != RANDOM)]
    for short in BLOCKS:
        if f"{short}_rms" in part:
            here = part[part[f"{short}_rms"].notna()]
            ratio = here[f"{short}_rms"] / here[f"{short}_predicted"]
            error = here[f"{short}_rms_error"] / here[f"{short}_predicted"]
            found.append(here[["scenario", *SETTLED, "design"]].assign(block=short, ratio=ratio, error=error))
    return pd.concat(found, ignore_index=True)


def knees(rows: pd.DataFrame, design: str) -> pd.DataFrame:
    """The knees of the median random set and of a design, and what it takes at random to err as the fewest chosen do.

    From the knee on a predicted error, times √N, is at most a tenth above the last one.
    """
    found = []
    part = rows[(rows.experiment == "counts") & (rows.estimator == "best")]
    for (robot, setting), some in part.groupby(["robot", "setting"], sort=False):
        for short in BLOCKS:
            if some[f"{short}_predicted"].isna().all():
                continue
            drawn, own = (
                some[some.design == name].groupby("n_poses")[f"{short}_predicted"].median() for name in (RANDOM, design)
            )
            enough = drawn.index[drawn <= own.iloc[0]]
            row = {"robot": robot, "setting": setting, "block": short, "random": _knee(drawn), "chosen": _knee(own)}
            found.append(row | {"fewest": own.index[0], "as good": enough[0] if len(enough) else np.nan})
    return pd.DataFrame(found)


def _knee(curve: pd.Series) -> int:
    level = curve.to_numpy() * np.sqrt(curve.index.to_numpy())
    above = np.flatnonzero(level > KNEE * level[-1])
    return int(curve.index[above[-1] + 1 if len(above) else 0])


def efficiencies(rows: pd.DataFrame, experiment: str) -> pd.DataFrame:
    """A-efficiency at the truth: mean, its error and the smallest; and root-mean-square errors where there are some."""
    found = []
    part = rows[rows.experiment == experiment]
    for (setting, off, design), some in part.groupby(["setting", "off", "design"], sort=False):
        mean, error = mean_of(some.efficiency.to_numpy(float))
        row = {"setting": setting, "off": off, "design": design, "mean": mean, "error": error}
        row |= {"least": some.efficiency.min(), "sets": len(some)}
        for short in BLOCKS:
            if f"{short}_error" in some and some[f"{short}_error"].notna().any():
                row[f"{short}_rms"] = float(np.sqrt((some[f"{short}_error"] ** 2).mean()))
        found.append(row)
    return pd.DataFrame(found)


def real(out: Path) -> pd.DataFrame | None:
    """Prediction errors of twelves of measured poses; None where there were no measurements."""
    path = out / FILE
    return pd.read_csv(path) if path.exists() else None
