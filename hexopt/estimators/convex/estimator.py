"""The estimator of the convex family: a loss, priors and constraints, posed, solved and proven."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from ...arrays import as_array
from ...constraints import Constraint
from ...errors import InputError
from ...losses import Loss, Quadratic
from ...numerics.forms import Consecutive
from ...numerics.lstsq import LstsqSolution
from ...numerics.programme import Solution
from ...priors import Prior
from ...problem import LinearProblem
from ...result import Certificate, Estimate, Status
from ..least_squares import check_rows, combinations, degrees_of_freedom, linear_uncertainty, unseen_combinations
from .duals import named_duals, solution_duals
from .posed import Posed, Settings, in_batch, posed, reference
from .posing import pose
from .routes import BACKENDS, Answer, closed_form, judged, solve
from .settings import nested, several
from .uncertainty import least_squares_uncertainty, uncertainty
from .uniqueness import undecided

__all__ = ["ConvexEstimator"]


@dataclass(frozen=True)
class ConvexEstimator:
    r"""A convex programme in the whitened residuals, with priors and constraints, and a proof of its answer.

    .. math:: \min_x \sum_i \rho\bigl(W_i(A_i x - y_i)/s\bigr) + \sum_k \pi_k(x)
              \quad\text{subject to}\quad x \in X_1 \cap X_2 \cap \ldots

    Parameters
    ----------
    loss : Loss, default Quadratic()
        :math:`\rho`: ``Quadratic``, ``Huber(t)``, ``GroupHuber(t)``, ``L1``, ``GroupL1`` or ``Chebyshev``; losses per
        pose take the direct form.
    prior : Prior or list of Prior, optional
        :math:`\pi_k`: ``GaussianPrior``, ``Ridge``, ``Lasso``.
    bounds : Constraint or list of Constraint, optional
        :math:`X_k`: ``Box``, ``Ball``, ``Linear``.
    weights : "model", None or array_like, default "model"
        "model": W whitens the rows by the noise model, :math:`W_i = S_i^{-1/2}`, evaluated at the unweighted solution
        or at ``linear(at=…)``; losses other than ``Quadratic`` whiten direct rows pose by pose. None: raw rows. An
        array (..., m) ≥ 0: one weight a row, the inverse of its variance.
    scale : float, "mad" or None, default None
        s: what one standard deviation of the (weighted) rows is, where the noise model does not say it. "mad": 1.4826
        times the median absolute residual of an L1 fit, without the residuals that it makes zero.
    backend : {"auto", "batched", "clarabel", "cvxpy"}, default "auto"
        "batched": Newton or interior point in NumPy on the whole batch; "clarabel": Clarabel directly, problem by
        problem; "cvxpy": the definition. "auto": the fastest that proves its answer, member by member.
    covariance : bool, default True
        Whether to compute covariance and influence.

    Raises
    ------
    InputError
        For thresholds or priors on rows that do not count in standard deviations, unknown names, empty bounds, or a
        backend that does not take the programme.

    Notes
    -----
    Every success carries a gap ≤ ``1e-8·(1 + |objective|)``, computed from the returned point and balanced duals,
    whatever solver found it; smooth losses, free or in a box, are moreover within 1e-6 σ of the optimum (relative to
    the objective where that is large). The optimum of ``L1`` and ``Chebyshev`` need not be unique. ``found.duals``
    holds the forces: "rows" (one a row, ψ of smooth losses), and one entry a constraint, positive where its upper
    bound holds. With fewer poses than unknowns a prior or bounds may make the answer unique: ``found.decided`` then
    names what they decided. With active constraints the covariance is that of the free directions.

    References
    ----------
    Daney (1998), eq. (5), (10) and (14) for the rows; Huber and Ronchetti (2009), Robust Statistics, chapter 7.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(
    ...     robot, 3, "direction", n_poses=12, nominal=robot.perturbed(0.1, rng=0), noise=noise, rng=1
    ... )
    >>> robust = hx.ConvexEstimator(hx.GroupHuber(2.5), bounds=hx.Box.around(data.nominal, 0.5))
    >>> found = hx.estimate(hx.loops.FixedDirection(data).linear(), robust)
    >>> found.status, bool(found.gap < 1e-8)
    (<Status.OPTIMAL: 0>, True)
    """

    loss: Loss = field(default_factory=Quadratic)
    prior: Prior | Sequence[Prior] | None = None
    bounds: Constraint | Sequence[Constraint] | None = None
    weights: Literal["model"] | npt.ArrayLike | None = "model"
    scale: float | Literal["mad"] | None = None
    backend: Literal["auto", "batched", "clarabel", "cvxpy"] = "auto"
    covariance: bool = True

    accepts: ClassVar[tuple[type, ...]] = (LinearProblem,)
    hint: ClassVar[str] = 'write estimate(loop.linear(form="direct"), ConvexEstimator())'

    def __post_init__(self) -> None:
        if not isinstance(self.loss, Loss):
            raise InputError(f"loss: expected a loss such as Huber(1.345), got {self.loss!r}")
        object.__setattr__(self, "prior", several("prior", self.prior, Prior, "GaussianPrior(…)"))
        object.__setattr__(self, "bounds", several("bounds", self.bounds, Constraint, "Box(…)"))
        if self.weights is not None and not isinstance(self.weights, str):
            weights = as_array("weights", self.weights, ("m",), own=True)
            if (weights < 0).any():
                raise InputError(f"weights: expected numbers ≥ 0, found {weights.min():g}")
            object.__setattr__(self, "weights", nested(weights.tolist()))
        elif self.weights not in (None, "model"):
            raise InputError(f"weights: expected None, 'model' or an array, got {self.weights!r}")
        number = isinstance(self.scale, Real) and not isinstance(self.scale, bool)
        if not (self.scale is None or self.scale == "mad" or (number and 0 < float(self.scale) < np.inf)):
            raise InputError(f"scale: expected None, 'mad' or a number > 0, got {self.scale!r}")
        if self.backend not in BACKENDS:
            raise InputError(f"backend: expected {', '.join(map(repr, BACKENDS))}; got {self.backend!r}")
        if self.weights is None and self.scale is None:
            if self.loss.degree is None:
                raise InputError(
                    f"{self.loss!r} has a threshold in σ: use weights='model', or give scale=… or scale='mad'"
                )
            if self.prior:
                raise InputError(
                    "a prior is weighed against rows in σ: use weights='model', or give scale=… or scale='mad'"
                )

    @property
    def _settings(self) -> Settings:
        return Settings(self.loss, self.prior, self.bounds, self.weights, self.scale)  # type: ignore[arg-type]  # tuples

    def cvxpy_problem(self, problem: LinearProblem) -> Any:
        """The programme of one problem as a ``cvxpy.Problem`` in the variable ``x``: the definition.

        Raises
        ------
        InputError
            For a batch: pass one of its problems.
        """
        if problem.batch_shape:
            raise InputError(f"cvxpy_problem takes one problem, got a batch of {problem.batch_shape}")
        return pose(posed(problem, self._settings, raw_unit=True).assembly.programme, 0).problem

    def certificate(self, problem: LinearProblem, found: Estimate) -> Certificate:
        """What is proven of an estimate's values, computed afresh from the problem.

        Smooth losses need the values only; for the others the duals of `found` are the witness.
        """
        made = posed(problem, self._settings)
        scaled, length = made.assembly.programme.scaled()
        count, batch = len(length), problem.batch_shape
        values = np.asarray(found.values, dtype=float).reshape(length.shape)
        finite = np.isfinite(values).all(axis=-1)
        solution = Solution(
            np.where(finite[:, None], values, 0.0) * length,
            finite,
            np.zeros(count, dtype=np.int64),
            **solution_duals(made, found, count),
        )
        known = reference(made.assembly, np.broadcast_to(problem.worst_cancellation, batch).reshape(-1), inverse=False)
        answer = judged(scaled, solution, np.asarray(known.condition))
        proof, good = answer.certificate, answer.proven & finite
        return Certificate(
            gap=np.where(finite, proof.gap * made.unit, np.nan).reshape(batch),
            primal_residual=np.where(finite, proof.primal_residual, np.nan).reshape(batch),
            dual_residual=np.where(finite, proof.dual_residual, np.nan).reshape(batch),
            ok=good.reshape(batch),
        )

    def fit(self, target: LinearProblem) -> Estimate:
        """Solve every problem of the batch; one that is infeasible, singular or unproven fails alone."""
        if not (self.prior or self.bounds):
            check_rows(target)
        made = posed(target, self._settings)
        batch = target.batch_shape
        lost = np.broadcast_to(target.worst_cancellation, batch).reshape(-1)
        plain = self.covariance and not (self.prior or self.bounds)
        known = reference(made.assembly, lost, inverse=plain and isinstance(self.loss, Quadratic))
        answer = self._answer(made, known)
        codes, words = self._codes(target, made, answer, known)
        good = (codes == Status.OPTIMAL)[:, None]
        answer = replace(answer, values=np.where(good, answer.values, np.nan))
        freedom = degrees_of_freedom(target)
        freedom += sum(made.assembly.programme.terms[i].rhs.shape[-1] for i in made.assembly.gaussian)
        freedom -= made.dropped
        certificate = answer.certificate
        return Estimate(
            values=in_batch(answer.values, batch),
            parameters=target.parameters,
            codes=codes.reshape(batch),
            objective=(answer.objective * made.unit).reshape(batch),
            gap=(certificate.gap * made.unit).reshape(batch),
            primal_residual=certificate.primal_residual.reshape(batch),
            dual_residual=certificate.dual_residual.reshape(batch),
            condition=np.asarray(known.condition).reshape(batch),
            chi2=self._chi2(made, answer, batch),
            iterations=np.asarray(answer.iterations).reshape(batch),
            duals=named_duals(made, answer, good, batch),
            estimator=f"{target.name} by {self!r}",
            **words | {"degrees_of_freedom": max(freedom, 0)} | self._uncertainty(target, made, answer, known, good),
        )

    def _answer(self, made: Posed, known: LstsqSolution) -> Answer:
        """The members that may have an answer, by the routes; the others stay without."""
        programme = made.assembly.programme
        quadratic = all(isinstance(term.loss, Quadratic) for term in programme.terms)
        if self.backend == "auto" and quadratic and programme.is_free:
            return closed_form(programme, known)
        hopeless = made.assembly.empty.copy()
        if not self.bounds and len(programme.terms) == 1 + len(made.assembly.gaussian):
            hopeless |= ~np.asarray(known.full_rank)
        if not hopeless.any():
            return solve(programme, self.backend, known)
        keep = np.flatnonzero(~hopeless)
        chosen = replace(known, values=known.values[keep], condition=known.condition[keep])
        return solve(programme.take(keep), self.backend, chosen).spread(keep, len(hopeless))

    def _codes(
        self, target: LinearProblem, posed: Posed, answer: Answer, reference: LstsqSolution
    ) -> tuple[npt.NDArray[np.int8], dict[str, Any]]:
        """The status of each member, and in words what is not seen and what priors or bounds decided."""
        finite = np.isfinite(answer.values).all(axis=-1)
        full = np.asarray(reference.full_rank)
        codes = np.where(answer.proven, Status.OPTIMAL, np.where(finite, Status.INACCURATE, Status.FAILED))
        codes = np.where(full | answer.proven, codes, Status.RANK_DEFICIENT)
        codes = np.where(answer.infeasible | posed.assembly.empty, Status.INFEASIBLE, codes).astype(np.int8)
        if not (self.prior or self.bounds):
            batch = replace(reference, full_rank=full.reshape(target.batch_shape))
            return codes, {"unseen": unseen_combinations(target, batch)}
        loose, partial = undecided(target, posed.assembly, answer, full)
        codes[loose & (codes == Status.OPTIMAL)] = Status.RANK_DEFICIENT
        words: dict[str, Any] = {"undetermined": in_batch(partial, target.batch_shape)}
        for name, which in (
            ("unseen", codes == Status.RANK_DEFICIENT),
            ("decided", partial & (codes == Status.OPTIMAL)),
        ):
            first = np.unravel_index(int(np.argmax(which)), target.batch_shape) if which.any() else None
            words[name] = () if first is None else combinations(target, first)
        return codes, words

    def _chi2(self, made: Posed, answer: Answer, batch: tuple[int, ...]) -> Any:
        if self.weights is None and self.scale is None:
            return None
        terms = [made.assembly.programme.terms[i] for i in (0, *made.assembly.gaussian)]
        if all(isinstance(term.loss, Quadratic) for term in terms) and len(terms) == len(made.assembly.programme.terms):
            return in_batch(2 * answer.objective, batch)
        squares = [np.square(term.residual(answer.values)).sum(axis=(-2, -1)) for term in terms]
        return np.asarray(sum(squares)).reshape(batch)

    def _uncertainty(
        self, target: LinearProblem, made: Posed, answer: Answer, known: LstsqSolution, good: Any
    ) -> dict[str, Any]:
        """Covariance and influence, NaN for members that failed."""
        found = self._first_order(target, made, answer, known)
        for name in ("covariance", "influence"):
            if found.get(name) is not None and not good.all():
                trailing = found[name].ndim - len(target.batch_shape)
                found[name] = np.where(good.reshape(target.batch_shape + (1,) * trailing), found[name], np.nan)
        return found

    def _first_order(self, target: LinearProblem, made: Posed, answer: Answer, known: LstsqSolution) -> dict[str, Any]:
        if not self.covariance:
            return {"covariance": None, "covariance_kind": "not asked for (covariance=False)"}
        if self.scale is not None and isinstance(target.form, Consecutive):
            reason = "a scale says nothing of how consecutive rows are correlated; use the direct form"
            return {"covariance": None, "covariance_kind": reason}
        if self.scale is not None:
            kind = "residual" if self.scale == "mad" else "model"
        elif isinstance(self.weights, str):
            kind = "model" if isinstance(self.loss, Quadratic) else "sandwich"
        else:
            kind = "propagated" if target.noise is not None and self.loss.smooth else ""
        if not isinstance(self.loss, Quadratic) or self.prior or self.bounds:
            return uncertainty(target, made, answer, kind)
        if self.scale is None and (self.weights is None or isinstance(self.weights, str)):
            return linear_uncertainty(
                target,
                made.unscaled(known, target.batch_shape),
                made.root,
                in_batch(answer.values, target.batch_shape),
            )
        return least_squares_uncertainty(target, made, answer, known, kind)
