"""Loop equations and their derivatives evaluated by CasADi, over poses and batches."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import InputError
from ..geometry import Leg
from ..loops import Loop
from ..result import Estimate
from .models import block_sizes, constants, loop_function

__all__ = ["jacobian", "known_jacobian", "mapped", "noise_jacobian", "pose_arguments", "residual"]

Values = npt.ArrayLike | Leg | Estimate


def residual(loop: Loop, x: Values) -> Array:
    r"""The direct misclosure :math:`g_i(x)` by CasADi, shape (..., n, d).

    Leading dimensions are those of values, measurements and known values together.

    Parameters
    ----------
    loop : Loop
    x : values, Leg or Estimate

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, leg=3, lock="direction", n_poses=4, n_sets=2, nominal=robot, rng=0)
    >>> loop = hx.loops.FixedDirection(data)
    >>> bool(abs(hx.symbolic.residual(loop, robot.leg(3)) - loop.residual(robot.leg(3))).max() < 1e-13)
    True
    """
    return _evaluated(loop, x, ["misclosure"])[..., 0]


def jacobian(loop: Loop, x: Values) -> Array:
    r""":math:`G_i = \partial g_i/\partial x` by automatic differentiation, shape (..., n, d, p)."""
    return _evaluated(loop, x, [f"jac:misclosure:{name}" for name in loop.parameters.names])


def known_jacobian(loop: Loop, x: Values, name: str) -> Array:
    r""":math:`\partial g_i/\partial k` by a known block k of the leg, shape (..., n, d, size)."""
    if name not in block_sizes(loop):
        raise InputError(f"name: expected {', '.join(map(repr, block_sizes(loop)))}; got {name!r}")
    return _evaluated(loop, x, [f"jac:misclosure:{name}"])


def noise_jacobian(loop: Loop, x: Values) -> Array:
    r""":math:`B_i = \partial g_i/\partial(\delta P, \delta\omega, \delta\rho)`, shape (..., n, d, 7)."""
    return _evaluated(loop, x, ["jac:misclosure:error"])


def pose_arguments(loop: Loop, x: Values) -> tuple[dict[str, Array], tuple[int, ...]]:
    """The inputs of the loop's function at x, each (K, …) with K poses of all sets; and the shape (..., n) of those."""
    data, blocks = loop.data, loop._blocks(x)  # the blocks by name, known or not
    blocks |= {name: getattr(loop, name) for name in constants(loop)}
    named = [*block_sizes(loop), *constants(loop)]
    batch = np.broadcast_shapes(data.batch_shape, *(blocks[name].shape[:-1] for name in named))
    shape = (*batch, data.n_poses)
    reading = np.zeros(shape) if data.length is None else data.length
    measured = {"position": data.position, "rotation": data.rotation, "reading": reading[..., None]}
    full = {name: blocks[name][..., None, :] for name in named} | measured
    trailing = {name: value.shape[-2:] if name == "rotation" else value.shape[-1:] for name, value in full.items()}
    return {
        name: np.broadcast_to(value, (*shape, *trailing[name])).reshape(-1, *trailing[name])
        for name, value in full.items()
    }, shape


def mapped(function: ca.Function, arguments: Sequence[Array]) -> list[Array]:
    """A function at K sets of arguments, (K, m) or (K, m, n) each; its outputs (K, rows, columns)."""
    count = len(arguments[0])
    if count == 0:
        return [np.empty((0, *function.size_out(k))) for k in range(function.n_out())]
    flat = [value.T if value.ndim == 2 else np.concatenate(list(value), axis=-1) for value in arguments]
    found = function.map(count).call([ca.DM(part) for part in flat])
    return [np.stack(np.split(part.full(), count, axis=-1)) for part in found]


def _evaluated(loop: Loop, x: Values, outputs: Sequence[str]) -> Array:
    """Outputs of the loop's function side by side, (..., n, d, columns)."""
    function = loop_function(loop)
    arguments, shape = pose_arguments(loop, x)
    arguments["error"] = np.zeros((len(arguments["position"]), 7))
    derived = function.factory("derived", function.name_in(), list(outputs))
    parts = mapped(derived, [arguments[name] for name in function.name_in()])
    found: Array = np.concatenate(parts, axis=-1)
    return found.reshape(*shape, *found.shape[1:])
