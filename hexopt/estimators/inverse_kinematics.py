"""Nonlinear least squares on leg lengths: the inverse-kinematics calibration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal

import numpy as np

from ..arrays import Array, matvec
from ..constraints import Constraint
from ..errors import InputError
from ..geometry import Leg
from ..loops import LegLength
from ..losses import Loss, Quadratic
from ..numerics.lm import LMResult, levenberg_marquardt
from ..numerics.lstsq import solve
from ..priors import Prior
from ..result import Estimate, Status
from .convex import ConvexEstimator
from .convex.scale import mad_scale
from .least_squares import check_rows, linear_uncertainty, unseen_combinations
from .leg_end import last_step
from .leg_reference import check_ipopt, fitted_by_ipopt
from .leg_rows import LegRows
from .local_fit import check_settings, first_guess
from .sequential_convex import SequentialConvex

__all__ = ["InverseKinematics"]

#: Of the first step: Gauss–Newton's, all but, from where a nominal is as a rule.
DAMPING = 1e-6


@dataclass(frozen=True)
class InverseKinematics:
    r"""Leg lengths fitted to poses: :math:`\min\sum\rho(w_i(\lVert P_i + R_i b - a\rVert - \gamma\rho_i - \delta)/s)`.

    Parameters
    ----------
    start : Leg, optional
        Where the iteration starts; by default the data's nominal. Its other values are not used.
    weights : None or "model", default None
        "model": :math:`w_i^{-2} = n^T(\sigma_P^2 I + \sigma_E^2 JJ^T)n + \gamma^2\sigma_\rho^2` from the noise
        model, at the unweighted solution.
    max_iterations : int, default 200
        Of each of the two: the plain fit, and that of the loss with its priors and bounds.
    loss : Loss, default Quadratic()
        :math:`\rho`, as in :class:`~hexopt.ConvexEstimator`: ``Huber(1.345)`` for outliers.
    prior : Prior or list of Prior, optional
        Added to the sum: ``GaussianPrior``, ``Ridge``, ``Lasso``.
    bounds : Constraint or list of Constraint, optional
        ``Box``, ``Ball``, ``Linear``.
    scale : float, "mad" or None, default None
        s: one standard deviation of the (weighted) rows, where the noise model does not say it; "mad" is taken of the
        rows to first order about the unweighted solution.
    backend : {"auto", "ipopt"}, default "auto"
        "ipopt": CasADi and IPOPT, set by set: the slow reference, for Quadratic and Huber, normal priors and boxes.
    covariance : bool, default True
        Whether to compute covariance and influence.

    Raises
    ------
    InputError
        For settings that do not fit, thresholds or priors on rows that do not count in standard deviations, or without
        an initial guess.
    RankDeficientError
        For too few poses, unless a prior or bounds may decide.

    Notes
    -----
    Needs an initial guess, unlike the linear loops; no certificate of a global minimum (gap is NaN). The unknowns are
    those of the loop: ``LegLength(data, unknown=(…))``; Model 36 has b and a, 42 the offset, 48 the gain too. Poses
    rotated about one axis only, or a leg's own DIRECTION or LEG set alone, do not determine them, nor does a locked
    length offset and gain together; what a prior or bounds then decide is in ``found.decided``.

    Plain least squares is Levenberg–Marquardt on the whole batch. With another loss, a prior or bounds it is damped
    sequential convex programming: the rows, linearised, are solved by the routes of the convex family; the status,
    the duals and the covariance are those of the last such programme, and a success has its optimum there to 1e-6 σ
    (to the family's gap where neither the loss is smooth nor the bounds are a box).

    References
    ----------
    Masory, Wang and Zhuang (1993); Daney (1998), section 1.2.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "none", n_poses=10, nominal=robot.perturbed(0.3, rng=0), rng=1)
    >>> found = hx.estimate(hx.loops.LegLength(data), hx.InverseKinematics())
    >>> bool(found.error(robot.leg(3))["base_point"] < 1e-9)
    True
    """

    start: Leg | None = None
    weights: Literal["model"] | None = None
    max_iterations: int = 200
    loss: Loss = field(default_factory=Quadratic)
    prior: Prior | Sequence[Prior] | None = None
    bounds: Constraint | Sequence[Constraint] | None = None
    scale: float | Literal["mad"] | None = None
    backend: Literal["auto", "ipopt"] = "auto"
    covariance: bool = True

    accepts: ClassVar[tuple[type, ...]] = (LegLength,)
    hint: ClassVar[str] = "write estimate(loops.LegLength(data), InverseKinematics())"

    def __post_init__(self) -> None:
        check_settings(self.start, self.max_iterations)
        if self.weights not in (None, "model"):
            raise InputError(f"weights: expected None or 'model', got {self.weights!r}")
        if self.backend not in ("auto", "ipopt"):
            raise InputError(f"backend: expected 'auto' or 'ipopt', got {self.backend!r}")
        convex = self._convex
        object.__setattr__(self, "prior", convex.prior)
        object.__setattr__(self, "bounds", convex.bounds)
        if self.backend == "ipopt":
            check_ipopt(self.loss, convex.prior, convex.bounds)  # type: ignore[arg-type]  # made tuples

    @property
    def _convex(self) -> ConvexEstimator:
        return ConvexEstimator(self.loss, self.prior, self.bounds, self.weights, self.scale, covariance=self.covariance)

    @property
    def _is_plain(self) -> bool:
        return isinstance(self.loss, Quadratic) and self.scale is None and not (self.prior or self.bounds)

    def fit(self, target: LegLength) -> Estimate:
        """Fit every set of the batch; one that does not converge, or is not determined, fails alone."""
        first = first_guess(self, self.start, target, target.parameters, target.data.batch_shape)
        if not (self.prior or self.bounds):
            _check_poses(target, first)
        rows = LegRows.of(target)
        return self._fit_plain(rows, first) if self._is_plain else self._fit_convex(rows, first)

    def _fit_plain(self, rows: LegRows, first: Array) -> Estimate:
        found = self._minimise(rows, first)
        root = None
        if self.weights == "model":
            root = rows.loop.linearised(np.where(found.converged[..., None], found.values, first)).whitening()
            rows = rows.weighted(root, None)
            again = self._minimise(rows, found.values)
            found = replace(again, iterations=found.iterations + again.iterations)
        return self._estimate(rows, found, root)

    def _fit_convex(self, raw: LegRows, first: Array) -> Estimate:
        target, flat = raw.loop, (-1, first.shape[-1])
        plain, iterations = self._unweighted(raw, first)
        rows = self._weighted(raw, plain)
        minimiser = SequentialConvex.of(self._convex, rows, plain)
        begin = first.reshape(flat) if self.bounds else minimiser.better(first.reshape(flat), plain.reshape(flat))
        if self.backend == "ipopt":
            values, done, more = fitted_by_ipopt(rows, begin, self.max_iterations, minimiser.frame.programme)
            values = np.where(done[:, None], values, begin)
        else:
            values, more = minimiser.minimise(begin, self.max_iterations)
        values, iterations = values.reshape(first.shape), iterations + more.reshape(iterations.shape)
        found = minimiser.estimate(values)
        if target.blind_spots:
            seen = replace(minimiser, rows=replace(rows, noiseless=True)).estimate(values)
            found = _without_noise(found, seen, () if self.prior or self.bounds else target.blind_spots)
        kind = found.covariance_kind
        if self.scale is not None and kind in ("model", "sandwich"):
            kind = "residual" if self.scale == "mad" else "model"
        return replace(
            found,
            objective=np.where(found.ok, found.objective, np.nan),
            chi2=None if found.chi2 is None else np.where(found.ok, found.chi2, np.nan),
            covariance_kind=kind,
            iterations=iterations,
            estimator=f"{type(target).__name__} by {self!r}",
        )

    def _unweighted(self, rows: LegRows, first: Array) -> tuple[Array, Any]:
        """The plain solution, where weights and scale are taken; the start where there is none."""
        if rows.loop.data.n_poses < first.shape[-1] or rows.loop.blind_spots:
            return first, np.zeros(first.shape[:-1], dtype=np.int64)
        found = self._minimise(rows, first)
        values, converged = np.where(found.converged[..., None], found.values, first), found.converged
        residual, jacobian = rows.at(values.reshape(-1, first.shape[-1]))
        good = converged & solve(jacobian, residual, inverse=False).full_rank.reshape(converged.shape)
        return np.where(good[..., None], values, first), found.iterations

    def _weighted(self, rows: LegRows, plain: Array) -> LegRows:
        local, shared = rows.loop.linearised(plain), isinstance(self.loss, Quadratic)
        root = local.whitening(shared=shared) if self.weights == "model" else None
        scale = None
        if self.scale == "mad":
            matrix, change = local.whitened_by(root)
            scale = mad_scale(matrix, change + matvec(matrix, plain), local.name)
            scale = np.where(np.isfinite(scale), scale, np.inf)  # rows that say nothing: these sets fail alone
        elif self.scale is not None:
            scale = np.full(local.batch_shape, float(self.scale))
        return rows.weighted(root, scale, shared=shared)

    def _minimise(self, rows: LegRows, start: Array) -> LMResult:
        """Least squares from starts (..., p), of which the result has the shape."""
        flat, batch = start.reshape(-1, start.shape[-1]), start.shape[:-1]
        if self.backend == "ipopt":
            values, converged, iterations = fitted_by_ipopt(rows, flat, self.max_iterations)
            values = np.where(converged[:, None], values, flat)
            polished = levenberg_marquardt(rows.at, values, max_iterations=1, damping=DAMPING)  # the last digits
            result = LMResult(polished.values, converged, iterations)
        else:
            result = levenberg_marquardt(
                rows.at,
                flat,
                max_iterations=self.max_iterations,
                damping=DAMPING,
                chosen=lambda which: rows.take(which).at,
            )
        return replace(
            result,
            values=result.values.reshape(start.shape),
            converged=result.converged.reshape(batch),
            iterations=result.iterations.reshape(batch),
        )

    def _estimate(self, rows: LegRows, found: LMResult, root: Any) -> Estimate:
        """The estimate at the end of least squares on (weighted) rows."""
        loop, values = rows.loop, found.values
        square, still, local = last_step(rows, found, values_only=not self.covariance)
        codes = np.where(found.converged & still, Status.OPTIMAL, Status.NOT_CONVERGED)
        codes = np.where(local.full_rank & (not loop.blind_spots), codes, Status.RANK_DEFICIENT).astype(np.int8)
        more: dict[str, Any] = {
            "covariance": None,
            "covariance_kind": "not asked for (covariance=False)",
            "degrees_of_freedom": loop.data.n_poses - values.shape[-1],
        }
        if self.covariance or not local.full_rank.all():
            problem = loop.linearised(values)
            more["unseen"] = unseen_combinations(problem, local)
            if self.covariance:
                more |= linear_uncertainty(problem, local, root, values)
        if loop.blind_spots:  # by their combinations where no noise makes them look seen
            more["unseen"] = more.get("unseen") or loop.blind_spots
        square = np.where(codes == Status.OPTIMAL, square, np.nan)
        return Estimate(
            values=np.where((codes == Status.OPTIMAL)[..., None], values, np.nan),
            parameters=loop.parameters,
            codes=codes,
            objective=0.5 * square,
            gap=np.full(codes.shape, np.nan),
            condition=local.condition,
            chi2=None if root is None else square,
            iterations=found.iterations,
            estimator=f"{type(loop).__name__} by {self!r}",
            **more,
        )


def _check_poses(loop: LegLength, first: Array) -> None:
    """Too few poses are a wrong call."""
    if loop.data.n_poses < loop.parameters.size:
        check_rows(loop.linearised(first))


def _without_noise(found: Estimate, seen: Estimate, blind: tuple[str, ...]) -> Estimate:
    """An estimate of a blind loop with the rank and covariance of what its rows see."""
    unseen = (seen.codes == Status.RANK_DEFICIENT) & (found.codes != Status.INFEASIBLE)
    codes = np.where(unseen, seen.codes, found.codes)
    return replace(
        seen,
        values=np.where((codes == Status.OPTIMAL)[..., None], found.values, np.nan),
        codes=codes,
        objective=found.objective,
        unseen=blind or seen.unseen,
    )
