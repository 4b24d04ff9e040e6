"""What is run: every point of the paper's figures 5–10, and how its factors depend on the pose ranges."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

import hexopt as hx

__all__ = ["N1", "SCENARIOS", "Scenario"]

#: Poses of the LEG set that lends b to the LENGTH set, as in section 5.2.
N1 = 7
LEG = 3
ERR = 0.01
LEVELS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1)
SOURCES = {"all": (1, 1, 1), "position": (1, 0, 0), "angle": (0, 1, 0), "length": (0, 0, 1)}


@dataclass(frozen=True)
class Scenario:
    """One point of a figure: a kind of experiment, a leg, a number of poses, a noise, and pose ranges.

    Noise levels are half-widths of uniform errors: cm, degrees and cm. Ranges that are None are the robot's own.
    """

    key: str
    experiment: str
    kind: str  # a lock, "offset" or "three-step"
    n_poses: int
    position: float = ERR
    angle: float = ERR
    length: float = ERR
    leg: int = LEG
    source: str = "all"
    ranges: hx.PoseRanges | None = None
    varied: str = ""
    setting: float = float("nan")

    def noise(self) -> hx.UniformNoise | None:
        """The noise model, or None for exact readings."""
        if not (self.position or self.angle or self.length):
            return None
        return hx.UniformNoise(self.position, float(np.deg2rad(self.angle)), self.length)

    @property
    def level(self) -> float:
        """The largest of the three noise levels: what factors are relative to."""
        return max(self.position, self.angle, self.length)


def _over_poses() -> Iterator[Scenario]:
    """Figures 5, 6, 9 and 10: errors against the number of poses, at the two noise levels of section 5.2."""
    for kind, counts in (("direction", range(4, 51)), ("leg", range(4, 31)), ("length", range(5, 31))):
        for err in (0.01, 0.001):
            for n in counts:
                yield Scenario(f"{kind}, N={n}, err={err}", "poses", kind, n, err, err, err)


def _over_noise() -> Iterator[Scenario]:
    """Figures 7 and 8: the three noise sources apart, at N = 7."""
    for source, (p, a, length) in SOURCES.items():
        for err in LEVELS:
            key = f"direction, noise on {source}, err={err}"
            yield Scenario(key, "noise", "direction", 7, p * err, a * err, length * err, source=source)


def _offsets() -> Iterator[Scenario]:
    for err in (0.001, 0.01, 0.1):
        yield Scenario(f"offset, err={err}", "offset", "offset", 1, err, err, err)


def _all_legs() -> Iterator[Scenario]:
    """Both methods on every leg, with and without noise."""
    for leg in range(1, 7):
        for experiment, err in (("legs", ERR), ("no noise", 0.0)):
            for kind in ("direction", "three-step"):
                key = f"{kind}, leg {leg}, err={err}"
                yield Scenario(key, experiment, kind, 7, err, err, err, leg)
        for kind, n in (("direction", 3), ("leg", 3), ("length", 4)):
            yield Scenario(f"{kind}, leg {leg}, N={n}, no noise", "no noise", kind, n, 0.0, 0.0, 0.0, leg)


def _over_ranges() -> Iterator[Scenario]:
    """How the factors at N = 7 depend on the ranges that the paper does not print."""
    own = hx.robots.left_hand().ranges
    low, high = own.length
    middle = (low + high) / 2
    varied: dict[str, list[tuple[float, hx.PoseRanges]]] = {
        "rotation range, ± degrees": [
            (degrees, replace(own, angles=(float(np.deg2rad(degrees)),) * 3)) for degrees in (5, 10, 20, 35, 50, 70)
        ],
        "spread of leg length, cm": [
            (spread, replace(own, length=(middle - spread / 2, middle + spread / 2)))
            for spread in (0.5, 1, 2, 3.3, 5, 8, 12)
        ],
        "cone of directions, ± degrees": [
            (degrees, replace(own, cone=float(np.deg2rad(degrees)))) for degrees in (10, 20, 30, 45, 68, 90)
        ],
    }
    for name, settings in varied.items():
        for value, ranges in settings:
            for kind in ("direction", "leg", "length"):
                key = f"{kind}, {name} {value:g}"
                yield Scenario(key, "ranges", kind, 7, ranges=ranges, varied=name, setting=value)


SCENARIOS = (*_over_poses(), *_over_noise(), *_offsets(), *_all_legs(), *_over_ranges())
