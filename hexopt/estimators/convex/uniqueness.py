"""Whether an answer is unique, and what of it the measurements did not decide."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import Array, BoolArray, matvec, norm, transpose
from ...numerics.lstsq import rank_tolerance
from ...numerics.lstsq import solve as solve_lstsq
from ...numerics.programme import Programme
from ...problem import LinearProblem
from .assembly import Assembly
from .routes import Answer

__all__ = ["holding", "undecided", "unweighted_about"]

#: Residuals below this (in σ) are at the kink of a loss, and duals above this share of it hold there.
KINK = 1e-6


def unweighted_about(problem: LinearProblem, centre: Array) -> Array:
    """The unweighted solution, nearest to a centre (..., p) in what the rows do not see."""
    rows = problem.matrix.shape[-2]
    if rows >= problem.parameters.size:
        plain = solve_lstsq(problem.matrix, problem.rhs, problem.worst_cancellation, inverse=False)
        if plain.full_rank.all():
            return plain.values
    scale = np.sqrt(np.einsum("...mp,...mp->...p", problem.matrix, problem.matrix))
    scale[scale == 0] = 1.0
    tolerance = rank_tolerance(*problem.matrix.shape[-2:]) * np.max(problem.worst_cancellation, initial=1.0)
    inverse = np.linalg.pinv(problem.matrix / scale[..., None, :], rcond=tolerance)
    change = matvec(inverse, problem.rhs - matvec(problem.matrix, centre)) / scale
    return np.asarray(centre + change)


def undecided(problem: LinearProblem, assembly: Assembly, answer: Answer, full: BoolArray) -> tuple[BoolArray, ...]:
    """Members whose answer is not unique, and members of which the rows alone do not decide all, both (B,).

    Beside the rows and normal priors (which have full rank where `full`), an entry is decided by an active bound,
    by the kink of a lasso, or across the deviation of a joint.
    """
    data = assembly.programme.terms[0]
    rows, size = data.matrix.shape[-2:]
    seen = np.zeros(len(full), dtype=bool)
    if not assembly.gaussian:
        seen = full
    elif rows >= size:
        lost = np.broadcast_to(problem.worst_cancellation, problem.batch_shape).reshape(-1)
        seen = np.asarray(solve_lstsq(data.matrix, data.rhs, lost, inverse=False).full_rank)
    loose = np.zeros(len(full), dtype=bool)
    held = holding(assembly.programme, answer)
    for member in np.flatnonzero(~full & answer.proven):
        loose[member] = _rank_of(assembly.programme, answer, held, int(member)) < size
    return loose, ~seen


def holding(programme: Programme, answer: Answer) -> tuple[BoolArray, list[BoolArray], list[BoolArray]]:
    """Which bounds of the box (B, p), rows of intervals (B, q) and balls (B,) hold the answers.

    Those whose force, in columns of unit length, is more than rounding beside the forces of the rows; and equations.
    """
    proof = answer.certificate
    columns = np.sqrt(sum(np.einsum("...mp,...mp->...p", term.matrix, term.matrix) for term in programme.terms))
    columns = np.where(columns > 0, columns, 1.0)
    weak = KINK * (1 + np.max([np.abs(part).max(axis=-1, initial=0.0) for part in proof.rows], axis=0))[:, None]
    box = (np.abs(proof.box) > weak * columns) | (programme.lower == programme.upper)
    intervals = [
        (np.abs(force) * norm(part.matrix / columns[:, None, :]) > weak) | (part.lower == part.upper)
        for part, force in zip(programme.intervals, proof.intervals, strict=True)
    ]
    balls = [
        norm(matvec(transpose(ball.matrix), force) / columns) > weak[:, 0]
        for ball, force in zip(programme.balls, proof.balls, strict=True)
    ]
    return np.asarray(box), [np.asarray(part) for part in intervals], [np.asarray(part) for part in balls]


def _rank_of(programme: Programme, answer: Answer, held: tuple[Any, ...], member: int) -> int:
    """The rank of all rows that pin the answer down."""
    x = answer.values[member]
    box, intervals, balls = held
    parts = [np.eye(programme.size)[box[member]]]
    for number, term in enumerate(programme.terms):
        matrix = term.matrix[member]
        if number and not term.loss.smooth:
            z, u = matrix @ x - term.rhs[member], answer.certificate.rows[number][member]
            z, u = z.reshape(-1, term.size), u.reshape(-1, term.size)
            kink = (norm(z) <= KINK) & (norm(u) <= (1 - KINK) * term.loss.bound)
            unit = z / np.maximum(norm(z), 1e-300)[:, None]  # away from its kink a length is curved across z
            across = np.eye(term.size) - np.where(kink[:, None, None], 0.0, unit[:, :, None] * unit[:, None, :])
            matrix = (across @ matrix.reshape(len(z), term.size, -1)).reshape(matrix.shape)
        parts.append(matrix)
    parts += [part.matrix[member][rows[member]] for part, rows in zip(programme.intervals, intervals, strict=True)]
    parts += [ball.matrix[member] for ball, one in zip(programme.balls, balls, strict=True) if one[member]]
    stacked = np.concatenate(parts)
    length = norm(stacked.T)
    return int(np.linalg.matrix_rank(stacked / np.where(length > 0, length, 1.0)))
