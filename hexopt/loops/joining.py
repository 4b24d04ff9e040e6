"""Several loop equations, over different poses, as one linear problem in shared parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import Array, frozen
from ..errors import InputError
from ..numerics.forms import Direct
from ..parameters import Parameters
from ..problem import LinearProblem
from ..result import Estimate
from .base import Loop
from .joined_noise import JoinedNoise, Place
from .parts import Part, check_alike, joined_names, joined_parameters, places_of

__all__ = ["join"]


def join(
    *targets: Loop | LinearProblem, at: npt.ArrayLike | Mapping[str, npt.ArrayLike] | Estimate | None = None
) -> LinearProblem:
    r"""Sets of different poses as one problem: :math:`A_k E_k x \approx y_k`, k = 1, 2, …, one below the other.

    :math:`E_k` picks the parameters of set k. Those of equal name, such as b in Types I and II, are one
    unknown; every set keeps its own nuisance. The covariance of the rows is
    :math:`\mathrm{diag}(S_1, S_2, …) + \sum_c U_c U_c^T`, where c runs over the common errors of the sets,
    each drawn once a set, and the estimates that known values come from: one that several sets take has one error.

    Parameters
    ----------
    *targets : Loop or LinearProblem
        Loops are taken in their direct form; problems must have it. All have as many rows a pose, and all a
        noise model or none. Batches broadcast.
    at : array_like, mapping or Estimate, optional
        Where the noise is evaluated for weights: the joined values (..., p), or by name. By default at
        the unweighted solution of the joined problem.

    Returns
    -------
    LinearProblem
        Of loops of one leg the names stay as they are ("base_point"); of several legs, which their nominals
        number, they are "leg3.base_point". Nuisances that several sets have are "direction.1", "direction.2",
        in the order of the sets. Names of a problem are the caller's.

    Raises
    ------
    InputError
        For sets that have a pose in common, or do not fit each other.
    UnitError
        For parameters of one name in two units.

    Notes
    -----
    Legs seen in the *same* pose share its error, which takes an equation of the whole robot: here
    it would be counted once a leg. The same holds of a known estimate that was made of joined poses.

    Examples
    --------
    A LEG set knows b well; together with a DIRECTION set it improves a too.

    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.NormalNoise(0.01, 1e-4, 0.01)
    >>> one = hx.loops.FixedDirection(hx.simulate_leg(robot, 3, "direction", 7, noise=noise, rng=0))
    >>> two = hx.loops.FixedLeg(hx.simulate_leg(robot, 3, "leg", 20, noise=noise, rng=1))
    >>> both = hx.join(one, two)
    >>> both.parameters.names
    ('platform_point', 'base_point', 'direction', 'fixed_point')
    >>> alone, found = (hx.estimate(part, hx.LeastSquares(weights="model")) for part in (one.linear(), both))
    >>> bool((found.standard_errors[:6] < alone.standard_errors[:6]).all())
    True
    """
    problems = [_direct(target, k) for k, target in enumerate(targets, start=1)]
    if not problems:
        raise InputError("join: expected loops or direct linear problems, got nothing; write join(one, two)")
    parts = [
        Part(target, f"argument {k} ({problem.name})", problem)
        for k, (target, problem) in enumerate(zip(targets, problems, strict=True), start=1)
    ]
    _check_rows(parts)
    check_alike("join", parts)
    names = joined_names("join", parts)
    parameters = joined_parameters("join", parts, names)
    places = places_of(parts, names, parameters)
    matrix, rhs, lost = _stacked(problems, places, parameters.size)
    counted = Counter(problem.name for problem in problems)
    noises = tuple(problem.noise for problem in problems if problem.noise is not None)
    return LinearProblem(
        matrix,
        rhs,
        parameters,
        rows_per_block=problems[0].rows_per_block,
        noise=JoinedNoise(noises, places) if noises else None,
        at=None if at is None else _values(at, parameters),
        cancellation=lost,
        name="join of " + ", ".join(f"{k} {name}" if k > 1 else name for name, k in counted.items()),
        uncarried="; ".join(dict.fromkeys(problem.uncarried for problem in problems if problem.uncarried)),
    )


def _direct(target: Loop | LinearProblem, k: int) -> LinearProblem:
    """The direct problem of argument k."""
    if isinstance(target, (list, tuple)):
        raise InputError(f"join: argument {k} is a {type(target).__name__}; write join(*loops)")
    if not isinstance(target, (Loop, LinearProblem)):
        raise InputError(f"join: argument {k}: expected a loop or a LinearProblem, got {type(target).__name__}")
    problem = target.linear() if isinstance(target, Loop) else target
    label = f"argument {k} ({problem.name})"
    if not isinstance(problem.form, Direct):
        form = type(problem.form).__name__.lower()
        raise InputError(f"join: {label} has the form {form!r}, expected 'direct'; join the loop, or its .linear()")
    if problem.at is not None:
        raise InputError(f"join: {label} has its own at=; leave it out, and give at= to join, for all parameters")
    return problem


def _check_rows(parts: Sequence[Part]) -> None:
    """As many rows a pose in all parts."""
    first = parts[0]
    for part in parts[1:]:
        if first.rows != part.rows:
            raise InputError(
                f"join: {first.label} has {first.rows} rows a pose, {part.label} has {part.rows}; "
                "join sets with as many"
            )


def _stacked(problems: Sequence[LinearProblem], places: Sequence[Place], size: int) -> tuple[Array, Array, Array]:
    """Matrix, right-hand side and cancellation of the joined problem."""
    batch = np.broadcast_shapes(*(problem.batch_shape for problem in problems))
    rows = sum(problem.rhs.shape[-1] for problem in problems)
    matrix, rhs, lost = np.zeros((*batch, rows, size)), np.empty((*batch, rows)), np.ones((*batch, size))
    silent = np.zeros(batch, dtype=bool)
    start = 0
    for problem, place in zip(problems, places, strict=True):
        stop = start + problem.rhs.shape[-1]
        matrix[..., start:stop, place] = problem.matrix
        rhs[..., start:stop] = problem.rhs
        lost[..., place] = np.maximum(lost[..., place], problem.cancellation)
        silent |= ~problem.matrix.any(axis=(-2, -1))  # a known value of this set failed: so does the joined one, alone
        start = stop
    matrix[silent], rhs[silent], lost[silent] = 0.0, 0.0, 1.0
    return frozen(matrix), frozen(rhs), lost


def _values(at: npt.ArrayLike | Mapping[str, npt.ArrayLike] | Estimate, parameters: Parameters) -> Array:
    """The joined vector of values behind `at`."""
    given = at.params if isinstance(at, Estimate) else at
    if not isinstance(given, Mapping):
        vector = np.asarray(given, dtype=float)
        if vector.shape[-1:] != (parameters.size,):
            raise InputError(
                f"at: expected {parameters.size} values ({', '.join(parameters.names)}), got {vector.shape}"
            )
        return vector
    if set(given) != set(parameters.names):
        raise InputError(f"at: expected {', '.join(parameters.names)}; got {', '.join(given)}")
    arrays = [np.atleast_1d(np.asarray(given[block.name], dtype=float)) for block in parameters]
    for array, block in zip(arrays, parameters, strict=True):
        if array.shape[-1] != block.size:
            raise InputError(f"at: {block.name}: expected shape (..., {block.size}), got {array.shape}")
    shape = np.broadcast_shapes(*(array.shape[:-1] for array in arrays))
    return np.concatenate([np.broadcast_to(array, (*shape, array.shape[-1])) for array in arrays], axis=-1)
