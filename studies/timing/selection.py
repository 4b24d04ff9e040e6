"""Times the choice of poses: candidates, relaxations, designs and proofs, in the same run on one thread."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cvxpy as cp
import numpy as np
import pandas as pd

import hexopt as hx
from studies.timing.nonlinear import race, seconds

ERR = 0.01
LEG = 3
#: Poses of a design.
CHOSEN = 7
LOCKS = {"I": "direction", "II": "leg", "III": "length"}
#: Criteria that the peers know.
CRITERIA = ("A", "D")

#: The criterion of covariances (..., k, k).
SIZES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "A": lambda covariance: np.trace(covariance, axis1=-2, axis2=-1),
    "D": lambda covariance: np.linalg.slogdet(covariance)[1],
}


def noise() -> hx.UniformNoise:
    """The paper's."""
    return hx.UniformNoise(ERR, float(np.deg2rad(ERR)), ERR)


def equation(setting: str, n: int) -> Any:
    """The loop over n candidates of leg 3 of the Left Hand, which all six legs reach."""
    robot = hx.robots.left_hand()
    data = hx.candidates(robot, LEG, LOCKS[setting], n, noise(), rng=0).leg(LEG)
    if setting == "III":
        return hx.loops.FixedLength(data, platform_point=robot.leg(LEG).platform_point)
    return {"I": hx.loops.FixedDirection, "II": hx.loops.FixedLeg}[setting](data)


def information(loop: Any) -> np.ndarray:
    """Information matrices (n, q, q) at the nominal, with what is of interest first."""
    return np.asarray(loop.information(loop.start()))


def reached(bound: float, value: float, criterion: str, k: int) -> float:
    """How much of a bound a value reaches, as a ratio of variances."""
    return bound / value if criterion == "A" else float(np.exp((bound - value) / k))


def once(work: Callable[[], object]) -> Callable[[], int]:
    """A peer that solves one problem."""

    def one() -> int:
        work()
        return 1

    return one


def against_free_poses(n: int, repeats: int) -> pd.DataFrame:
    """Candidates with information matrices, against as many random poses of one leg that no limit holds back."""
    table = []
    for setting, lock in LOCKS.items():
        free = partial(hx.simulate_leg, hx.robots.left_hand(), LEG, lock, n, noise=noise(), rng=0)

        def ours(setting: str = setting) -> np.ndarray:
            return information(equation(setting, n))

        times = race(ours, once(free), 1, repeats, unit="ms")
        rate = {"candidates a second": 1e3 * n / times["hexopt, ms"]}
        table.append({"type": setting, "candidates": n, "peer": "simulate_leg, no limits"} | times | rate)
    return pd.DataFrame(table)


def programme(matrices: np.ndarray, k: int, criterion: str) -> tuple[cp.Problem, Callable[[], float]]:
    r"""The relaxation in cvxpy, and how to read its value once it is solved.

    In coordinates in which equal weights have the information I, and in units of what they reach: as it stands,
    Clarabel gives up on D, and ends far from the optimum of A.
    """
    n, q, _ = matrices.shape
    root = np.linalg.inv(np.linalg.cholesky(matrices.sum(axis=0) * (CHOSEN / n)))
    weights = cp.Variable(n, nonneg=True)
    total = cp.reshape((root @ matrices @ root.T).reshape(n, -1).T @ weights, (q, q), order="C")
    total, picked = (total + total.T) / 2, root[:, :k]
    allowed = [weights <= 1, cp.sum(weights) == CHOSEN]
    if criterion == "A":
        unit = float((picked**2).sum())
        problem = cp.Problem(cp.Minimize(cp.matrix_frac(picked / np.sqrt(unit), total)), allowed)
        return problem, lambda: float(problem.value * unit)
    basis, triangle = np.linalg.qr(picked)
    schur = cp.Variable((k, k), PSD=True)
    problem = cp.Problem(cp.Maximize(cp.log_det(schur)), [*allowed, total - basis @ schur @ basis.T >> 0])
    return problem, lambda: float(-problem.value + 2 * np.linalg.slogdet(triangle)[1])


def solved(matrices: np.ndarray, k: int, criterion: str) -> tuple[float, float]:
    """The value that Clarabel ends at, and the seconds in which it did, without cvxpy's; NaN where it fails."""
    problem, value = programme(matrices, k, criterion)
    try:
        problem.solve(solver=cp.CLARABEL)
    except cp.SolverError:
        return np.nan, np.nan
    return value(), float(problem.solver_stats.solve_time)


