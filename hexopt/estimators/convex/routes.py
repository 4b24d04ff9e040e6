"""Which solver takes a programme: the fastest that proves its answer, then Clarabel, then cvxpy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Array, BoolArray, matvec
from ...errors import InputError
from ...losses import Quadratic
from ...numerics.certificate import Certificate, certify
from ...numerics.conic import conic_solves, solve_conic
from ...numerics.interior import interior_solves, solve_interior
from ...numerics.lstsq import LstsqSolution
from ...numerics.newton import newton_solves, solve_newton
from ...numerics.polish import polish
from ...numerics.programme import Programme, Solution
from .posing import solve_cvxpy

__all__ = ["BACKENDS", "Answer", "closed_form", "judged", "solve"]

#: A solver of scaled programmes, from a start that it may use.
Route = Callable[[Programme, Array], Solution]
#: Problems that are worked on together: so many that calls cost little, so few that arrays stay in the cache.
CHUNK = 1024

BACKENDS = ("auto", "batched", "clarabel", "cvxpy")
#: What the gap must reach, relative to 1 + |objective|, to be called a success.
GAP = 1e-8
#: How far, in standard deviations of the rows, a success of smooth losses in a box may be from the optimum: of
#: a quadratic the gap is half its square.
DEVIATION = 1e-6
#: Largest violation of a constraint and imbalance of the duals, relative to the size of the scaled unknowns.
FEASIBILITY = 1e-9
#: Condition number of the columns beyond which the rows are made orthonormal first.
ILL_CONDITIONED = 1e4


@dataclass(frozen=True, eq=False)
class Answer:
    """A point of every member with its certificate, in the variables of the programme; the batch is flat."""

    values: Array
    objective: Array
    certificate: Certificate
    proven: BoolArray
    infeasible: BoolArray
    iterations: Any

    def spread(self, where: Any, count: int) -> Answer:
        """The answer of some members of a batch of `count`; the others have NaN and nothing proven."""

        def wide(part: Any) -> Any:
            missing = np.nan if part.dtype.kind == "f" else 0
            out = np.full((count, *part.shape[1:]), missing, dtype=part.dtype)
            out[where] = part
            return out

        return _arraywise(wide, self)


def _arraywise(change: Callable[..., Any], *parts: Any) -> Any:
    """Answers (or what they hold) of one structure as one, every array being `change` of theirs."""
    if isinstance(parts[0], tuple):
        return tuple(_arraywise(change, *pieces) for pieces in zip(*parts, strict=True))
    if not is_dataclass(parts[0]):
        return change(*parts)
    names = [item.name for item in fields(parts[0])]
    return replace(parts[0], **{name: _arraywise(change, *(getattr(part, name) for part in parts)) for name in names})  # type: ignore[type-var]


def solve(programme: Programme, backend: str, known: LstsqSolution) -> Answer:
    """Solve every member by the routes of a backend, a slower one only for members that are not proven yet.

    `known` is the least-squares solution of the data and normal priors: a start, and the condition number.
    """
    routes = _routes(programme, backend)
    answers = []
    for start in range(0, max(programme.batch, 1), CHUNK):
        part = slice(start, start + CHUNK)
        answers.append(_solve_chunk(programme.take(part), routes, known.values[part], known.condition[part]))
    return answers[0] if len(answers) == 1 else _arraywise(lambda *parts: np.concatenate(parts), *answers)


def _solve_chunk(programme: Programme, routes: Sequence[Route], start: Array, condition: Array) -> Answer:
    scaled, length = programme.scaled()
    answer = _tried(routes[0], scaled, start * length, condition)
    for route in routes[1:]:
        left = np.flatnonzero(~answer.proven & ~answer.infeasible)
        if len(left) == 0:
            break
        other = _tried(route, scaled.take(left), (start * length)[left], condition[left])
        answer = _merged(answer, other, left)
    certificate = replace(answer.certificate, box=answer.certificate.box * length)
    return replace(answer, values=answer.values / length, certificate=certificate)


def closed_form(programme: Programme, known: LstsqSolution) -> Answer:
    """The answer of a free programme of quadratic terms, which is their least-squares solution."""
    full = np.asarray(known.full_rank)
    ends = np.cumsum([term.rhs.shape[-1] for term in programme.terms])
    rows = tuple(np.split(known.residual[:, : ends[-1]], ends[:-1], axis=-1))
    allowed = np.minimum(GAP * (1 + known.objective), 0.5 * DEVIATION**2 * np.maximum(1.0, known.objective))
    zero, nothing = np.zeros(full.shape), np.zeros(known.values.shape)
    return Answer(
        known.values,
        known.objective,
        Certificate(
            known.gap,
            zero,
            known.imbalance,
            nothing,
            rows,
            nothing,
            (),
            (),
        ),
        full & (known.gap <= allowed),
        np.zeros(full.shape, dtype=bool),
        np.zeros(full.shape, dtype=np.int64),
    )


def _routes(programme: Programme, backend: str) -> list[Route]:
    batched: list[Route] = []
    if newton_solves(programme):
        batched.append(solve_newton)
    if interior_solves(programme):
        batched.append(lambda part, start: solve_interior(part))
    direct: list[Route] = [_direct] if conic_solves(programme) else []
    if backend == "batched" and not batched:
        raise InputError(
            "backend='batched': no batched route takes this loss with these priors and constraints; "
            "write backend='auto' or 'clarabel'"
        )
    if backend == "clarabel" and not direct:
        raise InputError("backend='clarabel': only cvxpy takes a loss that is not built in; write backend='cvxpy'")
    last: list[Route] = [_posed]
    return {"auto": batched + direct + last, "batched": batched, "clarabel": direct, "cvxpy": last}[backend]


def _direct(programme: Programme, start: Array) -> Solution:
    return solve_conic(programme)


def _posed(programme: Programme, start: Array) -> Solution:
    """By cvxpy, whose word that a member is infeasible counts only if Clarabel's proof of it holds."""
    solution = solve_cvxpy(programme)
    doubted = np.flatnonzero(np.zeros(0) if solution.infeasible is None else solution.infeasible)
    infeasible = np.zeros(programme.batch, dtype=bool)
    if len(doubted):
        part = programme.take(doubted)
        plain = replace(part, terms=tuple(replace(term, loss=Quadratic()) for term in part.terms))
        infeasible[doubted] = np.asarray(solve_conic(plain).infeasible)
    return replace(solution, infeasible=infeasible)


