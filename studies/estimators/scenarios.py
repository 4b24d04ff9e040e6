"""What the estimators meet: errors that fit the model and errors that do not, nominals that are right and wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

import hexopt as hx

__all__ = ["ERR", "LEG", "SCENARIOS", "TOLERANCE", "Array", "Nominal", "Scenario", "Tracker"]

Array = npt.NDArray[Any]

LEG = 3
#: Half-width of the paper's uniform errors: cm, degrees and cm.
ERR = 0.01
#: What priors take for one standard deviation of a nominal coordinate, cm.
TOLERANCE = 0.1
#: A bad pose is off by this much in a random direction, cm.
SHIFT = (0.5, 2.0)
COUNTS = {"direction": (5, 7, 20, 50), "leg": (5, 7, 20, 50)}
#: Scenarios of equal settings that the claims on coverage and efficiency pool, to have enough sets.
PARTS = 10


@dataclass(frozen=True)
class Tracker:
    """Errors of a tracker that looks at a target on an arm: those of orientation move the position, too.

    With T the target and r the arm, P = T − R r, and so δP = δT − δω × R r. Standard deviations, in cm and radians.
    """

    arm: tuple[float, float, float] = (0.0, 0.0, 30.0)
    target: float = ERR / 3**0.5
    angle: float = float(np.deg2rad(0.05))
    length: float = ERR / 3**0.5

    def apply(self, position: Array, rotation: Array, length: Array, rng: np.random.Generator) -> Any:
        exact = hx.NormalNoise(pose_covariance=self.covariance(position, rotation))
        return exact.apply(position, rotation, length, rng)

    def covariance(self, position: Array, rotation: Array, n_readings: int = 1) -> Array:
        x, y, z = np.moveaxis(rotation @ np.asarray(self.arm), -1, 0)
        zero = np.zeros_like(x)
        crossed = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(rotation.shape)
        root = np.zeros((*rotation.shape[:-2], 6 + n_readings, 6 + n_readings))
        root[..., :3, :3] = self.target * np.eye(3)
        root[..., :3, 3:6] = self.angle * crossed
        root[..., 3:6, 3:6] = self.angle * np.eye(3)
        root[..., 6:, 6:] = self.length * np.eye(n_readings)
        product: Array = root @ np.swapaxes(root, -1, -2)
        return product

    def common(self, n_readings: int = 1) -> None:
        return None

    def for_leg(self, number: int) -> Tracker:
        return self


@dataclass(frozen=True)
class Nominal:
    """A nominal leg for each set, and what estimators may make of it."""

    points: dict[str, Array]
    unit: str

    def prior(self) -> hx.GaussianPrior:
        variance = dict.fromkeys(self.points, TOLERANCE**2)
        return hx.GaussianPrior(self.points, variance, unit=self.unit, if_present=True)

    def box(self, radius: float) -> hx.Box:
        sides = {name: (point - radius, point + radius) for name, point in self.points.items()}
        return hx.Box(sides, unit=self.unit, if_present=True)

    def lasso(self, strength: float) -> hx.Lasso:
        return hx.Lasso(self.points, strength, unit=self.unit, if_present=True)


@dataclass(frozen=True)
class Scenario:
    """Sets of one kind and size, their errors, and the nominals that go with them.

    Attributes
    ----------
    case : str
        What the scenario shows; figures and tables put those of one case together.
    kind : str
        The lock: "direction" (Type I) or "leg" (Type II).
    errors : {"uniform", "normal", "tracker"}
        Of the good poses, and what estimators assume.
    bad : float
        The share of bad poses.
    nominal : {"tolerance", "wrong", "one joint"}
        Normal about the truth, one tolerance a coordinate; off by five tolerances in a random direction; or so for
        the platform point alone.
    part : int
        Tells equal scenarios apart whose sets are pooled.
    """

    key: str
    case: str
    kind: str
    n_poses: int
    errors: str = "uniform"
    bad: float = 0.0
    nominal: str = "tolerance"
    part: int = 0

    def noise(self) -> Any:
        """The noise; of bad poses its covariance knows nothing."""
        sd = ERR / 3**0.5
        noise: Any = {
            "uniform": hx.UniformNoise(ERR, float(np.deg2rad(ERR)), ERR),
            "normal": hx.NormalNoise(sd, float(np.deg2rad(sd)), sd),
            "tracker": Tracker(),
        }[self.errors]
        return hx.Outliers(noise, self.bad, SHIFT) if self.bad else noise

    def nominals(self, leg: hx.Leg, n_sets: int, rng: np.random.Generator) -> Nominal:
        """A nominal for each set."""
        points = {}
        for name in ("platform_point", "base_point"):
            normal = rng.standard_normal((n_sets, 3))
            off = TOLERANCE * normal
            if self.nominal != "tolerance":
                off = 5 * TOLERANCE * normal / np.linalg.norm(normal, axis=-1, keepdims=True)
            if self.nominal == "one joint" and name == "base_point":
                off = np.zeros_like(normal)
            points[name] = leg.block(name) + off
        return Nominal(points, leg.length_unit)


def _over_poses() -> Iterator[Scenario]:
    """Every case at every number of poses."""
    cases: dict[str, dict[str, Any]] = {
        "uniform": {},
        "normal": {"errors": "normal"},
        "5 % bad": {"bad": 0.05},
        "15 % bad": {"bad": 0.15},
        "tracker": {"errors": "tracker"},
    }
    for case, settings in cases.items():
        for kind, counts in COUNTS.items():
            for n in counts:
                yield Scenario(f"{case}, {kind}, N={n}", case, kind, n, **settings)


def _over_nominals() -> Iterator[Scenario]:
    """Too few poses with a prior, a wrong prior, and one joint that alone has moved."""
    for kind in COUNTS:
        yield Scenario(f"two poses, {kind}", "two poses", kind, 2)
        for n in (7, 20):
            yield Scenario(f"wrong nominal, {kind}, N={n}", "wrong nominal", kind, n, nominal="wrong")
    for n in (5, 7, 20):
        yield Scenario(f"one joint moved, direction, N={n}", "one joint moved", "direction", n, nominal="one joint")


def _trials() -> Iterator[Scenario]:
    """Many sets under normal errors, for the least-squares estimators alone."""
    for kind, counts in COUNTS.items():
        for n in counts:
            for part in range(PARTS):
                yield Scenario(f"trials, {kind}, N={n}, part {part}", "trials", kind, n, errors="normal", part=part)


SCENARIOS = (*_over_poses(), *_over_nominals(), *_trials())
