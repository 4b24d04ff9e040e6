"""Runs the second part of the comparison: ``python -m studies baselines``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from studies.baselines.data import draw, frame, judged
from studies.baselines.methods import answer, methods_for
from studies.baselines.running import running
from studies.baselines.scenarios import LEG, SCENARIOS, Scenario
from studies.baselines.together import chain, home, joint, one_set
from studies.harness import Study
from studies.harness.cli import main as run_study

__all__ = ["STUDY", "main", "run"]

#: An answer so near to the truth, in units of the bound, is the right one.
REACHED = 0.1

_Run = Callable[[Scenario, int, np.random.Generator], pd.DataFrame]


def one_leg(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """All methods of a setting on the same random sets."""
    case, exact = draw(scenario, n_sets, rng)
    bound, leg = exact.bound(), case.truth.leg(LEG)
    frames = []
    for name, method in methods_for(scenario).items():
        found = answer(method, case)
        frames.append(frame(name, found.codes, judged(found, leg, bound[: len(found.codes)])))
    return pd.concat(frames, ignore_index=True)


def basin(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Whether methods find the truth from a nominal that is off, in measurements without error.

    They do where they succeed, and are off by less than `REACHED` of what the assumed noise makes unavoidable.
    """
    _, case = draw(scenario, n_sets, rng)
    bound, leg, frames = case.bound(), case.truth.leg(LEG), []
    for name, method in methods_for(scenario).items():
        found = answer(method, case, each=True)
        columns = judged(found, leg, bound[: len(found.codes)])
        shares = [columns[f"{short}_error"] / columns[f"{short}_bound"] for short in found.values]
        reached = found.ok & (np.max(shares, axis=0) < REACHED)
        frames.append(frame(name, found.codes, columns | {"reached": reached.astype(float)}))
    return pd.concat(frames, ignore_index=True)


_RUNS: dict[str, _Run] = {
    "basin": basin, "joint": joint, "one set": one_set, "home": home, "chain": chain, "running": running
}  # fmt: skip


def run(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """One scenario: a row a set and method, and where estimates run, a row a pose."""
    return _RUNS.get(scenario.experiment, one_leg)(scenario, n_sets, rng)


STUDY = Study(name="baselines", run=run, scenarios=SCENARIOS, sets=400, chunk_size=200, seed=2025)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, time the methods if that is still to do, and write the report."""
    from studies.baselines.cost import measure
    from studies.baselines.report import is_whole, write

    def report(out: Path) -> Path | None:
        if is_whole(out):
            measure(out)
        return write(out)

    return run_study(STUDY, argv, report)
