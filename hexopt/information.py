r"""The information that poses bring, in the coordinates that choices of poses work in.

:math:`M(w) = M_0 + \sum_i w_i M_i`, with the parameters of interest first, in units of their expected spread, and all
that is estimated on the way (nuisances, shared errors) behind them. The covariance of what is of interest is
:math:`C(w) = K^T M(w)^{-1} K`, :math:`K = [I\;0]^T`: the inverse of the Schur complement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from .arrays import Array, BoolArray, as_array, brief, frozen, transpose
from .errors import InputError, RankDeficientError
from .loops.clamps import clamp_difference
from .loops.implicit import Implicit
from .numerics.forms import Direct
from .numerics.lstsq import null_combinations
from .parameters import Block, Parameters
from .problem import LinearProblem
from .result import Estimate

__all__ = [
    "PoseInformation",
    "chosen_scalars",
    "coordinate_units",
    "expected_spreads",
    "inverse_root",
    "main_covariance",
    "pose_information",
    "scenario_values",
]

#: Eigenvalues of M(w), with a unit diagonal, below this are rounding: the poses do not see all parameters.
RANK = 1e-12


@dataclass(frozen=True, eq=False)
class PoseInformation:
    r"""Information of n poses about m coordinates, of which the first k are of interest, in S scenarios.

    Attributes
    ----------
    blocks : ndarray, shape (S, n, m, m)
        :math:`M_i` of every pose.
    fixed : ndarray, shape (S, m, m)
        :math:`M_0`, what is there before.
    labels, units : tuple of str
        The k scalars of interest.
    spread : ndarray, shape (k,)
        The unit of each coordinate of interest: its parameter's expected spread.
    """

    blocks: Array
    fixed: Array
    labels: tuple[str, ...]
    units: tuple[str, ...]
    spread: Array

    def __post_init__(self) -> None:
        for name in ("blocks", "fixed", "spread"):
            object.__setattr__(self, name, frozen(np.ascontiguousarray(getattr(self, name))))

    @property
    def n_poses(self) -> int:
        """n."""
        return int(self.blocks.shape[-3])

    @property
    def size(self) -> int:
        """m, all coordinates."""
        return int(self.blocks.shape[-1])

    @property
    def main(self) -> int:
        """k, those of interest, which stand first."""
        return len(self.labels)

    def take(self, index: Any) -> Self:
        """Some of the poses."""
        return replace(self, blocks=self.blocks[:, index])

    def total(self, weights: npt.NDArray[Any]) -> Array:
        r""":math:`M(w)` of weights (n,), shape (S, m, m)."""
        used = np.flatnonzero(weights)
        blocks = self.blocks if len(used) == len(weights) else self.blocks[:, used]
        return self.fixed + (weights[used] @ blocks.reshape(*blocks.shape[:2], self.size**2)).reshape(self.fixed.shape)

    def unseen(self, total: Array) -> tuple[str, ...]:
        """What one singular information matrix (m, m) does not see, in words."""
        scale = np.sqrt(np.diag(total))
        safe = np.where(scale > 0, scale, 1.0)
        scaled = total / safe[:, None] / safe
        lost = int((np.linalg.eigvalsh(scaled) <= RANK).sum())
        scalars = Parameters(tuple(Block(label, 1, unit) for label, unit in zip(self.labels, self.units, strict=True)))
        words = []
        for vector in null_combinations(scaled, threshold=0.05, at_least=max(lost, 1)) / safe:
            main = vector[: self.main] * self.spread
            words.append(scalars.combination(main) if np.abs(main).max() > 0 else "something estimated on the way")
        return tuple(words)

    def covariance(self, weights: Array) -> Array:
        r""":math:`K^T M(w)^{-1} K`, shape (S, k, k), in units of the spread; infinite where M(w) is singular."""
        return main_covariance(self.total(weights), self.main)


def inverse_root(total: Array) -> tuple[Array, BoolArray]:
    r"""R with :math:`R R^T = M^{-1}` for matrices (..., m, m), and which of them have an inverse, shape (...)."""
    scale = np.sqrt(np.einsum("...ii->...i", total))
    safe = np.where(scale > 0, scale, 1.0)
    scaled = total / safe[..., :, None] / safe[..., None, :]
    finite: BoolArray = np.asarray(np.isfinite(scaled).all(axis=(-2, -1)))
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], scaled, 0.0))
    seen = (values[..., 0] > RANK) & finite
    return vectors / np.sqrt(np.where(seen[..., None], values, 1.0))[..., None, :] / safe[..., None], seen


def main_covariance(total: Array, main: int) -> Array:
    """The first k rows and columns of the inverses of (..., m, m); infinite on the diagonal where there is none."""
    root, seen = inverse_root(total)
    root = root[..., :main, :]
    return np.where(seen[..., None, None], root @ transpose(root), np.diag(np.full(main, np.inf)))


def pose_information(
    target: Implicit | LinearProblem,
    at: Any = None,
    of: Sequence[str] | None = None,
    spread: Mapping[str, float] | None = None,
    measured: Implicit | Estimate | Sequence[Implicit | Estimate] = (),
) -> PoseInformation:
    r"""Information :math:`M_i = J_i^T J_i` of every pose, :math:`J_i` its whitened rows by scaled coordinates.

    Parameters
    ----------
    target : loop or LinearProblem
        One set of poses. A problem is taken in its direct form, with the rows as they are where their noise is
        unknown: unit standard deviations.
    at : values, geometry or Estimate, or a list of them, optional
        Where it is evaluated; several are scenarios. By default the target's start: as a rule its nominal.
    of : sequence of str, optional
        Blocks of interest; the others are estimated on the way. By default all that are no nuisance. Of several
        legs "base_point" means that of each.
    spread : dict of str to float, optional
        Expected spread of blocks by name, in their units; by default their ``scale``, 1.
    measured : loop or Estimate, or a list of them, optional
        What is known before: poses under the same clamp, as the same loop over them, with which the candidates share
        nuisance and shared errors; or an estimate from elsewhere, of which the parameters that are no nuisance count.

    Returns
    -------
    PoseInformation

    Raises
    ------
    InputError
        For a batch of sets, unknown names, no noise model, or values that are not finite.
    RankDeficientError
        If the lock hides parameters, whatever the poses.
    """
    if not isinstance(target, (Implicit, LinearProblem)):
        raise InputError(f"expected a loop over the poses, such as FixedDirection(data), got {brief(target)}")
    parameters = target.parameters
    main = chosen_scalars(parameters, of)
    sizes = expected_spreads(parameters, spread)
    if target.batch_shape:
        raise InputError(f"expected one set of poses, got a batch of {target.batch_shape}; take one, such as data[0]")
    known = tuple(measured) if isinstance(measured, (list, tuple)) else (measured,)
    if isinstance(target, LinearProblem):
        blocks, fixed = _of_problem(target)
        places = np.arange(parameters.size)
    else:
        loops = [one for one in known if isinstance(one, Implicit)]
        blocks, fixed = _of_model(target, at, loops)
        units = [np.r_[parameters[name]] for name in target.unit_vectors]
        places = np.setdiff1d(np.arange(parameters.size), np.concatenate([np.zeros(0, dtype=int), *units]))
    for one in known:
        if isinstance(one, Estimate):
            fixed = fixed + _of_estimate(one, parameters, places, blocks.shape[-1])
        elif isinstance(target, LinearProblem) or not isinstance(one, Implicit):
            raise InputError(
                f"measured: expected a loop like that over the candidates, or an Estimate; got {brief(one)}"
            )
    if not np.isfinite(blocks).all():
        raise InputError("at: the information of some poses is not finite there; look for values that are NaN")
    first = np.flatnonzero(main[places])
    order = np.concatenate([first, np.setdiff1d(np.arange(blocks.shape[-1]), first)])
    fixed = np.broadcast_to(fixed, (len(blocks), *fixed.shape[-2:]))
    diagonal = np.einsum("snii->i", blocks) + np.einsum("sii->i", fixed)
    scale = coordinate_units(np.sqrt(diagonal), first, sizes[places[first]])
    order_scale = scale[order]
    both = order_scale[:, None] * order_scale
    units_of = [block.unit for block in parameters for _ in range(block.size)]
    chosen = places[first]
    return PoseInformation(
        blocks[..., order[:, None], order] * both,
        fixed[..., order[:, None], order] * both,
        tuple(parameters.labels[i] for i in chosen),
        tuple(units_of[i] for i in chosen),
        sizes[chosen],
    )


def coordinate_units(lengths: Array, main: npt.NDArray[np.intp], spread: Array) -> Array:
    """The unit of every coordinate, from the lengths of columns, both (q,).

    Of interest, the expected spread; of the others what makes their columns as long as those of interest are in root
    mean square: a condition number is to say nothing of the units of nuisances.
    """
    mean = float(np.sqrt(np.square(lengths[main] * spread).mean()))
    units = (mean or 1.0) / np.where(lengths > 0, lengths, 1.0)
    units[main] = spread
    return units


def scenario_values(model: Implicit, at: Any = None) -> Array:
    """Values of every scenario, shape (S, p): of one place or a list of them, by default the start."""
    many = at if isinstance(at, (list, tuple)) and not np.isscalar(at[0] if at else 0.0) else [at]
    values = [model.start() if one is None else model.values(one) for one in many]
    return np.concatenate([value.reshape(-1, model.parameters.size) for value in values])


def _of_model(model: Implicit, at: Any, measured: Sequence[Implicit]) -> tuple[Array, Array]:
    """Blocks (S, n, m, m) of a loop, and what is there before: (m, m), or (S, m, m)."""
    if model.uncarried:
        raise InputError(f"no information: {model.uncarried}")
    if model.blind_spots:
        unseen = "; ".join(model.blind_spots)
        raise RankDeficientError(f"no choice of poses under this lock sees {unseen}", model.blind_spots)
    stacked = scenario_values(model, at)
    blocks, fixed = model.joint_information(stacked)
    for other in measured:
        _check_same_clamp(model, other)
        fixed = fixed + model.joint_information(stacked, over=other)[0].sum(axis=-3)
    return blocks, fixed


def _check_same_clamp(model: Implicit, measured: Implicit) -> None:
    """The poses that were measured share the nuisance of the candidates, as far as a nominal can tell."""
    if measured.batch_shape:
        raise InputError(f"measured: expected one set of poses, got a batch of {measured.batch_shape}")
    if type(measured) is not type(model) or measured.parameters.names != model.parameters.names:
        raise InputError(
            f"measured: expected {type(model).__name__} of {', '.join(model.parameters.names)}, as over the "
            f"candidates; got {type(measured).__name__} of {', '.join(measured.parameters.names)}"
        )
    for (part, _), (other, _) in zip(model.parts, measured.parts, strict=True):
        difference = clamp_difference(part.data, other.data)
        if difference:
            raise InputError(
                f"measured: is on another clamp than the candidates: {difference}; make candidates on the clamp that "
                "is set (given=…), or give the estimate from those poses instead"
            )


def _of_estimate(found: Estimate, parameters: Parameters, places: npt.NDArray[np.intp], size: int) -> Array:
    """The information (m, m) that an estimate is of the parameters that are no nuisance."""
    names = [name for name in found.parameters.main.names if name in parameters.main.names]
    if not names or found.batch_shape or not found.ok:
        raise InputError(
            f"measured: expected a successful estimate of one set, of some of {', '.join(parameters.main.names)}; "
            f"got {', '.join(found.parameters.names)}"
            + (f" of a batch of {found.batch_shape}" if found.batch_shape else "")
        )
    covariance = found.covariance_of(*names)
    where = np.searchsorted(places, np.concatenate([np.r_[parameters[name]] for name in names]))
    out = np.zeros((size, size))
    out[where[:, None], where] = np.linalg.inv(covariance)
    return out


def _of_problem(problem: LinearProblem) -> tuple[Array, Array]:
    """Blocks (1, n, m, m) and the prior of a linear problem."""
    if not isinstance(problem.form, Direct):
        raise InputError('the rows of a pose stand alone in the direct form only; write loop.linear("direct")')
    if problem.uncarried:
        raise InputError(f"no information: {problem.uncarried}")
    rows, common = problem.matrix, np.zeros((len(problem.matrix), 0))
    if problem.noise is not None:
        root, shared = problem.whitening(shared=False), problem.row_covariance().common
        rows = root.apply(rows)
        if shared is not None:
            common = root.apply(shared.reshape(len(rows), -1))
    prior = np.diag(np.repeat([0.0, 1.0], [rows.shape[-1], common.shape[-1]]))
    wide = np.concatenate([rows, common], axis=-1).reshape(-1, problem.rows_per_block, len(prior))
    return (transpose(wide) @ wide)[None], prior


def _named(argument: str, parameters: Parameters, given: str) -> list[str]:
    """The blocks that are meant: by their name, or by their name without the leg."""
    known = parameters.main.names
    found = [name for name in known if given in (name, name.rpartition(".")[2])]
    if not found:
        raise InputError(f"{argument}: unknown parameter {given!r}; this problem has {', '.join(known)}")
    return found


def chosen_scalars(parameters: Parameters, of: Sequence[str] | None) -> BoolArray:
    """Which scalars are of interest, shape (p,)."""
    names = parameters.main.names if of is None else (of,) if isinstance(of, str) else tuple(of)
    if not names:
        raise InputError("of: no parameter is of interest; name some, or leave it out")
    wanted = {name for given in names for name in _named("of", parameters, given)}
    return np.repeat([block.name in wanted for block in parameters], [block.size for block in parameters])


def expected_spreads(parameters: Parameters, spread: Mapping[str, float] | None) -> Array:
    """The expected spread of every scalar, shape (p,)."""
    sizes = np.array(parameters.scale)
    for given, value in (spread or {}).items():
        named = _named("spread", parameters, given)
        size = float(as_array(f"spread[{given!r}]", value, (), batch=False))
        if size <= 0:
            raise InputError(f"spread[{given!r}]: expected an expected spread > 0, got {size}")
        for name in named:
            sizes[parameters[name]] = size
    return sizes
