"""Designs of whole numbers to start from: rounded weights, systematic samples of them, and random draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import Array, transpose
from ..errors import RankDeficientError
from ..information import inverse_root
from .criteria import DOptimal
from .exchange import Counts, exchange, factors
from .feasible import Feasible
from .objective import Objective

__all__ = ["rounded", "starts_of"]

#: Weight of all candidates together that stands in, while a design is mended, for what it does not see.
TRACE = 1e-9


def starts_of(
    objective: Objective,
    feasible: Feasible,
    weights: Array,
    number: int = 8,
    rng: np.random.Generator | None = None,
    rows: Array | None = None,
) -> list[Counts]:
    r"""Different designs that see all parameters, from the weights w of a relaxation.

    First the largest weights. Then systematic samples, which take a pose whenever the cumulated weight passes one of
    :math:`u, u + 1, \ldots`, for several offsets u; with an `rng` as many random draws with chances as the weights
    are, and as many with equal ones. All are filled up to the budget by the largest weights. A design that does not see
    all parameters is mended by exchanges for :math:`\log\det(M + \varepsilon\sum_i M_i)`.

    Parameters
    ----------
    objective : Objective
    feasible : Feasible
    weights : ndarray, shape (n,)
        Allowed ones.
    number : int, default 8
        Of designs, before those that are equal are taken out.
    rng : Generator, optional
    rows : ndarray, shape (S, n, r, m), optional
        `factors` of the poses, if they are at hand.

    Returns
    -------
    list of ndarray of int, shape (n,)

    Raises
    ------
    RankDeficientError
        If no design was found that sees all parameters.
    """
    if not np.isfinite(objective.value(np.floor(feasible.cap + 1e-9))):
        raise RankDeficientError(f"all candidates together do not see {_all(objective)}; take others that differ more")
    rows = factors(objective.information.blocks) if rows is None else rows
    found: dict[bytes, Counts] = {}
    for order in _orders(weights, number, rng):
        counts = _mended(objective, feasible, _taken(feasible, order), rows)
        if counts is not None:
            found.setdefault(counts.tobytes(), counts)
    if not found:
        raise RankDeficientError(_too_few(objective, feasible, rows))
    return list(found.values())


def rounded(feasible: Feasible, weights: Array) -> Counts:
    """The design of the largest weights, filled up to the budget, whether it sees all parameters or not."""
    return _taken(feasible, _order(weights, weights))


def _orders(weights: Array, number: int, rng: np.random.Generator | None) -> list[Counts]:
    """In which order poses are taken, by every design."""
    offsets = number - 1 if rng is None else (number + 1) // 3
    orders = [_order(weights, weights)]
    for i in range(offsets):
        passed = np.floor(np.cumsum(weights) + (i + 0.5) / offsets)
        orders.append(_order(np.diff(passed, prepend=0.0), weights))
    while rng is not None and len(orders) < number:
        keys = np.log(np.maximum(weights, 1e-300)) + rng.gumbel(size=len(weights))
        orders += [np.argsort(-keys, kind="stable"), rng.permutation(len(weights))]
    return orders[:number]


def _order(first: Array, then: Array) -> Counts:
    """Poses by their whole numbers, each so often, and behind them all poses by what is left of their weights."""
    whole = np.floor(np.maximum(first, 0.0) + 1e-6)
    rest = np.argsort(-(then - whole), kind="stable")
    return np.concatenate([np.repeat(np.arange(len(first)), whole.astype(np.intp)), rest])


def _taken(feasible: Feasible, order: Counts) -> Counts:
    """Poses in this order, again and again, while one fits."""
    counts = np.zeros(len(feasible.cap), dtype=np.intp)
    limit, left, cheapest = np.floor(feasible.cap + 1e-9), feasible.total * (1 + 1e-12), feasible.cost.min()
    more = True
    while more:
        more = False
        for pose in order:
            if left < cheapest:
                return counts
            if counts[pose] < limit[pose] and feasible.cost[pose] <= left:
                counts[pose] += 1
                left -= feasible.cost[pose]
                more = True
    return counts


def _mended(objective: Objective, feasible: Feasible, counts: Counts, rows: Array) -> Counts | None:
    """The design, after exchanges where it does not see all parameters; None if these do not help."""
    if np.isfinite(objective.value(counts)):
        return counts
    information = objective.information
    root, _ = inverse_root(information.blocks.sum(axis=1) + information.fixed)
    little = TRACE * np.eye(information.size)  # of the information of all candidates, in whose coordinates this is
    every = replace(
        information,
        blocks=transpose(root)[:, None] @ information.blocks @ root[:, None],
        fixed=transpose(root) @ information.fixed @ root + little,
        labels=("",) * information.size,
    )
    volume, turned = Objective(every, DOptimal()), rows @ root[:, None]
    for _ in range(information.size):
        counts, _ = exchange(volume, feasible, counts, 1, turned)
        if np.isfinite(objective.value(counts)):
            return counts
    return None


def _all(objective: Objective) -> str:
    """What a design has to see."""
    return f"all {objective.information.size} parameters and nuisances"


def _too_few(objective: Objective, feasible: Feasible, rows: Array) -> str:
    """Why no design was found that sees all parameters, and what to do."""
    ask = _all(objective)
    if not feasible.counts_poses:
        return f"no design within the budget of {feasible.total:g} sees {ask}; raise it"
    n = int(feasible.total)
    for more in range(n + 1, objective.information.size + n + 1):
        enough = replace(feasible, total=float(more))
        if _mended(objective, enough, _taken(enough, np.arange(len(feasible.cap))), rows) is not None:
            return f"no design of {n} of these poses sees {ask}; choose {more} or more"
    return f"no design of {n} of these poses sees {ask}; choose more"
