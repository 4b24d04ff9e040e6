"""What every estimator returns, and the one function that runs them all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from .arrays import Array, BoolArray, norm
from .errors import InputError, UnitError
from .geometry import LENGTH_UNITS, Hexapod, Leg
from .geometry.leg import LEG_BLOCKS
from .parameters import Parameters
from .summaries import failure_of, summary_of

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Certificate", "Estimate", "Estimator", "Status", "estimate"]


class Status(IntEnum):
    """How an estimation ended; only OPTIMAL is a success."""

    OPTIMAL = 0
    INACCURATE = 1
    RANK_DEFICIENT = 2
    NOT_CONVERGED = 3
    INFEASIBLE = 4
    FAILED = 5


_NAMES = {status.value: status.name for status in Status}


@dataclass(frozen=True, eq=False)
class Certificate:
    """What is proven of values, whoever found them.

    Attributes
    ----------
    gap : ndarray, shape (...)
        Objective minus a lower bound of the optimum.
    primal_residual, dual_residual : ndarray, shape (...)
        Largest violation of a constraint, and largest imbalance of the duals, in scaled variables.
    ok : ndarray of bool, shape (...)
        Whether that proves the values to be optimal.
    """

    gap: Array
    primal_residual: Array
    dual_residual: Array
    ok: BoolArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated parameters of one problem or a batch, and how sure they are.

    Attributes
    ----------
    values : ndarray, shape (..., p)
        NaN where the status is no success.
    parameters : Parameters
        Names, units and places of the p values.
    codes : ndarray of int, shape (...)
        :class:`Status` of every problem; see :attr:`status`.
    covariance : ndarray, shape (..., p, p), or None
        Then `covariance_kind` says why.
    covariance_kind : str
        "sandwich", "model", "residual" or "posterior"; or the reason for None.
    objective : ndarray, shape (...)
        Value of the estimator's programme at `values`.
    gap : ndarray, shape (...)
        Objective minus a lower bound computed from `values`; NaN without a certificate.
    condition : ndarray, shape (...)
        Condition number of the column-scaled matrix, within a factor √p, times what the form's differences
        cancelled; NaN if not computed.
    degrees_of_freedom : int
    chi2 : ndarray, shape (...), or None
        Weighted sum of squared residuals; None for unweighted estimates.
    influence : ndarray, shape (..., p, n, d), or None
        −∂values/∂(direct rows), by which the errors of poses are carried on.
    iterations : ndarray of int, shape (...)
        0 for closed forms.
    duals : dict of str to ndarray
        Forces by name, of convex programmes: "rows" (..., m), and one entry a constraint, positive where its upper
        bound holds.
    estimator : str
    unseen : tuple of str
        Where a problem is rank deficient: the combinations that its matrix does not see.
    decided : tuple of str
        Of a success: the combinations that the measurements do not see, so that a prior or bounds decided them.
    undetermined : ndarray of bool, shape (...), or None
        Which problems that is true of; None where there is neither prior nor bound.
    primal_residual, dual_residual : ndarray, shape (...), or None
        Largest violation of a constraint, and largest imbalance of the duals, at `values` in scaled variables.
    """

    values: Array
    parameters: Parameters
    codes: npt.NDArray[np.int8]
    covariance: Array | None
    covariance_kind: str
    objective: Array
    gap: Array
    condition: Array
    degrees_of_freedom: int
    chi2: Array | None = None
    influence: Array | None = None
    iterations: npt.NDArray[np.int64] = field(default_factory=lambda: np.array(0))
    duals: Mapping[str, Array] = field(default_factory=dict)
    estimator: str = ""
    unseen: tuple[str, ...] = ()
    decided: tuple[str, ...] = ()
    undetermined: BoolArray | None = None
    primal_residual: Array | None = None
    dual_residual: Array | None = None

    @property
    def params(self) -> dict[str, Array]:
        """The values by block name: "base_point" → (..., 3), and so on."""
        return self.parameters.split(self.values)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one problem."""
        return self.values.shape[:-1]

    @property
    def status(self) -> Any:
        """A :class:`Status` for one problem, an object array of them for a batch."""
        if not self.batch_shape:
            return Status(int(self.codes))
        return np.array([Status(int(code)) for code in self.codes.flat], dtype=object).reshape(self.batch_shape)

    @property
    def ok(self) -> Any:
        """Whether the status is a success: a bool, or an array of them."""
        good: BoolArray = np.asarray(self.codes) == Status.OPTIMAL
        return good if self.batch_shape else bool(good)

    @property
    def standard_errors(self) -> Array:
        """Square roots of the covariance's diagonal, shape (..., p)."""
        if self.covariance is None:
            raise InputError(f"there is no covariance: {self.covariance_kind}")
        return np.sqrt(np.einsum("...ii->...i", self.covariance))

    def covariance_of(self, *names: str) -> Array:
        """The covariance of some blocks, in the given order."""
        if self.covariance is None:
            raise InputError(f"there is no covariance: {self.covariance_kind}")
        index = np.concatenate([np.arange(self.parameters.size)[self.parameters[name]] for name in names])
        return self.covariance[..., index[:, None], index]

    def error(self, truth: Leg | Hexapod) -> dict[str, Array]:
        r"""Euclidean error of every leg block, :math:`\lVert \hat b - b\rVert` and so on, by name.

        Parameters
        ----------
        truth : Leg or Hexapod
            The true leg; or the robot, for "leg3.base_point" and so on of several legs (Daney 1998, section 4).
        """
        found = {}
        for block in self.parameters:
            prefix, _, name = block.name.rpartition(".")
            if name not in LEG_BLOCKS or bool(prefix) == isinstance(truth, Leg):
                continue
            leg = truth if isinstance(truth, Leg) else truth.leg(int(prefix.removeprefix("leg")))
            if block.unit in LENGTH_UNITS and block.unit != leg.length_unit:
                raise UnitError(f"the estimate of {block.name} is in {block.unit}, the leg in {leg.length_unit}")
            found[block.name] = norm(self.params[block.name] - leg.block(name))
        if not found and any(name.rpartition(".")[2] in LEG_BLOCKS for name in self.parameters.names):
            raise InputError(
                f"this estimate has {', '.join(self.parameters.names)}: a leg for one leg, the robot for several"
            )
        return found

    def __getitem__(self, index: Any) -> Estimate:
        """One problem of a batch, or some."""
        if not self.batch_shape:
            raise InputError("this estimate is of one problem, not of a batch")

        def pick(value: Any) -> Any:
            return None if value is None else value[index]

        names = ["values", "codes", "covariance", "objective", "gap", "condition", "chi2", "influence"]
        names += ["primal_residual", "dual_residual", "undetermined"]
        return replace(
            self,
            unseen=self.unseen if np.any(self.codes[index] == Status.RANK_DEFICIENT) else (),
            decided=self.decided if self.undetermined is not None and np.any(self.undetermined[index]) else (),
            **{name: pick(getattr(self, name)) for name in names},
            iterations=self.iterations if self.iterations.ndim == 0 else self.iterations[index],
            duals={name: value[index] for name, value in self.duals.items()},
        )

    def to_frame(self) -> pd.DataFrame:
        """A tidy pandas table: one row a problem and parameter."""
        import pandas as pd

        count, size = int(np.prod(self.batch_shape)), self.parameters.size
        errors = np.full((count, size), np.nan) if self.covariance is None else self.standard_errors
        units = [block.unit for block in self.parameters for _ in range(block.size)]
        return pd.DataFrame(
            {
                "problem": np.repeat(np.arange(count), size),
                "parameter": list(self.parameters.labels) * count,
                "value": self.values.reshape(-1),
                "standard_error": errors.reshape(-1),
                "unit": units * count,
                "status": np.repeat([Status(int(code)).name for code in np.ravel(self.codes)], size),
            }
        )

    def summary(self) -> str:
        """A readable report: values, units, standard errors, fit and certificate."""
        return summary_of(self, _NAMES)


