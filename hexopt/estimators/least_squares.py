"""Least squares on a linear problem: the paper's estimator, and its weighted form."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from ..arrays import Array
from ..errors import InputError, NumericalWarning, RankDeficientError
from ..numerics.forms import Centred
from ..numerics.lstsq import EPS, LstsqSolution, null_combinations, solve, solve_normal_equations, solve_svd
from ..problem import LinearProblem, Whitening
from ..result import Estimate, Status

__all__ = [
    "LeastSquares",
    "check_rows",
    "combinations",
    "degrees_of_freedom",
    "linear_uncertainty",
    "status_of",
    "unseen_combinations",
]

#: Where the square of the condition number κ exceeds this many κ, normal equations may lose more than 100·eps·κ.
NORMAL_EQUATIONS_LIMIT = 100.0
#: A relative error that the normal equations may have and still be a success; beyond it they are INACCURATE.
NORMAL_EQUATIONS_LOSS = 1e-8
_SOLVERS = {"auto": solve, "svd": solve_svd, "normal": solve_normal_equations}


@dataclass(frozen=True)
class LeastSquares:
    r"""Least squares: :math:`\min_x \tfrac12\lVert W(A x - y)\rVert^2`.

    Parameters
    ----------
    method : {"auto", "svd", "normal"}, default "auto"
        "svd": singular values of the column-scaled matrix. "auto": the same accuracy, by the refined Gram
        matrix where the condition number is below 1000. "normal": :math:`(A^TA)^{-1}A^Ty` as the paper
        writes it, which squares the condition number: it warns where that costs digits, and is INACCURATE where
        it may cost more than half of them.
    weights : None or "model", default None
        None: raw rows, as in the paper. "model": rows whitened by the noise model (generalised least
        squares), whose covariance is evaluated at the unweighted solution or at ``linear(at=…)``.
    covariance : bool, default True
        Whether to compute the covariance and the influence; sweeps that need neither save most of the time.

    Notes
    -----
    The covariance of the unweighted estimate is the sandwich :math:`A^+ D S D^T A^{+T}` of the noise
    model; of the weighted one :math:`(A^T W^T W A)^{-1}`; without a noise model it comes from the residuals.
    The gap is ``|U'r|²/2``, from the returned residual r projected on the range of A: zero at an optimum.

    References
    ----------
    Daney (1998), eq. (7), (12) and (17).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", n_poses=7, noise=noise, rng=2)
    >>> found = hx.estimate(hx.loops.FixedLeg(data).linear("consecutive"), hx.LeastSquares())
    >>> found.status, found.covariance_kind
    (<Status.OPTIMAL: 0>, 'sandwich')
    """

    method: Literal["auto", "svd", "normal"] = "auto"
    weights: Literal["model"] | None = None
    covariance: bool = True

    accepts: ClassVar[tuple[type, ...]] = (LinearProblem,)
    hint: ClassVar[str] = 'write estimate(loop.linear(form="direct"), LeastSquares())'

    def __post_init__(self) -> None:
        if self.method not in _SOLVERS:
            raise InputError(f"method: expected {', '.join(map(repr, _SOLVERS))}; got {self.method!r}")
        if self.weights not in (None, "model"):
            raise InputError(f"weights: expected None or 'model', got {self.weights!r}")

    def fit(self, target: LinearProblem) -> Estimate:
        """Solve every problem of the batch; a rank-deficient member fails alone."""
        check_rows(target)
        solver = _SOLVERS[self.method]
        root = target.whitening() if self.weights == "model" else None
        solution = solver(*target.whitened_by(root), target.worst_cancellation, inverse=self.covariance)
        codes = status_of(solution.full_rank)
        if self.method == "normal":
            lost = _lost_digits(solution.condition, target.worst_cancellation)
            codes[(codes == Status.OPTIMAL) & (lost > NORMAL_EQUATIONS_LOSS)] = Status.INACCURATE
        if self.covariance:
            uncertainty = linear_uncertainty(target, solution, root, solution.values)
        else:
            uncertainty = {
                "covariance": None,
                "covariance_kind": "not asked for (covariance=False)",
                "degrees_of_freedom": degrees_of_freedom(target),
            }
        return Estimate(
            values=np.where((codes == Status.OPTIMAL)[..., None], solution.values, np.nan),
            parameters=target.parameters,
            codes=codes,
            objective=solution.objective,
            gap=solution.gap,
            condition=solution.condition,
            chi2=None if root is None else 2 * solution.objective,
            estimator=f"{target.name} by {self!r}",
            unseen=unseen_combinations(target, solution),
            **uncertainty,
        )


def check_rows(problem: LinearProblem) -> None:
    """Too few equations for the unknowns is a wrong call, not a failed estimate."""
    unknowns = problem.parameters.size
    rows = degrees_of_freedom(problem) + unknowns
    if rows >= unknowns:
        return
    need = f"; {problem.name} needs at least {problem.minimum_poses} poses" if problem.minimum_poses else ""
    raise RankDeficientError(
        f"too few poses: {rows} equations for {unknowns} unknowns ({', '.join(problem.parameters.names)}){need}",
        combinations(problem, ()),
    )


def status_of(full_rank: np.ndarray) -> np.ndarray:
    """Status codes from a mask of full rank."""
    return np.where(full_rank, Status.OPTIMAL, Status.RANK_DEFICIENT).astype(np.int8)


def unseen_combinations(problem: LinearProblem, solution: LstsqSolution) -> tuple[str, ...]:
    """What the first rank-deficient problem of the batch does not see, in words."""
    if solution.full_rank.all():
        return ()
    first = np.unravel_index(int(np.argmin(solution.full_rank)), solution.full_rank.shape)
    seen = combinations(problem, first)
    if seen:
        return seen
    lost = np.broadcast_to(problem.worst_cancellation, problem.batch_shape)[first]
    if solve_svd(problem.matrix[first], problem.rhs[first], lost).full_rank:
        return ("nothing, but the normal equations square the condition number",)
    return combinations(problem, first, at_least=1)


def combinations(problem: LinearProblem, index: tuple[np.intp, ...], at_least: int = 0) -> tuple[str, ...]:
    """What the rows of one problem of a batch do not see, in words."""
    if 0 in problem.batch_shape:
        return ()
    first = index or (0,) * len(problem.batch_shape)
    lost = np.broadcast_to(problem.cancellation, (*problem.batch_shape, problem.parameters.size))[first]
    unseen = null_combinations(problem.matrix[first], lost, threshold=0.05, at_least=at_least)
    return tuple(problem.parameters.combination(vector, threshold=0.0) for vector in unseen)


def degrees_of_freedom(problem: LinearProblem) -> int:
    """Rows minus unknowns; a centred form has used one block of rows for the mean."""
    rows, unknowns = problem.matrix.shape[-2:]
    return rows - unknowns - (problem.rows_per_block if isinstance(problem.form, Centred) else 0)


def linear_uncertainty(
    problem: LinearProblem, solution: LstsqSolution, root: Whitening | None, values: Array
) -> dict[str, Any]:
    """Covariance, its kind, influence and degrees of freedom of a (whitened) least-squares solution.

    `values` is where the noise model is evaluated; `root` is the whitening that was used, if any.
    """
    freedom = degrees_of_freedom(problem)
    gain = solution.inverse if root is None else root.after(solution.inverse)
    influence = problem.direct_gain(gain)
    result: dict[str, Any] = {"influence": influence, "degrees_of_freedom": freedom}
    if problem.uncarried:
        return result | {"covariance": None, "covariance_kind": problem.uncarried}
    if root is not None:
        square = solution.inverse @ np.swapaxes(solution.inverse, -1, -2)
        return result | {"covariance": square, "covariance_kind": "model"}
    if problem.noise is not None:
        covariance = problem.noise.covariance(values).propagated(influence)
        return result | {"covariance": covariance, "covariance_kind": "sandwich"}
    if freedom == 0:
        reason = "no noise model, and no residual is left to estimate one (as many rows as unknowns)"
        return result | {"covariance": None, "covariance_kind": reason}
    variance = 2 * solution.objective / _residual_weight(problem, influence)
    flat = influence.reshape(*influence.shape[:-2], influence.shape[-2] * influence.shape[-1])
    covariance = variance[..., None, None] * (flat @ np.swapaxes(flat, -1, -2))
    return result | {"covariance": covariance, "covariance_kind": "residual"}


def _residual_weight(problem: LinearProblem, influence: Array) -> Array:
    r"""The sum of squared residuals that direct rows of unit variance leave, :math:`\mathrm{tr}((I - AA^+) D D^T)`.

    For direct rows it is the degrees of freedom.
    """
    k, d, p = problem.matrix.shape[-2] // problem.rows_per_block, problem.rows_per_block, problem.matrix.shape[-1]
    rows = problem.matrix.reshape(*problem.batch_shape, k, d, p)
    n = influence.shape[-2]
    multiplier = problem.form.apply(np.eye(n)[:, None, :])  # (..., k, 1, n)
    total = d * np.einsum("...kin,...kin->...", multiplier, multiplier)
    weight: Array = total - np.einsum("...pnd,...ndp->...", influence, problem.form.adjoint(rows))
    return weight


def _lost_digits(condition: Array, cancellation: Array) -> Array:
    """What squaring costs each problem beyond the 100·eps·κ that the other methods promise, relative; it warns of that.

    The cost is eps·(κ/c)², where c is the cancellation that κ contains.
    """
    squared = np.asarray(condition / cancellation) ** 2
    bad = squared > NORMAL_EQUATIONS_LIMIT * np.asarray(condition)
    if bad.any():
        worst = float(np.max(np.where(np.isfinite(condition), condition, 0.0)))
        lost = EPS * float(np.max(np.where(np.isfinite(squared), squared, 0.0)))
        warnings.warn(
            f"normal equations: {int(bad.sum())} of {bad.size} problems have too large a condition number "
            f"(worst {worst:.2g}); its square costs digits (relative error up to {lost:.1g}). Use LeastSquares()",
            NumericalWarning,
            stacklevel=4,
        )
    return np.where(bad, EPS * squared, 0.0)
