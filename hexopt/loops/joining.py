"""Several loop equations, over different poses, as one linear problem in shared parameters."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import Array, frozen
from ..errors import InputError, UnitError
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements
from ..numerics.forms import Direct
from ..parameters import Block, Parameters
from ..problem import LinearProblem, RowNoise
from ..result import Estimate
from .base import Loop
from .joined_noise import JoinedNoise, Place

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
    parts = _parts(targets)
    _check_alike(parts)
    _check_poses(parts)
    renamed = _renamed(parts)
    parameters = _parameters(parts, renamed)
    index = np.arange(parameters.size)
    places = [np.concatenate([index[parameters[name]] for name in names.values()]) for names in renamed]
    problems = [part.problem for part in parts]
    matrix, rhs, lost = _stacked(problems, places, parameters.size)
    counted = Counter(problem.name for problem in problems)
    noises = tuple(problem.noise for problem in problems if problem.noise is not None)
    return LinearProblem(
        matrix,
        rhs,
        parameters,
        rows_per_block=problems[0].rows_per_block,
        noise=JoinedNoise(noises, tuple(places)) if noises else None,
        at=None if at is None else _values(at, parameters),
        cancellation=lost,
        name="join of " + ", ".join(f"{k} {name}" if k > 1 else name for name, k in counted.items()),
        uncarried="; ".join(dict.fromkeys(problem.uncarried for problem in problems if problem.uncarried)),
    )


# --- the parts, checked ---------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """One argument: its direct problem, the measurements behind it as far as they are known, and what it is called."""

    problem: LinearProblem
    data: tuple[LegMeasurements, ...]
    is_loop: bool
    label: str

    @property
    def legs(self) -> set[int]:
        """The numbers of the legs that were measured, as far as they are known."""
        return {data.nominal.number for data in self.data if data.nominal is not None}


def _parts(targets: Sequence[Loop | LinearProblem]) -> list[_Part]:
    if not targets:
        raise InputError("join: expected loops or direct linear problems, got nothing; write join(one, two)")
    parts = []
    for k, target in enumerate(targets, start=1):
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
        data = (target.data,) if isinstance(target, Loop) else _data(problem.noise)
        parts.append(_Part(problem, data, isinstance(target, Loop), label))
    return parts


def _data(noise: RowNoise | None) -> tuple[LegMeasurements, ...]:
    """The measurements that a noise model is of, where it is a loop's."""
    if isinstance(noise, JoinedNoise):
        return tuple(data for part in noise.noises for data in _data(part))
    return (noise.data,) if isinstance(noise, Loop) else ()


def _check_alike(parts: Sequence[_Part]) -> None:
    """Rows, noise, units and batches that fit."""
    first = parts[0]
    for part in parts[1:]:
        one, two = first.problem.rows_per_block, part.problem.rows_per_block
        if one != two:
            raise InputError(
                f"join: {first.label} has {one} rows a pose, {part.label} has {two}; join sets with as many"
            )
    silent = [part.label for part in parts if part.problem.noise is None]
    if 0 < len(silent) < len(parts):
        raise InputError(f"join: {', '.join(silent)}: no noise model, the others have one; give all noise=…, or none")
    units = sorted({data.length_unit for part in parts for data in part.data})
    if len(units) > 1:
        raise UnitError(f"join: the sets are in {' and '.join(units)}; convert them to one unit")
    shapes = [part.problem.batch_shape for part in parts]
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(f"join: the batches {', '.join(map(str, shapes))} do not fit each other") from None


def _check_poses(parts: Sequence[_Part]) -> None:
    """No pose stands twice: its error would count twice."""
    for i, two in enumerate(parts):
        for one in parts[:i]:
            same = any(_share_a_pose(a, b) for a in one.data for b in two.data)
            if not (one.data and two.data):  # then only the equations can tell
                same = all(np.array_equal(getattr(one.problem, k), getattr(two.problem, k)) for k in ("rhs", "matrix"))
            if same:
                raise InputError(
                    f"join is for different poses: {one.label} and {two.label} have a pose in common; give each pose "
                    "once. Legs seen in the same pose share its error: they belong in one WholeRobot equation"
                )


def _share_a_pose(one: LegMeasurements, two: LegMeasurements) -> bool:
    """Whether some pose of a set is, to the bit, one of the other set (of the same member of the batch)."""
    for i in range(two.n_poses):
        same = (one.position == two.position[..., i : i + 1, :]).all(axis=-1)
        if same.any() and (same & (one.rotation == two.rotation[..., i : i + 1, :, :]).all(axis=(-2, -1))).any():
            return True
    return False


# --- names and places -----------------------------------------------------------------------------


def _renamed(parts: Sequence[_Part]) -> list[dict[str, str]]:
    """The joined name of every block, for each part."""
    several = len(set().union(*(part.legs for part in parts))) > 1
    prefixes = [_prefix(part) if several else "" for part in parts]
    names = [
        {block.name: prefix + block.name for block in part.problem.parameters}
        for part, prefix in zip(parts, prefixes, strict=True)
    ]
    owned = [
        (own, block.name)
        for own, part in zip(names, parts, strict=True)
        for block in part.problem.parameters
        if block.nuisance
    ]
    count, seen = Counter(own[name] for own, name in owned), Counter[str]()
    for own, name in owned:
        joined = own[name]
        seen[joined] += 1
        if count[joined] > 1:
            own[name] = f"{joined}.{seen[joined]}"
    return names


def _prefix(part: _Part) -> str:
    """What stands before the names of one of several legs; the names of a problem are the caller's."""
    if part.is_loop:
        if not part.legs:
            raise InputError(
                f"join: which leg is {part.label}? other loops are of several legs; give its data nominal=robot.leg(k)"
            )
        return f"leg{min(part.legs)}."
    bare = [name for name in part.problem.parameters.names if name in LEG_BLOCKS]
    if part.legs and bare:
        legs = " and ".join(map(str, sorted(part.legs)))
        raise InputError(
            f"join: {part.label} is of leg {legs} beside other legs, but has the bare name {bare[0]}; give join the "
            f"loops themselves, whose names become leg{min(part.legs)}.{bare[0]} and so on"
        )
    return ""


def _parameters(parts: Sequence[_Part], renamed: Sequence[Mapping[str, str]]) -> Parameters:
    """The joined blocks: leg by leg in a leg's order, then the nuisances in the order of the sets."""
    blocks: dict[str, Block] = {}
    for part, names in zip(parts, renamed, strict=True):
        for own in part.problem.parameters:
            block = Block(names[own.name], own.size, own.unit, own.scale, own.nuisance)
            other = blocks.setdefault(block.name, block)
            if (other.size, other.nuisance) != (block.size, block.nuisance) or (other is not block and block.nuisance):
                raise InputError(
                    f"join: {block.name} of {part.label} is not what another set calls so: {block} and {other}; "
                    "give one of them another name"
                )
            if other.unit != block.unit:
                raise UnitError(f"join: {block.name} is in {other.unit}, and in {block.unit} in {part.label}")
    main = [block for block in blocks.values() if not block.nuisance]
    order, owners = list(LEG_BLOCKS), list(dict.fromkeys(block.name.rpartition(".")[0] for block in main))

    def rank(block: Block) -> tuple[int, int]:
        owner, _, bare = block.name.rpartition(".")
        return owners.index(owner), order.index(bare) if bare in order else len(order)

    return Parameters((*sorted(main, key=rank), *(block for block in blocks.values() if block.nuisance)))


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