class Estimator(Protocol):
    """An estimator is a value with settings; it says what it accepts and has one method, `fit`."""

    @property
    def accepts(self) -> tuple[type, ...]:
        """The kinds of target that `fit` takes."""
        ...

    @property
    def hint(self) -> str:
        """What to write when the target is of another kind."""
        ...

    def fit(self, target: Any) -> Estimate:
        """Estimate the parameters of `target`, a member of a batch failing alone."""
        ...


def estimate(target: Any, estimator: Estimator, throw: bool | None = None) -> Estimate:
    """Estimate the parameters of a linear problem or a loop equation.

    Parameters
    ----------
    target : LinearProblem or loop
        What the estimator accepts.
    estimator : Estimator
        For example ``LeastSquares()``; settings are in its constructor.
    throw : bool, optional
        Raise if a problem has no trustworthy answer (True), or return NaN and a status (False). By
        default raise for a single problem, not for a batch. A wrong call always raises.

    Returns
    -------
    Estimate

    Raises
    ------
    InputError
        If the estimator does not take this target; the message says what to write.
    RankDeficientError
        If the parameters are not determined; the message names the unseen combinations.
    EstimationError
        For any other failure, under `throw`.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, leg=3, lock="leg", n_poses=5, n_sets=2, rng=0)
    >>> found = hx.estimate(hx.loops.FixedLeg(data).linear(), hx.LeastSquares())
    >>> bool((found.error(robot.leg(3))["platform_point"] < 1e-12).all())
    True
    """
    if isinstance(estimator, type) or not hasattr(estimator, "accepts"):
        raise InputError(f"estimator: expected one such as LeastSquares(), got {estimator!r}")
    if not isinstance(target, estimator.accepts):
        wanted = " or ".join(kind.__name__ for kind in estimator.accepts)
        raise InputError(f"{type(estimator).__name__} takes a {wanted}, got {type(target).__name__}: {estimator.hint}")
    result = estimator.fit(target)
    if throw is None:
        throw = not result.batch_shape
    if throw and not np.all(result.ok):
        raise failure_of(result, _NAMES)
    return result
