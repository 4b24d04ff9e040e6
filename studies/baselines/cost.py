"""What the methods cost: kept apart from the rows of the sweep, which are the same to the bit each time."""

from __future__ import annotations

import statistics
import time
from pathlib import Path

import numpy as np
import pandas as pd

from studies.baselines.data import draw
from studies.baselines.methods import answer, methods_for
from studies.baselines.scenarios import SCENARIOS
from studies.harness.task import single_threaded

__all__ = ["FILE", "measure"]

FILE = "cost.csv"
N_POSES = (7, 10, 20, 50)
SETS, REPEATS = 100, 3


def measure(out: Path, *, sets: int = SETS, repeats: int = REPEATS) -> Path:
    """Time every method on one thread, on a batch of `sets` (slow ones on fewer), and write ``cost.csv``.

    A file that stands is kept.
    """
    path = out / FILE
    if path.exists():
        return path
    rows = []
    with single_threaded():
        for scenario in SCENARIOS:
            if not scenario.key.startswith("methods, normal") or scenario.n_poses not in N_POSES:
                continue
            case, _ = draw(scenario, sets, np.random.default_rng(0))
            for name, method in methods_for(scenario).items():
                times = []
                for _ in range(repeats):
                    start = time.perf_counter()
                    count = len(answer(method, case).codes)
                    times.append(1e6 * (time.perf_counter() - start) / count)
                settings = {"setting": scenario.setting, "n_poses": scenario.n_poses, "method": name}
                rows.append({**settings, "microseconds": statistics.median(times)})
    pd.DataFrame(rows).to_csv(path, index=False)
    return path
