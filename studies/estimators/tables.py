"""Tables of the report: mean errors, bias, failures and cost."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

import hexopt as hx
from studies.estimators.claims import TYPES
from studies.estimators.cost import FILE
from studies.estimators.figures import PANELS
from studies.estimators.run import AXES, METHODS
from studies.estimators.scenarios import ERR, SCENARIOS
from studies.harness import iter_chunks
from studies.harness.tables import with_error

__all__ = ["bias", "cost", "failures", "mean_errors", "measured"]

LETTERS = {"base": "a", "platform": "b"}
_CASE = {scenario.key: scenario.case for scenario in SCENARIOS}


def measured(frame: pd.DataFrame, value: str, error: str) -> list[str]:
    """A column ± the column of its errors."""
    return [with_error(*pair) for pair in zip(frame[value].tolist(), frame[error].tolist(), strict=True)]


def mean_errors(table: pd.DataFrame, case: str) -> pd.DataFrame:
    """Methods by point and number of poses: mean ± standard error in units of err, and how many sets failed."""
    rows = table[(table.case == case) & table.value.str.endswith("_error")]
    columns = {}
    for kind, short, _ in PANELS:
        here = rows[(rows.kind == kind) & (rows.value == f"{short}_error")]
        for n in sorted(set(here.n_poses)):
            part = here.loc[here.n_poses == n, ["method", "mean", "sem", "failures"]]
            part[["mean", "sem"]] /= ERR
            texts = zip(part["mean"].tolist(), measured(part, "mean", "sem"), part["failures"].tolist(), strict=True)
            shown = [("< 0.0001" if mean < 1e-4 else text) + f" [{lost}]" * (lost > 0) for mean, text, lost in texts]
            cells = dict(zip(part["method"].tolist(), shown, strict=True))
            columns[f"{TYPES[kind]}, {LETTERS[short]}", f"N = {n}"] = cells
    names = [name for name in METHODS if any(name in cells for cells in columns.values())]
    frame = pd.DataFrame({head: [cells.get(name) for name in names] for head, cells in columns.items()}, index=names)
    return frame.rename_axis("method")


def bias(table: pd.DataFrame, cases: Sequence[str], n_poses: int = 20) -> pd.DataFrame:
    """Length of the mean signed error in units of err, and in brackets that of its Monte-Carlo error."""
    columns = {}
    for case in cases:
        for kind, short, _ in PANELS:
            part = table[(table.n_poses == n_poses) & (table.case == case) & (table.kind == kind)]
            part = part[part.value.isin([f"{short}_{axis}" for axis in AXES])]
            squares = part[["mean", "sem"]].pow(2).groupby(part["method"]).sum().reindex(list(METHODS))
            sizes = np.sqrt(squares.to_numpy()).tolist()
            cells = ["–" if np.isnan(mean) else f"{mean / ERR:.2g} ({sem / ERR:.2g})" for mean, sem in sizes]
            columns[case, f"{TYPES[kind]}, {LETTERS[short]}"] = cells
    return pd.DataFrame(columns, index=pd.Index(METHODS, name="method"))


def failures(out: Path) -> tuple[pd.DataFrame, int]:
    """Estimates that are no success by case, method and status; and how many estimates there are at all."""
    counts: Counter[tuple[str, str, int]] = Counter()
    for part in iter_chunks(out, ["scenario", "method", "status"]):
        case = _CASE[part["scenario"].iloc[0]]
        for method, status in zip(part["method"].tolist(), part["status"].tolist(), strict=True):
            counts[case, method, status] += 1
    totals: Counter[tuple[str, str]] = Counter()
    for (case, method, _), count in counts.items():
        totals[case, method] += count
    rows = [
        {
            "case": case,
            "method": method,
            "status": hx.Status(status).name,
            "estimates": count,
            "share": count / totals[case, method],
        }
        for (case, method, status), count in counts.items()
        if status != hx.Status.OPTIMAL
    ]
    return pd.DataFrame(rows), counts.total()


def cost(out: Path) -> pd.DataFrame | None:
    """Microseconds a set; None where nothing was timed."""
    path = out / FILE
    if not path.exists():
        return None
    table = pd.read_csv(path)
    table["sets"] = table["case"] + ", " + table["kind"].map(TYPES)
    table["poses"] = "N = " + table["n_poses"].astype(str)
    wide = table.pivot(index="method", columns=["sets", "poses"], values="microseconds")
    return wide.reindex(list(METHODS))
