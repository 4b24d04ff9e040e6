"""The rows that poses have, whitened where their noise is known, and where parameters and poses stand in them."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, as_array, brief, norm
from ..errors import InputError
from ..geometry import LENGTH_UNITS
from ..information import point_of
from ..loops.implicit import Implicit, check_errors
from ..loops.rows import shared_places
from ..numerics.forms import Consecutive
from ..parameters import Parameters
from ..problem import LinearProblem

__all__ = ["ObservedRows", "hidden_scalars", "observed_rows"]

UNKNOWN = "the noise is unknown: rows as they are, as of unit standard deviation"
UNPLACED = "the equations do not determine where their noise is evaluated: rows as they are; give at="


@dataclass(frozen=True)
class ObservedRows:
    """Rows of one target at one point.

    Attributes
    ----------
    matrix : ndarray, shape (M, q)
        By free coordinates; those of shared errors, and the rows of their unit variances, last.
    owner : ndarray of int, shape (M,)
        The pose (or difference of poses) of every row; −1 for shared errors.
    per : str
        What owns rows: "pose" or "difference".
    basis : ndarray, shape (p, q)
        Of the free coordinates: parameters by columns.
    places : ndarray of int
        Which scalar each of the first coordinates is; behind them stand unit vectors and shared errors.
    raw : ndarray, shape (M', p')
        The equations' matrix: not whitened, a unit vector counting three.
    lost : ndarray, shape (q,)
        By how much differences shortened each column.
    caveat : str
        Why the rows are not whitened; empty if they are.
    size : float
        Of the robot, from its frame's origins to joints and poses; infinite if that is not known.
    """

    matrix: Array
    owner: npt.NDArray[np.intp]
    per: str
    basis: Array
    places: npt.NDArray[np.intp]
    raw: Array
    lost: Array
    caveat: str
    size: float


def observed_rows(target: Implicit | LinearProblem, at: Any) -> ObservedRows:
    """The rows of a loop or a linear problem of one set, at a point or at its start."""
    if not isinstance(target, (Implicit, LinearProblem)):
        raise InputError(f"expected a loop over the poses, such as FixedDirection(data), got {brief(target)}")
    if target.batch_shape:
        raise InputError(f"expected one set of poses, got a batch of {target.batch_shape}; take one, such as data[0]")
    if target.uncarried:
        raise InputError(f"no information: {target.uncarried}")
    rows = _of_problem(target, at) if isinstance(target, LinearProblem) else _of_model(target, at)
    if not np.isfinite(rows.matrix).all():
        raise InputError("at: the rows of some poses are not finite there; look for values that are NaN")
    return rows


def _of_model(model: Implicit, at: Any) -> ObservedRows:
    """Rows by parameters and shared errors, as the Cramér–Rao bound has them."""
    values = model.chart().normalised(_point(model, at))
    whitened = [part.whitened(values[place]) for part, place in model.parts]
    check_errors(model, values, whitened)
    shared = shared_places(whitened)
    chart = model.chart(shared=shared.count)
    unknowns = np.concatenate([values, np.zeros(shared.count)])
    matrix = model.stacked(whitened, unknowns, chart, shared)[1]
    poses, owner = 0, []
    for part in whitened:
        n, d = part.misclosure.shape[-2:]
        owner.append(np.repeat(np.arange(poses, poses + n), d))
        poses += n
    units = [np.r_[model.parameters[name]] for name in model.unit_vectors]
    places = np.setdiff1d(np.arange(model.parameters.size), np.concatenate([np.zeros(0, dtype=np.intp), *units]))
    return ObservedRows(
        matrix,
        np.concatenate([*owner, np.full(shared.count, -1)]),
        "pose",
        chart.basis(unknowns)[: model.parameters.size],
        places,
        model.direct_rows(values)[1],
        np.ones(matrix.shape[-1]),
        "",
        _size(model, values),
    )


def _of_problem(problem: LinearProblem, at: Any) -> ObservedRows:
    """Rows of any form; what all poses share has columns of its own in the direct one."""
    model = problem.noise if isinstance(problem.noise, Implicit) else None
    if at is not None:
        values = as_array("at", at, (None,), batch=False) if model is None else _point(model, at)
        problem = replace(problem, at=values)
    count = problem.matrix.shape[-1]
    caveat = UNKNOWN
    if problem.noise is not None:
        caveat = "" if np.isfinite(problem.row_covariance().blocks).all() else UNPLACED
    matrix, common = (replace(problem, noise=None) if caveat else problem).with_shared()
    shared = common.shape[-1]
    prior = np.eye(count + shared)[count:]
    return ObservedRows(
        np.concatenate([np.concatenate([matrix, common], axis=-1), prior]),
        np.concatenate([np.arange(len(matrix)) // problem.rows_per_block, np.full(shared, -1)]),
        "difference" if isinstance(problem.form, Consecutive) else "pose",
        np.eye(count, count + shared),
        np.arange(count),
        problem.matrix,
        np.concatenate([problem.cancellation, np.ones(shared)]),
        caveat,
        np.inf if model is None or caveat else _size(model, None),
    )


def _point(model: Implicit, at: Any) -> Array:
    """Values of a loop, (p,): at one place, or at its start."""
    return as_array("at", point_of(model, at), (model.parameters.size,), batch=False)


def _size(model: Implicit, values: Array | None) -> float:
    """The largest distance of a joint or a pose from the origin of its frame."""
    sizes = [float(norm(part.data.position).max()) for part, _ in model.parts]
    if values is not None:
        points = (block for block in model.parameters.main if block.size == 3 and block.unit in LENGTH_UNITS)
        sizes += [float(norm(values[model.parameters[block.name]])) for block in points]
    return max(sizes)


def hidden_scalars(parameters: Parameters, blind_spots: tuple[str, ...]) -> BoolArray:
    """Which scalars stand in blocks that a loop's blind spots name, shape (p,)."""
    said = [set(re.findall(r"\w+", words)) for words in blind_spots]
    hidden = [any(set(block.name.split(".")) <= words for words in said) for block in parameters]
    return np.repeat(hidden, [block.size for block in parameters]).astype(bool)
