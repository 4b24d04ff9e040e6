"""What the rows say: errors against the bound, gains, coverage, each with its Monte-Carlo error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import hexopt as hx
from studies.baselines.data import AXES, BLOCKS, POINTS
from studies.baselines.scenarios import SCENARIOS, Array
from studies.harness import iter_chunks

__all__ = [
    "Rows",
    "bias",
    "covered",
    "each",
    "efficiency",
    "failures",
    "gain",
    "mean_of",
    "rms_ratio",
    "rows_of",
    "shares",
]

_BY_KEY = {scenario.key: scenario for scenario in SCENARIOS}


Rows = dict[str, pd.DataFrame]


def rows_of(out: Path) -> Rows:
    """All rows by experiment, failures included, with their scenarios' settings."""
    parts: dict[str, list[pd.DataFrame]] = {}
    for part in iter_chunks(out):
        scenario = _BY_KEY[part["scenario"].iloc[0]]
        names = ("experiment", "setting", "n_poses", "second", "errors", "level", "off", "cone")
        settings = {name: getattr(scenario, name) for name in names}
        parts.setdefault(scenario.experiment, []).append(part.assign(**settings))
    return {experiment: pd.concat(chunks, ignore_index=True) for experiment, chunks in parts.items()}


def each(table: pd.DataFrame) -> Iterator[Any]:
    """The rows of a table, their cells by attribute."""
    return table.itertuples()


def mean_of(values: Array) -> tuple[float, float]:
    """A mean and its Monte-Carlo error; NaN where there is nothing."""
    if len(values) < 2:
        return float(values.mean()) if len(values) else np.nan, np.nan
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def rms_ratio(above: Array, below: Array) -> tuple[float, float]:
    """Root mean square over root mean square of paired values, and its error by the delta method."""
    if len(above) == 0:
        return np.nan, np.nan
    one, two = np.square(above), np.square(below)
    ratio = float(np.sqrt(one.mean() / two.mean()))
    return ratio, mean_of(one - ratio**2 * two)[1] / float(two.mean()) / (2 * ratio)


def efficiency(rows: pd.DataFrame) -> pd.DataFrame:
    """By noise, setting, N and method: RMS of error over bound, set by set, and the mean of eᵀC⁻¹e/p.

    Set by set, as at minimal numbers of poses few nearly singular sets would decide a ratio of averages.
    """
    found = []
    index = ["level", "errors", "setting", "n_poses", "method"]
    for key, every in rows.groupby(index, sort=False):
        part = every[every.ok]
        settings = dict(zip(index, key, strict=True)) | {"sets": len(every), "failures": len(every) - len(part)}
        size, size_error = mean_of(part["normalised"].to_numpy(float))
        for short in BLOCKS:
            error = part[f"{short}_error"].to_numpy(float)
            if len(part) and np.isnan(error).all():
                continue
            share = error / part[f"{short}_bound"].to_numpy(float)
            ratio, ratio_error = rms_ratio(share, np.ones_like(share))
            rms = float(np.sqrt(np.mean(error**2))) if len(error) else np.nan
            values = {"rms": rms, "ratio": ratio, "ratio_error": ratio_error}
            found.append({**settings, "block": short, **values, "normalised": size, "normalised_error": size_error})
    return pd.DataFrame(found)


def gain(rows: pd.DataFrame, by: Sequence[str], worse: str, better: str, column: str) -> pd.DataFrame:
    """RMS of one method over that of another on the same sets, where both succeeded."""
    found = []
    for key, part in rows.groupby(list(by), sort=False, dropna=False):
        one, two = (
            part[(part.method == name) & part.ok].set_index(["scenario", "repetition"]) for name in (worse, better)
        )
        suffixes = ("_worse", "_better")
        both = one[[column]].merge(two[[column]], left_index=True, right_index=True, suffixes=suffixes).dropna()
        ratio, error = rms_ratio(both[f"{column}_worse"].to_numpy(), both[f"{column}_better"].to_numpy())
        settings = dict(zip(by, key, strict=True))
        found.append({**settings, "column": column, "gain": ratio, "gain_error": error, "sets": len(both)})
    return pd.DataFrame(found)


def covered(rows: pd.DataFrame, by: Sequence[str], column: str) -> pd.DataFrame:
    """Per cent of the coordinates inside their stated 95 % intervals."""
    found = []
    for key, every in rows.groupby([*by, "method"], sort=False):
        part = every[every.ok]
        share, error = mean_of(100 * part[column].dropna().to_numpy(float))
        settings = dict(zip([*by, "method"], key, strict=True))
        found.append(
            {
                **settings,
                "covered": share,
                "covered_error": error,
                "sets": len(part),
                "failures": len(every) - len(part),
            }
        )
    return pd.DataFrame(found)


def bias(rows: pd.DataFrame, by: Sequence[str]) -> pd.DataFrame:
    """Length of the mean signed error of each point, and the length of its Monte-Carlo error."""
    found = []
    for key, every in rows.groupby([*by, "method"], sort=False):
        part = every[every.ok]
        for short in POINTS:
            signed = part[[f"{short}_{axis}" for axis in AXES]].to_numpy(float)
            if len(part) < 2 or np.isnan(signed).all():
                continue
            error = signed.std(axis=0, ddof=1) / np.sqrt(len(signed))
            settings = dict(zip([*by, "method"], key, strict=True))
            length = {"bias": np.linalg.norm(signed.mean(axis=0)), "bias_error": np.linalg.norm(error)}
            found.append({**settings, "block": short, **length, "sets": len(part)})
    return pd.DataFrame(found)


def shares(rows: pd.DataFrame) -> pd.DataFrame:
    """Of bad starts: the share that finds the truth, that ends elsewhere, and that fails."""
    found = []
    for (setting, off, method), part in rows.groupby(["setting", "off", "method"], sort=False):
        reached, error = mean_of(part["reached"].to_numpy(float))
        elsewhere = float((part["ok"] & (part["reached"] == 0)).mean())
        share = {"reached": reached, "reached_error": error, "elsewhere": elsewhere, "failed": float((~part.ok).mean())}
        found.append({"setting": setting, "off": off, "method": method, **share, "sets": len(part)})
    return pd.DataFrame(found)


def failures(rows: pd.DataFrame) -> pd.DataFrame:
    """Estimates that are no success, by experiment, method and status."""
    index = ["experiment", "setting", "method"]
    total = rows.groupby(index, sort=False).size()
    lost = rows[~rows.ok].groupby([*index, "status"], sort=False).size().rename("estimates").reset_index()
    lost["share"] = lost["estimates"] / total.loc[pd.MultiIndex.from_frame(lost[index])].to_numpy() if len(lost) else []
    lost["status"] = [hx.Status(status).name for status in lost["status"]]
    return lost
