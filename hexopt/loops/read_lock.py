"""Locked legs whose reading is taken too: what the clamp holds, and what the sensor says of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from ..arrays import Array, norm
from ..measurements import Lock
from ..rotations.checks import turning_columns
from .base import Loop
from .leg_length import constant_reading

__all__ = ["ReadLeg", "ReadLength"]


class ReadLeg(Loop):
    r"""Type II with its reading: :math:`P_i + R_i b - c` and :math:`\gamma\rho_i + \delta - \lVert c - a\rVert`.

    Unknown are b, a, the offset and the nuisance c ("fixed_point"), the place where the platform joint stands still.
    One such set says of a no more than its distance from c: it is for several sets together,
    in :class:`~hexopt.loops.WholeRobot`.

    Parameters
    ----------
    data : LegMeasurements
        Under the lock "leg", with readings.
    unknown : sequence of str, default ("platform_point", "base_point", "offset")
    platform_point, base_point, offset, gain : array_like or Estimate, optional
        Known values; by default the nominal's.

    References
    ----------
    Daney (1998), eq. (8) and (19).
    """

    locks = (Lock.LEG,)
    default_unknown = ("platform_point", "base_point", "offset")
    involved = ("platform_point", "base_point", "offset", "gain")
    linear_in = ()
    nuisance: ClassVar[Mapping[str, int]] = {"fixed_point": 3}
    rows = 4
    forms = ()
    minimum_poses = 3

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """One reading does not tell offset and gain apart."""
        return constant_reading(self.unknown)

    def _reach(self, blocks: Mapping[str, Array]) -> Array:
        """c − a, shape (..., 1, 3)."""
        reach: Array = (blocks["fixed_point"] - blocks["base_point"])[..., None, :]
        return reach

    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        still = self.data.position + self._arm(blocks) - blocks["fixed_point"][..., None, :]
        length = self._true_length(blocks) - norm(self._reach(blocks))
        return _below(still, length[..., None])

    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        shape = self.data.position.shape
        reach = self._reach(blocks)
        unit = (reach / norm(reach)[..., None])[..., None, :]
        nothing = np.zeros((*shape, 1))
        still = np.broadcast_to(-np.eye(3), self.data.rotation.shape)
        return {
            "platform_point": _below_rows(self.data.rotation, np.zeros((*shape[:-1], 1, 3))),
            "base_point": _below_rows(np.zeros((*shape, 3)), unit),
            "offset": _below_rows(nothing, np.ones((*shape[:-1], 1, 1))),
            "gain": _below_rows(nothing, self.data.readings()[..., None, None]),
            "fixed_point": _below_rows(still, -unit),
        }

    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        arm = self._arm(blocks)
        out = np.zeros((*np.broadcast_shapes(arm.shape[:-1], blocks["gain"].shape), 4, 7))
        out[..., :3, :3] = np.eye(3)
        out[..., :3, 3:6] = turning_columns(arm)
        out[..., 3, 6] = blocks["gain"]
        return out

    def _nuisance_values(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        return {"fixed_point": (self.data.position + self._arm(blocks)).mean(axis=-2)}


class ReadLength(Loop):
    r"""Type III with its reading: :math:`\lVert P_i + R_i b - a\rVert - \ell` and :math:`\gamma\rho_i + \delta - \ell`.

    Unknown are b, a, the offset and the nuisance :math:`\ell` ("locked_length"). The offset is equation (19) of the
    paper, estimated with all else.

    Parameters
    ----------
    data : LegMeasurements
        Under the lock "length", with readings.
    unknown : sequence of str, default ("platform_point", "base_point", "offset")
    platform_point, base_point, offset, gain : array_like or Estimate, optional
        Known values; by default the nominal's.

    References
    ----------
    Daney (1998), eq. (13) and (19).
    """

    locks = (Lock.LENGTH,)
    default_unknown = ("platform_point", "base_point", "offset")
    involved = ("platform_point", "base_point", "offset", "gain")
    linear_in = ()
    nuisance: ClassVar[Mapping[str, int]] = {"locked_length": 1}
    rows = 2
    forms = ()

    @property
    def minimum_poses(self) -> int:
        """4 for a, and 7 with b unknown too."""
        return 7 if "platform_point" in self.unknown else 4

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """One reading does not tell offset and gain apart."""
        return constant_reading(self.unknown)

    def _vectors(self, blocks: Mapping[str, Array]) -> Array:
        vectors: Array = self.data.position + self._arm(blocks) - blocks["base_point"][..., None, :]
        return vectors

    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        locked = blocks["locked_length"]
        return _below(
            (norm(self._vectors(blocks)) - locked)[..., None], (self._true_length(blocks) - locked)[..., None]
        )

    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        shape = (*self.data.position.shape[:-1], 1)
        vectors = self._vectors(blocks)
        unit = (vectors / norm(vectors)[..., None])[..., None, :]
        one, nothing = np.ones((*shape, 1)), np.zeros((*shape, 1))
        return {
            "platform_point": _below_rows(unit @ self.data.rotation, np.zeros((*shape, 3))),
            "base_point": _below_rows(-unit, np.zeros((*shape, 3))),
            "offset": _below_rows(nothing, one),
            "gain": _below_rows(nothing, self.data.readings()[..., None, None]),
            "locked_length": _below_rows(-one, -one),
        }

    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        vectors = self._vectors(blocks)
        unit = vectors / norm(vectors)[..., None]
        out = np.zeros((*np.broadcast_shapes(unit.shape[:-1], blocks["gain"].shape), 2, 7))
        out[..., 0, :3] = unit
        out[..., 0, 3:6] = np.einsum("...ni,...nij->...nj", unit, turning_columns(self._arm(blocks)))
        out[..., 1, 6] = blocks["gain"]
        return out

    def _nuisance_values(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        return {"locked_length": norm(self._vectors(blocks)).mean(axis=-1, keepdims=True)}


def _below(upper: Array, lower: Array) -> Array:
    """Rows (..., d) below rows, whose batches broadcast."""
    batch = np.broadcast_shapes(upper.shape[:-1], lower.shape[:-1])
    return np.concatenate([np.broadcast_to(part, (*batch, part.shape[-1])) for part in (upper, lower)], axis=-1)


def _below_rows(upper: Array, lower: Array) -> Array:
    """Columns (..., d, size) of rows below those of other rows."""
    batch = np.broadcast_shapes(upper.shape[:-2], lower.shape[:-2])
    return np.concatenate([np.broadcast_to(part, (*batch, *part.shape[-2:])) for part in (upper, lower)], axis=-2)
