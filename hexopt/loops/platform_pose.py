r"""Any pose: where the readings put the platform, by forward kinematics, against where it was seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import Array, transpose
from ..errors import InputError
from ..forward import PoseSolution, pose_derivatives, solve_poses
from ..forward.equations import inverses
from ..geometry import Hexapod
from ..geometry.leg import LEG_BLOCKS
from ..measurements import Measurements
from ..problem import ConstantRowNoise, LinearProblem, RowCovariance
from ..result import Estimate
from ..rotations import matrix_to_rotation_vector, rotation_vector_jacobian
from .known import chosen_unknown
from .leg_length import hidden_by
from .legs import leg_blocks, leg_columns, leg_parameters, leg_values
from .set_equation import SetEquation

__all__ = ["PlatformPose"]

LEGS = range(1, 7)


@dataclass(frozen=True)
class _Solved:
    """The poses that a geometry and the readings give, and what they differ by from those seen."""

    blocks: Mapping[str, Array]
    poses: PoseSolution
    residual: Array  # (..., n, 6)
    turning: Array  # (..., n, 3, 3): of the rotation vector by a turn of the computed pose

    def left(self, rows: Array) -> Array:
        """Rows (..., n, 6, c) by (δP, δω) as rows by the change of the residual."""
        return np.concatenate([rows[..., :3, :], self.turning @ rows[..., 3:, :]], axis=-2)


class PlatformPose(SetEquation):
    r"""The computed pose is the measured one.

    The misclosure is :math:`g_i = (\hat P_i - P_i, \log(\hat R_i R_i^T))`, six rows a pose, where the computed pose
    solves :math:`\lVert\hat P_i + \hat R_i b_k - a_k\rVert = \gamma_k\rho_{ik} + \delta_k`, k = 1…6, from the measured
    one on (:func:`~hexopt.forward_kinematics`). All six legs are unknown together: Model 36 has b and a of every leg,
    42 the offsets, 48 the gains too. The derivatives are those of the implicit-function theorem. For
    :class:`~hexopt.ForwardKinematics`.

    Parameters
    ----------
    data : Measurements
        Under any lock.
    unknown : sequence of str, default ("platform_point", "base_point", "offset")
        The blocks to estimate, of every leg; the others are known from ``data.nominal``.

    Raises
    ------
    InputError
        If a known value is missing, or a name is not a leg's.

    Notes
    -----
    A pose that the geometry x cannot reach from the measured one has rows of NaN; ``poses(x).status`` says why.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> loop = hx.loops.PlatformPose(hx.simulate(robot, n_poses=8, rng=0))
    >>> loop.parameters.size, bool(abs(loop.residual(robot)).max() < 1e-12)
    (42, True)
    """

    n_readings = 6

    def __init__(
        self, data: Measurements, *, unknown: Sequence[str] | str = ("platform_point", "base_point", "offset")
    ) -> None:
        if not isinstance(data, Measurements):
            raise InputError(
                f"PlatformPose: expected Measurements, with six readings a pose, got {type(data).__name__}"
            )
        if data.n_poses == 0:
            raise InputError("PlatformPose: there are no poses")
        self.data = data
        self.unknown = chosen_unknown("PlatformPose", tuple(LEG_BLOCKS), unknown, dict.fromkeys(LEG_BLOCKS))
        self.parameters = leg_parameters(self.unknown, LEGS, data.length_unit)
        self._blocks(np.ones(self.parameters.size))  # is all that is known there?

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one set."""
        return self.data.batch_shape

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """What the lock hides of its leg, as in :class:`LegLength`."""
        return tuple(f"leg{self.data.locked_leg}.{words}" for words in hidden_by(self.data.lock, self.unknown))

    @property
    def minimum_poses(self) -> int:
        """As many poses as unknowns a leg."""
        return self.parameters.size // len(LEGS)

    def values(self, x: npt.ArrayLike | Hexapod | Estimate) -> Array:
        """A vector of values (..., p) from values, a :class:`Hexapod` or an :class:`Estimate`."""
        return leg_values(x, self.parameters, self.data.length_unit)

    def start(self) -> Array:
        """The values of the data's nominal."""
        if self.data.nominal is None:
            raise InputError(
                "PlatformPose needs an initial guess: give the estimator start=Hexapod(…), or the data a nominal"
            )
        return self.values(self.data.nominal)

    def poses(self, x: npt.ArrayLike | Hexapod | Estimate) -> PoseSolution:
        """Where the readings put the platform of geometry x: a status for every pose, (..., n)."""
        return self._solved(x).poses

    def residual(self, x: npt.ArrayLike | Hexapod | Estimate) -> Array:
        r""":math:`g_i(x)`, shape (..., n, 6): position, and rotation vector in radians; NaN where there is no pose."""
        return self._solved(x).residual

    def jacobian(self, x: npt.ArrayLike | Hexapod | Estimate) -> Array:
        r""":math:`G_i = \partial g_i/\partial x`, shape (..., n, 6, p)."""
        return self.rows(x)[1]

    def rows(self, x: npt.ArrayLike | Hexapod | Estimate, radius: float = 1.0) -> tuple[Array, Array]:
        """Residual and Jacobian of one solution of the poses; turns count as lengths, times a radius."""
        solved, scale = self._solved(x), _turns_times(radius)
        return scale * solved.residual, scale[:, None] * self._columns(solved)[0]

    def noise_jacobian(self, x: npt.ArrayLike | Hexapod | Estimate) -> Array:
        r""":math:`B_i = \partial g_i/\partial(\delta P, \delta\omega, \delta\rho)`, six δρ, shape (..., n, 6, 12)."""
        return self._columns(self._solved(x))[1]

    def linearised(self, x: npt.ArrayLike | Hexapod | Estimate, radius: float = 1.0) -> LinearProblem:
        """The rows to first order about x, in the unknown *change* of x; turns count as lengths, times a radius.

        A set with a pose that x cannot reach has rows of zero, and a noise of NaN.
        """
        solved = self._solved(x)
        jacobian, by_noise = self._columns(solved)
        scale = _turns_times(radius)
        residual = scale * solved.residual
        jacobian, by_noise = scale[:, None] * jacobian, scale[:, None] * by_noise
        noise = None
        if self.data.noise is not None:
            own = by_noise @ self.error_covariance @ transpose(by_noise)
            common = [part for _, part in self.shared(x, by_noise)]
            noise = ConstantRowNoise(RowCovariance(own, common[0] if common else None))
        reached = np.asarray(np.isfinite(jacobian).all(axis=(-3, -2, -1)))[..., None]
        flat = (*residual.shape[:-2], residual.shape[-2] * 6)
        return LinearProblem(
            np.where(reached[..., None], jacobian.reshape(*flat, self.parameters.size), 0.0),
            np.where(reached, -residual.reshape(flat), 0.0),
            self.parameters,
            rows_per_block=6,
            noise=noise,
            minimum_poses=self.minimum_poses,
            name=type(self).__name__,
        )

    def _blocks(self, values: Array) -> dict[str, Array]:
        """The legs as stacked arrays, with a dimension of poses: points (..., 1, 6, 3), offset and gain (..., 1, 6)."""
        blocks = leg_blocks(values, self.parameters, self.data.nominal, LEGS)
        return {
            name: block[..., None, :, :] if LEG_BLOCKS[name] > 1 else block[..., None, :]
            for name, block in blocks.items()
        }

    def _solved(self, x: npt.ArrayLike | Hexapod | Estimate) -> _Solved:
        data, blocks = self.data, self._blocks(self.values(x))
        poses = solve_poses(blocks, data.length, data.position, data.rotation)
        reached = np.asarray(poses.ok)[..., None]
        between = np.where(reached[..., None], poses.rotation @ transpose(data.rotation), np.eye(3))
        turn = matrix_to_rotation_vector(between)
        residual = np.where(reached, np.concatenate([poses.position - data.position, turn], axis=-1), np.nan)
        return _Solved(blocks, poses, residual, inverses(rotation_vector_jacobian(turn))[0])

    def _columns(self, solved: _Solved) -> tuple[Array, Array]:
        """The derivatives by the unknowns and by the errors of the measurements."""
        by = pose_derivatives(solved.blocks, solved.poses.position, solved.poses.rotation)
        noise = np.zeros((*solved.residual.shape, 6 + self.n_readings))
        noise[..., :3, :3] = -np.eye(3)
        noise[..., 3:, 3:6] = -transpose(solved.turning)
        noise[..., 6:] = solved.left(by.pop("reading")[..., 0])
        return solved.left(leg_columns(by, self.parameters, LEGS)), noise


def _turns_times(radius: float) -> Array:
    """What the six rows of a pose are multiplied by."""
    return np.repeat([1.0, radius], 3)
