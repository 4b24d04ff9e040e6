"""Batched Levenberg–Marquardt for small dense problems."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray
from .charts import Chart
from .factor import factored, solved
from .lstsq import gram_condition, solve

__all__ = ["LMEnd", "LMResult", "levenberg_marquardt"]

#: Values (k, p) to residuals (k, m) and Jacobians (k, m, p or q).
Evaluate = Callable[[Array], tuple[Array, Array]]
Index = npt.NDArray[np.int64]

#: A step below this share of the scaled parameters ends the iteration; the polishing step follows.
STEP_TOLERANCE = 1e-9
#: The polishing step may be larger by this factor.
POLISH = 1e4
#: And is not taken where the last step was damped by more: there the undamped one may lead away.
SAFE = 1e-2
#: Where elimination finds a pivot below 1 over this, the polishing step is that of an orthogonal factorisation.
STEEP = 1e5
#: The next step is expected to be shorter by as much as this one was, but by no more than this.
SHORTER = 1e-3
#: And only where it is damped by less: the polishing step is not damped at all.
DAMPED = 1e-5


@dataclass(frozen=True)
class LMResult:
    """Where each problem ended.

    Attributes
    ----------
    values : ndarray, shape (k, p)
    converged : ndarray of bool, shape (k,)
    iterations : ndarray of int, shape (k,)
    end : LMEnd, optional
        What the last step says of the rows there; without it they are to be evaluated once more.
    """

    values: Array
    converged: BoolArray
    iterations: npt.NDArray[np.int64]
    end: LMEnd | None = None


@dataclass(frozen=True, eq=False)
class LMEnd:
    """The rows where each problem ended, as its polishing step saw them; infinite where there was none.

    Attributes
    ----------
    objective : ndarray, shape (k,)
        To first order in the rows.
    moved : ndarray, shape (k,)
        By how much the step moved the rows, as a share of their length.
    condition : ndarray, shape (k,)
        As in :func:`~hexopt.numerics.lstsq.solve`.
    """

    objective: Array
    moved: Array
    condition: Array


def levenberg_marquardt(
    evaluate: Evaluate,
    start: Array,
    *,
    max_iterations: int = 100,
    chart: Chart | None = None,
    absolute: float = 0.0,
    damping: float = 1e-3,
    chosen: Callable[[Index], Evaluate] | None = None,
) -> LMResult:
    r"""Minimise :math:`\tfrac12\lVert r(x)\rVert^2` for a batch of problems.

    Parameters
    ----------
    evaluate : callable
        Values (k, p) to residuals (k, m) and Jacobians (k, m, p).
    start : ndarray, shape (k, p)
    max_iterations : int, default 100
    chart : Chart, optional
        Where some unknowns are unit vectors: the Jacobian is then (k, m, q), by the chart's free coordinates.
    absolute : float, default 0
        A step that moves the rows by less ends the iteration, whatever the size of the values: of whitened rows a
        share of a standard error, of others a share of what they measure.
    damping : float, default 1e-3
        To begin with, relative to the squared column lengths; less where the start is near the end.
    chosen : callable, optional
        Members (an index array) to the `evaluate` of these alone, so that what has ended costs nothing.

    Notes
    -----
    Marquardt's scaling by column lengths, damping by Nielsen's rule. A member ends where its next step, if that is
    shorter by as much as the last was, would be small; it is then left as it is. One undamped step polishes each
    converged member: it is kept where it is small, and brings the accuracy of an orthogonal factorisation.
    """
    x = np.array(start, dtype=float)
    chart = chart or Chart(x.shape[1])
    converged, iterations = np.zeros(len(x), dtype=bool), np.zeros(len(x), dtype=np.int64)
    state = _State.at(np.arange(len(x)), x, evaluate, np.full(len(x), damping))
    state = state.chosen(np.isfinite(state.cost))
    ended: list[_State] = []
    most: list[Array] = []
    for _ in range(max_iterations):
        if len(state.index) == 0:
            break
        rows = evaluate if len(state.index) == len(x) else _evaluate_some(evaluate, chosen, state.index, x)
        step, size, predicted = _damped_step(state)
        tolerance = np.maximum(STEP_TOLERANCE * _row_size(chart, state.x, state.jacobian), absolute)
        undamped = (state.damping < DAMPED) & (state.size > size)
        shorter = np.divide(size, state.size, out=np.ones(len(size)), where=undamped)
        going = size * np.maximum(shorter, SHORTER) >= tolerance
        after = _State.at(state.index, chart.moved(state.x, step), rows, state.damping)
        state = state.advanced(after, size, predicted)
        iterations[state.index] += 1
        if not going.all():
            ended.append(state.chosen(~going))
            x[ended[-1].index] = ended[-1].x
            most.append(np.where(state.damping < SAFE, POLISH * tolerance, 0.0)[~going])
            state = state.chosen(going)
    x[state.index] = state.x
    end = LMEnd(*np.full((3, len(x)), np.inf))
    if ended:
        last = _State.joined(ended)
        converged[last.index] = True
        x[last.index], end.objective[last.index], end.moved[last.index], end.condition[last.index] = _polished(
            chart, last, np.concatenate(most)
        )
    return LMResult(x, converged, iterations, end)


def _evaluate_some(evaluate: Evaluate, chosen: Callable[[Index], Evaluate] | None, which: Index, x: Array) -> Evaluate:
    """The rows of some members; by those of all where there is nothing better."""
    if chosen is not None:
        return chosen(which)

    def rows(values: Array) -> tuple[Array, Array]:
        full = x.copy()
        full[which] = values
        residual, jacobian = evaluate(full)
        return residual[which], jacobian[which]

    return rows


@dataclass(frozen=True, eq=False)
class _State:
    """Where the members that still iterate are; but for x the batch is last, so that each operation is one pass."""

    index: Index
    x: Array  # (k, p)
    residual: Array  # (m, k)
    jacobian: Array  # (m, q, k)
    cost: Array
    damping: Array
    growth: Array
    size: Array  # by how much the last step moved the rows; 0 where the damping grew after it

    @classmethod
    def at(cls, index: Index, x: Array, evaluate: Evaluate, damping: Array) -> _State:
        residual, jacobian = (np.ascontiguousarray(np.moveaxis(part, 0, -1)) for part in evaluate(x))
        cost = 0.5 * np.einsum("mk,mk->k", residual, residual)
        return cls(index, x, residual, jacobian, cost, damping, np.full(len(x), 2.0), np.zeros(len(x)))

    def chosen(self, keep: BoolArray) -> _State:
        """Some of them."""
        if keep.all():
            return self
        parts = {part.name: getattr(self, part.name)[..., keep] for part in fields(self) if part.name != "x"}
        return _State(x=self.x[keep], **parts)

    @staticmethod
    def joined(parts: Sequence[_State]) -> _State:
        """Several as one."""
        names = [part.name for part in fields(_State)]
        columns = {name: [getattr(part, name) for part in parts] for name in names}
        return _State(**{name: np.concatenate(some, axis=0 if name == "x" else -1) for name, some in columns.items()})

    def advanced(self, after: _State, size: Array, predicted: Array) -> _State:
        """`after` where it is better, and the damping of the next step (Nielsen 1999)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = np.clip(np.nan_to_num((self.cost - after.cost) / predicted), 0.0, 1.0)
            better = after.cost <= self.cost  # not where it is no number
        for name in () if better.all() else ("residual", "jacobian", "cost"):
            np.copyto(getattr(after, name), getattr(self, name), where=~better)
        shrink = np.maximum(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3)
        damping = np.where(better, self.damping * shrink, self.damping * self.growth)
        return replace(
            after,
            x=np.where(better[:, None], after.x, self.x),
            damping=np.clip(damping, 1e-15, 1e15),
            growth=np.where(better, 2.0, np.minimum(2.0 * self.growth, 1e9)),
            size=np.where(better & (shrink < 1), size, 0.0),
        )


