"""What a wrong nominal costs a design, and whether measuring some poses first helps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

import hexopt as hx
from studies.poses.data import BEST, BLOCKS, Case
from studies.poses.designs import chosen, next_pose
from studies.poses.scenarios import FEWEST, Array, Scenario

__all__ = ["AT_ONCE", "AVERAGE", "RUNS", "SEQUENTIAL", "SINGLE", "WORST", "nominals", "sequential"]

SINGLE, AVERAGE, WORST = "A at the nominal", "average of five nominals", "worst of five nominals"
AT_ONCE, SEQUENTIAL = "A at the nominal, at once", "A, re-estimated after every pose"
#: Scenarios beside the nominal, and the share of the sets that such designs are made for.
AROUND, SHARE = 4, 10
#: Nominals from which poses are chosen one by one.
RUNS = 50


def nominals(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Designs at nominals that are off, and at several that may be: their A-efficiency at the truth."""
    case, n = Case.of(scenario, rng), scenario.n_poses
    best, rows = _value(case, chosen(case, n, "A").poses), []
    for i in range(n_sets):
        wrong = _off(case, scenario, rng)
        there = replace(case, leg=wrong)
        settings: dict[str, dict[str, Any]] = {SINGLE: {"at": wrong}}
        if i < max(1, n_sets // SHARE):
            around = [wrong, *(_off(there, scenario, rng) for _ in range(AROUND))]
            settings |= {AVERAGE: {"at": around}, WORST: {"at": around, "worst": True}}
        for name, setting in settings.items():
            design = hx.select_poses(there.candidates, n, "A", spread=case.spread, **setting)
            efficiency = best / _value(case, design.poses)
            rows.append({"design": name, "repetition": i, "efficiency": efficiency})
    return pd.DataFrame(rows)


def _off(case: Case, scenario: Scenario, rng: np.random.Generator) -> hx.Leg:
    """A leg whose coordinates are all off, with random signs."""
    points = {}
    for name in ("base_point", "platform_point"):
        points[name] = case.leg.block(name) + scenario.off * rng.choice([-1.0, 1.0], 3)
    return case.leg.replaced(**points)


def _value(case: Case, poses: hx.LegMeasurements) -> float:
    """The sum of predicted variances, at the truth."""
    covariance: Array = case.loop(poses).crlb(case.leg)
    return float(np.trace(covariance))


def sequential(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Poses chosen at once at a wrong nominal, and one by one at what the poses so far say: efficiency and errors."""
    case, n = Case.of(scenario, rng), scenario.n_poses
    best, rows = _value(case, chosen(case, n, "A").poses), []
    for i in range(n_sets):
        wrong = _off(case, scenario, rng)
        there = replace(case, leg=wrong)
        index = chosen(there, n, "A").indices
        picked = {AT_ONCE: (index, _noisy(case, index, rng))}
        if i < RUNS:
            picked[SEQUENTIAL] = _one_by_one(case, there, n, rng)
        for name, (index, data) in picked.items():
            columns = {"efficiency": best / _value(case, case.poses(index))} | _errors(case, _estimated(case, data))
            rows.append({"design": name, "repetition": i, **columns})
    return pd.DataFrame(rows)


def _one_by_one(case: Case, there: Case, n: int, rng: np.random.Generator) -> tuple[Array, hx.LegMeasurements]:
    """The fewest poses at the nominal; then measure, re-estimate, choose the next."""
    index = chosen(there, FEWEST[case.setting], "A").indices
    data = _noisy(case, index, rng)
    while len(index) < n:
        new = np.array([next_pose(case, index, data, _estimated(case, data))])
        index, data = np.append(index, new), _joined(data, _noisy(case, new, rng))
    return index, data


def _estimated(case: Case, data: hx.LegMeasurements) -> hx.Estimate:
    return hx.estimate(*case.solvers(case.loop(replace(data, nominal=case.start)))[BEST], throw=False)


def _errors(case: Case, found: hx.Estimate) -> dict[str, float]:
    error = found.error(case.leg)
    return {f"{short}_error": float(error[block]) for short, block in BLOCKS.items() if block in error}


def _noisy(case: Case, index: Array, rng: np.random.Generator) -> hx.LegMeasurements:
    exact = case.poses(index)
    assert exact.length is not None
    return exact.moved_to(*case.robot.noise.apply(exact.position, exact.rotation, exact.length, rng))


def _joined(first: hx.LegMeasurements, then: hx.LegMeasurements) -> hx.LegMeasurements:
    assert first.length is not None
    assert then.length is not None
    return first.moved_to(
        np.concatenate([first.position, then.position]),
        np.concatenate([first.rotation, then.rotation]),
        np.concatenate([first.length, then.length]),
    )
