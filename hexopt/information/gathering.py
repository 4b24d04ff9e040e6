"""The information of every pose of a loop or a linear problem."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..arrays import Array, as_array, brief, transpose
from ..errors import InputError, RankDeficientError
from ..loops.implicit import Implicit
from ..numerics.forms import Direct
from ..problem import LinearProblem
from ..result import Estimate
from .before import estimate_information, measured_information
from .matrices import PoseInformation
from .scalars import chosen_scalars, coordinate_units, expected_spreads

__all__ = ["point_of", "pose_information", "scenario_values"]


def pose_information(
    target: Implicit | LinearProblem,
    at: Any = None,
    of: Sequence[str] | None = None,
    spread: Mapping[str, float] | None = None,
    measured: Implicit | Estimate | Sequence[Implicit | Estimate] | None = None,
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
        Blocks of interest; the others are estimated on the way, and must be seen too. By default all that are no
        nuisance. Of several legs "base_point" means that of each.
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
    known = () if measured is None else tuple(measured) if isinstance(measured, (list, tuple)) else (measured,)
    if isinstance(target, LinearProblem):
        if at is not None:
            raise InputError("at: a problem is evaluated where it was made; write loop.linear(at=…), or give the loop")
        blocks, fixed = _of_problem(target)
        places = np.arange(parameters.size)
    else:
        loops = [one for one in known if isinstance(one, Implicit)]
        blocks, fixed = _of_model(target, at, loops)
        units = [np.r_[parameters[name]] for name in _units_of(target)]
        places = np.setdiff1d(np.arange(parameters.size), np.concatenate([np.zeros(0, dtype=int), *units]))
    for one in known:
        if isinstance(one, Estimate):
            fixed = fixed + estimate_information(one, parameters, places, blocks.shape[-1])
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
    names = [
        *(parameters.labels[i] for i in places),
        *np.repeat(_units_of(target), 2),
        *["a shared error"] * len(order),
    ]
    return PoseInformation(
        blocks[..., order[:, None], order] * both,
        fixed[..., order[:, None], order] * both,
        tuple(parameters.labels[i] for i in chosen),
        tuple(units_of[i] for i in chosen),
        sizes[chosen],
        tuple(str(names[i]) for i in order[len(first) :]),
    )


def _units_of(target: Implicit | LinearProblem) -> tuple[str, ...]:
    """The blocks that are unit vectors, with two coordinates each."""
    return target.unit_vectors if isinstance(target, Implicit) else ()


def scenario_values(model: Implicit, at: Any = None) -> Array:
    """Values of every scenario, shape (S, p): of one place or a list of them, by default the start."""
    many = at if isinstance(at, (list, tuple)) and not np.isscalar(at[0] if at else 0.0) else [at]
    return np.concatenate([point_of(model, one).reshape(-1, model.parameters.size) for one in many])


def point_of(model: Implicit, at: Any) -> Array:
    """Values of a loop, (..., p): at a place, or at its start."""
    try:
        values = model.start() if at is None else model.values(at)
    except InputError:
        raise
    except (TypeError, ValueError):
        raise InputError(f"at: expected values, a geometry or an Estimate, got {brief(at)}") from None
    return as_array("at", values, (model.parameters.size,))


def _of_model(model: Implicit, at: Any, measured: Sequence[Implicit]) -> tuple[Array, Array]:
    """Blocks (S, n, m, m) of a loop, and what is there before: (m, m), or (S, m, m)."""
    if model.uncarried:
        raise InputError(f"no information: {model.uncarried}")
    if model.blind_spots:
        unseen = "; ".join(model.blind_spots)
        raise RankDeficientError(f"no choice of poses under this lock sees {unseen}", model.blind_spots)
    stacked = scenario_values(model, at)
    blocks, prior = model.joint_information(stacked)
    return blocks, prior + measured_information(model, stacked, measured)


def _of_problem(problem: LinearProblem) -> tuple[Array, Array]:
    """Blocks (1, n, m, m) and the prior of a linear problem."""
    if not isinstance(problem.form, Direct):
        raise InputError('the rows of a pose stand alone in the direct form only; write loop.linear("direct")')
    if problem.uncarried:
        raise InputError(f"no information: {problem.uncarried}")
    rows, common = problem.with_shared()
    prior = np.diag(np.repeat([0.0, 1.0], [rows.shape[-1], common.shape[-1]]))
    wide = np.concatenate([rows, common], axis=-1).reshape(-1, problem.rows_per_block, len(prior))
    return (transpose(wide) @ wide)[None], prior