def _column_lengths(jacobian: Array) -> Array:
    """Of Jacobians (m, q, k), shape (q, k)."""
    lengths = np.sqrt(np.einsum("mqk,mqk->qk", jacobian, jacobian))
    lengths[~(lengths > 0)] = 1.0
    return lengths


def _row_size(chart: Chart, x: Array, jacobian: Array) -> Array:
    sizes = _column_lengths(jacobian) * np.where(chart.turning, 1.0, chart.coordinates(x)).T
    return np.sqrt(np.einsum("qk,qk->k", sizes, sizes))


def _normal_equations(state: _State) -> tuple[Array, Array, Array]:
    """The Gram matrix (q, q, k) and the gradient (q, k) by columns of unit length, and those lengths (q, k)."""
    jacobian = state.jacobian
    gram = np.empty((*jacobian.shape[1:2], *jacobian.shape[1:]))
    for i in range(len(gram)):  # half of it, mirrored
        np.einsum("mk,mqk->qk", jacobian[:, i], jacobian[:, i:], out=gram[i, i:])
        gram[i:, i] = gram[i, i:]
    gradient = np.einsum("mqk,mk->qk", jacobian, state.residual)
    scale = np.sqrt(np.einsum("qqk->qk", gram))
    scale[~(scale > 0)] = 1.0
    gram /= scale[:, None]
    gram /= scale
    gradient /= scale
    finite = np.isfinite(gram).all(axis=(0, 1))
    if not finite.all():
        gram[..., ~finite], gradient[:, ~finite] = np.eye(len(gram))[..., None], 0.0
    return gram, gradient, scale


def _damped_step(state: _State) -> tuple[Array, Array, Array]:
    """The step (k, q), by how much it moves the rows, and the decrease that it predicts."""
    gram, gradient, scale = _normal_equations(state)
    diagonal = np.arange(len(gram))
    gram[diagonal, diagonal] += state.damping
    step = -solved(factored(gram), gradient)
    predicted = 0.5 * np.einsum("qk,qk->k", step, state.damping * step - gradient)
    return (step / scale).T, np.sqrt(np.einsum("qk,qk->k", step, step)), predicted


def _polished(chart: Chart, state: _State, most: Array) -> tuple[Array, Array, Array, Array]:
    """The values after an undamped step, where that moves the rows by no more than `most`; and the parts of LMEnd."""
    gram, gradient, scale = _normal_equations(state)
    factor = factored(gram)
    step = -solved(factor, gradient)
    steep = np.flatnonzero(~((factor[1] > 0) & (factor[1] < STEEP)).all(axis=0))
    if len(steep):
        residual, jacobian = state.residual[:, steep].T, np.moveaxis(state.jacobian[..., steep], -1, 0)
        solution = solve(np.nan_to_num(jacobian), -residual, inverse=False)
        step[:, steep] = np.where(solution.full_rank[:, None], solution.values, 0.0).T * scale[:, steep]
    small = np.sqrt(np.einsum("qk,qk->k", step, step)) < most
    square = np.maximum(-np.einsum("qk,qk->k", gradient, step), 0.0)
    moved = np.sqrt(np.divide(square, 2 * state.cost, out=np.full(len(small), np.inf), where=small & (state.cost > 0)))
    values = np.where(small[:, None], chart.moved(state.x, (step / scale).T), state.x)
    return values, state.cost - 0.5 * np.where(small, square, 0.0), moved, gram_condition(np.moveaxis(gram, -1, 0))
