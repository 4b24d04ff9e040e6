"""How a pose moves with the readings and the geometry."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..arrays import Array
from .equations import LegEquations, inverses

__all__ = ["pose_derivatives"]


def pose_derivatives(blocks: Mapping[str, Array], position: Array, rotation: Array) -> dict[str, Array]:
    r"""How the pose moves with the readings and with the geometry, by the implicit-function theorem.

    With :math:`x = (\delta P, \delta\omega)`, :math:`R \to \exp([\delta\omega]_\times) R`, the leg k gives
    :math:`n_k^T\delta P + (R b_k \times n_k)^T\delta\omega + n_k^T R\,\delta b_k - n_k^T\delta a_k - \delta\delta_k
    - \rho_k\,\delta\gamma_k - \gamma_k\,\delta\rho_k = 0`.

    Parameters
    ----------
    blocks : dict of str to ndarray
        As :func:`robot_blocks` gives them, or with leading dimensions.
    position, rotation : ndarray, shape (..., 3) and (..., 3, 3)
        A pose that agrees with the readings.

    Returns
    -------
    dict of str to ndarray
        ∂x/∂block by "platform_point" and "base_point" (..., 6, 6, 3), "offset", "gain" and "reading" (..., 6, 6, 1),
        the leg second to last; NaN where the pose is singular or is NaN.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> from hexopt.forward import pose_derivatives, robot_blocks
    >>> robot = hx.robots.left_hand()
    >>> by = pose_derivatives(robot_blocks(robot), robot.home_position, robot.home_rotation)
    >>> np.allclose(by["base_point"].sum(axis=1), np.eye(6, 3))  # the platform goes where the base goes
    True
    """
    batch = np.broadcast_shapes(position.shape[:-1], blocks["platform_point"].shape[:-2], blocks["gain"].shape[:-1])
    equations = LegEquations.of({**blocks, "offset": 0.0 * blocks["offset"]}, np.zeros(6), batch)
    p, r = np.broadcast_to(position, (*batch, 3)), np.broadcast_to(rotation, (*batch, 3, 3))
    distance, jacobian = equations(p.reshape(-1, 3), r.reshape(-1, 3, 3))
    inverse = inverses(jacobian)[0]
    inverse[:, 3:] /= equations.radius[:, None, None]
    inverse, unit = inverse.reshape(*batch, 6, 6), jacobian[..., :3].reshape(*batch, 6, 3)
    reading = (distance.reshape(*batch, 6) - blocks["offset"]) / blocks["gain"]
    column = inverse[..., None]
    return {
        "platform_point": -column * (unit @ r)[..., None, :, :],
        "base_point": column * unit[..., None, :, :],
        "offset": column,
        "gain": column * reading[..., None, :, None],
        "reading": column * blocks["gain"][..., None, :, None],
    }
