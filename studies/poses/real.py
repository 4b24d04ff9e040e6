"""Twelve of 108 measured poses of a real hexapod: chosen ones against random ones, by how well they predict the rest.

A design sees positions, rotations and the nominal; of the readings it uses where the equations are evaluated, as any
design does, and never a residual. Every leg is fitted by least squares on its length (a, b, offset, gain) to twelve
poses; what counts is the root mean square, over the six legs and the other 96 poses, of predicted minus measured
length. A twelve to which some leg cannot be fitted has an infinite one.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import hexopt as hx
from studies.poses.scenarios import Array

__all__ = [
    "CRITERIA",
    "FILE",
    "FOLDER",
    "NOISE",
    "RANDOM_SETS",
    "N",
    "chosen",
    "chosen_by_leg",
    "load",
    "measure",
    "prediction",
    "random_twelves",
]

#: The variable that names the folder of the measurements, and the file of what came out.
FOLDER, FILE = "HEXOPT_REAL_DATA", "real.csv"
N, RANDOM_SETS = 12, 200
UNKNOWN = ("platform_point", "base_point", "offset", "gain")
#: Assumed: motion capture good for 0.3 mm and 0.5 mrad, cables for 0.2 mm (in revolutions).
NOISE = hx.NormalNoise(0.3, 5e-4, 0.2 / 71)
CRITERIA = ("A", "D")


def load(folder: Path) -> hx.Measurements:
    """The 108 poses."""
    robot = hx.Hexapod.from_toml(folder / "nominal.toml")
    (data,) = hx.read_measurements(folder / "calibration_108.csv", length_unit="mm", nominal=robot)
    return replace(data, noise=NOISE)


def chosen(data: hx.Measurements, criterion: str | hx.Criterion) -> Array:
    """Twelve poses for all legs at once."""
    return hx.select_poses(hx.loops.WholeRobot(data, unknown=UNKNOWN), N, criterion).indices


def chosen_by_leg(data: hx.Measurements, criterion: str) -> Array:
    """Twelve poses for each leg, (6, 12)."""
    legs = [hx.loops.LegLength(data.leg(k), unknown=UNKNOWN) for k in range(1, 7)]
    return np.array([hx.select_poses(leg, N, criterion).indices for leg in legs])


def prediction(data: hx.Measurements, index: Array) -> Array:
    """RMS error of the lengths in all other poses, of twelves (S, 12) or (S, 6, 12); infinite where a fit fails."""
    index = np.broadcast_to(index if index.ndim == 3 else index[:, None], (len(index), 6, N))
    squares = np.zeros(len(index))
    for k in range(1, 7):
        own = index[:, k - 1]
        rest = np.array([np.setdiff1d(np.arange(data.n_poses), one) for one in own])
        loop = _over(data.leg(k), own)
        found = hx.estimate(loop, hx.InverseKinematics(), throw=False)
        values = np.where(found.ok[:, None], found.values, loop.start())
        off = _over(data.leg(k), rest).residual(values)[..., 0]
        squares += np.where(found.ok, (off**2).mean(axis=-1), np.inf)
    rms: Array = np.sqrt(squares / 6)
    return rms


def _over(leg: hx.LegMeasurements, index: Array) -> hx.loops.LegLength:
    assert leg.length is not None
    data = leg.moved_to(leg.position[index], leg.rotation[index], leg.length[index])
    return hx.loops.LegLength(data, unknown=UNKNOWN)


def random_twelves(data: hx.Measurements, count: int, rng: np.random.Generator) -> Array:
    """Indices (count, 12)."""
    return rng.random((count, data.n_poses)).argsort(axis=1)[:, :N]


def measure(out: Path, seed: int = 0) -> None:
    """Write a row for every twelve into ``out/real.csv``; without measurements, say why not."""
    folder = os.environ.get(FOLDER)
    if not folder:
        print(f"no real measurements: {FOLDER} does not name a folder with them")
        return
    data = load(Path(folder))
    criteria = {name: name for name in CRITERIA} | {"G": hx.GOptimal(data)}
    together = {name: prediction(data, chosen(data, criterion)[None]) for name, criterion in criteria.items()}
    apart = {f"{name}, leg by leg": prediction(data, chosen_by_leg(data, name)[None]) for name in CRITERIA}
    random = prediction(data, random_twelves(data, RANDOM_SETS, np.random.default_rng(seed)))
    frames = [
        pd.DataFrame({"design": name, "rms": rms}) for name, rms in (together | apart | {"random": random}).items()
    ]
    pd.concat(frames).to_csv(out / FILE, index=False)
