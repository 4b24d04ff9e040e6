"""The designs that are compared: one entry each."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import hexopt as hx
from studies.poses.data import Case
from studies.poses.raw import METRES, paper_rows, raw_rows, smallest
from studies.poses.scenarios import FEWEST, Array, Scenario

__all__ = [
    "DESIGNS",
    "KAPPA",
    "KAPPA_PAPER",
    "KAPPA_RAW",
    "RANDOM",
    "REFINED",
    "STEPWISE",
    "A",
    "chosen",
    "designs_for",
    "in_unit",
    "next_pose",
    "random_sets",
]

Design = Callable[[Case, int, np.random.Generator], hx.LegMeasurements]
RANDOM, A, REFINED, STEPWISE = "random", "A", "A, refined", "A, one by one"
KAPPA_PAPER, KAPPA_RAW, KAPPA = "κ of the paper's rows", "κ of the direct rows", "κ, weighted and scaled"


def _raw(rows: Any) -> Design:
    return lambda case, n, rng: case.poses(smallest(case, rows, n, rng))


def in_unit(unit: str) -> str:
    """The design by κ of the direct rows in some unit."""
    return f"{KAPPA_RAW}, in {unit.replace('um', 'µm')}"


def chosen(case: Case, n: int, criterion: str) -> hx.Design:
    """By hexopt, at the truth."""
    return hx.select_poses(case.candidates, n, criterion, at=case.leg, spread=case.spread)


def _by(criterion: str) -> Design:
    return lambda case, n, rng: chosen(case, n, criterion).poses


def _refined(case: Case, n: int, rng: np.random.Generator) -> hx.LegMeasurements:
    better = hx.refine_poses(chosen(case, n, "A"), case.robot.geometry, rng=rng)
    poses: hx.LegMeasurements = better.poses
    return poses


def _stepwise(case: Case, n: int, rng: np.random.Generator) -> hx.LegMeasurements:
    """The fewest poses at once, then the best next one: what re-estimating comes to where estimates are exact."""
    index = chosen(case, FEWEST[case.setting], "A").indices
    while len(index) < n:
        index = np.append(index, next_pose(case, index, case.poses(index), case.leg))
    return case.poses(index)


def next_pose(case: Case, index: Array, measured: hx.LegMeasurements, at: Any) -> int:
    """The candidate that A chooses next, after those of some indices have been measured."""
    rest = np.setdiff1d(np.arange(case.pool.n_poses), index)
    known = case.loop(measured)
    found = hx.select_poses(case.loop(case.poses(rest)), 1, "A", measured=known, at=at, spread=case.spread)
    return int(rest[found.indices[0]])


#: Every design. O1 chooses as D does, O3 as E; without a nuisance, O2 as κ.
DESIGNS: dict[str, Design] = {
    KAPPA_PAPER: _raw(paper_rows),
    KAPPA_RAW: _raw(raw_rows),
    **{in_unit(unit): _raw(partial(raw_rows, unit=unit)) for unit in METRES},
    KAPPA: _by("kappa"),
    "O2": _by("O2"),
    "O4": _by("O4"),
    "O5": _by("O5"),
    "E (O3)": _by("E"),
    "D (O1)": _by("D"),
    STEPWISE: _stepwise,
    A: _by("A"),
    REFINED: _refined,
}
#: Of designs of many poses the exchange of `raw` takes long, and on the second robot so do all.
_OF = {
    "counts": {KAPPA, "O2", "O4", "O5", "E (O3)", "D (O1)", STEPWISE, A, REFINED},
    "units": {KAPPA_PAPER, *map(in_unit, METRES), KAPPA, A},
}
_SECOND = {KAPPA_PAPER, KAPPA_RAW, *map(in_unit, METRES), KAPPA, "D (O1)", A}


def designs_for(scenario: Scenario) -> dict[str, Design]:
    """The designs that take part in a scenario."""
    names = set(_OF.get(scenario.experiment, set(DESIGNS) - set(map(in_unit, METRES))))
    if scenario.robot == "rubin":
        names &= _SECOND
    if scenario.setting in ("free", "gain"):
        names -= {KAPPA_PAPER, "O2"}
    return {name: design for name, design in DESIGNS.items() if name in names}


def random_sets(case: Case, n: int, count: int, rng: np.random.Generator) -> Array:
    """Indices (count, n) of sets of different candidates."""
    order = rng.random((count, case.pool.n_poses)).argsort(axis=1)
    return order[:, :n]
