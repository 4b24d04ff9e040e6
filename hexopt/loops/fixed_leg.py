"""Type II: direction and length of the leg are locked, so B is one fixed point (Daney 1998, eq. 9–12)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ..arrays import Array
from ..measurements import Lock
from ..rotations.checks import turning_columns
from .base import Loop

__all__ = ["FixedLeg"]


class FixedLeg(Loop):
    r"""The platform joint stands still: :math:`g_i = P_i + R_i b - c`, :math:`c = a + \ell n`.

    Unknown are b and the nuisance c ("fixed_point"). The leg's reading is not used. The forms
    "consecutive", :math:`g_{i+1} - g_i`, and "centred" eliminate c; the first is the paper's
    equation (10), :math:`(R_{i+1} - R_i)\,b = P_i - P_{i+1}`.

    Parameters
    ----------
    data : LegMeasurements
        Under the lock "leg"; at least 3 poses, rotated about two axes or more.
    unknown : sequence of str, default ("platform_point",)

    References
    ----------
    Daney (1998), section 3.3.1, eq. (9)–(12). Each block :math:`R_{i+1} - R_i` has rank 2, hence N ≥ 3.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, leg=3, lock="leg", n_poses=3, n_sets=5, rng=0)
    >>> found = hx.estimate(hx.loops.FixedLeg(data).linear("consecutive"), hx.LeastSquares())
    >>> bool((found.error(robot.leg(3))["platform_point"] < 1e-9).all())
    True
    """

    locks = (Lock.LEG,)
    default_unknown = ("platform_point",)
    involved = ("platform_point",)
    linear_in = (frozenset({"platform_point"}),)
    nuisance: ClassVar[Mapping[str, int]] = {"fixed_point": 3}
    rows = 3
    minimum_poses = 3

    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        misclosure: Array = self.data.position + self._arm(blocks) - blocks["fixed_point"][..., None, :]
        return misclosure

    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        rotation = self.data.rotation
        return {"platform_point": rotation, "fixed_point": np.broadcast_to(-np.eye(3), rotation.shape)}

    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        arm = self._arm(blocks)
        out = np.zeros((*arm.shape, 7))
        out[..., :3] = np.eye(3)
        out[..., 3:6] = turning_columns(arm)
        return out

    def _nuisance_values(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        return {"fixed_point": (self.data.position + self._arm(blocks)).mean(axis=-2)}
