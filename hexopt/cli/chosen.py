"""The poses that ``select`` chooses: what is promised, in print and in a report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import RankDeficientError, SamplingError
from ..geometry import Hexapod
from ..kinematics import inverse_kinematics
from ..measurements import Lock, Measurements
from ..selection.choosing import select_poses
from ..selection.design import Design
from ..selection.ordering import measuring_order
from ..selection.refinement import refine_poses
from .planning import SCENARIOS, Plan

__all__ = ["Chosen", "choose", "count", "report_on", "summary"]


@dataclass(frozen=True, eq=False)
class Chosen:
    """The poses of one set."""

    leg: int | None
    lock: Lock
    best: Design  # of the candidates
    design: Design  # the same, or refined
    notes: tuple[str, ...]

    def measurements(self, robot: Hexapod) -> Measurements:
        """In the order of measuring, with all six readings."""
        order = measuring_order(robot, self.design.poses)
        position, rotation = self.design.poses.position[order], self.design.poses.rotation[order]
        length = inverse_kinematics(robot, position, rotation)
        held = None if self.lock is Lock.NONE else self.leg
        return Measurements(position, rotation, length, self.lock, held, length_unit=robot.length_unit)

    def lines(self) -> list[str]:
        """What is promised, and what is proven."""
        best = self.best
        who = "all legs" if self.leg is None else f"leg {self.leg}"
        known = np.isfinite(best.efficiency)
        sure = f"at least {_percent(best.efficiency)} of the best choice" if known else "no bound on the best"
        if best.proven:
            sure = "the best choice, proven"
        lines = [f"  {who}: {len(best.indices)} of {len(best.weights)} candidates, {sure}"]
        if not best.proven:
            lines.append(f"    search: {best.stopped}")
        if self.design is not best:
            lines.append(f"    {self.design.stopped}")
        lines += [f"    {note}" for note in self.notes]
        lines.append(f"    {'parameter':<24s}{'± 1 σ':>9s}  unit")
        design = self.design
        shown = zip(design.labels, design.standard_errors, design.units, design.doubtful, strict=True)
        for label, error, unit, doubtful in shown:
            lines.append(f"    {label:<24s}{error:>9.3g}  {unit}" + ", not seen in practice" * bool(doubtful))
        return lines


def choose(plan: Plan, leg: int | None, n: int, ask: dict[str, Any], refine: bool, several: bool) -> Chosen:
    """The poses for one clamp, or for all legs."""
    before = plan.before(leg)
    try:
        pool, lines, left_out = plan.pool(leg, before)
        known = [plan.loop(data, leg) for data in before]
        best = select_poses(plan.loop(pool, leg), n, measured=known, rng=plan.seed, **ask)
        design = refine_poses(best, plan.robot, rng=plan.seed) if refine else best
    except (RankDeficientError, SamplingError) as error:
        raise type(error)(f"leg {leg}: {error}" if several else str(error)) from None
    notes = [left_out] if left_out else []
    if lines is not None:
        chosen = lines[design.indices[measuring_order(plan.robot, design)]]
        whose = f" of leg {leg}" if several else ""
        notes.append(f"the poses{whose} come from lines {', '.join(map(str, chosen))} of {plan.source}")
    if plan.lock is not Lock.NONE:
        notes.append(f"clamp: {plan.clamp(leg, pool).describe()}")
    if before:
        notes.append(f"with {count(sum(data.n_poses for data in before), 'pose')} measured before")
    return Chosen(leg, plan.lock, best, design, tuple(notes))


def report_on(plan: Plan, chosen: list[Chosen], nominal_error: str | None, worst: bool, repeat: bool) -> str:
    """The report; its libraries load only here."""
    from ..report import design_report

    settings = {"Seed": str(plan.seed)}
    if plan.measured is not None:
        settings["Measured before"] = str(plan.measured)
    if nominal_error is not None:
        whom = f"the worst of {SCENARIOS} such robots" if worst else f"{SCENARIOS} such robots on average"
        settings["Nominal"] = f"joint coordinates off by up to {nominal_error}; good for {whom}"
    notes = dict.fromkeys(note for one in chosen for note in one.notes if not note.startswith("clamp"))
    if notes:
        settings["Notes"] = "; ".join(notes)
    return design_report(plan.robot, [one.design for one in chosen], repeat=repeat, settings=settings, rng=plan.seed)


def summary(plan: Plan, chosen: list[Chosen], criterion: str) -> str:
    """What is promised of all sets."""
    held = "none locked" if plan.lock is Lock.NONE else f"lock {plan.lock}"
    lines = [f"{plan.robot.name}: poses to measure, {held}, criterion {criterion}"]
    if plan.limits.describe() == "none":
        lines.append("  the robot has no limits: whether it reaches these poses is not known")
    lines += [line for one in chosen for line in one.lines()]
    return "\n".join(lines)


def _percent(share: float) -> str:
    """Rounded down, so that it stays a bound."""
    return f"{np.floor(1000 * share) / 10:.1f} %"


def count(number: int, what: str) -> str:
    """So many of something, in words."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
