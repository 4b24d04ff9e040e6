"""Three claims about the estimators, each with its figure and Monte-Carlo error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from studies.estimators.run import AXES, GLS, GROUP_HUBER, METHODS, PAPER, POINTS
from studies.estimators.scenarios import SCENARIOS, Array
from studies.harness import iter_chunks

__all__ = ["claims", "coverage", "efficiency", "robustness", "trials"]

TYPES = {"direction": "Type I", "leg": "Type II"}
#: Of a ratio of errors under bad poses: what GroupHuber is to stay within, and what the paper's is to exceed.
WITHIN, BEYOND = 2.0, 10.0
#: Percentage points about 95 %, and the relative distance from the Cramér–Rao bound.
POINTS_OFF, NEAR_BOUND = 1.0, 0.05

_CASES = {scenario.key: (scenario.case, scenario.kind, scenario.n_poses) for scenario in SCENARIOS}
_FLAGS = [f"{short}_{axis}_covered" for short in POINTS for axis in AXES]


def trials(out: Path) -> pd.DataFrame:
    """The rows of the case "trials" that succeeded, with the settings of their scenarios."""
    values = [f"{short}_{what}" for short in POINTS for what in ("error", "bound", "linear_bound", "covered")]
    columns = ["scenario", "method", "ok", "joint_covered", *values, *_FLAGS]
    parts = [part for part in iter_chunks(out, columns) if _CASES[part["scenario"].iloc[0]][0] == "trials"]
    rows = pd.concat(parts, ignore_index=True)
    rows["kind"] = rows["scenario"].map({key: kind for key, (_, kind, _) in _CASES.items()})
    rows["n_poses"] = rows["scenario"].map({key: n for key, (_, _, n) in _CASES.items()})
    rows["method"] = pd.Categorical(rows["method"], categories=list(METHODS))
    return rows


def coverage(rows: pd.DataFrame) -> pd.DataFrame:
    """Coverage in per cent, by method, kind and N: pooled over coordinates, worst coordinate, joint region."""
    found = []
    for (method, kind, n), all_sets in rows.groupby(["method", "kind", "n_poses"], observed=True):
        part = all_sets[all_sets.ok]
        inside = 100 * part[_FLAGS].dropna(axis="columns", how="all").to_numpy(float)
        single = inside.mean(axis=0)
        worst = float(single[np.abs(single - 95).argmax()])
        pooled, pooled_error = _mean(inside.mean(axis=1))
        joint, joint_error = _mean(100 * part["joint_covered"].to_numpy(float))
        found.append(
            {
                "method": method,
                "kind": kind,
                "n_poses": n,
                "pooled": pooled,
                "pooled_error": pooled_error,
                "worst": worst,
                "worst_error": float(np.sqrt(worst * (100 - worst) / len(part))),
                "joint": joint,
                "joint_error": joint_error,
                "sets": len(part),
                "failures": len(all_sets) - len(part),
            }
        )
    return pd.DataFrame(found)


def _mean(values: Array) -> tuple[float, float]:
    """The mean and its Monte-Carlo error."""
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def efficiency(rows: pd.DataFrame) -> pd.DataFrame:
    """RMS error over the bound on it, with the error of that ratio (delta method, paired sets)."""
    found = []
    for (method, kind, n), all_sets in rows.groupby(["method", "kind", "n_poses"], observed=True):
        part = all_sets[all_sets.ok]
        for short in POINTS:
            square = part[f"{short}_error"].to_numpy(float) ** 2
            if np.isnan(square).all():
                continue
            for bound in ("bound", "linear_bound"):
                limit = part[f"{short}_{bound}"].to_numpy(float) ** 2
                ratio = float(np.sqrt(square.mean() / limit.mean()))
                error = _mean(square - ratio**2 * limit)[1] / float(limit.mean()) / (2 * ratio)
                settings = {"method": method, "kind": kind, "n_poses": n, "point": short, "against": bound}
                found.append({**settings, "ratio": ratio, "ratio_error": error, "sets": len(part)})
    return pd.DataFrame(found)


def robustness(table: pd.DataFrame, n_poses: int = 20) -> pd.DataFrame:
    """Mean error with 15 % bad poses over the same method's with none, of the aggregated `table`."""
    rows = table[(table.n_poses == n_poses) & table.value.str.endswith("_error") & (table["count"] > 0)]
    index = ["method", "kind", "value"]
    clean, bad = (rows[rows.case == case] for case in ("uniform", "15 % bad"))
    both = bad.merge(clean, on=index, suffixes=("_bad", "_clean")).set_index(index)
    ratio = both["mean_bad"] / both["mean_clean"]
    error = ratio * np.hypot(both["sem_bad"] / both["mean_bad"], both["sem_clean"] / both["mean_clean"])
    median = both["q0.5_bad"] / both["q0.5_clean"]
    highest = both["q0.99_bad"] / both["q0.99_clean"]
    failures = both["failures_bad"] + both["failures_clean"]
    return pd.DataFrame(
        {"ratio": ratio, "ratio_error": error, "median": median, "highest": highest, "failures": failures}
    ).reset_index()


def claims(table: pd.DataFrame, rows: pd.DataFrame) -> pd.DataFrame:
    """The three claims as rows: what was to be, what was found ± its Monte-Carlo error, and whether it holds."""
    return pd.concat([_on_robustness(table), _on_coverage(rows), _on_efficiency(rows)], ignore_index=True)


def _on_robustness(table: pd.DataFrame) -> pd.DataFrame:
    found = robustness(table)
    found = found[found.method.isin([GROUP_HUBER, PAPER])].sort_values("method", ascending=False)
    robust = found["method"] == GROUP_HUBER
    return pd.DataFrame(
        {
            "claim": "mean error, 15 % bad poses over none, N = 20: " + found["method"].astype(str),
            "sets": found["kind"].map(TYPES) + ", " + found["value"].str.removesuffix("_error") + " point",
            "wanted": np.where(robust, f"at most {WITHIN:g}", f"at least {BEYOND:g}"),
            "found": found["ratio"],
            "error": found["ratio_error"],
            "holds": np.where(robust, found["ratio"] <= WITHIN, found["ratio"] >= BEYOND),
        }
    )


def _sets(found: pd.DataFrame) -> pd.Series:
    """Which sets each row of a table is of."""
    return found["kind"].map(TYPES) + ", N = " + found["n_poses"].astype(str)


def _on_coverage(rows: pd.DataFrame) -> pd.DataFrame:
    found = coverage(rows)
    found = found[found["method"] == GLS]
    return pd.DataFrame(
        {
            "claim": "95 % intervals of GLS, normal errors: per cent covered",
            "sets": _sets(found),
            "wanted": f"95 ± {POINTS_OFF:g}",
            "found": found["pooled"],
            "error": found["pooled_error"],
            "holds": (found[["pooled", "worst"]] - 95).abs().max(axis="columns") <= POINTS_OFF,
        }
    )


def _on_efficiency(rows: pd.DataFrame) -> pd.DataFrame:
    found = efficiency(rows)
    wanted = (found["method"] == GLS) & (found["kind"] == "leg") & (found["n_poses"] >= 7)
    found = found[wanted & (found["against"] == "bound")]
    return pd.DataFrame(
        {
            "claim": "RMS error of GLS direct over the Cramér–Rao bound",
            "sets": _sets(found),
            "wanted": f"at most {1 + NEAR_BOUND:g}",
            "found": found["ratio"],
            "error": found["ratio_error"],
            "holds": found["ratio"] <= 1 + NEAR_BOUND,
        }
    )
