"""Runs the study of the choice of poses: ``python -m studies poses``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

import hexopt as hx
from studies.harness import Study
from studies.harness.cli import main as run_study
from studies.poses.data import Case, judged, predicted
from studies.poses.designs import RANDOM, designs_for, random_sets
from studies.poses.nominals import nominals, sequential
from studies.poses.scenarios import SCENARIOS, Scenario

__all__ = ["STUDY", "main", "run"]

_Run = Callable[[Scenario, int, np.random.Generator], pd.DataFrame]


def compared(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Every design, and `n_sets` random sets of the same candidates: a row a set and estimator."""
    case, n = Case.of(scenario, rng), scenario.n_poses
    frames = _rows(RANDOM, case, case.poses(random_sets(case, n, n_sets, rng)), scenario.random_draws, rng)
    for name, design in designs_for(scenario).items():
        frames += _rows(name, case, design(case, n, rng), scenario.draws, rng)
    return pd.concat(frames, ignore_index=True)


def _rows(
    design: str, case: Case, exact: hx.LegMeasurements, draws: int, rng: np.random.Generator
) -> list[pd.DataFrame]:
    if not exact.batch_shape:
        assert exact.length is not None
        exact = exact.moved_to(exact.position[None], exact.rotation[None], exact.length[None])
    promised, frames = predicted(case, exact), []
    for name, columns in judged(case, exact, draws, rng).items():
        place = {"design": design, "estimator": name, "repetition": np.arange(exact.batch_shape[0])}
        frames.append(pd.DataFrame({**place, **promised, **columns}))
    return frames


def run(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """One scenario: a row a set of poses and estimator; with wrong nominals, a row a nominal and design."""
    runs: dict[str, _Run] = {"nominal": nominals, "sequential": sequential}
    return runs.get(scenario.experiment, compared)(scenario, n_sets, rng)


STUDY = Study(name="poses", run=run, scenarios=SCENARIOS, sets=100, chunk_size=100, seed=2026)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, then the real measurements if there are some, and write the report."""
    from studies.poses.real import measure
    from studies.poses.report import is_whole, write

    def report(out: Path) -> Path | None:
        if is_whole(out):
            measure(out)
        return write(out)

    return run_study(STUDY, argv, report)
