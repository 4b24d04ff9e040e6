r"""Sequential convex programming: a loop under any loss, prior and bounds of the convex family.

With direct misclosures r(x), weights W and a scale s, minimise over the convex set X

.. math:: F(x) = \rho\bigl(W r(x)/s\bigr) + \sum_k \pi_k(x)

by the optimum of the linearised rows :math:`r(x_k) + J(x_k)(x - x_k)`, kept near :math:`x_k` by a term
:math:`\tfrac\lambda2\lVert D(x - x_k)\rVert^2` where F does not follow them (D the lengths of the columns): Fletcher's
composite Gauss–Newton method, damped as by Levenberg and Marquardt. It ends with :math:`\lambda = 0`, so that the
last programme has its optimum at the answer, and its multipliers and covariance are the answer's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array, BoolArray, matvec, norm, transpose
from ..losses import Quadratic
from ..numerics.lstsq import EPS
from ..numerics.newton import newton_solves
from ..numerics.programme import Programme, Term
from ..result import Estimate, Status
from .convex import ConvexEstimator
from .convex.assembly import Assembly, assemble
from .convex.posed import reference
from .convex.routes import GAP, closed_form, solve
from .leg_rows import LegRows

__all__ = ["SequentialConvex"]

#: A step below this many σ of the rows ends the iteration; one that stagnates must be below the second.
STEP, STAGNANT = 1e-9, 1e-6
#: Share of the promised decrease that a step must reach.
DECREASE = 1e-4
#: The least damping, below which there is none.
DAMPING = 1e-6
#: How often a member may settle while it is damped, and leave again without: its rows do not hold it there.
MAX_RETURNS = 3


@dataclass(frozen=True, eq=False)
class SequentialConvex:
    """The minimiser, for the loss, prior and bounds of an estimator of linear problems; the batch is flat.

    Attributes
    ----------
    convex : ConvexEstimator
        Its weights and scale are those of `rows`, and not looked at.
    rows : LegRows
    frame : Assembly
        The programme of some linearisation, of which priors and bounds are kept.
    unit : ndarray, shape (B,)
        By what raw rows are divided on the way, so that they count in about σ; 1 for others.
    """

    convex: ConvexEstimator
    rows: LegRows
    frame: Assembly
    unit: Array

    @classmethod
    def of(cls, convex: ConvexEstimator, rows: LegRows, start: Array) -> SequentialConvex:
        """The minimiser of rows, for starts (..., p)."""
        residual, jacobian = rows.at(start.reshape(-1, start.shape[-1]))
        shape = start.shape[:-1]
        frame = assemble(
            convex.loss,
            jacobian.reshape(*shape, *jacobian.shape[1:]),
            residual.reshape(*shape, residual.shape[-1]),
            1,
            rows.loop.parameters,
            convex.prior,  # type: ignore[arg-type]  # made tuples by the estimator
            convex.bounds,  # type: ignore[arg-type]
        )
        unit = np.ones(len(residual))
        if rows.is_raw:
            lost = norm(rows.rounding(start.reshape(len(unit), -1)))
            unit = np.maximum(norm(residual), 1e3 * lost + 1e-300) / np.sqrt(residual.shape[-1])
        return cls(convex, rows, frame, unit)

    def better(self, one: Array, other: Array) -> Array:
        """Of two points (B, p) of each member the one where F is less, bounds aside."""
        first, second = (_value(self._about(x, np.arange(len(x)))) for x in (one, other))
        return np.where((first <= second)[:, None], one, other)

    def minimise(self, start: Array, max_iterations: int) -> tuple[Array, Any]:
        """Where each member (B, p) ended, settled or not, and after how many steps."""
        x, active = np.array(start), np.arange(len(start))
        here = self._about(x, active)
        value = _value(here)
        if self.convex.bounds:
            value[:] = np.inf  # the first step enters the bounds
        damping, last, returns = np.zeros(len(x)), np.full(len(x), np.inf), np.zeros(len(x))
        iterations = np.zeros(len(x), dtype=np.int64)
        for _ in range(max_iterations):
            if len(active) == 0:
                break
            step = self._step(here, damping[active])
            found = np.isfinite(step).all(axis=-1)
            step[~found] = 0.0
            there = self._about(x[active] + step, active)
            lost = self._rounding(x[active], active)
            new, rounding = _value(there), _uncertainty(here, lost)
            promised = value[active] - here.objective(step)
            share = _share(value[active] - new, promised, rounding)
            good = found & (share >= DECREASE)
            x[active] += np.where(good[:, None], step, 0.0)
            value[active] = np.where(good, new, value[active])
            length, arrived, near = _length(here, lost, step)
            settled = (damping[active] == 0) & (arrived | (near & (length >= 0.5 * last[active])))
            rests = near | (promised <= rounding)  # what is left to gain is rounding
            returns[active] += rests & (damping[active] > 0)
            damping[active] = np.where(rests, 0.0, _damped(damping[active], share))
            last[active] = length
            iterations[active] += found
            going = found & ~settled & (returns[active] <= MAX_RETURNS)
            active = active[going]
            here = there.take(going) if good[going].all() else self._about(x[active], active)
        return x, iterations

    def estimate(self, x: Array) -> Estimate:
        """The estimate at x (..., p), where its linearised programme has its optimum at x; NOT_CONVERGED elsewhere."""
        inner = replace(self.convex, weights=None if self.rows.is_raw else "model", scale=None)
        found: Estimate = inner.fit(self.rows.problem(x))
        flat = x.reshape(-1, x.shape[-1])
        everyone = np.arange(len(flat))
        local = self._about(flat, everyone)
        *_, near = _length(local, self._rounding(flat, everyone), self._step(local, np.zeros(len(flat))))
        astray = (found.codes == Status.OPTIMAL) & ~near.reshape(x.shape[:-1])
        codes = np.where(astray, Status.NOT_CONVERGED, found.codes).astype(np.int8)
        return replace(
            found,
            values=np.where((codes == Status.OPTIMAL)[..., None], x, np.nan),
            codes=codes,
            gap=np.full(codes.shape, np.nan),
            influence=None if found.influence is None else self.rows.direct(found.influence),
        )

    def _about(self, x: Array, which: Any) -> Programme:
        """The linearised programme of some members in their change from x."""
        residual, jacobian = self.rows.take(which).at(x)
        unit = self.unit[which, None]
        frame = self.frame.programme.take(which).about(x)
        return replace(
            frame, terms=(Term(self.convex.loss, jacobian / unit[..., None], -residual / unit), *frame.terms[1:])
        )

    def _rounding(self, x: Array, which: Any) -> Array:
        """By how much each row of the programme at x is uncertain."""
        return self.rows.take(which).rounding(x) / self.unit[which, None]

    def _step(self, programme: Programme, damping: Array) -> Array:
        """The optimum of each linearised programme, kept near zero by its damping; NaN where there is none."""
        gaussian = self.frame.gaussian
        if damping.any():
            near = np.sqrt(damping)[:, None] * norm(transpose(programme.terms[0].matrix))
            gaussian = (*gaussian, len(programme.terms))
            damper = Term(Quadratic(), near[:, :, None] * np.eye(programme.size), np.zeros(near.shape))
            programme = replace(programme, terms=(*programme.terms, damper))
        assembly = replace(self.frame, programme=programme, gaussian=gaussian)
        known = reference(assembly, np.ones(len(damping)), inverse=False)
        if programme.is_free and all(isinstance(term.loss, Quadratic) for term in programme.terms):
            return closed_form(programme, known).values
        out, keep = np.full((programme.batch, programme.size), np.nan), np.arange(programme.batch)
        if not self.convex.bounds and len(programme.terms) == 1 + len(gaussian):
            keep = np.flatnonzero(known.full_rank)
        known = replace(known, values=np.zeros((len(keep), programme.size)), condition=known.condition[keep])
        answer = solve(programme.take(keep), "auto", known)
        out[keep] = np.where(answer.infeasible[:, None], np.nan, answer.values)
        return out


def _value(programme: Programme) -> Array:
    """The objective where nothing changes: F itself."""
    return programme.objective(np.zeros((programme.batch, programme.size)))


def _length(programme: Programme, lost: Array, step: Array) -> tuple[Array, BoolArray, BoolArray]:
    """How long a step is in σ of the rows, whether x has arrived at its end, and whether nearly."""
    terms = [term for term in programme.terms if term.loss.smooth] or programme.terms[:1]
    length = np.sqrt(np.asarray(sum(np.square(matvec(term.matrix, step)).sum(axis=-1) for term in terms)))
    rounding = norm(lost)
    near = length <= np.maximum(STAGNANT, rounding)
    if not newton_solves(programme):
        value = _value(programme)
        near |= value - programme.objective(step) <= GAP * (1 + value)
    return length, length <= np.maximum(STEP, rounding), near


def _share(gained: Array, promised: Array, rounding: Array) -> Array:
    """How much of the promised decrease was gained; all of it where both are rounding, or the start was outside."""
    inside = np.isfinite(promised)
    gained, promised = np.where(inside, gained, 0.0), np.where(inside, promised, 0.0)
    telling = np.abs(gained - promised) > rounding
    return np.where(telling, np.divide(gained, promised, out=np.zeros(len(gained)), where=promised > 0), 1.0)


def _damped(damping: Array, share: Array) -> Array:
    """The damping of the next step, after one that gained such a share of its promise."""
    less = np.where(damping > DAMPING, 0.1 * damping, 0.0)
    more = np.maximum(np.where(share >= DECREASE, 4.0, 10.0) * damping, 100 * DAMPING)
    return np.where(share > 0.75, less, np.where(share < 0.25, more, damping))


def _uncertainty(programme: Programme, lost: Array) -> Array:
    """By how much the objective is uncertain, where its rows are by `lost`."""
    data = programme.terms[0]
    force = np.abs(data.loss.psi(data.blocks(data.rhs))).reshape(data.rhs.shape)
    return np.asarray(np.einsum("bm,bm->b", force, lost) + 8 * EPS * _value(programme))