def _tried(route: Route, programme: Programme, start: Array, condition: Array) -> Answer:
    """One route on scaled members; the ill-conditioned ones in an orthonormal basis where no constraint forbids it."""
    solution = route(programme, start)
    answer = judged(programme, solution, condition)
    if route in (_direct, _posed) and not answer.proven.all():
        polished = judged(programme, polish(programme, solution), condition)
        answer = _merged(answer, polished, np.arange(programme.batch))
    bad = np.flatnonzero(np.asarray(condition > ILL_CONDITIONED) & np.isfinite(condition) & ~answer.proven)
    if not programme.is_free or len(bad) == 0:
        return answer
    part = programme.take(bad)
    basis, forth, back = _orthonormal(part)
    solution = route(basis, matvec(forth, start[bad]))
    return _merged(answer, judged(part, replace(solution, values=matvec(back, solution.values)), condition[bad]), bad)


def judged(programme: Programme, solution: Solution, condition: Array) -> Answer:
    """A solution with its certificate, which is taken in orthonormal columns where the rows are ill-conditioned.

    There the imbalance that rounding leaves of the duals counts in σ of the rows; in ill-conditioned columns a tiny
    one may stand for a large distance.
    """
    answer = _certified(programme, solution)
    finite = np.isfinite(solution.values).all(axis=-1)
    ill = finite & ~(condition <= ILL_CONDITIONED)
    again = np.flatnonzero(ill | (finite & ~answer.proven)) if programme.is_free else np.flatnonzero(ill)
    if len(again) == 0:
        return answer
    if not programme.is_free:
        return replace(answer, proven=_balanced_in_rows(programme, answer, again))
    values = solution.values[again]
    basis, _, _ = _orthonormal(programme.take(again).about(values))  # residuals are those of the values themselves
    rows = None if solution.rows is None else tuple(part[again] for part in solution.rows)
    at = Solution(np.zeros((len(again), basis.size)), solution.converged[again], 0 * solution.iterations[again], rows)
    second = replace(_certified(basis, at), values=values)
    return _merged(replace(answer, proven=answer.proven & ~ill), second, again)


