r"""Convex programmes by Clarabel itself: one pattern for a batch, and only numbers change from member to member.

A loss is :math:`\rho(z) = \sup_{u \in U} u^T z - \tfrac{M}{2}\lVert u\rVert^2`, so a :class:`Programme` has the dual

.. math:: \min\; \sum_j \tfrac{M_j}{2}\lVert u_j\rVert^2 + y_j^T u_j
          + \sum_i h_i^T w_i^+ - l_i^T w_i^- + \sum_k c_k^T v_k + r_k e_k
          \quad\text{s.t.}\quad \sum_j A_j^T u_j + \sum_i C_i^T (w_i^+ - w_i^-) + \sum_k E_k^T v_k = 0,

with :math:`u_j \in U_j`, :math:`w^\pm \ge 0`, :math:`\lVert v_k\rVert \le e_k` and the box as one more interval.
That is what Clarabel is given: it has no normal equations and half the unknowns of the primal with its slacks,
0 is always feasible, and −x is the multiplier of the balance. Where no x is feasible it is unbounded, and
Clarabel's ray is Farkas' certificate. The blocks are those of :mod:`hexopt.numerics.conic_blocks`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, norm, transpose
from ..errors import InputError
from .certificate import certify
from .conic_blocks import Block, Rows, blocks_of, pattern_of, rows_of, sides_of, unit_of
from .programme import Programme, Solution, transposed_product

__all__ = ["conic_solves", "solve_conic"]

#: Clarabel's tolerance, which is absolute for members normalised to an objective of about ½, and its longest step.
#: Second-order cones stall unless it is CAREFUL. What it has almost solved is at REDUCED; the certificate judges.
ROUGH, EXACT, CAREFUL, PATIENT, REDUCED = (1e-9, 0.99), (1e-13, 0.99), (1e-12, 0.8), (1e-13, 0.8), 1e-8
#: A member is solved about zero, about its answer, and again while its gap misses GOAL (if all is smooth, SHARP).
PASSES, GOAL, SHARP = 4, 1e-9, 5e-13
#: From pass to pass the unit of residuals shrinks to no less than this share: below it is rounding.
SHRINK = 1e-9
#: No point closer than this, in units of the data, escapes a proof of infeasibility.
ESCAPE = 1e6
#: How many members' numbers are prepared together.
CHUNK = 256


def conic_solves(programme: Programme) -> bool:
    """Whether every loss is the support function of a ball, smoothed (unless of all rows) or not."""
    kinds = [(term.loss.per, term.loss.curvature, bool(np.isfinite(term.loss.bound))) for term in programme.terms]
    known = [("row", 1, False), ("pose", 1, False), ("row", 1, True), ("pose", 1, True)]
    known += [("row", 0, True), ("pose", 0, True), ("all", 0, True)]
    return bool(kinds) and all(kind in known for kind in kinds)


def solve_conic(programme: Programme) -> Solution:
    """Solve every member in turn by one persistent Clarabel solver; one that fails, fails alone.

    Parameters
    ----------
    programme : Programme
        In scaled variables (:meth:`Programme.scaled`), rows in standard deviations.

    Returns
    -------
    Solution
        `converged` is Clarabel's claim, for :func:`certify` to judge; `infeasible` is proven here. The duals of
        smooth losses are ψ of the residuals, which is closer than Clarabel's.

    Raises
    ------
    InputError
        If a loss is not of the conic kind: see :func:`conic_solves`.
    """
    if not conic_solves(programme):
        raise InputError("solve_conic: every loss must have curvature 0 or 1, as the support function of a ball")
    usable, crossed = _checked(programme)
    todo = np.flatnonzero(usable & ~crossed)
    out = _blank(programme, crossed)
    chosen = programme if len(todo) == programme.batch else programme.take(todo)
    rows = [rows_of(one) for one in sides_of(chosen)]
    engine = _Engine(pattern_of(chosen, rows))
    for start in range(0, len(todo), CHUNK):
        with np.errstate(all="ignore"):  # a member whose numbers overflow fails
            part = _solve_chunk(chosen.take(slice(start, start + CHUNK)), rows, engine)
        _put(out, todo[start : start + CHUNK], part)
    out.values[~out.converged] = np.nan
    return out


def _solve_chunk(programme: Programme, rows: list[Rows], engine: _Engine) -> Solution:
    """All passes of some members; of each the answer with the smallest gap counts."""
    infeasible = np.zeros(programme.batch, dtype=bool)
    out = _blank(programme, infeasible)
    out.values[:] = np.clip(0.0, programme.lower, programme.upper)
    unit, best = np.zeros(programme.batch), np.full(programme.batch, np.inf)
    active = np.arange(programme.batch)
    smooth = all(term.loss.curvature for term in programme.terms)
    for count in range(PASSES):
        part, centre = programme.take(active), out.values[active]
        unit[active] = np.maximum(unit_of(part.about(centre)), SHRINK * unit[active])
        found = _attempt(part, centre, unit[active], rows, engine, count)
        infeasible[active] |= np.asarray(found.infeasible) & ~out.converged[active]
        out.iterations[active] += found.iterations
        found.iterations[:] = out.iterations[active]
        proof = certify(part, found)
        gap = np.where(found.converged, proof.gap + proof.primal_residual, np.inf)
        better = gap < best[active]
        _put(out, active[better], found, better)
        best[active] = np.minimum(gap, best[active])
        value = part.objective(out.values[active])
        missed = best[active] > (SHARP * np.maximum(1.0, value) if smooth else GOAL * (1.0 + value))
        active = active[(missed | (count == 0)) & ~infeasible[active]]
        if not active.size:
            break
    return out


def _attempt(part: Programme, centre: Array, unit: Array, rows: list[Rows], engine: _Engine, count: int) -> Solution:
    """Some members about a centre, in a unit each; x lies on the bounds that have a multiplier."""
    about = part.about(centre)
    blocks = blocks_of(about, rows, unit)
    primal, dual, iterations, good, ray = engine.solve(blocks, count)
    v = np.split(primal, np.cumsum([block.cost.shape[1] for block in blocks])[:-1], axis=1)
    slacks = np.split(dual, part.size + np.cumsum([0] + [block.limits.shape[1] for block in blocks])[:-1], axis=1)
    duals = [block.read(a, b) for block, a, b in zip(blocks, v, slacks[1:], strict=True)]
    terms, sides = len(part.terms), len(part.terms) + len(rows)
    infeasible = ray.copy()
    infeasible[ray] = _is_farkas(about.take(ray), [one[ray] for one in duals[terms:]], unit[ray])
    x = np.clip(centre - unit[:, None] * slacks[0], part.lower, part.upper)
    x = np.where(duals[terms] > 0, part.upper, np.where(duals[terms] < 0, part.lower, x))
    x = np.where(good[:, None], x, centre)
    for i, term in enumerate(part.terms):
        if term.loss.curvature:
            duals[i] = term.loss.psi(term.residual(x)).reshape(term.rhs.shape)
    u, w, balls = tuple(duals[:terms]), tuple(duals[terms + 1 : sides]), tuple(duals[sides:])
    return Solution(x, good, iterations, u, w, balls, infeasible)


class _Engine:
    """Clarabel solvers whose numbers change from member to member: one for each kind of pass."""

    def __init__(self, pattern: BoolArray) -> None:
        self.pattern = pattern  # (n, p): coefficients that are not zero for some member
        self.solvers: dict[tuple[float, float], Any] = {}

    def solve(
        self, blocks: list[Block], count: int
    ) -> tuple[Array, Array, npt.NDArray[np.int64], BoolArray, BoolArray]:
        """Dual variables and multipliers of every member, iterations, who is solved, and who is a ray."""
        import scipy.sparse as sp

        cone = sp.block_diag([block.cone for block in blocks], format="coo")
        column, row = np.nonzero(self.pattern)
        size = self.pattern.shape[1]
        rows, columns = np.concatenate([row, cone.row + size]), np.concatenate([column, cone.col])
        order = np.lexsort((rows, columns))
        starts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=cone.shape[1]))])
        coupling = np.concatenate([block.coupling for block in blocks], axis=1)[:, self.pattern]
        data = np.concatenate([coupling, np.broadcast_to(cone.data, (len(coupling), cone.nnz))], axis=1)[:, order]
        cost = np.concatenate([block.cost for block in blocks], axis=1)
        limits = np.concatenate([np.zeros((len(cost), size)), *[block.limits for block in blocks]], axis=1)
        primal, dual = np.zeros(cost.shape), np.zeros(limits.shape)
        iterations, (good, ray) = np.zeros(len(cost), dtype=np.int64), np.zeros((2, len(cost)), dtype=bool)
        pointed = any(kind == "ball" for block in blocks for kind, _ in block.cones)
        kind = (ROUGH, CAREFUL if pointed else EXACT, PATIENT, PATIENT)[count]
        for i in range(len(cost)):
            if all(np.isfinite(part[i]).all() for part in (data, cost, limits)):
                found = self._member(kind, blocks, data[i], cost[i], limits[i], rows[order], starts)
                status = str(found.status) if found else "panic"
                if np.isfinite(np.sum(found.x) if found else np.nan):
                    primal[i], iterations[i] = found.x, found.iterations
                    ray[i] = status in ("DualInfeasible", "AlmostDualInfeasible")
                    dual[i] = 0.0 if ray[i] else found.z
                    good[i] = (
                        status in ("Solved", "AlmostSolved", "InsufficientProgress") and np.isfinite(dual[i]).all()
                    )
        return primal, np.nan_to_num(dual), iterations, good, ray

    def _member(
        self, kind: tuple[float, float], blocks: list[Block], data: Array, cost: Array, limits: Array, *where: Any
    ) -> Any:
        """Clarabel's solution, or None if it panics: then the next member makes a new solver."""
        try:
            if kind in self.solvers:
                self.solvers[kind].update(q=cost, A=data, b=limits)
            else:
                self.solvers[kind] = _fresh(kind, blocks, data, cost, limits, *where)
            return self.solvers[kind].solve()
        except BaseException as error:  # pyo3's PanicException is no Exception
            self.solvers.pop(kind, None)
            if type(error).__name__ != "PanicException":
                raise
            return None


