"""Random sets of one leg, their nominals and bounds; and how answers become columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

import hexopt as hx
from studies.baselines.scenarios import LEG, Array, Scenario

__all__ = ["AXES", "BLOCKS", "POINTS", "Answer", "Case", "draw", "frame", "judged", "noisy"]

#: Estimands by their short names.
BLOCKS = {"platform": "platform_point", "base": "base_point", "offset": "offset"}
POINTS = ("base", "platform")
AXES = ("x", "y", "z")
BOTH = ("platform_point", "base_point")
_Z95 = 1.959963984540054
_LOCKS = {"I": "direction", "2 × I": "direction", "II": "leg", "III": "length", "III ab": "length"}
_LOOPS = {"I": hx.loops.FixedDirection, "2 × I": hx.loops.FixedDirection, "II": hx.loops.FixedLeg}


@dataclass(frozen=True)
class Case:
    """Sets of one leg: what every method is given.

    Attributes
    ----------
    setting : str
    views : tuple of LegMeasurements
        The leg's readings, in one set or two; exact or with errors.
    nominals : dict of str to ndarray
        Of all six legs, off the truth: "base_points" (n_sets, 6, 3), "platform_points" and "offsets".
    truth : Hexapod
    robot_data : Measurements, optional
        All six readings of the same poses, where the leg is free.
    """

    setting: str
    views: tuple[hx.LegMeasurements, ...]
    nominals: Mapping[str, Array]
    truth: hx.Hexapod
    robot_data: hx.Measurements | None = None

    @property
    def n_sets(self) -> int:
        """How many sets there are."""
        return int(self.views[0].batch_shape[0])

    def sets(self, start: int, stop: int) -> Case:
        """Some of the sets."""
        here = slice(start, stop)
        data = None if self.robot_data is None else self.robot_data[here]
        nominals = {name: value[here] for name, value in self.nominals.items()}
        return replace(self, views=tuple(view[here] for view in self.views), nominals=nominals, robot_data=data)

    @property
    def nominal(self) -> hx.Leg:
        """The leg's nominals, one a set; the offset is known but where it is estimated."""
        leg, k = self.truth.leg(LEG), LEG - 1
        points = {
            "base_point": self.nominals["base_points"][:, k],
            "platform_point": self.nominals["platform_points"][:, k],
        }
        if self.setting == "free":
            points["offset"] = self.nominals["offsets"][:, k]
        return leg.replaced(**points)

    @property
    def nominal_robot(self) -> hx.Hexapod:
        """The nominal of the first set."""
        return replace(self.truth, **{name: value[0] for name, value in self.nominals.items()})

    @property
    def readings(self) -> hx.Measurements:
        """All six readings."""
        assert self.robot_data is not None, "a locked leg is simulated by itself"
        return self.robot_data

    @cached_property
    def loops(self) -> tuple[hx.loops.Loop, ...]:
        """The loop equation of every set."""
        views = [replace(view, nominal=self.nominal) for view in self.views]
        if self.setting == "free":
            return tuple(hx.loops.LegLength(view) for view in views)
        if self.setting == "III":
            b = self.truth.leg(LEG).platform_point
            return tuple(hx.loops.FixedLength(view, platform_point=b) for view in views)
        if self.setting == "III ab":
            return tuple(hx.loops.FixedLength(view, unknown=BOTH) for view in views)
        return tuple(_LOOPS[self.setting](view) for view in views)

    @property
    def model(self) -> Any:
        """All sets as one model, for estimators that take loops."""
        return self.loops[0] if len(self.loops) == 1 else hx.loops.Sets(*self.loops)

    def linear(self, form: str = "direct") -> hx.LinearProblem:
        """All sets as one linear problem."""
        if len(self.loops) == 1:
            return self.loops[0].linear(form)
        return hx.join(*(loop.linear(form) for loop in self.loops))

    def bound(self) -> Array:
        """The Cramér–Rao bound of the leg's parameters at the truth, (n_sets, p, p)."""
        leg = self.truth.leg(LEG)
        bound: Array = self.model.crlb(self.model.values(leg))
        return bound


