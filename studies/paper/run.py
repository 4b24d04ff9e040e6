"""Runs the paper's Monte-Carlo: ``python -m studies paper``."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

import hexopt as hx
from studies.harness import Study
from studies.harness.cli import main as run_study
from studies.paper.published import B_PRINTED
from studies.paper.scenarios import N1, SCENARIOS, Scenario

PAPER, DIRECT = "consecutive (paper)", "direct"
FORMS = {PAPER: "consecutive", DIRECT: "direct"}
SOLVER = hx.LeastSquares(covariance=False)

COLUMNS = ("base_error", "platform_error", "offset_error", "condition", "status")
Columns = dict[str, npt.NDArray[Any]]


def run(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """All methods on the same random sets of one scenario: one row a set and method."""
    robot = hx.robots.left_hand()
    parts = dict(_METHODS[scenario.kind](scenario, robot, n_sets, rng))
    nothing = np.full(n_sets, np.nan)
    columns = {name: np.concatenate([part.get(name, nothing) for part in parts.values()]) for name in COLUMNS}
    return pd.DataFrame(
        {
            "method": pd.Categorical(np.repeat(list(parts), n_sets), categories=list(parts)),
            "repetition": np.tile(np.arange(n_sets), len(parts)),
            **columns,
            "ok": columns["status"] == hx.Status.OPTIMAL,
        }
    )


def _simulated(
    scenario: Scenario, robot: hx.Hexapod, lock: str, n_poses: int, n_sets: int, rng: np.random.Generator
) -> hx.LegMeasurements:
    return hx.simulate_leg(
        robot, scenario.leg, lock, n_poses, n_sets, noise=scenario.noise(), ranges=scenario.ranges, rng=rng
    )


def _columns(*found: hx.Estimate, leg: hx.Leg) -> Columns:
    columns: Columns = {}
    for estimate in found:
        columns |= {f"{name.removesuffix('_point')}_error": error for name, error in estimate.error(leg).items()}
    status = np.max([estimate.codes for estimate in found], axis=0)  # OPTIMAL is the smallest
    return {**columns, "condition": found[-1].condition, "status": status}


def _one_set(
    scenario: Scenario, robot: hx.Hexapod, n_sets: int, rng: np.random.Generator
) -> Iterator[tuple[str, Columns]]:
    """Section 4: a and b from a DIRECTION set (method 3.2), or b from a LEG set (method 3.3)."""
    equation = hx.loops.FixedDirection if scenario.kind == "direction" else hx.loops.FixedLeg
    loop = equation(_simulated(scenario, robot, scenario.kind, scenario.n_poses, n_sets, rng))
    for method, form in FORMS.items():
        yield method, _columns(hx.estimate(loop.linear(form), SOLVER), leg=robot.leg(scenario.leg))


def _type_three(
    scenario: Scenario, robot: hx.Hexapod, n_sets: int, rng: np.random.Generator
) -> Iterator[tuple[str, Columns]]:
    """Section 4, method 3.3: a from a LENGTH set, with the b of a LEG set of N1 poses of its own."""
    leg = robot.leg(scenario.leg)
    first = hx.loops.FixedLeg(_simulated(scenario, robot, "leg", N1, n_sets, rng))
    data = _simulated(scenario, robot, "length", scenario.n_poses, n_sets, rng)
    for method, form in FORMS.items():
        b = hx.estimate(first.linear(form), SOLVER)
        a = hx.estimate(hx.loops.FixedLength(data, platform_point=b).linear(form), SOLVER)
        yield method, _columns(b, a, leg=leg)
    if scenario.level in B_PRINTED and scenario.leg == 3:
        loop = hx.loops.FixedLength(data, platform_point=B_PRINTED[scenario.level])
        yield "consecutive, b as printed", _columns(hx.estimate(loop.linear("consecutive"), SOLVER), leg=leg)


def _three_step(
    scenario: Scenario, robot: hx.Hexapod, n_sets: int, rng: np.random.Generator
) -> Iterator[tuple[str, Columns]]:
    """All three steps on one leg: b, a and the offset."""
    sets = {
        hx.Lock(lock): _simulated(scenario, robot, lock, scenario.n_poses, n_sets, rng) for lock in ("leg", "length")
    }
    for method, form in FORMS.items():
        result = hx.ThreeStep(form).calibrate_leg(sets, SOLVER)
        yield method, _columns(*result.steps.values(), leg=robot.leg(scenario.leg))


def _offset(
    scenario: Scenario, robot: hx.Hexapod, n_sets: int, rng: np.random.Generator
) -> Iterator[tuple[str, Columns]]:
    """Equation (19): as the paper tests it, and at the end of the three steps."""
    leg = robot.leg(scenario.leg)
    pose = _simulated(scenario, robot, "none", 1, n_sets, rng)
    shape = (n_sets, 3)
    points = {
        "platform_point": leg.platform_point + rng.uniform(-scenario.level, scenario.level, shape),
        "base_point": leg.base_point + rng.uniform(-scenario.level, scenario.level, shape),
    }
    loop = hx.loops.LegLength(pose, unknown=("offset",), **points)
    yield "one pose, err on b and a (paper)", _columns(hx.estimate(loop.linear(), SOLVER), leg=leg)

    sets = {hx.Lock(lock): _simulated(scenario, robot, lock, N1, n_sets, rng) for lock in ("leg", "length")}
    steps = hx.ThreeStep().calibrate_leg(sets, SOLVER).steps
    known = {name: steps[name] for name in ("platform_point", "base_point")}
    one = hx.loops.LegLength(sets[hx.Lock.LENGTH].poses(0), unknown=("offset",), **known)
    yield f"three steps ({N1}, {N1}), one pose", _columns(*known.values(), hx.estimate(one.linear(), SOLVER), leg=leg)
    yield f"three steps ({N1}, {N1}), all LENGTH poses", _columns(*steps.values(), leg=leg)


_METHODS = {
    "direction": _one_set,
    "leg": _one_set,
    "length": _type_three,
    "three-step": _three_step,
    "offset": _offset,
}

STUDY = Study(name="paper", run=run, scenarios=SCENARIOS, sets=1000, chunk_size=1000, seed=1998)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study and write its report."""
    from studies.paper.report import write

    return run_study(STUDY, argv, write)