def _fresh(
    kind: tuple[float, float], blocks: list[Block], data: Array, cost: Array, limits: Array, rows: Array, starts: Array
) -> Any:
    """A solver that takes updates; not equilibrated, or an answer would depend on the scales of the first member."""
    import clarabel
    import scipy.sparse as sp

    settings = clarabel.DefaultSettings()
    settings.verbose = settings.presolve_enable = settings.input_sparse_dropzeros = False
    settings.chordal_decomposition_enable = settings.equilibrate_enable = False
    settings.direct_solve_method, settings.max_threads, settings.max_iter = "qdldl", 1, 200
    tolerance, settings.max_step_fraction = kind
    for name in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
        setattr(settings, name, tolerance)
        setattr(settings, f"reduced_{name}", REDUCED)
    made = {"row": clarabel.NonnegativeConeT, "ball": clarabel.SecondOrderConeT}
    cones = [made[name](n) for block in blocks for name, n in block.cones]
    zero = clarabel.ZeroConeT(len(limits) - sum(block.limits.shape[1] for block in blocks))
    matrix = sp.csc_matrix((data, rows, starts), shape=(len(limits), len(cost)))
    squares = sp.diags(np.repeat([float(b.curvature) for b in blocks], [b.cost.shape[1] for b in blocks]), format="csc")
    return clarabel.DefaultSolver(squares, cost, matrix, limits, [zero, *cones], settings)


