"""Any pose: the leg's length by inverse kinematics (Daney 1998, eq. 18–19)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from ..arrays import Array, norm
from ..errors import RankDeficientError
from ..geometry import Hexapod, Leg
from ..measurements import Lock
from ..problem import LinearProblem
from ..result import Estimate
from ..rotations.checks import turning_columns
from .base import Loop

__all__ = ["LegLength", "constant_reading", "hidden_by", "hidden_from_all"]


class LegLength(Loop):
    r"""The reading agrees with the geometry: :math:`g_i = \lVert P_i + R_i b - a\rVert - \gamma\rho_i - \delta`.

    Holds in any pose. With a and b known it is linear: ``unknown=("offset",)`` is the paper's equation
    (19), over one or many poses; ``unknown=("offset", "gain")`` finds the gain as well. With a and b
    unknown it is the inverse-kinematics calibration of Masory, Wang and Zhuang, for
    :class:`~hexopt.InverseKinematics`: Model 36 (b, a), 42 (and offset), 48 (and gain).

    Parameters
    ----------
    data : LegMeasurements
        Under any lock, with readings.
    unknown : sequence of str, default ("platform_point", "base_point", "offset")
    platform_point, base_point, offset, gain : array_like or Estimate, optional
        Known values; by default the nominal's.

    References
    ----------
    Daney (1998), eq. (18)–(19). Masory, Wang and Zhuang (1993).

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> leg = robot.leg(3)
    >>> data = hx.simulate_leg(robot, leg=3, lock="none", n_poses=1, rng=0)
    >>> loop = hx.loops.LegLength(
    ...     data, unknown=("offset",), platform_point=leg.platform_point, base_point=leg.base_point
    ... )
    >>> hx.estimate(loop.linear(), hx.LeastSquares()).values.round(9)
    array([15.25])
    """

    locks = tuple(Lock)
    default_unknown = ("platform_point", "base_point", "offset")
    involved = ("platform_point", "base_point", "offset", "gain")
    linear_in = (frozenset({"offset", "gain"}),)
    rows = 1
    forms = ("direct",)

    @property
    def minimum_poses(self) -> int:
        """As many poses as unknowns."""
        return self.parameters.size

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """A leg that keeps its direction says nothing of a across it, one that keeps its length gives one reading."""
        return hidden_by(self.data.lock, self.unknown)

    def linear(self, form: str = "direct", at: npt.ArrayLike | Leg | Hexapod | Estimate | None = None) -> LinearProblem:
        """As of any loop; a constant reading does not tell offset and gain apart: RankDeficientError."""
        if self.blind_spots:
            raise RankDeficientError(
                f"LegLength under the lock {str(self.data.lock)!r} does not see {' and '.join(self.blind_spots)}; "
                "give one of them as known, or poses of other lengths",
                self.blind_spots,
            )
        return super().linear(form, at)

    def _vectors(self, blocks: Mapping[str, Array]) -> Array:
        vectors: Array = self.data.position + self._arm(blocks) - blocks["base_point"][..., None, :]
        return vectors

    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        return (norm(self._vectors(blocks)) - self._true_length(blocks))[..., None]

    def _unit(self, blocks: Mapping[str, Array]) -> Array:
        vectors = self._vectors(blocks)
        unit: Array = vectors / norm(vectors)[..., None]
        return unit

    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        unit = self._unit(blocks)
        return {
            "platform_point": np.einsum("...ni,...nij->...nj", unit, self.data.rotation)[..., None, :],
            "base_point": -unit[..., None, :],
            "offset": np.full((*unit.shape[:-1], 1, 1), -1.0),
            "gain": -self.data.readings()[..., None, None],
        }

    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        unit = self._unit(blocks)
        out = np.zeros((*np.broadcast_shapes(unit.shape[:-1], blocks["gain"].shape), 1, 7))
        out[..., 0, :3] = unit
        out[..., 0, 3:6] = np.einsum("...ni,...nij->...nj", unit, turning_columns(self._arm(blocks)))
        out[..., 0, 6] = -blocks["gain"]
        return out


def hidden_by(lock: Lock, unknown: Sequence[str]) -> tuple[str, ...]:
    """What a leg's lengths under its lock do not see, though noise in the measurements makes it look seen; in words."""
    across = lock in (Lock.DIRECTION, Lock.LEG) and "base_point" in unknown
    constant = constant_reading(unknown) if lock in (Lock.LEG, Lock.LENGTH) else ()
    return ("base_point across the leg's locked direction",) * across + constant


def constant_reading(unknown: Sequence[str]) -> tuple[str, ...]:
    """What the reading of a locked length does not see, in words."""
    return ("offset against gain: a locked length has one reading",) * ({"offset", "gain"} <= set(unknown))


def hidden_from_all(loops: Sequence[Loop]) -> tuple[str, ...]:
    """What several sets of one leg do not see either.

    A locked direction brings one equation for a and an unknown offset, a locked length one for offset and gain.
    """
    blind = [set(loop.blind_spots) for loop in loops]
    common = [words for words in loops[0].blind_spots if all(words in one for one in blind)]
    across = 3 + ("offset" in loops[0].unknown)
    return tuple(
        words for words in common if len(loops) < (2 if words in constant_reading(loops[0].unknown) else across)
    )