def plain_exchange(matrices: np.ndarray, k: int, criterion: str, rng: int = 0) -> tuple[np.ndarray, float]:
    """Fedorov's exchange from one random start, as one would write it: indices, and the criterion.

    Every pose of the design in turn gives way to the best candidate, until none helps.
    """
    chosen = np.random.default_rng(rng).permutation(len(matrices))[:CHOSEN]
    while True:
        before = chosen.copy()
        for place in range(CHOSEN):
            kept = np.delete(chosen, place)
            values = SIZES[criterion](np.linalg.inv(matrices[kept].sum(axis=0) + matrices)[:, :k, :k])
            values[kept] = np.inf
            chosen[place] = np.argmin(values)
        if (chosen == before).all():
            return chosen, float(values[chosen[-1]])


def against_clarabel(n: int, repeats: int) -> pd.DataFrame:
    """`select_poses` with one start, most of which is its relaxation, against cvxpy and Clarabel on the relaxation."""
    return pd.DataFrame([_relaxed(setting, criterion, n, repeats) for setting in LOCKS for criterion in CRITERIA])


def _relaxed(setting: str, criterion: str, n: int, repeats: int) -> dict[str, Any]:
    """One row: times, and how far either value is above the proven bound, as a share of variance."""
    loop = equation(setting, n)
    matrices, k = information(loop), loop.parameters.main.size
    ours = partial(hx.select_poses, loop, CHOSEN, criterion, starts=1)
    runs: list[tuple[float, float]] = []
    times = race(ours, once(lambda: runs.append(solved(matrices, k, criterion))), 1, repeats, unit="ms")
    design = ours()
    return {
        "type": setting,
        "criterion": criterion,
        "candidates": n,
        "peer": "cvxpy + Clarabel",
        **times,
        "Clarabel alone, ms": 1e3 * float(np.median([alone for _, alone in runs])),
        "hexopt, above bound": 1 - reached(design.bound, design.relaxed, criterion, k),
        "peer, above bound": 1 - reached(design.bound, runs[0][0], criterion, k),
    }


def against_exchange(few: int, many: int, repeats: int) -> pd.DataFrame:
    """`select_poses` as a whole, against its information matrices alone, and of few against a plain exchange."""
    table = []
    for n in (few, many):
        for setting in LOCKS:
            for criterion in CRITERIA:
                table += _designed(setting, criterion, n, repeats, exchange=n == few)
    return pd.DataFrame(table)


def _designed(setting: str, criterion: str, n: int, repeats: int, *, exchange: bool) -> list[dict[str, Any]]:
    """A row a peer."""
    loop = equation(setting, n)
    matrices, k = information(loop), loop.parameters.main.size
    ours, plain = partial(hx.select_poses, loop, CHOSEN, criterion), partial(plain_exchange, matrices, k, criterion)
    design, rows = ours(), []
    row = {"type": setting, "criterion": criterion, "candidates": n}
    peers: dict[str, tuple[Callable[[], object], float]] = {
        "information matrices alone": (lambda: information(loop), np.nan)
    }
    if exchange:
        peers["plain exchange, one start"] = (plain, reached(design.bound, plain()[1], criterion, k))
    for peer, (work, efficiency) in peers.items():
        times = race(ours, once(work), 1, repeats, unit="ms")
        rows.append(row | {"peer": peer} | times | {"efficiency": design.efficiency, "of the peer": efficiency})
    return rows


def proofs(n: int, limit: float) -> pd.DataFrame:
    """Branch and bound, once each, beside the same call without it."""
    return pd.DataFrame([_proven(setting, criterion, n, limit) for setting in LOCKS for criterion in CRITERIA])


def _proven(setting: str, criterion: str, n: int, limit: float) -> dict[str, Any]:
    """One row: times, and what the design reaches of its own bound."""
    ours = partial(hx.select_poses, equation(setting, n), CHOSEN, criterion)
    found: list[hx.Design] = []
    without = seconds(lambda: found.append(ours()))
    within = seconds(lambda: found.append(ours(prove=limit)))
    return {
        "type": setting,
        "criterion": criterion,
        "candidates": n,
        "without, s": without,
        "with, s": within,
        "ratio": within / without,
        "efficiency without": found[0].efficiency,
        "efficiency": found[1].efficiency,
        "proven": found[1].proven,
        "stopped": found[1].stopped,
    }
