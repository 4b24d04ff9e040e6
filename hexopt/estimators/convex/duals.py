"""Duals by name, as an estimate has them, and back as a solution takes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...arrays import BoolArray
from ...result import Estimate
from .posed import Posed, in_batch
from .routes import Answer

__all__ = ["named_duals", "solution_duals"]


def named_duals(made: Posed, answer: Answer, good: BoolArray, batch: tuple[int, ...]) -> dict[str, Any]:
    """The duals of a certificate by name, in the shape of the batch; NaN for members that are not good, (B, 1)."""
    proof, assembly, unit = answer.certificate, made.assembly, made.unit[:, None]
    named = {name: part * unit for name, part in zip(assembly.row_names, proof.rows, strict=True)}
    named["rows"] = proof.rows[0] * (made.unit / made.divisor)[:, None] if made.is_raw else proof.rows[0]
    if assembly.box_name:
        named[assembly.box_name] = proof.box * unit
    named |= {name: part * unit for name, part in zip(assembly.interval_names, proof.intervals, strict=True)}
    named |= {name: part * unit for name, part in zip(assembly.ball_names, proof.balls, strict=True)}
    return {name: in_batch(np.where(good, part, np.nan), batch) for name, part in named.items()}


def solution_duals(made: Posed, found: Estimate, count: int) -> dict[str, Any]:
    """The duals of an estimate as a solution takes them."""

    def flat(name: str) -> Any:
        dual = np.nan_to_num(found.duals[name])
        unit = made.unit / made.divisor if name == "rows" and made.is_raw else made.unit
        return dual.reshape(count, dual.shape[-1]) / unit[:, None]

    parts: dict[str, Any] = {
        "intervals": tuple(flat(name) for name in made.assembly.interval_names),
        "balls": tuple(flat(name) for name in made.assembly.ball_names),
    }
    terms = made.assembly.programme.terms
    if not all(term.loss.smooth for term in terms):
        parts["rows"] = tuple(flat(name) for name in made.assembly.row_names)
    return parts
