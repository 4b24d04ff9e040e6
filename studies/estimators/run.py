"""Runs the comparison: ``python -m studies estimators``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import chdtri

import hexopt as hx
from studies.estimators.scenarios import LEG, SCENARIOS, Array, Nominal, Scenario
from studies.harness import Study
from studies.harness.cli import main as run_study

Task = tuple[Any, Any]  # a target and an estimator
Method = Callable[[hx.loops.Loop, Nominal], Task]


def _convex(loop: hx.loops.Loop, loss: Any = None, **settings: Any) -> Task:
    return loop.linear("direct"), hx.ConvexEstimator(loss or hx.Quadratic(), **settings)


PAPER, UNWEIGHTED, GLS, GROUP_HUBER = "consecutive (paper)", "direct, unweighted", "GLS", "GroupHuber 2.5"
PRIOR, LASSO = "GLS, normal prior", "GLS, lasso 100/cm"
BOX, HUBER_BOX = "GLS, box ± 0.5 cm", "GroupHuber 2.5, box ± 0.5 cm"

#: Every method: what goes to hexopt.estimate, in the order of figures and tables. A new one is one entry here.
METHODS: dict[str, Method] = {
    PAPER: lambda loop, _: (loop.linear("consecutive"), hx.LeastSquares()),
    UNWEIGHTED: lambda loop, _: (loop.linear("direct"), hx.LeastSquares()),
    GLS: lambda loop, _: (loop.linear("direct"), hx.LeastSquares(weights="model")),
    "GLS, reweighted": lambda loop, _: (loop, hx.Reweighted(hx.LeastSquares(weights="model"))),
    "Huber 1.345": lambda loop, _: _convex(loop, hx.Huber(1.345)),
    GROUP_HUBER: lambda loop, _: _convex(loop, hx.GroupHuber(2.5)),
    "L1": lambda loop, _: _convex(loop, hx.L1()),
    "Chebyshev": lambda loop, _: _convex(loop, hx.Chebyshev()),
    PRIOR: lambda loop, nominal: _convex(loop, prior=nominal.prior()),
    BOX: lambda loop, nominal: _convex(loop, bounds=nominal.box(0.5)),
    HUBER_BOX: lambda loop, nominal: _convex(loop, hx.GroupHuber(2.5), bounds=nominal.box(0.5)),
    LASSO: lambda loop, nominal: _convex(loop, prior=nominal.lasso(100.0)),
}
#: A method that is in some cases only: where nominals are the matter.
CASES_OF = {LASSO: ("uniform", "two poses", "wrong nominal", "one joint moved")}
#: Cases that only some methods are in: many sets for linear estimators, and too few poses for losses alone.
METHODS_OF = {
    "trials": (PAPER, UNWEIGHTED, GLS),
    "two poses": (PAPER, UNWEIGHTED, GLS, PRIOR, BOX, HUBER_BOX, LASSO),
}

POINTS = {"platform": "platform_point", "base": "base_point"}
AXES = ("x", "y", "z")
_Z95 = 1.959963984540054


def methods_for(scenario: Scenario) -> dict[str, Method]:
    """The methods that take part in a scenario."""
    case = scenario.case
    return {name: METHODS[name] for name in METHODS_OF.get(case, METHODS) if case in CASES_OF.get(name, (case,))}


def draw(
    scenario: Scenario, n_sets: int, rng: np.random.Generator
) -> tuple[hx.loops.Loop, Nominal, dict[str, Array], hx.Leg]:
    """Noisy sets as a loop equation, their nominals, bounds of the error, and the true leg."""
    robot = hx.robots.left_hand()
    leg, noise = robot.leg(LEG), scenario.noise()
    exact = hx.simulate_leg(robot, LEG, scenario.kind, scenario.n_poses, n_sets, rng=rng)
    position, rotation, length = noise.apply(exact.position, exact.rotation, exact.length, rng)
    data = replace(exact, position=position, rotation=rotation, length=length, noise=noise)
    equation = hx.loops.FixedDirection if scenario.kind == "direction" else hx.loops.FixedLeg
    bounds = _bounds(equation(replace(exact, noise=noise)), leg, n_sets)
    return equation(data), scenario.nominals(leg, n_sets, rng), bounds, leg


def _bounds(loop: hx.loops.Loop, leg: hx.Leg, n_sets: int) -> dict[str, Array]:
    """The Cramér–Rao bound on the RMS error of each point, at the truth; and where ‖n‖ = 1 is not used ("linear")."""
    if loop.data.n_poses < loop.minimum_poses:
        return {}
    values = loop.values(leg)
    jacobian, noise = loop.jacobian(values), loop.covariance(values).blocks
    information = np.einsum("sidp,sidq->spq", jacobian, np.linalg.solve(noise, jacobian))
    tangent = np.broadcast_to(np.eye(information.shape[-1]), information.shape)
    if "direction" in loop.parameters:
        where = loop.parameters["direction"]
        tangent = np.concatenate([tangent[..., : where.start], _across(values[..., where], where.start)], axis=-1)
    bounds = {}
    for name, basis in (("bound", tangent), ("linear_bound", None)):
        matrix = information if basis is None else np.swapaxes(basis, -1, -2) @ information @ basis
        variance = np.einsum("...ii->...i", np.linalg.inv(matrix))
        for short, point in POINTS.items():
            if point in loop.parameters:
                bounds[f"{short}_{name}"] = np.sqrt(variance[..., loop.parameters[point]].sum(axis=-1))
    return bounds


def _across(direction: Array, before: int) -> Array:
    """Two columns for the moves that a unit direction can make, below `before` rows of zeros."""
    _, _, basis = np.linalg.svd(direction[..., None, :])
    across = np.swapaxes(basis[..., 1:, :], -1, -2)
    return np.concatenate([np.zeros((*across.shape[:-2], before, 2)), across], axis=-2)


def estimated(method: Method, loop: hx.loops.Loop, nominal: Nominal) -> hx.Estimate | None:
    """What a method makes of all sets; None where it refuses so few poses altogether."""
    try:
        return hx.estimate(*method(loop, nominal), throw=False)
    except hx.RankDeficientError:
        return None


def run(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """All methods on the same random sets of one scenario: one row a set and method."""
    loop, nominal, bounds, leg = draw(scenario, n_sets, rng)
    chosen = methods_for(scenario)
    nothing = np.full(n_sets, np.nan)
    frames = []
    for name, method in chosen.items():
        found = estimated(method, loop, nominal)
        columns = dict.fromkeys(COLUMNS, nothing) | bounds
        status = np.full(n_sets, hx.Status.RANK_DEFICIENT, dtype=np.int8)
        if found is not None:
            columns |= _errors(found, leg)
            status = found.codes
        frames.append(
            pd.DataFrame(
                {
                    "method": pd.Categorical([name] * n_sets, categories=list(METHODS)),
                    "repetition": np.arange(n_sets),
                    **columns,
                    "status": status,
                    "ok": status == hx.Status.OPTIMAL,
                }
            )
        )
    return pd.concat(frames, ignore_index=True)


COLUMNS = (
    *(
        f"{short}_{what}"
        for short in POINTS
        for what in ("error", "square", *AXES, "covered", *(f"{a}_covered" for a in AXES))
    ),
    "joint_covered",
    *(f"{short}_{what}" for short in POINTS for what in ("bound", "linear_bound")),
)


def _errors(found: hx.Estimate, leg: hx.Leg) -> dict[str, Array]:
    """Euclidean and signed errors, and whether the stated covariance covers them; NaN where it states none."""
    columns = {}
    present = {short: point for short, point in POINTS.items() if point in found.parameters}
    signed = {short: found.params[point] - leg.block(point) for short, point in present.items()}
    for short, point in present.items():
        columns[f"{short}_error"] = np.linalg.norm(signed[short], axis=-1)
        columns[f"{short}_square"] = columns[f"{short}_error"] ** 2
        columns |= {f"{short}_{axis}": signed[short][:, i] for i, axis in enumerate(AXES)}
        if found.covariance is None:
            continue
        error = found.standard_errors[:, found.parameters[point]]
        inside = np.where(found.ok[:, None], np.abs(signed[short]) <= _Z95 * error, np.nan)
        columns[f"{short}_covered"] = inside.mean(axis=-1)
        columns |= {f"{short}_{axis}_covered": inside[:, i] for i, axis in enumerate(AXES)}
    if found.covariance is not None:
        error = np.concatenate(list(signed.values()), axis=-1)
        columns["joint_covered"] = _jointly_covered(error, found.covariance_of(*present.values()), found.ok)
    return columns


def _jointly_covered(error: Array, covariance: Array, ok: Array) -> Array:
    """Whether the 95 % ellipsoid contains the truth; where the covariance is flat, it must be met exactly."""
    usable = ok & np.isfinite(covariance).all(axis=(-2, -1))
    values, vectors = np.linalg.eigh(np.where(usable[:, None, None], covariance, np.eye(error.shape[-1])))
    along = np.einsum("...ij,...i->...j", vectors, error)
    least = np.maximum(1e-14 * values[:, -1:], np.finfo(float).tiny)
    distance = (along**2 / np.maximum(values, least)).sum(axis=-1)
    inside: Array = np.where(usable, distance <= chdtri(error.shape[-1], 0.05), np.nan)
    return inside


STUDY = Study(name="estimators", run=run, scenarios=SCENARIOS, sets=1000, chunk_size=500, seed=2024)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the study, time the methods if that is still to do, and write the report."""
    from studies.estimators.cost import measure
    from studies.estimators.report import is_whole, write

    def report(out: Path) -> Path | None:
        if is_whole(out):
            measure(out)
        return write(out)

    return run_study(STUDY, argv, report)