def _balanced_in_rows(programme: Programme, answer: Answer, which: Any) -> BoolArray:
    """Whether members that are proven stay so when their imbalance counts as rows u with Aᵀu = imbalance."""
    proven = answer.proven.copy()
    stacked = np.concatenate([term.matrix[which] for term in programme.terms], axis=-2)
    _, s, vt = np.linalg.svd(stacked, full_matrices=False)
    along = matvec(vt, answer.certificate.imbalance[which])
    seen = s > 1e-15 * s[:, :1]
    rows = np.sqrt(np.square(np.divide(along, s, out=np.zeros(s.shape), where=seen)).sum(axis=-1))
    size = np.sqrt(1 + 2 * answer.objective[which])
    proven[which] &= rows * size <= GAP * (1 + answer.objective[which])
    return proven


def _certified(programme: Programme, solution: Solution) -> Answer:
    finite = np.asarray(np.isfinite(solution.values).all(axis=-1))
    inside = replace(solution, values=np.where(finite[:, None], solution.values, 0.0))
    certificate = certify(programme, inside)
    objective = programme.objective(inside.values)
    infeasible = np.zeros(len(finite), dtype=bool) if solution.infeasible is None else solution.infeasible
    good = _proven(programme, inside.values, objective, certificate) & finite
    if not finite.all():
        objective = np.where(finite, objective, np.nan)
        certificate = replace(
            certificate,
            gap=np.where(finite, certificate.gap, np.nan),
            primal_residual=np.where(finite, certificate.primal_residual, np.nan),
            dual_residual=np.where(finite, certificate.dual_residual, np.nan),
        )
    return Answer(solution.values, objective, certificate, good, infeasible & ~good, solution.iterations)


def _proven(programme: Programme, values: Array, objective: Array, certificate: Certificate) -> BoolArray:
    """Whether a certificate proves its point of a scaled programme."""
    allowed = GAP * (1 + np.abs(objective))
    if newton_solves(programme):
        allowed = np.minimum(allowed, 0.5 * DEVIATION**2 * np.maximum(1.0, objective))
    size = 1 + np.abs(values).max(axis=-1, initial=0.0)
    force = 1 + np.max([np.abs(part).max(axis=-1, initial=0.0) for part in certificate.rows], axis=0)
    return np.asarray(
        (certificate.gap <= allowed)
        & (certificate.primal_residual <= FEASIBILITY * size)
        & (certificate.dual_residual <= FEASIBILITY * force)
    )


def _orthonormal(programme: Programme) -> tuple[Programme, Array, Array]:
    """A free programme in a basis in which its stacked rows are orthonormal, the way there and back, (B, p, p).

    Of fewer rows than unknowns the last columns are zero.
    """
    stacked = np.concatenate([term.matrix for term in programme.terms], axis=-2)
    u, s, vt = np.linalg.svd(stacked, full_matrices=False)
    u = np.concatenate([u, np.zeros((*u.shape[:-1], programme.size - u.shape[-1]))], axis=-1)
    ends = np.cumsum([term.matrix.shape[-2] for term in programme.terms])[:-1]
    parts = np.split(u, ends, axis=-2)
    terms = tuple(replace(term, matrix=part) for term, part in zip(programme.terms, parts, strict=True))
    return replace(programme, terms=terms), s[:, :, None] * vt, np.swapaxes(vt, -1, -2) / s[:, None, :]


def _merged(answer: Answer, other: Answer, where: Any) -> Answer:
    """`answer` with the members at `where` taken from `other` if that is proven, or closer to it."""
    mine, theirs = answer.certificate, other.certificate
    closer = ~(mine.gap[where] + mine.primal_residual[where] <= theirs.gap + theirs.primal_residual)
    better = np.asarray(other.proven | other.infeasible | closer)
    source = np.flatnonzero(better & ~answer.proven[where])
    chosen = where[source]

    def put(mine: Any, theirs: Any) -> Any:
        out = np.array(mine)
        out[chosen] = theirs[source]
        return out

    iterations = np.array(answer.iterations)
    iterations[where] += other.iterations
    return replace(_arraywise(put, answer, other), iterations=iterations)