def draw(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> tuple[Case, Case]:
    """Sets with errors, and the same sets without: where bounds are evaluated, and convergence is tried."""
    robot, setting, count = scenario.robot, scenario.setting, scenario.n_poses
    signs = {"base_points": (6, 3), "platform_points": (6, 3), "offsets": (6,)}
    nominals = {
        name: getattr(robot, name) + scenario.off * rng.choice([-1.0, 1.0], (n_sets, *shape))
        for name, shape in signs.items()
    }
    if setting == "free":
        exact = hx.simulate(robot, "none", count, n_sets, rng=rng)
        seen, clean = noisy(exact, scenario, rng), replace(exact, noise=scenario.noise)
        return (
            Case(setting, (seen.leg(LEG),), nominals, robot, seen),
            Case(setting, (clean.leg(LEG),), nominals, robot, clean),
        )
    sets = 2 if setting == "2 × I" else 1
    true = [hx.simulate_leg(robot, LEG, _LOCKS[setting], count, n_sets, rng=rng) for _ in range(sets)]
    views = tuple(noisy(data, scenario, rng) for data in true)
    ideal = tuple(replace(data, noise=scenario.noise) for data in true)
    return Case(setting, views, nominals, robot), Case(setting, ideal, nominals, robot)


def noisy(exact: Any, scenario: Scenario, rng: np.random.Generator) -> Any:
    """Measurements with the scenario's errors, which estimators know of."""
    noise = scenario.noise
    position, rotation, length = noise.apply(exact.position, exact.rotation, exact.length, rng)
    return replace(exact, position=position, rotation=rotation, length=length, noise=noise)


@dataclass(frozen=True)
class Answer:
    """What a method made of some sets.

    Attributes
    ----------
    values : dict of str to ndarray
        Of the leg, by short name, (n_sets, size); NaN where it failed.
    codes : ndarray of int, (n_sets,)
    covariance : ndarray, (n_sets, p, p), or None
        In the order of the values.
    """

    values: Mapping[str, Array]
    codes: Array
    covariance: Array | None = None

    @classmethod
    def of(cls, found: hx.Estimate, leg: int = LEG) -> Answer:
        """Of an estimate, of one leg or of a robot."""
        names = cls.names(found, leg)
        covariance = None if found.covariance is None else found.covariance_of(*names.values())
        return cls({short: found.params[name] for short, name in names.items()}, found.codes, covariance)

    @staticmethod
    def names(found: hx.Estimate, leg: int = LEG) -> dict[str, str]:
        """The leg's blocks in an estimate, by short name."""
        return {
            short: name
            for short, block in BLOCKS.items()
            for name in (block, f"leg{leg}.{block}")
            if name in found.parameters
        }

    @classmethod
    def failed(cls, n_sets: int, status: hx.Status) -> Answer:
        """No values at all."""
        return cls({}, np.full(n_sets, status, dtype=np.int8))

    @classmethod
    def joined(cls, answers: Sequence[Answer]) -> Answer:
        """Of sets one after the other."""
        values = {name: np.concatenate([one.values[name] for one in answers]) for name in answers[0].values}
        return cls(values, np.concatenate([one.codes for one in answers]))

    @property
    def ok(self) -> Array:
        """Whether it succeeded, set by set."""
        return self.codes == hx.Status.OPTIMAL

    def errors(self, leg: hx.Leg) -> dict[str, Array]:
        """Signed errors by short name."""
        return {short: value - leg.block(BLOCKS[short]) for short, value in self.values.items()}


def judged(answer: Answer, leg: hx.Leg, bound: Array | None) -> dict[str, Array]:
    """Errors, bounds, and what the stated covariance covers, as columns."""
    columns: dict[str, Array] = {}
    errors, start = answer.errors(leg), 0
    for short, error in errors.items():
        stop = start + error.shape[-1]
        columns[f"{short}_error"] = np.linalg.norm(error, axis=-1)
        if short in POINTS:
            columns |= {f"{short}_{axis}": error[:, i] for i, axis in enumerate(AXES)}
        if bound is not None:
            columns[f"{short}_bound"] = np.sqrt(_trace(bound[:, start:stop, start:stop]))
        if answer.covariance is not None:
            spread = np.sqrt(np.einsum("...ii->...i", answer.covariance)[:, start:stop])
            inside = np.where(answer.ok[:, None], np.abs(error) <= _Z95 * spread, np.nan)
            columns[f"{short}_covered"] = inside.mean(axis=-1)
        start = stop
    if bound is not None and errors:
        error = np.concatenate(list(errors.values()), axis=-1)
        square = np.einsum("...i,...i->...", error, np.linalg.solve(bound, error[..., None])[..., 0])
        columns["normalised"] = square / error.shape[-1]
    return columns


def _trace(matrix: Array) -> Array:
    trace: Array = np.einsum("...ii->...", matrix)
    return trace


def frame(method: str, codes: Array, columns: Mapping[str, Array]) -> pd.DataFrame:
    """The rows of one method."""
    count = len(codes)
    return pd.DataFrame(
        {
            "method": [method] * count,
            "repetition": np.arange(count),
            **{name: columns.get(name, np.full(count, np.nan)) for name in COLUMNS},
            "status": codes.astype(np.int8),
            "ok": codes == hx.Status.OPTIMAL,
        }
    )


#: Every row has these, NaN where they do not apply.
COLUMNS = (
    *(f"{short}_{what}" for short in BLOCKS for what in ("error", "bound", "covered")),
    *(f"{short}_{axis}" for short in POINTS for axis in AXES),
    "normalised",
    "reached",
    "home_covered",
    "home_error",
    "poses_seen",
    *(f"{short}_predicted" for short in BLOCKS),
    "nees",
)
