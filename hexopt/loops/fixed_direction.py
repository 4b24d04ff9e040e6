"""Type I: the direction of the leg is locked, its length is read (Daney 1998, eq. 3–7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ..arrays import Array
from ..measurements import Lock
from ..numerics.forms import Consecutive
from ..rotations.checks import turning_columns
from .base import Loop

__all__ = ["FixedDirection"]


class FixedDirection(Loop):
    r"""Leg vectors are parallel: :math:`g_i = P_i + R_i b - a - \ell_i n`, :math:`\ell_i = \gamma\rho_i + \delta`.

    Unknown are b, a and the nuisance n (the leg's direction, here as any vector: no unit length is
    imposed). Offset and gain are known. The form "consecutive",
    :math:`\ell_i g_{i+1} - \ell_{i+1} g_i`, eliminates n and is the paper's equation (5),

    .. math:: (\ell_i R_{i+1} - \ell_{i+1} R_i)\, b + (\ell_{i+1} - \ell_i)\, a
              = \ell_{i+1} P_i - \ell_i P_{i+1},

    with the sign of the second column *corrected*: as printed it returns −a.

    Parameters
    ----------
    data : LegMeasurements
        Under the lock "direction"; at least 3 poses with different lengths.
    unknown : sequence of str, default ("platform_point", "base_point")
    platform_point, base_point, offset, gain : array_like or Estimate, optional
        Known values; by default the nominal's.

    Notes
    -----
    One locked direction sees :math:`a + \delta n` only: a wrong offset moves a by its error along n.
    A pair of poses of equal length says nothing of a.

    References
    ----------
    Daney (1998), section 3.2, eq. (3)–(7).

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, leg=3, lock="direction", n_poses=7, n_sets=5, rng=0)
    >>> paper = hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), hx.LeastSquares())
    >>> bool((paper.error(robot.leg(3))["base_point"] < 1e-10).all())
    True
    """

    locks = (Lock.DIRECTION,)
    default_unknown = ("platform_point", "base_point")
    involved = ("platform_point", "base_point", "offset", "gain")
    linear_in = (frozenset({"platform_point", "base_point"}),)
    nuisance: ClassVar[Mapping[str, int]] = {"direction": 3}
    nuisance_unit = "1"
    unit_vectors = ("direction",)
    rows = 3
    forms = ("direct", "consecutive")

    @property
    def minimum_poses(self) -> int:
        """3 for b and a (eq. 6: 3(N − 1) ≥ 6); 2 for one of them."""
        return 3 if {"platform_point", "base_point"} <= set(self.unknown) else 2

    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        along = self._true_length(blocks)[..., None] * blocks["direction"][..., None, :]
        misclosure: Array = self.data.position + self._arm(blocks) - blocks["base_point"][..., None, :] - along
        return misclosure

    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        rotation = self.data.rotation
        identity = np.broadcast_to(np.eye(3), rotation.shape)
        direction = blocks["direction"][..., None, :]
        direction = np.broadcast_to(direction, np.broadcast_shapes(direction.shape, self.data.position.shape))
        return {
            "platform_point": rotation,
            "base_point": -identity,
            "offset": -direction[..., None],
            "gain": -(self.data.readings()[..., None] * direction)[..., None],
            "direction": -self._true_length(blocks)[..., None, None] * identity,
        }

    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        arm, along = self._arm(blocks), -blocks["gain"][..., None] * blocks["direction"][..., None, :]
        out = np.zeros((*np.broadcast_shapes(arm.shape, along.shape), 7))
        out[..., :3] = np.eye(3)
        out[..., 3:6] = turning_columns(arm)
        out[..., 6] = along
        return out

    def _nuisance_values(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        length = self._true_length(blocks)
        vectors = self.data.position + self._arm(blocks) - blocks["base_point"][..., None, :]
        weighted = np.einsum("...n,...ni->...i", length, vectors)
        return {"direction": weighted / np.einsum("...n,...n->...", length, length)[..., None]}

    def _consecutive(self) -> Consecutive:
        length = self._true_length(self._known)
        return Consecutive(length[..., :-1], length[..., 1:])
