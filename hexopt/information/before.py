"""What is known before: poses that were measured on the clamp, and estimates from elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError, UnitError
from ..loops.clamps import clamp_difference
from ..loops.implicit import Implicit
from ..loops.set_equation import SetEquation
from ..parameters import Parameters
from ..result import Estimate
from .matrices import inverse_root

__all__ = ["estimate_information", "measured_information"]


def measured_information(model: Implicit, values: Array, measured: Sequence[Implicit]) -> Array:
    """The information (S, m, m) of poses on the clamps of the candidates, at values (S, p) of these."""
    total = np.zeros(1)
    for other in measured:
        _check_same_clamp(model, other)
        total = total + model.joint_information(values, over=other)[0].sum(axis=-3)
    return total


def estimate_information(found: Estimate, parameters: Parameters, places: npt.NDArray[np.intp], size: int) -> Array:
    """The information (m, m) that an estimate is of the parameters that are no nuisance."""
    names = [name for name in found.parameters.main.names if name in parameters.main.names]
    if not names or found.batch_shape or not found.ok:
        raise InputError(
            f"measured: expected a successful estimate of one set, of some of {', '.join(parameters.main.names)}; "
            f"got {', '.join(found.parameters.names)}"
            + (f" of a batch of {found.batch_shape}" if found.batch_shape else "")
        )
    units = {block.name: block.unit for block in parameters}
    for block in found.parameters:
        if block.name in names and block.unit != units[block.name]:
            raise UnitError(f"measured: {block.name} is in {block.unit}, that of the candidates in {units[block.name]}")
    root, seen = inverse_root(found.covariance_of(*names))
    if not seen:
        raise InputError("measured: the covariance of the estimate is singular or not finite, so it is no information")
    where = np.searchsorted(places, np.concatenate([np.r_[parameters[name]] for name in names]))
    out = np.zeros((size, size))
    out[where[:, None], where] = root @ root.T
    return out


def _check_same_clamp(model: Implicit, measured: Implicit) -> None:
    """The poses that were measured share the nuisance of the candidates, as far as a nominal can tell."""
    if measured.batch_shape:
        raise InputError(f"measured: expected one set of poses, got a batch of {measured.batch_shape}")
    if type(measured) is not type(model) or measured.parameters.names != model.parameters.names:
        raise InputError(
            f"measured: expected {type(model).__name__} of {', '.join(model.parameters.names)}, as over the "
            f"candidates; got {type(measured).__name__} of {', '.join(measured.parameters.names)}"
        )
    if len(measured.parts) != len(model.parts):
        raise InputError(f"measured: has {len(measured.parts)} sets, and the candidates {len(model.parts)}")
    for (part, _), (other, _) in zip(model.parts, measured.parts, strict=True):
        if not _same(_common(part), _common(other)):
            raise InputError(
                "measured: has another common error of all poses than the candidates; give both one noise model, or "
                "the estimate from those poses instead"
            )
        difference = clamp_difference(part.data, other.data)
        if difference:
            raise InputError(
                f"measured: is on another clamp than the candidates: {difference}; make candidates on the clamp that "
                "is set (given=…), or give the estimate from those poses instead"
            )
        known = part.known_otherwise(other)
        if known:
            raise InputError(
                f"measured: knows {', '.join(known)} by other values than the candidates, or from another estimate; "
                "give both the same"
            )


def _common(part: SetEquation) -> Array | None:
    """The covariance of the error that all poses share."""
    noise = part.data.noise
    common: Array | None = None if noise is None else noise.common(part.n_readings)
    return common


def _same(one: Array | None, two: Array | None) -> bool:
    return (one is None and two is None) or (one is not None and two is not None and np.array_equal(one, two))
