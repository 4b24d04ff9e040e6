"""A linear problem with its rows weighted and scaled, its priors and constraints: a programme to solve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...arrays import Array
from ...constraints import Constraint
from ...errors import InputError
from ...losses import Loss, Quadratic
from ...numerics.forms import Direct
from ...numerics.lstsq import LstsqSolution, solve
from ...priors import Prior
from ...problem import LinearProblem, Whitening
from .assembly import Assembly, assemble, centre_of
from .scale import mad_scale
from .uniqueness import unweighted_about

__all__ = ["Posed", "Settings", "in_batch", "posed", "reference"]


@dataclass(frozen=True, eq=False)
class Settings:
    """What of an estimator makes the programme."""

    loss: Loss
    priors: Sequence[Prior]
    constraints: Sequence[Constraint]
    weights: Any
    scale: Any


@dataclass(frozen=True, eq=False)
class Posed:
    """A programme, and how its rows were made of the problem's.

    Attributes
    ----------
    assembly : Assembly
    root : Whitening or None
    divisor : ndarray, shape (B,)
        By what the weighted rows were divided.
    unit : ndarray, shape (B,)
        The objective of the problem over that of the programme.
    shared : bool
        Whether the whitening holds the error that all poses share.
    is_raw : bool
        Whether rows have neither weights nor scale, so that the divisor is their unit only.
    dropped : int
        How many rows have the weight zero in all members.
    """

    assembly: Assembly
    root: Whitening | None
    divisor: Array
    unit: Array
    shared: bool
    is_raw: bool
    dropped: int

    def undivided(self, gain: Array) -> Array:
        """A gain on divided rows, (B, p, m), as one on the weighted rows."""
        return gain if (self.divisor == 1).all() else gain / self.divisor[:, None, None]

    def unscaled(self, known: LstsqSolution, batch: tuple[int, ...]) -> LstsqSolution:
        """A least-squares solution of the programme as one of the weighted rows, in the problem's batch."""
        parts = {
            "values": known.values,
            "full_rank": known.full_rank,
            "condition": known.condition,
            "inverse": self.undivided(known.inverse),
            "objective": known.objective * self.unit,
            "gap": known.gap * self.unit,
            "residual": known.residual * self.divisor[:, None],
            "imbalance": known.imbalance * self.divisor,
        }
        return LstsqSolution(**{name: in_batch(part, batch) for name, part in parts.items()})


def in_batch(array: Any, batch: tuple[int, ...]) -> Any:
    """An array (B, ...) of the flat batch in the problem's batch."""
    return array.reshape((*batch, *array.shape[1:]))


def posed(target: LinearProblem, settings: Settings, *, raw_unit: bool = False) -> Posed:
    """Check, weight, scale and assemble; raw rows in units of their right-hand side, unless in their own."""
    loss = settings.loss
    if loss.per == "pose" and not isinstance(target.form, Direct):
        raise InputError(f"{loss!r} looks at whole poses: use the direct form, loop.linear(form='direct')")
    shared = isinstance(loss, Quadratic)
    root = _root(target, settings, shared=shared)
    matrix, rhs = target.whitened_by(root)
    divisor = _divisor(settings, matrix, rhs, target.name)
    raw = settings.weights is None and settings.scale is None
    if raw and raw_unit:
        divisor = np.ones(divisor.shape)
    if (divisor != 1).any():
        matrix, rhs = matrix / divisor[..., None, None], rhs / divisor[..., None]
    assembly = assemble(
        loss,
        matrix,
        rhs,
        target.rows_per_block,
        target.parameters,
        settings.priors,
        settings.constraints,
    )
    unit = divisor ** (loss.degree or 0) if raw else np.ones(divisor.shape)
    dropped = 0
    if settings.weights is not None and not isinstance(settings.weights, str):
        weights = np.broadcast_to(np.asarray(settings.weights), target.rhs.shape)
        dropped = int((weights == 0).all(axis=tuple(range(weights.ndim - 1))).sum())
    return Posed(assembly, root, divisor.reshape(-1), unit.reshape(-1), shared, raw, dropped)


def _root(target: LinearProblem, settings: Settings, *, shared: bool) -> Whitening | None:
    if settings.weights is None:
        return None
    if not isinstance(settings.weights, str):
        weights = np.asarray(settings.weights, dtype=float)
        if weights.shape != target.rhs.shape[target.rhs.ndim - weights.ndim :]:
            raise InputError(f"weights: expected shape {target.rhs.shape} or its last part, got {weights.shape}")
        return Whitening(np.sqrt(np.broadcast_to(weights, target.rhs.shape))[..., None, None])
    if (settings.priors or settings.constraints) and target.at is None and target.noise is not None:
        centre = centre_of(target.parameters, settings.priors, settings.constraints)
        target = replace(target, at=unweighted_about(target, centre))
    return target.whitening(shared=shared)


def _divisor(settings: Settings, matrix: Array, rhs: Array, name: str) -> Array:
    """What one σ of the weighted rows is; for raw rows without a scale, the size of the right-hand side."""
    batch = rhs.shape[:-1]
    if settings.scale == "mad":
        return mad_scale(matrix, rhs, name)
    if settings.scale is not None:
        return np.full(batch, float(settings.scale))
    if settings.weights is not None:
        return np.ones(batch)
    size = np.sqrt(np.einsum("...m,...m->...", rhs, rhs) / rhs.shape[-1])
    return np.asarray(np.where(size > 0, size, 1.0))


def reference(assembly: Assembly, lost: Array, *, inverse: bool) -> LstsqSolution:
    """Least squares on the data and the normal priors: their condition, rank, and (if all is quadratic) the answer."""
    terms = [assembly.programme.terms[i] for i in (0, *assembly.gaussian)]
    matrix, rhs = terms[0].matrix, terms[0].rhs
    missing = matrix.shape[-1] - sum(term.rhs.shape[-1] for term in terms)
    if missing > 0 or len(terms) > 1:
        blank = np.zeros((len(rhs), max(missing, 0), matrix.shape[-1]))
        matrix = np.concatenate([*(term.matrix for term in terms), blank], axis=-2)
        rhs = np.concatenate([*(term.rhs for term in terms), blank[..., 0]], axis=-1)
    return solve(matrix, rhs, lost, inverse=inverse)
