"""Times nonlinear calibrations against SciPy and IPOPT, set by set, in the same run on one thread."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

import hexopt as hx

POSES = (10, 20)
ERR = 0.01
OFF = 0.5  # of the nominal, in every coordinate, in cm

#: Residual and Jacobian of one set at given values.
Rows = tuple[Callable[[np.ndarray], np.ndarray], Callable[[np.ndarray], np.ndarray]]


def seconds(work: Callable[[], object]) -> float:
    """How long it takes, once."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def race(
    fast: Callable[[], object], slow: Callable[[], int], n_sets: int, repeats: int, unit: str = "µs"
) -> dict[str, float]:
    """Times a set, in turn: `slow` says how many sets it solved, `fast` solves `n_sets`."""
    in_unit = {"µs": 1e6, "ms": 1e3}[unit]
    few = slow()
    fast()
    pairs = [(seconds(slow) / few, seconds(fast) / n_sets) for _ in range(repeats)]
    return {
        f"peer, {unit}": in_unit * statistics.median(one for one, _ in pairs),
        f"hexopt, {unit}": in_unit * statistics.median(two for _, two in pairs),
        "ratio (median of pairs)": statistics.median(one / two for one, two in pairs),
    }


def leg_lengths(n_poses: int, n_sets: int) -> hx.loops.LegLength:
    """Model 42 of leg 3 of the Left Hand from unlocked poses."""
    robot = hx.robots.left_hand()
    noise = hx.UniformNoise(ERR, float(np.deg2rad(ERR)), ERR)
    nominal = robot.perturbed(OFF, offsets=OFF, rng=0)
    return hx.loops.LegLength(hx.simulate_leg(robot, 3, "none", n_poses, n_sets, noise=noise, nominal=nominal, rng=1))


def plain_rows(position: np.ndarray, rotation: np.ndarray, reading: np.ndarray, weight: np.ndarray) -> Rows:
    """The rows of one set as one would write them for SciPy, with weights (n,)."""

    def residual(x: np.ndarray) -> np.ndarray:
        vector = position + rotation @ x[:3] - x[3:6]
        return np.asarray(weight * (np.sqrt((vector * vector).sum(axis=1)) - reading - x[6]))

    def jacobian(x: np.ndarray) -> np.ndarray:
        vector = position + rotation @ x[:3] - x[3:6]
        unit = vector * (weight / np.sqrt((vector * vector).sum(axis=1)))[:, None]
        return np.concatenate([(unit[:, None] @ rotation)[:, 0], -unit, -weight[:, None]], axis=1)

    return residual, jacobian


def against_scipy(n_sets: int, repeats: int) -> pd.DataFrame:
    """A batch of hexopt against a loop over ``least_squares(method="lm")`` with the analytic Jacobian."""
    table = []
    for n_poses in POSES:
        loop = leg_lengths(n_poses, n_sets)
        for weights in (None, "model"):
            for covariance in (False, True):
                estimator = hx.InverseKinematics(weights=weights, covariance=covariance)
                table.append(
                    {"estimator": "InverseKinematics", "poses N": n_poses, "weights": weights or "none"}
                    | {"covariance": covariance, "peer": "scipy least_squares"}
                    | race(partial(hx.estimate, loop, estimator), _scipy(loop, weights), n_sets, repeats)
                )
    return pd.DataFrame(table)


def against_ipopt(n_sets: int, repeats: int) -> pd.DataFrame:
    """The same against CasADi and IPOPT, a program a set."""
    table = []
    for n_poses in POSES:
        loop, few = leg_lengths(n_poses, n_sets), leg_lengths(n_poses, 5)
        robust: dict[str, Any] = {"loss": hx.Huber(), "weights": "model"}
        for name, settings in (("Quadratic", {}), ("Huber", robust)):
            estimator = hx.InverseKinematics(**settings)
            reference = hx.InverseKinematics(**settings, backend="ipopt")

            def slow(few: hx.loops.LegLength = few, reference: hx.InverseKinematics = reference) -> int:
                hx.estimate(few, reference)
                return 5

            table.append(
                {"estimator": "InverseKinematics", "poses N": n_poses, "loss": name, "peer": "CasADi + IPOPT"}
                | race(partial(hx.estimate, loop, estimator), slow, n_sets, repeats)
            )
    return pd.DataFrame(table)


def _scipy(loop: hx.loops.LegLength, weights: str | None) -> Callable[[], int]:
    """A loop over sets of the batch, each fitted as the estimator does; it says how many there were."""
    data, start = loop.data, loop.values(loop.data.nominal)
    few = min(len(data.position), 100)
    found = hx.estimate(loop, hx.InverseKinematics())
    weight = loop.linearised(found.values).whitening().blocks[..., 0, 0]

    def work() -> int:
        for i in range(few):
            measured = data.position[i], data.rotation[i], data.length[i]
            residual, jacobian = plain_rows(*measured, np.ones(data.n_poses))
            first = least_squares(residual, start, jacobian, method="lm")
            if weights is not None:
                residual, jacobian = plain_rows(*measured, weight[i])
                least_squares(residual, first.x, jacobian, method="lm")
        return few

    return work
