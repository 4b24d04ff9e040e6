"""Type III: the length of the leg is locked, so B moves on a sphere about A (Daney 1998, eq. 13–17)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from ..arrays import Array
from ..measurements import LegMeasurements, Lock
from ..rotations.checks import turning_columns
from .base import Loop
from .rows import Members, picked

__all__ = ["FixedLength"]


class FixedLength(Loop):
    r"""Points of one sphere: :math:`g_i = (V_i - o)^T (a - o) + \sigma - \tfrac12\lVert V_i - o\rVert^2`.

    Here :math:`V_i = P_i + R_i b`, and :math:`\sigma = (\ell^2 - \lVert a - o\rVert^2)/2` is the nuisance
    ("sphere"). The origin o is the mean of the measured positions: it changes no solution, and keeps the
    digits that :math:`\lVert V_i\rVert^2` would lose far from the base frame. b is known, as a rule from
    a Type II set, and its covariance is carried. The form "consecutive" is the paper's equation (15),
    :math:`(V_{i+1} - V_i)^T a = (\lVert V_{i+1}\rVert^2 - \lVert V_i\rVert^2)/2`.

    Parameters
    ----------
    data : LegMeasurements
        Under the lock "length"; at least 4 poses whose V do not lie in one plane.
    unknown : sequence of str, default ("base_point",)
    platform_point : array_like or Estimate, optional
        The known b; by default the nominal's.

    References
    ----------
    Daney (1998), section 3.3.2, eq. (13)–(17).

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, leg=3, lock="length", n_poses=6, n_sets=5, rng=0)
    >>> loop = hx.loops.FixedLength(data, platform_point=robot.leg(3).platform_point)
    >>> found = hx.estimate(loop.linear("consecutive"), hx.LeastSquares())
    >>> bool((found.error(robot.leg(3))["base_point"] < 1e-9).all())
    True
    """

    locks = (Lock.LENGTH,)
    default_unknown = ("base_point",)
    involved = ("platform_point", "base_point")
    linear_in = (frozenset({"base_point"}),)
    nuisance: ClassVar[Mapping[str, int]] = {"sphere": 1}
    nuisance_unit = "{unit}²"
    rows = 1

    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same equation, about the same origins, of some members of a batch."""
        taken = super().take(which, batch)
        vars(taken)["origin"] = picked(self.origin, 1, batch, which)
        return taken

    @property
    def minimum_poses(self) -> int:
        """4 for a (eq. 17: N − 1 ≥ 3); 7 with b unknown too."""
        return 4 if self.unknown == ("base_point",) else 7

    @cached_property
    def origin(self) -> Array:
        """o, the mean measured position, shape (..., 3)."""
        return self.data.position.mean(axis=-2)

    def on(self, data: LegMeasurements) -> Self:
        """The same equation, about the same origin, of other values of the measurements."""
        moved = super().on(data)
        vars(moved)["origin"] = self.origin
        return moved

    def _points(self, blocks: Mapping[str, Array]) -> Array:
        """V_i − o, shape (..., n, 3)."""
        points: Array = (self.data.position - self.origin[..., None, :]) + self._arm(blocks)
        return points

    def _spokes(self, blocks: Mapping[str, Array]) -> tuple[Array, Array]:
        """V_i − o, and (a − o) − (V_i − o)."""
        points = self._points(blocks)
        return points, (blocks["base_point"] - self.origin)[..., None, :] - points

    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        points = self._points(blocks)
        centre = (blocks["base_point"] - self.origin)[..., None, :]
        return np.einsum("...i,...i->...", points, centre - 0.5 * points)[..., None] + blocks["sphere"][..., None, :]

    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        points, spokes = self._spokes(blocks)
        return {
            "platform_point": np.einsum("...ni,...nij->...nj", spokes, self.data.rotation)[..., None, :],
            "base_point": points[..., None, :],
            "sphere": np.ones((*points.shape[:-1], 1, 1)),
        }

    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        _, spokes = self._spokes(blocks)
        out = np.zeros((*spokes.shape[:-1], 1, 7))
        out[..., 0, :3] = spokes
        out[..., 0, 3:6] = np.einsum("...ni,...nij->...nj", spokes, turning_columns(self._arm(blocks)))
        return out

    def _nuisance_values(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        free = self._misclosure({**blocks, "sphere": np.zeros(1)})
        return {"sphere": -free.mean(axis=-2)}
