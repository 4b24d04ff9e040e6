"""What the methods cost: kept apart from the rows of the sweep, which are the same to the bit each time."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

import numpy as np
import pandas as pd

from studies.estimators.run import METHODS, draw, estimated, methods_for
from studies.estimators.scenarios import SCENARIOS
from studies.harness.task import single_threaded

__all__ = ["FILE", "measure"]

FILE = "cost.csv"
CASES = ("uniform", "15 % bad")
N_POSES = (7, 20, 50)
SETS, REPEATS = 100, 3


def measure(out: Path, *, sets: int = SETS, repeats: int = REPEATS) -> Path:
    """Time every method on batches of `sets` on one thread, and write ``cost.csv``; a file that stands is kept."""
    path = out / FILE
    if path.exists():
        return path
    with single_threaded():
        table = pd.DataFrame([row for case in CASES for row in _timed(case, sets, repeats)])
    table.to_csv(path, index=False)
    return path


def _timed(case: str, sets: int, repeats: int) -> list[dict[str, object]]:
    rows: list[dict[str, object]] = []
    for scenario in SCENARIOS:
        if scenario.case != case or scenario.n_poses not in N_POSES:
            continue
        loop, nominal, _, _ = draw(scenario, sets, np.random.default_rng(0))
        for name in methods_for(scenario):
            times = []
            for _ in range(repeats):
                start = time.perf_counter()
                estimated(METHODS[name], loop, nominal)
                times.append((time.perf_counter() - start) / sets)
            settings = {"case": case, "kind": scenario.kind, "n_poses": scenario.n_poses, "method": name}
            rows.append({**settings, "microseconds": 1e6 * statistics.median(times)})
    return rows
