"""Candidates of one leg, the equation over poses of them, and the errors that estimates from these make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

import hexopt as hx
from studies.poses.scenarios import ROBOTS, Array, Robot, Scenario

__all__ = ["BEST", "BLOCKS", "PAPER", "Case", "judged", "predicted"]

PAPER, BEST = "paper", "best"
#: Estimands by their short names.
BLOCKS = {"base": "base_point", "platform": "platform_point", "offset": "offset", "gain": "gain"}
_LOCKS = {"I": "direction", "II": "leg", "III": "length", "free": "none", "gain": "none"}
_UNKNOWN = ("platform_point", "base_point", "offset")
_Solve = tuple[Any, Any]
#: Instead of zero, in what is divided by.
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Case:
    """A leg and the poses that it could be measured in.

    Attributes
    ----------
    setting : str
    robot : Robot
    leg : Leg
        The truth.
    start : Leg
        What nonlinear estimators start from: every coordinate is off by the robot's tolerance.
    whole : Measurements
        The candidates, with the exact readings of all legs.
    """

    setting: str
    robot: Robot
    leg: hx.Leg
    start: hx.Leg
    whole: hx.Measurements

    @classmethod
    def of(cls, scenario: Scenario, rng: np.random.Generator) -> Case:
        """Candidates at random, on the clamp at home."""
        robot = ROBOTS[scenario.robot]
        geometry, lock = robot.geometry, _LOCKS[scenario.setting]
        pool = hx.candidates(geometry, scenario.leg, lock, scenario.candidates, robot.noise, rng=rng)
        start = geometry.perturbed(robot.tolerance, rng=rng).leg(scenario.leg)
        return cls(scenario.setting, robot, geometry.leg(scenario.leg), start, pool)

    @cached_property
    def pool(self) -> hx.LegMeasurements:
        """The candidates, with the reading of the leg."""
        return self.whole.leg(self.leg.number)

    @cached_property
    def candidates(self) -> Any:
        """The equation over all candidates."""
        return self.loop(self.pool)

    @property
    def spread(self) -> dict[str, float]:
        """What is expected of the parameters."""
        sizes = dict.fromkeys(BLOCKS.values(), self.robot.tolerance) | {"gain": 1e-3 * float(self.leg.gain)}
        return {name: size for name, size in sizes.items() if name in self.candidates.parameters}

    def loop(self, data: hx.LegMeasurements) -> Any:
        """The equation over some poses."""
        if self.setting in ("free", "gain"):
            return hx.loops.LegLength(data, unknown=(*_UNKNOWN, "gain") if self.setting == "gain" else _UNKNOWN)
        if self.setting == "III":
            return hx.loops.FixedLength(data, platform_point=self.leg.platform_point)
        return {"I": hx.loops.FixedDirection, "II": hx.loops.FixedLeg}[self.setting](data)

    def poses(self, index: Array) -> hx.LegMeasurements:
        """Some candidates: indices (N,), or (S, N) of a batch."""
        pool, flat = self.pool, np.reshape(index, -1)
        if np.ndim(index) == 1:
            return pool.poses(flat)
        assert pool.length is not None
        return pool.moved_to(pool.position[index], pool.rotation[index], pool.length[index])

    def solvers(self, loop: Any) -> dict[str, _Solve]:
        """The paper's estimator, or without a lock least squares on leg length; and the best there is."""
        if self.setting in ("free", "gain"):
            return {PAPER: (loop, hx.InverseKinematics()), BEST: (loop, hx.MaximumLikelihood())}
        paper = (loop.linear("consecutive"), hx.LeastSquares())
        if self.setting == "I":
            return {PAPER: paper, BEST: (loop, hx.MaximumLikelihood())}
        return {PAPER: paper, BEST: (loop.linear("direct"), hx.LeastSquares(weights="model"))}

    def repeated(self, exact: hx.LegMeasurements, draws: int, rng: np.random.Generator) -> hx.LegMeasurements:
        """Noisy copies of sets of poses (S, N), shape (S, draws, N)."""
        assert exact.length is not None

        def copies(array: Array) -> Array:
            return np.repeat(array[:, None], draws, axis=1)

        noisy = self.robot.noise.apply(copies(exact.position), copies(exact.rotation), copies(exact.length), rng)
        return replace(exact.moved_to(*noisy), nominal=self.start)


def predicted(case: Case, exact: hx.LegMeasurements) -> dict[str, Array]:
    """The predicted root-mean-square error of every block, at the truth: the bound, one entry a set."""
    loop = case.loop(exact)
    names, variance = loop.parameters.main, np.einsum("...ii->...i", loop.crlb(case.leg))
    return {
        f"{short}_predicted": np.sqrt(variance[..., names[block]].sum(axis=-1))
        for short, block in BLOCKS.items()
        if block in names
    }


def judged(case: Case, exact: hx.LegMeasurements, draws: int, rng: np.random.Generator) -> dict[str, dict[str, Array]]:
    """By estimator: the root-mean-square error of every block over noisy copies of sets (S, N), and its own error.

    An estimate that failed has no error; the share of failures is a column.
    """
    loop, answers = case.loop(case.repeated(exact, draws, rng)), {}
    for name, solve in case.solvers(loop).items():
        found = hx.estimate(*solve, throw=False)
        count = found.ok.sum(axis=-1)
        columns = {"failed": 1 - count / draws}
        for short, block in BLOCKS.items():
            if block in found.parameters:
                square = np.where(found.ok, found.error(case.leg)[block] ** 2, 0.0)
                mean = square.sum(axis=-1) / np.maximum(count, 1)
                spread = np.where(found.ok, (square - mean[:, None]) ** 2, 0.0).sum(axis=-1) / np.maximum(count, 1)
                rms = np.where(count, np.sqrt(mean), np.nan)
                columns[f"{short}_rms"] = rms
                columns[f"{short}_rms_error"] = np.sqrt(spread / np.maximum(count, 1)) / np.maximum(2 * rms, TINY)
        answers[name] = columns
    return answers
