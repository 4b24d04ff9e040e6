"""Least squares with a unit vector among the unknowns: the global minimum, with its certificate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from ..arrays import Array, matvec, transpose
from ..errors import InputError
from ..numerics.lstsq import EPS, GRAM_LIMIT, LstsqSolution, solve
from ..numerics.sphere import SphereMinimum, minimise_on_sphere
from ..problem import LinearProblem, Whitening
from ..result import Certificate, Estimate, Status
from .least_squares import check_rows, degrees_of_freedom, linear_uncertainty, unseen_combinations

__all__ = ["UnitNormLeastSquares"]

#: Of a success: the largest gap, relative to 1 + |objective|.
GAP = 1e-9
#: How far from one the norm of a certified answer may be.
FEASIBLE = 1e-12


@dataclass(frozen=True)
class UnitNormLeastSquares:
    r"""The global minimum of :math:`\tfrac12\lVert W(A x - y)\rVert^2` subject to :math:`\lVert n\rVert = 1`.

    n is one block of x: for Type I the direction of the locked leg, which plain least squares leaves without a
    length. The programme is not convex, yet it has no duality gap, so that the answer comes with a proof.

    Parameters
    ----------
    block : str, default "direction"
        The unit vector; of several sets of a leg joined, one of them ("direction.2").
    weights : None or "model", default None
        As in :class:`LeastSquares`: raw rows; or rows whitened by the noise model, whose covariance is evaluated
        at the unweighted solution without the unit norm, or at ``linear(at=…)``.
    covariance : bool, default True
        Whether to compute the covariance and the influence.

    Raises
    ------
    InputError
        If the problem has no such block: the direct form has it.

    Notes
    -----
    With the plain solution :math:`\hat x`, :math:`C = (A^T W^T W A)^{-1}` and :math:`H = C_{nn}^{-1}`, the other
    unknowns eliminated, what is left is :math:`\min \tfrac12 (n - \hat n)^T H (n - \hat n)` on the sphere. The secular
    equation gives its multiplier :math:`\lambda`, and :math:`x = \hat x - \lambda\, C_{\cdot n}\, n`.

    For any :math:`\lambda` with :math:`H + \lambda I \succ 0` the Lagrangian L is convex, and its minimum bounds the
    programme from below. An x with :math:`\lVert n\rVert = 1` is above that bound by

    .. math:: \tfrac12 \nabla L^T (C^{-1} + \lambda E)^{-1} \nabla L, \qquad
              \nabla L = A^T W^T W (A x - y) + \lambda E x,

    E being the projection on n. That is the `gap`, with :math:`\lambda = n^T(\hat n - n) / n^T C_{nn} n` from the
    returned point; a success has at most 1e-9·(1 + ``|objective|``). ``duals["unit_norm"]`` is :math:`\lambda`,
    positive where the constraint shortens n. Where two minimisers are as good the status is RANK_DEFICIENT.

    Covariance and influence are those in the tangent space of the sphere, to first order in the noise:
    :math:`T (T^T A^T W^T W A T)^{-1} T^T` under weights, the sandwich otherwise, T spanning the changes of x that
    keep :math:`\lVert n\rVert`. The unit vector counts one unknown less.

    References
    ----------
    Daney (1998), section 3.2, eq. (3) and (4), where the direction is a unit vector; Moré and Sorensen (1983).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "direction", n_poses=7, noise=noise, rng=2)
    >>> problem = hx.loops.FixedDirection(data).linear("direct")
    >>> found = hx.estimate(problem, hx.UnitNormLeastSquares(weights="model"))
    >>> found.status, float(np.linalg.norm(found.params["direction"]).round(12))
    (<Status.OPTIMAL: 0>, 1.0)
    >>> bool(found.gap <= 1e-9 * found.objective)
    True
    """

    block: str = "direction"
    weights: Literal["model"] | None = None
    covariance: bool = True

    accepts: ClassVar[tuple[type, ...]] = (LinearProblem,)
    hint: ClassVar[str] = 'write estimate(FixedDirection(data).linear("direct"), UnitNormLeastSquares())'

    def __post_init__(self) -> None:
        if not isinstance(self.block, str):
            raise InputError(f"block: expected the name of a block, such as 'direction', got {self.block!r}")
        if self.weights not in (None, "model"):
            raise InputError(f"weights: expected None or 'model', got {self.weights!r}")

    def fit(self, target: LinearProblem) -> Estimate:
        """Solve every problem of the batch; a member without a single answer fails alone."""
        check_rows(target)
        reduced = self._reduced(target)
        plain, where = reduced.plain, reduced.where
        centre = np.where(plain.full_rank[..., None], plain.values[..., where], 0.0)
        pull = reduced.curvature * matvec(transpose(reduced.axes), centre)
        minimum = minimise_on_sphere(reduced.curvature, reduced.axes, pull, reduced.rounding)
        values = plain.values - minimum.multiplier[..., None] * matvec(reduced.cross, minimum.values)
        values[..., where] = minimum.values
        proof, objective, multiplier = reduced.certified(values)
        codes = np.where(proof.ok, Status.OPTIMAL, Status.INACCURATE)
        codes = np.where(plain.full_rank & minimum.unique, codes, Status.RANK_DEFICIENT).astype(np.int8)
        good = codes == Status.OPTIMAL
        uncertainty = self._uncertainty(target, reduced, minimum.values, objective, values)
        for name in ("covariance", "influence"):
            if uncertainty.get(name) is not None and not good.all():
                trailing = uncertainty[name].ndim - good.ndim
                uncertainty[name] = np.where(good.reshape(good.shape + (1,) * trailing), uncertainty[name], np.nan)
        return Estimate(
            values=np.where(good[..., None], values, np.nan),
            parameters=target.parameters,
            codes=codes,
            objective=objective,
            gap=proof.gap,
            condition=plain.condition,
            chi2=None if reduced.root is None else 2 * objective,
            duals={"unit_norm": multiplier},
            estimator=f"{target.name} by {self!r}",
            unseen=unseen_combinations(target, plain) or _two_answers(target, reduced, minimum),
            primal_residual=proof.primal_residual,
            dual_residual=proof.dual_residual,
            **uncertainty | {"degrees_of_freedom": uncertainty["degrees_of_freedom"] + 1},
        )

    def _uncertainty(
        self, target: LinearProblem, reduced: _Reduced, direction: Array, objective: Array, values: Array
    ) -> dict[str, Any]:
        if self.covariance:
            return linear_uncertainty(target, reduced.tangent(direction, objective), reduced.root, values)
        return {
            "covariance": None,
            "covariance_kind": "not asked for (covariance=False)",
            "degrees_of_freedom": degrees_of_freedom(target),
        }

    def certificate(self, target: LinearProblem, found: Estimate) -> Certificate:
        """What is proven of the values of `found`, whoever found them: the gap to the global minimum on the sphere."""
        check_rows(target)
        if found.values.shape != (*target.batch_shape, target.parameters.size):
            raise InputError(
                f"{found.values.shape} values are no answer to {target.batch_shape} problems of {target.name}"
            )
        return self._reduced(target).certified(found.values)[0]

    def _reduced(self, target: LinearProblem) -> _Reduced:
        if self.block not in target.parameters:
            names = ", ".join(target.parameters.names)
            raise InputError(f"block: {target.name} has {names} and no {self.block!r}; the direct form: {self.hint}")
        root = target.whitening() if self.weights == "model" else None
        matrix, rhs = target.whitened_by(root)
        return _Reduced.of(matrix, rhs, root, target, target.parameters[self.block])


@dataclass(frozen=True, eq=False)
class _Reduced:
    """The whitened rows, their plain solution, and the programme on the sphere that is left of them."""

    matrix: Array
    rhs: Array
    root: Whitening | None
    plain: LstsqSolution
    where: slice
    gain: Array  # the pseudo-inverse, and 0 where the rank is deficient
    cross: Array  # the columns of C that belong to n, (..., p, q)
    curvature: Array  # eigenvalues of H = C_nn⁻¹, ascending
    axes: Array
    rounding: Array  # of the smallest of them

    @classmethod
    def of(cls, matrix: Array, rhs: Array, root: Whitening | None, target: LinearProblem, where: slice) -> _Reduced:
        """Eliminate all unknowns but those of the block `where`."""
        plain = solve(matrix, rhs, target.worst_cancellation)
        bad = ~plain.full_rank[..., None, None]
        gain = np.where(bad, 0.0, plain.inverse)
        cross = gain @ transpose(gain[..., where, :])
        compliance, axes = np.linalg.eigh(cross[..., where, :] + bad * np.eye(where.stop - where.start))
        compliance = np.maximum(compliance, EPS * compliance[..., -1:])
        curvature = 1.0 / compliance[..., ::-1]
        condition = np.where(plain.full_rank, plain.condition, 1.0)
        share = np.minimum(EPS * condition * np.minimum(condition, GRAM_LIMIT), 0.5)
        rounding = share * curvature[..., 0]
        return cls(matrix, rhs, root, plain, where, gain, cross, curvature, axes[..., ::-1], rounding)

    def certified(self, values: Array) -> tuple[Certificate, Array, Array]:
        """What is proven of any values, their objective, and the multiplier that proves it."""
        n = values[..., self.where]
        residual = matvec(self.matrix, values) - self.rhs
        objective = 0.5 * np.einsum("...m,...m->...", residual, residual)
        step = matvec(self.gain, residual)
        square, pushed = np.einsum("...i,...i->...", n, n), matvec(self.cross, n)
        multiplier = -_ratio(n, step[..., self.where], pushed[..., self.where])
        multiplier = np.maximum(multiplier, self.rounding - self.curvature[..., 0])
        step += multiplier[..., None] * pushed  # C times the gradient of the Lagrangian
        moved = matvec(self.matrix, step)
        turned = matvec(transpose(self.axes), step[..., self.where])
        held = self.curvature / (self.curvature + multiplier[..., None])
        gap = np.einsum("...m,...m->...", moved, moved)
        gap = gap - multiplier * np.einsum("...i,...i->...", turned, held * turned)
        gap = 0.5 * (np.maximum(gap, 0.0) + np.abs(multiplier * (square - 1)))
        length = np.sqrt(np.einsum("...mp,...mp->...p", self.matrix, self.matrix))
        away = np.abs(np.sqrt(square) - 1)
        ok = self.plain.full_rank & (gap <= GAP * (1 + objective)) & (away <= FEASIBLE)
        gradient = matvec(transpose(self.matrix), moved)
        imbalance = (np.abs(gradient) / np.where(length > 0, length, 1.0)).max(axis=-1)
        return Certificate(gap, away, imbalance, np.asarray(ok)), objective, multiplier

    def tangent(self, n: Array, objective: Array) -> LstsqSolution:
        """The plain solution with the gain of rows on what can move: the changes of x that keep the norm of n."""
        inner = self.plain.inverse[..., self.where, :]
        pushed = matvec(self.cross, n)
        along = _ratio(n[..., None, :], transpose(inner), pushed[..., None, self.where])
        inverse = self.plain.inverse - pushed[..., :, None] * along[..., None, :]
        return replace(self.plain, inverse=inverse, objective=objective)


def _ratio(n: Array, part: Array, whole: Array) -> Array:
    """nᵀ part / nᵀ whole, and 0 where the rank is deficient, so that nothing was pushed."""
    size = np.einsum("...i,...i->...", n, whole)
    ratio: Array = np.einsum("...i,...i->...", n, part) / np.where(size > 0, size, 1.0)
    return ratio


def _two_answers(target: LinearProblem, reduced: _Reduced, minimum: SphereMinimum) -> tuple[str, ...]:
    """Where the first problem with two minimisers has them, in words."""
    if np.all(minimum.unique):
        return ()
    first = np.unravel_index(int(np.argmin(minimum.unique)), minimum.unique.shape)
    apart = matvec(reduced.cross, minimum.values - minimum.mirror)[first]
    return (f"on which side the answer lies along {target.parameters.combination(apart)}",)
