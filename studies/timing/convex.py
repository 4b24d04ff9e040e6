"""Times the convex family against cvxpy, statsmodels and SciPy, problem by problem, in the same run on one thread."""

from __future__ import annotations

import statistics
import warnings
from collections.abc import Callable
from typing import Any

import cvxpy as cp
import numpy as np
import pandas as pd

import hexopt as hx
from studies.timing.nonlinear import seconds

#: Rows, unknowns and rows a pose: Type I consecutive at N = 15, and its direct form.
SHAPES = ((42, 6, 3), (45, 9, 3))
HUBER, GROUP = 1.345, 2.5
TIGHT = 1e-12  # Clarabel's tolerances where cvxpy's answer is to be as good as ours
RADIUS = 0.05  # of the box, so that about half of the problems touch it


def rows(n_problems: int, m: int, p: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Whitened random rows around the solution zero, 5 % of their poses bad by 10 to 100 σ."""
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(n_problems, m, p))
    noise = rng.normal(size=(n_problems, m // 3, 3))
    bad = rng.uniform(size=(n_problems, m // 3)) < 0.05
    noise[bad] += rng.normal(size=(int(bad.sum()), 3)) * rng.uniform(10, 100, size=(int(bad.sum()), 1))
    return matrix, noise.reshape(n_problems, m)


def programmes(m: int, p: int) -> dict[str, tuple[Any, Callable[[cp.Expression], cp.Expression], bool]]:
    """Each estimator beside the same objective in cvxpy, and whether it has a box."""
    parameters = hx.Parameters((hx.Block("x", p, "cm"),))
    assert parameters.size == p
    box = hx.Box({"x": (-RADIUS, RADIUS)})

    def family(loss: hx.Quadratic, **settings: object) -> hx.ConvexEstimator:
        return hx.ConvexEstimator(loss, weights=None, scale=1.0, **settings)

    def blocks(z: cp.Expression) -> cp.Expression:
        return cp.norm(cp.reshape(z, (m // 3, 3), order="C"), 2, axis=1)

    def least(z: cp.Expression) -> cp.Expression:
        return 0.5 * cp.sum_squares(z)

    return {
        "Quadratic": (family(hx.Quadratic()), least, False),
        "Quadratic, values and gap only": (family(hx.Quadratic(), covariance=False), least, False),
        "LeastSquares, values and gap only": (hx.LeastSquares(covariance=False), least, False),
        "Quadratic in a box": (family(hx.Quadratic(), bounds=box), least, True),
        "Huber": (family(hx.Huber(HUBER)), lambda z: 0.5 * cp.sum(cp.huber(z, HUBER)), False),
        "GroupHuber": (family(hx.GroupHuber(GROUP)), lambda z: 0.5 * cp.sum(cp.huber(blocks(z), GROUP)), False),
        "L1": (family(hx.L1()), cp.norm1, False),
        "Chebyshev": (family(hx.Chebyshev()), cp.norm_inf, False),
    }


def against_cvxpy(n_problems: int, repeats: int) -> pd.DataFrame:
    """A batch of hexopt against re-solves of one cvxpy problem with parameters (DPP) by Clarabel."""
    table = []
    for m, p, size in SHAPES:
        matrix, rhs = rows(n_problems, m, p, seed=1)
        problem = hx.LinearProblem(matrix, rhs, hx.Parameters((hx.Block("x", p, "cm"),)), rows_per_block=size)
        for name, (estimator, objective, boxed) in programmes(m, p).items():
            row = {"rows × unknowns": f"{m} × {p}", "estimator": name}
            table.append(row | _race(problem, estimator, objective, boxed, repeats))
    return pd.DataFrame(table)


def _race(
    problem: hx.LinearProblem,
    estimator: hx.ConvexEstimator,
    objective: Callable[[cp.Expression], cp.Expression],
    boxed: bool,
    repeats: int,
) -> dict[str, float]:
    """cvxpy at its defaults, cvxpy at a tight tolerance, and hexopt, in turn."""
    count, m, p = problem.matrix.shape
    few = max(count // 100, 10)
    a, y, x = cp.Parameter((m, p)), cp.Parameter(m), cp.Variable(p)
    posed = cp.Problem(cp.Minimize(objective(a @ x - y)), [x >= -RADIUS, x <= RADIUS] if boxed else [])
    assert posed.is_dpp()

    def slow(**settings: float) -> None:
        for one, right in zip(problem.matrix[:few], problem.rhs[:few], strict=True):
            a.value, y.value = one, right
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # "may be inaccurate", at the tight tolerance
                posed.solve(solver=cp.CLARABEL, **settings)

    def exact() -> None:
        slow(tol_gap_abs=TIGHT, tol_gap_rel=TIGHT, tol_feas=TIGHT)

    def fast() -> None:
        hx.estimate(problem, estimator)

    slow()
    proven = float(np.mean(hx.estimate(problem, estimator).ok))
    runs = [(seconds(slow) / few, seconds(exact) / few, seconds(fast) / count) for _ in range(repeats)]
    return {
        "cvxpy, µs": 1e6 * statistics.median(run[0] for run in runs),
        "at 1e-12, µs": 1e6 * statistics.median(run[1] for run in runs),
        "hexopt, µs": 1e6 * statistics.median(run[2] for run in runs),
        "ratio (median)": statistics.median(run[0] / run[2] for run in runs),
        "at 1e-12": statistics.median(run[1] / run[2] for run in runs),
        "proven": proven,
    }


def against_loops(n_problems: int, repeats: int) -> pd.DataFrame:
    """A batch of hexopt against loops over statsmodels' RLM (Huber) and SciPy's lsq_linear (box)."""
    import statsmodels.api as sm
    from scipy.optimize import lsq_linear

    m, p, size = SHAPES[0]
    matrix, rhs = rows(n_problems, m, p, seed=2)
    problem = hx.LinearProblem(matrix, rhs, hx.Parameters((hx.Block("x", p, "cm"),)), rows_per_block=size)
    few = max(n_problems // 50, 10)

    def huber() -> None:
        for one, right in zip(matrix[:few], rhs[:few], strict=True):
            sm.RLM(right, one, M=sm.robust.norms.HuberT(HUBER)).fit()

    def box() -> None:
        for one, right in zip(matrix[:few], rhs[:few], strict=True):
            lsq_linear(one, right, (-RADIUS, RADIUS))

    known = hx.ConvexEstimator(hx.Huber(HUBER), weights=None, scale=1.0)
    robust = hx.ConvexEstimator(hx.Huber(HUBER), weights=None, scale="mad")
    boxed = hx.ConvexEstimator(bounds=hx.Box({"x": (-RADIUS, RADIUS)}), weights=None, scale=1.0)
    table = []
    for peer, work, estimator in (
        ("statsmodels RLM, Huber; ours with σ known", huber, known),
        ("statsmodels RLM, Huber; ours with the MAD of an L1 fit", huber, robust),
        ("scipy lsq_linear, box", box, boxed),
    ):

        def fast(estimator: hx.ConvexEstimator = estimator) -> hx.Estimate:
            return hx.estimate(problem, estimator)

        work()
        fast()
        pairs = [(seconds(work) / few, seconds(fast) / n_problems) for _ in range(repeats)]
        table.append(
            {
                "peer": peer,
                "peer, µs": 1e6 * statistics.median(one for one, _ in pairs),
                "hexopt, µs": 1e6 * statistics.median(two for _, two in pairs),
                "ratio (median of pairs)": statistics.median(one / two for one, two in pairs),
            }
        )
    return pd.DataFrame(table)
