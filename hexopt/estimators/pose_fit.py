"""Nonlinear least squares on poses: the forward-kinematics calibration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from ..arrays import Array, BoolArray, norm
from ..errors import InputError
from ..geometry import Hexapod
from ..loops import LegLength, PlatformPose
from ..loops.platform_pose import LEGS
from ..numerics.lm import LMResult
from ..numerics.lstsq import LstsqSolution, solve_svd
from ..problem import LinearProblem, Whitening
from ..result import Estimate, Status
from .inverse_kinematics import InverseKinematics
from .least_squares import check_rows, linear_uncertainty, unseen_combinations
from .local_fit import minimise

__all__ = ["ForwardKinematics"]

#: A full step beyond this share of the scaled values, where the iteration ended, is no convergence.
STATIONARY = 1e-6


@dataclass(frozen=True)
class ForwardKinematics:
    r"""Computed poses fitted to measured ones: :math:`\min_\theta\sum_i\lVert W_i\,g_i(\theta)\rVert^2/2`.

    With :math:`g_i = (\hat P_i - P_i, \log(\hat R_i R_i^T))`, where the pose that belongs to the readings is itself
    computed by Newton's method, for all six legs together.

    Parameters
    ----------
    start : Hexapod, optional
        Where the iteration starts; by default the data's nominal. Its other values are not used.
    weights : None or "model", default None
        None: turns count as lengths, times the largest :math:`\lVert b_k\rVert` of the start. "model":
        :math:`W_i^TW_i = (\Sigma_{P\omega} + J_\rho\Sigma_\rho J_\rho^T)^{-1}` from the noise model, at the unweighted
        solution; to first order that is the weighted fit of all readings at once.
    approach : bool, default True
        Whether to go from the start to the :class:`InverseKinematics` fit of every leg first, which sees no singular
        poses. False: the plain method, which costs more and fails more often.
    max_iterations : int, default 100

    Notes
    -----
    Levenberg–Marquardt on the whole batch, with the derivatives of the implicit-function theorem. A step to a
    geometry that leaves a pose without a solution is taken back; a set that begins with such a pose, or ends before
    a stationary point, is NOT_CONVERGED. No certificate of a global minimum (gap is NaN).

    References
    ----------
    Daney (1998), section 1.2.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate(robot, n_poses=10, nominal=robot.perturbed(0.3, offsets=0.3, rng=0), rng=1)
    >>> found = hx.estimate(hx.loops.PlatformPose(data), hx.ForwardKinematics())
    >>> bool(max(found.error(robot).values()) < 1e-9)
    True
    """

    start: Hexapod | None = None
    weights: Literal["model"] | None = None
    approach: bool = True
    max_iterations: int = 100

    accepts: ClassVar[tuple[type, ...]] = (PlatformPose,)
    hint: ClassVar[str] = "write estimate(loops.PlatformPose(data), ForwardKinematics()), data with all six readings"

    def __post_init__(self) -> None:
        if self.start is not None and not isinstance(self.start, Hexapod):
            raise InputError(f"start: expected a Hexapod, got {type(self.start).__name__}")
        if self.weights not in (None, "model"):
            raise InputError(f"weights: expected None or 'model', got {self.weights!r}")
        if self.max_iterations < 1:
            raise InputError(f"max_iterations: expected at least 1, got {self.max_iterations}")

    def fit(self, target: PlatformPose) -> Estimate:
        """Fit every set of the batch; one that does not converge, or is not determined, fails alone."""
        first = target.start() if self.start is None else target.values(self.start)
        first = np.broadcast_to(first, (*target.batch_shape, target.parameters.size))
        radius = float(norm((self.start or target.data.nominal).platform_points).max())
        check_rows(target.linearised(first, radius))
        if self.approach:
            first = self._approached(target, first)
        found = self._minimise(target, first, radius, None)
        root = None
        if self.weights == "model":
            root = target.linearised(found.values, radius).whitening()
            again = self._minimise(target, found.values, radius, root)
            found = replace(again, iterations=found.iterations + again.iterations)
        return self._estimate(target.linearised(found.values, radius), found, root, target.blind_spots)

    def _approached(self, target: PlatformPose, first: Array) -> Array:
        """The values of every leg that its lengths have, where they have any."""
        values = np.array(first)
        for k in LEGS:
            start = None if self.start is None else self.start.leg(k)
            fit = InverseKinematics(start, max_iterations=self.max_iterations)
            found = fit.fit(LegLength(target.data.leg(k), unknown=target.unknown))
            for name, block in found.params.items():
                values[..., target.parameters[f"leg{k}.{name}"]] = block
        return np.where(np.isfinite(values), values, first)

    def _minimise(self, target: PlatformPose, start: Array, radius: float, root: Whitening | None) -> LMResult:
        def rows(x: Array) -> tuple[Array, Array]:
            residual, jacobian = target.rows(x, radius)
            flat = (*residual.shape[:-2], residual.shape[-2] * residual.shape[-1])
            residual, jacobian = residual.reshape(flat), jacobian.reshape(*flat, jacobian.shape[-1])
            if root is None:
                return residual, jacobian
            return root.apply(residual[..., None])[..., 0], root.apply(jacobian)

        return minimise(rows, start, self.max_iterations)

    def _estimate(
        self, problem: LinearProblem, found: LMResult, root: Whitening | None, blind: tuple[str, ...]
    ) -> Estimate:
        matrix, rhs = problem.whitened_by(root)
        local = solve_svd(matrix, rhs)
        reached = (matrix != 0).any(axis=(-2, -1))
        codes = np.where(found.converged & _is_stationary(matrix, local, found.values), 0, Status.NOT_CONVERGED)
        codes = np.where((local.full_rank | ~reached) & (not blind), codes, Status.RANK_DEFICIENT).astype(np.int8)
        objective = np.where(reached, 0.5 * np.einsum("...m,...m->...", rhs, rhs), np.nan)
        return Estimate(
            values=np.where((codes == Status.OPTIMAL)[..., None], found.values, np.nan),
            parameters=problem.parameters,
            codes=codes,
            objective=objective,
            gap=np.full(codes.shape, np.nan),
            condition=local.condition,
            chi2=None if root is None else 2 * objective,
            iterations=found.iterations,
            estimator=f"{problem.name} by {self!r}",
            unseen=unseen_combinations(problem, replace(local, full_rank=local.full_rank | ~reached)) or blind,
            **linear_uncertainty(problem, local, root, found.values),
        )


def _is_stationary(matrix: Array, local: LstsqSolution, values: Array) -> BoolArray:
    """Whether a full step would be small, relative to the scaled values; rejected steps grow small as well."""
    scale = np.sqrt(np.einsum("...mp,...mp->...p", matrix, matrix))
    still: BoolArray = norm(scale * local.values) <= STATIONARY * norm(scale * values)
    return still