def _is_farkas(programme: Programme, multipliers: list[Array], unit: Array) -> BoolArray:
    """Whether multipliers of box, intervals and balls, once balanced, prove that no point within reach is feasible."""
    sides, balls = sides_of(programme), programme.balls
    matrix = np.concatenate([one.matrix for one in sides] + [ball.matrix for ball in balls], axis=1)
    lower, upper = (np.concatenate([getattr(one, name) for one in sides], axis=1) for name in ("lower", "upper"))
    w = np.concatenate(multipliers, axis=1)
    w = w / np.maximum(np.abs(w).max(axis=1, initial=0.0), 1e-300)[:, None]
    w = np.where(np.abs(w) < 1e-9, 0.0, w)
    weighted = transpose(np.abs(w)[..., None] * matrix)
    w = w - np.abs(w) * (np.linalg.pinv(weighted) @ transposed_product(matrix, w)[..., None])[..., 0]
    left = np.abs(transposed_product(matrix, w)).sum(axis=1)
    count = lower.shape[1]
    bound = np.where(w[:, :count] > 0, upper, np.where(w[:, :count] < 0, lower, 0.0))
    support, reach = (
        np.einsum("bq,bq->b", w[:, :count], bound),
        np.maximum(unit, np.abs(bound).max(axis=1, initial=0.0)),
    )
    for ball in balls:
        v = w[:, count : count + ball.centre.shape[1]]
        count += ball.centre.shape[1]
        support += np.einsum("bq,bq->b", v, ball.centre) + ball.radius * norm(v)
        reach = np.maximum(reach, norm(ball.centre))
    return np.asarray(support + 1e-12 * reach + ESCAPE * reach * left < 0)


