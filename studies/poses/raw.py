r"""Designs by the condition number of the matrix as it is: columns in their own units, rows without weights.

That is what is meant where the condition number of an identification matrix is to be made small. Of the locks there are
two such matrices, the consecutive differences of the paper, and the direct rows with their nuisance; of a free leg the
derivatives of its length. Nothing in hexopt designs by them, so the exchange of poses is here.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from studies.poses.data import Case
from studies.poses.scenarios import Array

__all__ = ["condition", "paper_rows", "raw_rows", "smallest"]

SWEEPS = 20
METRES = {"m": 1.0, "cm": 1e-2, "um": 1e-6}
#: Powers of length that unknowns have, where these are not lengths: those of the direct rows and of the gain.
DIMENSIONS = {"direction": 0, "gain": 0, "sphere": 2}


def paper_rows(case: Case, loop: Any) -> Array:
    """Equation (5) of the paper, and its kin."""
    matrix: Array = loop.linear("consecutive").matrix
    return matrix


def raw_rows(case: Case, loop: Any, unit: str = "") -> Array:
    """One block of rows a pose, with the nuisance as unknowns, and lengths in some unit: by default the robot's."""
    if case.setting in ("free", "gain"):
        parameters, jacobian = loop.parameters, loop.jacobian(case.leg)
        matrix: Array = jacobian.reshape(*jacobian.shape[:-3], -1, jacobian.shape[-1])
    else:
        problem = loop.linear("direct")
        parameters, matrix = problem.parameters, problem.matrix
    scale = METRES[case.leg.length_unit] / METRES[unit or case.leg.length_unit]
    powers = np.concatenate([[DIMENSIONS.get(block.name, 1)] * block.size for block in parameters])
    return matrix * scale ** (1.0 - powers)


def condition(matrix: Array) -> Array:
    """The ratio of the extreme singular values of matrices (..., rows, columns)."""
    values = np.linalg.svd(matrix, compute_uv=False)
    smallest = np.where(values[..., -1] > 0, values[..., -1], 1.0)
    return np.where(values[..., -1] > 0, values[..., 0] / smallest, np.inf)


def smallest(case: Case, rows: Any, n: int, rng: np.random.Generator) -> Array:
    """Indices (n,) whose matrix has a small condition number: pose by pose the best exchange, until none helps."""
    count = case.pool.n_poses
    chosen = rng.choice(count, n, replace=False)
    value = np.inf
    for _ in range(SWEEPS):
        before = value
        for place in range(n):
            others = np.delete(chosen, place)
            tried = np.repeat(chosen[None], count, axis=0)
            tried[:, place] = np.arange(count)
            values = condition(rows(case, case.loop(case.poses(tried))))
            values[others] = np.inf
            if values.min() < value:
                chosen, value = tried[values.argmin()], float(values.min())
        if value >= before * (1 - 1e-6):
            break
    return np.asarray(chosen)
