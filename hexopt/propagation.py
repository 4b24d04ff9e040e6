r"""Pose errors carried through several estimation steps, to first order.

A step solves :math:`A x = y` from rows :math:`g_i`, so an error of the rows moves its values by
:math:`-H_i\,dg_i` (H is the estimate's `influence`), and :math:`dg_i = B_i e_i + K_i\,dk` holds the
pose's error and that of values known from earlier steps. Written out, every step is a sum of gains
times pose errors, in which poses that two steps share appear once.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .arrays import Array, transpose
from .errors import InputError
from .loops import Loop
from .measurements import LegMeasurements
from .result import Estimate

__all__ = ["Gain", "joint_covariance", "pose_gain"]

#: Pairs of a measurement set and ∂values/∂e_i over its poses, (..., p, n, 7).
Gain = tuple[tuple[LegMeasurements, Array], ...]


def pose_gain(loop: Loop, found: Estimate, name: str, earlier: Mapping[str, Gain]) -> Gain:
    """How the block `name` of an estimate moves with the errors of all poses behind it.

    Parameters
    ----------
    loop : Loop
        The equation that was solved.
    found : Estimate
        Its solution, with an influence.
    name : str
        The block.
    earlier : dict of str to Gain
        The gains of the loop's known blocks that were estimated before.

    Raises
    ------
    InputError
        If the estimator gives no influence.
    """
    if found.influence is None:
        raise InputError(f"{found.estimator} gives no influence, so its errors cannot be carried on")
    influence = found.influence[..., found.parameters[name], :, :]
    gains = {id(loop.data): (loop.data, -np.einsum("...pnd,...nde->...pne", influence, loop.noise_jacobian(found)))}
    for known, behind in earlier.items():
        if known not in loop.involved or known in loop.unknown:
            continue
        through = -np.einsum("...pnd,...nds->...ps", influence, loop.known_jacobian(found, known))
        for data, gain in behind:
            carried = np.einsum("...ps,...sne->...pne", through, gain)
            before = gains.get(id(data))
            gains[id(data)] = (data, carried if before is None else before[1] + carried)
    return tuple(gains.values())


def joint_covariance(gains: Mapping[str, Gain]) -> Array:
    """Covariance of all blocks of `gains`, in their order, (..., p, p).

    Raises
    ------
    InputError
        If a set of measurements has no noise model.
    """
    sets = {id(data): data for gain in gains.values() for data, _ in gain}
    total: Array | None = None
    for key, data in sets.items():
        if data.noise is None:
            raise InputError("joint covariance: a set of measurements has no noise model; give it noise=…")
        blocks = [_of_set(gain, key, data.n_poses) for gain in gains.values()]
        shape = np.broadcast_shapes(*(block.shape[:-3] for block in blocks))
        gain = np.concatenate([np.broadcast_to(block, (*shape, *block.shape[-3:])) for block in blocks], axis=-3)
        own = data.noise.covariance(data.position, data.rotation)
        part = np.einsum("...pne,...nef,...qnf->...pq", gain, own, gain, optimize=True)
        common = data.noise.common()
        if common is not None:
            shared = gain.sum(axis=-2)
            part = part + shared @ common @ transpose(shared)
        total = part if total is None else total + part
    if total is None:
        raise InputError("joint covariance: no gains were given")
    return total


def _of_set(gain: Gain, key: int, n_poses: int) -> Array:
    for data, array in gain:
        if id(data) == key:
            return array
    size = gain[0][1].shape[-3]
    return np.zeros((size, n_poses, 7))