def _checked(programme: Programme) -> tuple[BoolArray, BoolArray]:
    """Members whose numbers are finite but for their bounds, and those with a bound that nothing satisfies."""
    parts: list[Array] = [part for term in programme.terms for part in (term.matrix, term.rhs)]
    parts += [part for ball in programme.balls for part in (ball.matrix, ball.centre, ball.radius)]
    parts += [one.matrix for one in programme.intervals]
    usable = ~np.isnan(np.concatenate([part for one in sides_of(programme) for part in (one.lower, one.upper)], axis=1))
    usable = usable.all(axis=1)
    for part in parts:
        usable &= np.isfinite(part).all(axis=tuple(range(1, part.ndim)))
    crossed = np.zeros(programme.batch, dtype=bool)
    for side in sides_of(programme):
        crossed |= ((side.lower > side.upper) | (side.lower == np.inf) | (side.upper == -np.inf)).any(axis=-1)
    for ball in programme.balls:
        crossed |= ball.radius < 0
    return usable, usable & crossed


def _blank(programme: Programme, infeasible: BoolArray) -> Solution:
    """Nothing found yet."""
    return Solution(
        np.full(programme.lower.shape, np.nan),
        np.zeros(programme.batch, dtype=bool),
        np.zeros(programme.batch, dtype=np.int64),
        tuple(np.zeros(term.rhs.shape) for term in programme.terms),
        tuple(np.zeros(one.lower.shape) for one in programme.intervals),
        tuple(np.zeros(ball.centre.shape) for ball in programme.balls),
        infeasible,
    )


def _put(out: Solution, where: Any, part: Solution, chosen: Any = slice(None)) -> None:
    """Members of one solution written into another."""

    def arrays(one: Solution) -> list[npt.NDArray[Any]]:
        flags = [one.converged, np.asarray(one.infeasible)]
        return [one.values, one.iterations, *flags, *(one.rows or ()), *one.intervals, *one.balls]

    for mine, theirs in zip(arrays(out), arrays(part), strict=True):
        mine[where] = theirs[chosen]
