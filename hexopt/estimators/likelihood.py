"""The likelihood of implicit equations as least squares in the parameters, and its stationary points."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, is_dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, matvec, norm
from ..loops.implicit import Implicit
from ..loops.rows import SharedPlaces, WhitenedRows
from ..numerics.charts import Chart
from ..numerics.lm import levenberg_marquardt
from ..numerics.lstsq import LstsqSolution, solve

__all__ = ["Likelihood", "Stationary"]

#: How often measurements are moved at most, so that the equations hold; each time gains about three digits.
ADJUSTMENTS = 20
#: Where Levenberg–Marquardt hands over to Gauss–Newton, and how much measurements may still move at its end, in σ.
NEAR = 1e-4
#: Where that ends: in σ, and relative to what rounding of the values does to the rows.
SETTLED, ROUNDING = 1e-7, 1e-12
#: And never looser than this: values that ran away settle nowhere.
LOOSEST = 1e-3
#: By how much the next step is taken to be shorter at most.
SHRINKING = 1e-2
#: Steps that all problems of a batch take together; those that need more go on alone.
FEW = 4
#: Steps that Gauss–Newton has.
FINISHING = 30


@dataclass(frozen=True, eq=False)
class Stationary:
    """Where Gauss–Newton ended.

    Attributes
    ----------
    unknowns : ndarray, shape (..., p + r)
        The values, and the common errors in standard deviations.
    settled, finite : ndarray of bool, shape (...)
        Which problems are at a stationary point, and at finite rows at all.
    misclosure, jacobian : ndarray, shape (..., M) and (..., M, q)
        The whitened rows there; 0 where not finite.
    local : LstsqSolution
        Of these rows.
    rows : list of WhitenedRows
        The same by set.
    iterations : ndarray of int, shape (...)
    """

    unknowns: Array
    settled: BoolArray
    finite: BoolArray
    misclosure: Array
    jacobian: Array
    local: LstsqSolution
    rows: list[WhitenedRows]
    iterations: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Likelihood:
    """A model as least squares in its values and the errors that its poses share."""

    target: Implicit
    chart: Chart
    shared: SharedPlaces

    def maximum(self, start: Array, max_iterations: int, near: list[WhitenedRows] | None) -> Stationary:
        """The stationary point found from `start`, whose rows are given where it is `near`.

        Else it goes by way of unweighted least squares. Where that does not settle, Levenberg–Marquardt goes down the
        likelihood itself.
        """
        started = np.asarray(np.isfinite(start).all(axis=-1))
        if near is not None:
            end = self._finished(self._with_shared(start), started, min(FEW, max_iterations), near)
        else:
            values, _, before = self._descended(start, self._raw_rows, max_iterations, 0.0)
            end = self._finished(self._with_shared(values), started, min(FEW, max_iterations))
            end = replace(end, iterations=end.iterations + before)
        left = started & end.finite & end.local.full_rank
        lost = np.asarray(left & ~end.settled)
        if max_iterations > FEW and lost.any():
            some, errors = self._some(lost), [_members(part.error, lost) for part in end.rows]
            on = some._finished(_members(end.unknowns, lost), _members(left, lost), max_iterations - FEW, errors=errors)
            on = replace(on, iterations=on.iterations + _members(end.iterations, lost))
            end = _merged(end, on, lost)
            lost = np.asarray(left & end.finite & end.local.full_rank & ~end.settled)
        if lost.any():
            end = _merged(end, self._some(lost)._by_likelihood(_members(start, lost), max_iterations), lost)
        return end

    def _some(self, which: BoolArray) -> Likelihood:
        """The same of some problems; of a single problem itself."""
        return replace(self, target=self.target.take(np.nonzero(which), which.shape)) if which.ndim else self

    def _by_likelihood(self, start: Array, max_iterations: int) -> Stationary:
        unknowns, converged, iterations = self._descended(
            self._with_shared(start), self._settled_rows, max_iterations, NEAR
        )
        end = self._finished(unknowns, converged, max_iterations)
        return replace(end, iterations=end.iterations + iterations)

    def _with_shared(self, values: Array) -> Array:
        """Values, and common errors of zero."""
        return np.concatenate([values, np.zeros((*values.shape[:-1], self.shared.count))], axis=-1)

    def _descended(
        self, start: Array, rows: Callable[[Array], tuple[Array, Array]], max_iterations: int, absolute: float
    ) -> tuple[Array, BoolArray, npt.NDArray[np.int64]]:
        """Levenberg–Marquardt: values, or the start where it does not converge; whether it did; iterations."""
        batch, width = start.shape[:-1], start.shape[-1]

        def flat_rows(flat: Array) -> tuple[Array, Array]:
            misclosure, jacobian = rows(flat.reshape(start.shape))
            return misclosure.reshape(-1, misclosure.shape[-1]), jacobian.reshape(-1, *jacobian.shape[-2:])

        chart = Chart(width, self.chart.units)
        flat = start.reshape(-1, width)
        found = levenberg_marquardt(flat_rows, flat, max_iterations=max_iterations, chart=chart, absolute=absolute)
        values = np.where(found.converged[:, None], found.values, flat)
        return values.reshape(start.shape), found.converged.reshape(batch), found.iterations.reshape(batch)

    def _raw_rows(self, values: Array) -> tuple[Array, Array]:
        """Unweighted rows, (..., M) and (..., M, q), where nothing is shared."""
        misclosure, jacobian = self.target.direct_rows(values)
        return misclosure, Chart(values.shape[-1], self.chart.units).reduced(jacobian, values)

    def _settled_rows(self, unknowns: Array) -> tuple[Array, Array]:
        """Whitened rows, (..., M) and (..., M, q), at measurements that agree with the unknowns."""
        return self.target.stacked(self._rows(unknowns, adjust=ADJUSTMENTS), unknowns, self.chart, self.shared)

    def _rows(
        self, unknowns: Array, errors: Sequence[Array | None] | None = None, adjust: int = 0
    ) -> list[WhitenedRows]:
        """The whitened rows of every set at measurements moved by errors, or not at all."""
        values, common = np.split(unknowns, [self.target.parameters.size], axis=-1)
        errors = [None] * len(self.shared.of_sets) if errors is None else errors
        return [
            part.whitened(values[..., place], common[..., shared] if len(shared) else None, error, adjust=adjust)
            for (part, place), shared, error in zip(self.target.parts, self.shared.of_sets, errors, strict=True)
        ]

    def _moved(self, rows: Sequence[WhitenedRows], errors: Sequence[Array] | None) -> BoolArray:
        """Of which problems some measurement moves on from its error."""
        moved: Any = False
        for k, (part, _) in enumerate(self.target.parts):
            away = rows[k].error if errors is None else rows[k].error - errors[k]
            moved = moved | (np.abs(away) > NEAR * part.error_scale).any(axis=(-2, -1))
        return np.asarray(moved)

    def _row_size(self, unknowns: Array, jacobian: Array) -> Array:
        """The size of the values as the rows see it, shape (...)."""
        lengths = np.sqrt(np.einsum("...mq,...mq->...q", jacobian, jacobian))
        return norm(lengths * np.where(self.chart.turning, 1.0, self.chart.coordinates(unknowns)))

    def _finished(
        self,
        unknowns: Array,
        moving: BoolArray,
        max_iterations: int,
        known: list[WhitenedRows] | None = None,
        errors: list[Array] | None = None,
    ) -> Stationary:
        """Gauss–Newton in the values and the measurements at once, until they settle.

        Steps shrink by a nearly constant factor; a problem has settled where the next one would be as small. The
        rows at the unknowns may be `known`, and the `errors` that the measurements have moved by.
        """
        settled = np.zeros(unknowns.shape[:-1], dtype=bool)
        iterations = np.zeros(unknowns.shape[:-1], dtype=np.int64)
        before: Array = np.full(unknowns.shape[:-1], np.inf)
        for _ in range(min(FINISHING, max_iterations)):
            rows, known = known or self._rows(unknowns, errors), None
            moved, errors = self._moved(rows, errors), [part.error for part in rows]
            misclosure, jacobian = self.target.stacked(rows, unknowns, self.chart, self.shared)
            finite = np.asarray(np.isfinite(jacobian).all(axis=(-2, -1)) & np.isfinite(misclosure).all(axis=-1))
            if not finite.all():
                misclosure = np.where(finite[..., None], misclosure, 0.0)
                jacobian = np.where(finite[..., None, None], jacobian, 0.0)
            local = solve(jacobian, -misclosure, inverse=False)
            active = moving & finite & local.full_rank & ~settled
            step = np.where(active[..., None], local.values, 0.0)
            size = norm(matvec(jacobian, step))
            shrinking = np.minimum(np.divide(size, before, out=np.ones(size.shape), where=before > 0), 1.0)
            rounding = ROUNDING * self._row_size(unknowns, jacobian)
            tolerance = np.clip(rounding, SETTLED, LOOSEST)
            unknowns, before = self.chart.moved(unknowns, step), size
            iterations += active
            settled = settled | (active & ~moved & (size * np.maximum(shrinking, SHRINKING) <= tolerance))
            if not (active & ~settled).any():
                break
        local = solve(jacobian, -misclosure)
        return Stationary(unknowns, settled, finite, misclosure, jacobian, local, rows, iterations)


def _members(array: npt.NDArray[Any], which: BoolArray) -> Any:
    """Some members as a flat batch; a single problem as it is."""
    return array[which] if which.ndim else array


def _merged(kept: Stationary, new: Stationary, where: BoolArray) -> Stationary:
    """`kept`, with the flat batch `new` at the members `where`; a single problem is replaced."""
    if where.ndim == 0:
        return new

    def merged(old: Any, fresh: Any) -> Any:
        if isinstance(fresh, np.ndarray):
            out = np.array(np.broadcast_to(old, (*where.shape, *fresh.shape[1:])))
            out[where] = fresh
            return out
        if isinstance(fresh, list):
            return [merged(one, two) for one, two in zip(old, fresh, strict=True)]
        if not is_dataclass(fresh):
            return fresh
        return replace(fresh, **{name: merged(getattr(old, name), value) for name, value in vars(fresh).items()})  # type: ignore[type-var]

    result: Stationary = merged(kept, new)
    return result
