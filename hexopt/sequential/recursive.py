"""Weighted least squares pose by pose: the Kalman filter, its information form, and its square root."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray
from ..errors import InputError
from ..estimators.least_squares import check_rows
from ..geometry import Leg
from ..loops import Loop
from ..measurements import LegMeasurements
from ..numerics.forms import Direct
from ..numerics.lstsq import null_combinations, solve
from ..parameters import Parameters
from ..problem import LinearProblem
from ..result import Estimate, Status
from .linear_run import FILTERS, Gate, empty_run, pose_rows, solved
from .over import check_gate, check_noise, check_state, next_pose
from .state import Moment, RunningState, chi2_quantile

__all__ = ["Recursive", "RecursiveState"]


@dataclass(frozen=True)
class Recursive:
    r"""Weighted least squares, one pose after the other: a filter of filterpy on rows :math:`z_i = H_i x + \nu_i`.

    With :math:`H_i`, :math:`z_i` the direct rows of pose i, whitened by its :math:`S_i^{-1/2}`, and parameters that
    stand still (no prediction step),

    .. math:: K_i = P_{i-1} H_i^T (I + H_i P_{i-1} H_i^T)^{-1}, \quad
              \hat x_i = \hat x_{i-1} + K_i (z_i - H_i \hat x_{i-1}), \quad
              P_i = (I - K_i H_i) P_{i-1}.

    It begins with no information at all, and ends where ``LeastSquares(weights="model")`` does.

    Parameters
    ----------
    filter : {"kalman", "information", "square_root"}
        filterpy's KalmanFilter (Joseph form), InformationFilter or SquareRootKalmanFilter. They agree; the square root
        keeps most digits.
    level : float, default 0.999
        A pose is flagged where its normalised innovation squared exceeds this quantile of :math:`\chi^2_d`.
    reject : bool, default False
        Whether flagged poses are left out of the estimate.

    Notes
    -----
    *Start.* An information filter started from zero information was wrong by metres, so rows are held and solved
    together until they determine the parameters with a condition number (of scaled columns) below 2000. Only then
    filterpy goes on, about that solution and in scaled variables. Until the rows have full rank the status is
    RANK_DEFICIENT, with what is unseen. Poses before that cannot be tested, and a bad one among them
    spoils the tests of the others. A bad pose that counts leaves the status OPTIMAL, as in least squares: ask the
    state's ``flagged`` and ``overconfident``. The end differs from the batch by less than 1e-8 standard errors
    (Kalman filter) or 1e-9 (square root), in 1000 sets of 4 to 20 poses.

    *Weights.* :meth:`fit` takes :math:`S_i` at the unweighted solution of all poses, or at ``linear(at=…)``. For
    poses that arrive one by one, :meth:`start` takes ``at=`` too; without it a pose is weighed at the running
    estimate, and those before the first estimate at their unweighted solution, so that no guess leaks in. By the
    tenth pose that costs 2 % in error against the batch, by the twentieth half a percent.

    *Shared errors* (a common error of all poses, the error of known estimates) are further unknowns f with
    :math:`0 = f + \nu`: the answer is that of the full covariance :math:`\mathrm{diag}(S_i) + U U^T`.

    filterpy runs one set at a time: sweeps are faster with :class:`~hexopt.LeastSquares`. A covariance that is not
    positive definite after an update is a status FAILED.

    References
    ----------
    Kalman (1960). Bar-Shalom, Li and Kirubarajan (2001), section 5.4, on the innovation test.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "direction", n_poses=20, noise=noise, rng=2)
    >>> loop = hx.loops.FixedDirection(data)
    >>> batch = hx.estimate(loop.linear(), hx.LeastSquares(weights="model"))
    >>> found = hx.estimate(loop, hx.Recursive())
    >>> bool(np.abs(found.values / batch.values - 1).max() < 1e-9)
    True

    Poses that arrive one by one, until the base point is known to 0.1 cm:

    >>> state = hx.Recursive().start(loop)
    >>> for i in range(data.n_poses):
    ...     state = hx.Recursive().step(state, data.poses([i]))
    ...     if state.enough(base_point=0.1):
    ...         break
    >>> state.n_poses, bool(state.predicted_error["base_point"][-1] < 0.1), bool(state.flagged.any())
    (5, True, False)
    """

    filter: Literal["kalman", "information", "square_root"] = "kalman"
    level: float = 0.999
    reject: bool = False

    accepts: ClassVar[tuple[type, ...]] = (Loop, LinearProblem)
    hint: ClassVar[str] = 'write estimate(loop, Recursive()), or estimate(loop.linear(form="direct"), Recursive())'

    def __post_init__(self) -> None:
        if self.filter not in FILTERS:
            raise InputError(f"filter: expected {', '.join(map(repr, FILTERS))}; got {self.filter!r}")
        check_gate(self.level, self.reject)

    def fit(self, target: Loop | LinearProblem) -> Estimate:
        """The estimate after all poses; a member of a batch that fails, fails alone."""
        problem = self._problem(target)
        check_rows(problem)
        return self._scanned(problem, None, keep=False).estimate

    def scan(self, target: Loop | LinearProblem) -> RecursiveState:
        """The state after all poses of a target, in their order: with estimates and innovations of every pose.

        Of a loop it goes on by :meth:`step`; later poses are weighed where these were.
        """
        return self._scanned(self._problem(target), target if isinstance(target, Loop) else None, keep=True)

    def start(self, loop: Loop, at: npt.ArrayLike | Leg | Estimate | None = None) -> RecursiveState:
        """The state before any pose.

        Parameters
        ----------
        loop : Loop
            Which equation, which unknowns and what is known. Its own poses are not counted.
        at : values, Leg or Estimate, optional
            Where poses are weighed; by default at the running estimate. A nuisance that it leaves open is what fits
            the loop's own poses best.
        """
        if not isinstance(loop, Loop):
            raise InputError(f"start: expected a loop such as loops.FixedDirection(data), got {type(loop).__name__}")
        problem = loop.linear(form="direct", at=at)
        if problem.at is not None:
            every = (*problem.batch_shape, problem.parameters.size)
            problem = replace(problem, at=np.broadcast_to(problem.at, every))
        return self._empty(problem, loop)

    def step(self, state: RecursiveState, pose: LegMeasurements) -> RecursiveState:
        """The state after one more pose, which is :class:`~hexopt.LegMeasurements` with n = 1 (of every set)."""
        check_state(state, RecursiveState)
        loop = state.loop
        if loop is None:
            raise InputError(
                "step: this state came from a linear problem; poses are added to one from start(loop) or scan(loop)"
            )
        problem = next_pose(loop, pose).linear(form="direct")
        runs, waiting = self._stepped(state, problem)
        moments = (*state.moments, _moment(runs, problem.parameters))
        return replace(state, runs=runs, waiting=waiting, moments=moments)

    # --- pieces -----------------------------------------------------------------------------------

    def _problem(self, target: Loop | LinearProblem) -> LinearProblem:
        problem = target.linear(form="direct") if isinstance(target, Loop) else target
        if not isinstance(problem.form, Direct):
            raise InputError(
                "Recursive takes one block of rows a pose, independent of the others; a "
                f'{type(problem.form).__name__.lower()} form mixes poses: write loop.linear(form="direct")'
            )
        check_noise(problem.name, problem.noise)
        if problem.at is None:
            problem = replace(problem, at=solve(problem.matrix, problem.rhs, inverse=False).values)
        return problem

    def _empty(self, problem: LinearProblem, loop: Loop | None) -> RecursiveState:
        check_noise(problem.name, problem.noise)
        runs = np.empty(problem.batch_shape, dtype=object)
        for place in np.ndindex(runs.shape):
            runs[place] = empty_run(problem.parameters.size)
        return RecursiveState(
            parameters=problem.parameters,
            moments=(_moment(runs, problem.parameters),),
            pose_rows=problem.rows_per_block,
            level=self.level,
            reject=self.reject,
            kind=problem.uncarried or "model",
            label=f"{problem.name} by {self!r}",
            runs=runs,
            loop=loop,
            at=problem.at,
        )

    def _gate(self, rows: int) -> Gate:
        return Gate(float(chi2_quantile(rows, self.level)), self.reject)

    def _scanned(self, problem: LinearProblem, loop: Loop | None, *, keep: bool) -> RecursiveState:
        state = self._empty(problem, loop)
        matrix, rhs = pose_rows(problem)
        gate, runs, moments = self._gate(problem.rows_per_block), state.runs, state.moments
        for i in range(rhs.shape[-2]):
            runs = self._absorbed(runs, matrix[..., i, :, :], rhs[..., i, :], gate)
            moments = (*moments, _moment(runs, problem.parameters)) if keep else moments
        return replace(state, runs=runs, moments=moments if keep else (_moment(runs, problem.parameters),))

    def _absorbed(self, runs: Any, matrix: Array, rhs: Array, gate: Gate, where: BoolArray | None = None) -> Any:
        """The sets, or some of them, after the whitened rows of one pose, (..., d, p + r) and (..., d)."""
        out = runs.copy()
        for place in np.ndindex(runs.shape):
            if where is None or where[place]:
                out[place] = runs[place].after(matrix[place], rhs[place], self.filter, gate)
        return out

    def _stepped(self, state: RecursiveState, problem: LinearProblem) -> tuple[Any, tuple[LinearProblem, ...]]:
        """The runs after one pose, and the poses that still wait for an estimate to be weighed at."""
        gate = self._gate(problem.rows_per_block)

        def after(runs: Any, pose: LinearProblem, at: Array, where: BoolArray | None = None) -> Any:
            matrix, rhs = pose_rows(replace(pose, at=at))
            return self._absorbed(runs, matrix[..., 0, :, :], rhs[..., 0, :], gate, where)

        if state.at is not None:
            return after(state.runs, problem, state.at), ()
        weighed = np.array([run.rows > 0 for run in state.runs.flat]).reshape(state.batch_shape)
        runs = after(state.runs, problem, state.moments[-1].values, weighed) if weighed.any() else state.runs.copy()
        if weighed.all():
            return runs, ()
        waiting, size = (*state.waiting, problem), problem.parameters.size
        point = np.full((*state.batch_shape, size), np.nan)
        for place in np.ndindex(runs.shape):
            if weighed[place]:
                continue
            run = runs[place]
            matrix, rhs = np.vstack([run.matrix, problem.matrix[place]]), np.append(run.rhs, problem.rhs[place])
            solution = solved(matrix, rhs)
            runs[place] = replace(run, matrix=matrix, rhs=rhs) if solution is None else empty_run(size)
            point[place] = np.nan if solution is None else solution.values
        settled = np.isfinite(point).all(axis=-1)
        if settled.any():
            for earlier in waiting:
                runs = after(runs, earlier, point, settled)
        return runs, () if (weighed | settled).all() else waiting


@dataclass(frozen=True, eq=False)
class RecursiveState(RunningState):
    """A running weighted least-squares estimate; made by :meth:`Recursive.start`, never changed.

    Attributes
    ----------
    runs : ndarray of object, shape (...)
        What is known of each set, with its filter.
    loop : Loop, or None
        The equation of poses to come.
    at : ndarray, shape (..., p), or None
        Where poses are weighed.
    waiting : tuple of LinearProblem
        Poses that wait for a first estimate to be weighed at.
    """

    runs: Any = None
    loop: Loop | None = None
    at: Array | None = None
    waiting: tuple[LinearProblem, ...] = ()

    def _condition(self, covariance: Array) -> Array:
        """Condition number of the weighted rows, columns scaled, from the covariance."""
        known: BoolArray = np.asarray(np.isfinite(covariance).all(axis=(-2, -1)))
        information = np.linalg.inv(np.where(known[..., None, None], covariance, np.eye(self.parameters.size)))
        scale = np.sqrt(np.abs(np.einsum("...ii->...i", information)))
        values = np.linalg.eigvalsh(information / scale[..., :, None] / scale[..., None, :])
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(known, np.sqrt(values[..., -1] / np.maximum(values[..., 0], 0.0)), np.inf)


def _unseen(runs: Any, parameters: Parameters) -> tuple[str, ...]:
    """The combinations that the first rank-deficient run does not see."""
    blind = next((run for run in runs.flat if run.code is Status.RANK_DEFICIENT), None)
    if blind is None:
        return ()
    size = parameters.size
    matrix = blind.matrix[:, :size] if len(blind.rhs) else np.zeros((1, size))
    unseen = null_combinations(matrix, np.ones(size), threshold=0.05, at_least=1)
    return tuple(parameters.combination(vector, threshold=0.0) for vector in unseen)


def _moment(runs: Any, parameters: Parameters) -> Moment:
    """What the runs (...) know of their p parameters."""
    size = parameters.size

    def gathered(values: Any, kind: Any, *shape: int) -> Any:
        return np.array(list(values), dtype=kind).reshape((*runs.shape, *shape))

    return Moment(
        values=gathered((run.mean[:size] for run in runs.flat), float, size),
        covariance=gathered((run.spread[:size, :size] for run in runs.flat), float, size, size),
        codes=gathered((run.code for run in runs.flat), np.int8),
        chi2=gathered((run.chi2 for run in runs.flat), float),
        rows=gathered((run.rows for run in runs.flat), np.int64),
        nis=gathered((run.nis for run in runs.flat), float),
        flagged=gathered((run.flagged for run in runs.flat), bool),
        unseen=_unseen(runs, parameters),
    )
