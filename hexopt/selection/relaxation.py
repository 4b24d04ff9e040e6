r"""The best weights, when poses may be measured in part: a convex programme, and what no design can beat.

Over all candidates :math:`\min_w f(w)` such that :math:`0 \le w \le u`, :math:`c^T w \le N` has an answer with few
weights between their bounds. At the price :math:`\lambda` of the budget, candidates with gains
:math:`g_i > \lambda c_i` are at their cap, and those with :math:`g_i < \lambda c_i` at zero. So only those in between
or next to it are free; the others keep their weights and join :math:`M_0`. Every round solves that small programme,
prices all candidates with its gains, and frees those on the wrong side, until a lower bound over all of them proves
the weights.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, frozen
from ..errors import InputError, RankDeficientError
from ..information import inverse_root
from .certificate import lower_bound
from .criteria import AOptimal, EOptimal
from .feasible import Feasible
from .interior_point import Optimum, minimise
from .objective import Objective
from .relaxed import Relaxation
from .semidefinite import relax_largest

__all__ = ["Relaxation", "relax"]

Index = npt.NDArray[np.intp]
MAX_ROUNDS = 40
#: So many candidates stand for all at the beginning.
SAMPLE = 600
#: Free candidates at zero, and at their cap.
FREE = 100
#: A round that leaves more than this share of the gap doubles them for the next.
SLOW = 0.5
#: The small programme is solved to this share of the gap over all candidates, but no better than that.
SHARE, FINEST = 1e-3, 1e-9


def relax(objective: Objective, feasible: Feasible, goal: float = 1e-6) -> Relaxation:
    """Minimise an objective over all allowed weights.

    Parameters
    ----------
    objective : Objective
        Of a convex criterion. Where its second derivative is not known, the weights are those of A, and the bound is
        what they prove: not tight as a rule.
    feasible : Feasible
    goal : float, default 1e-6
        Relative gap (in variance) at which the weights are good enough.

    Returns
    -------
    Relaxation
        Ask `ok` whether it is proven to the goal.

    Raises
    ------
    InputError
        If there are fewer candidates than are to be measured, or the criterion is not convex.
    RankDeficientError
        If all candidates together do not see all parameters; it names what they do not see.
    """
    _check(objective, feasible)
    if isinstance(objective.criterion, EOptimal):
        return relax_largest(objective, feasible, goal)
    guided = not objective.criterion.curved
    if guided or feasible.cost @ feasible.cap <= feasible.total * (1 + 1e-12):
        guide = replace(objective, criterion=AOptimal())
        weights = relax(guide, feasible, goal).weights if guided else feasible.cap
        return _priced(objective, feasible, weights, objective.mix(objective.local(weights).pieces), goal, 0)
    return _generated(objective, feasible, goal)


def _generated(objective: Objective, feasible: Feasible, goal: float) -> Relaxation:
    """Rounds of a small programme and prices for all."""
    n, gap, best = len(feasible.cap), 1.0, None
    width = n if _at_once(objective) else FREE
    held, profit = (np.zeros(n), np.zeros(n)) if width == n else _begun(objective, feasible)
    for iteration in range(1, MAX_ROUNDS + 1):
        free = _free(objective, feasible, held, profit, width)
        fine = FINEST if len(free) == n else max(FINEST, SHARE * gap)
        weights, found = _solved(objective, feasible, held, free, fine)
        now = _priced(objective, feasible, weights, found.mix, goal, iteration)
        if best is None or now.relative < best.relative:
            best = now
        if now.ok or len(free) == n:
            break
        if now.relative > SLOW * gap:
            outside = np.delete(feasible.best(now.gains) != weights, free)
            if not outside.any():  # the gap is the small programme's own: rounding
                break
            width *= 2
        gap = min(gap, now.relative)
        profit = _profit(feasible, now.gains, found.price)
        held = _settled(feasible, weights, profit, free)
    assert best is not None
    return best


def _check(objective: Objective, feasible: Feasible) -> None:
    """That there are enough candidates, that see all parameters, and a criterion that is known."""
    criterion, info = objective.criterion, objective.information
    if not criterion.convex:
        raise InputError(
            f"criterion {criterion.name} is not convex in the weights, so nothing bounds it; try A, D or E"
        )
    whole = float(feasible.cost @ feasible.cap)
    if whole < feasible.total * (1 - 1e-12):
        raise InputError(f"{feasible.total:g} to be measured, but all candidates together make {whole:g}; ask for less")
    total = info.total(feasible.cap * (feasible.total / whole))
    seen = inverse_root(total)[1]
    if not seen.all():
        unseen = info.unseen(total[int(np.argmin(seen))])
        raise RankDeficientError(f"all candidates together do not see {'; '.join(unseen)}", unseen)


def _at_once(objective: Objective) -> bool:
    """Whether there are so few candidates that all may be free: the method costs the less the fewer unknowns M has."""
    scenarios, n, size, _ = objective.information.blocks.shape
    return n <= SAMPLE or (n <= 2 * SAMPLE and scenarios * objective.information.main * size < n)


def _begun(objective: Objective, feasible: Feasible) -> tuple[Array, Array]:
    """Weights to begin with, and how profitable all candidates are: a sample stands for all, with larger caps."""
    n = len(feasible.cap)
    sample = np.zeros(n, dtype=bool)
    sample[:: -(-n // SAMPLE)] = True
    free = np.flatnonzero(_seeing(objective, feasible, np.zeros(n), sample))
    parts = feasible.cost * feasible.cap
    room = replace(feasible, cap=feasible.cap * (parts.sum() / parts[free].sum()))
    weights, found = _solved(objective, room, np.zeros(n), free, SHARE)
    gains = objective.gains(objective.local(weights).sensitivity(found.mix))
    profit = _profit(feasible, gains, found.price)
    held = np.minimum(_settled(room, weights, profit, free), feasible.cap)
    rest = Feasible(feasible.cap - held, feasible.cost, max(0.0, feasible.total - float(feasible.cost @ held)))
    return held + rest.best(gains), profit


def _solved(objective: Objective, feasible: Feasible, held: Array, free: Index, goal: float) -> tuple[Array, Optimum]:
    """The weights that are best when only some are free, and what the small programme says of them."""
    weights, info = held.copy(), objective.information
    weights[free] = 0.0
    inner = replace(objective, information=replace(info.take(free), fixed=info.total(weights)))
    left = feasible.total - float(feasible.cost @ weights)
    found = minimise(inner, replace(feasible.take(free), total=left), goal)
    weights[free] = found.weights
    return weights, found


def _priced(
    objective: Objective, feasible: Feasible, weights: Array, mix: Array, goal: float, iteration: int
) -> Relaxation:
    """Weights with the bound that they prove."""
    value = objective.value(weights)
    tangent, gains = lower_bound(objective, feasible, weights, mix)
    bound = max(tangent, objective.criterion.least)
    allowed = feasible.holds(weights)
    relative = (
        1 - float(objective.criterion.efficiency(bound, value, objective.information.main)) if allowed else np.inf
    )
    stopped = "proven to the goal" if relative <= goal else "the gap does not get smaller"
    return Relaxation(frozen(weights.copy()), value, bound, gains, mix, relative, goal, iteration, stopped)


def _profit(feasible: Feasible, gains: Array, price: float) -> Array:
    """Gains above the price of the budget, as a share of it; none where nothing helps any more."""
    return gains / feasible.cost / price - 1 if price > 0 else np.zeros(len(gains))


def _settled(feasible: Feasible, weights: Array, profit: Array, free: Index) -> Array:
    """The weights, at a bound where those that were free are nearer to it than their profit is to zero."""
    cap, inside, pays = feasible.cap[free], weights[free], profit[free]
    near = np.abs(pays) * np.minimum(cap, feasible.total / feasible.cost[free])
    out = weights.copy()
    out[free] = np.where((pays > 0) & (cap - inside < near), cap, np.where((pays < 0) & (inside < near), 0.0, inside))
    return out


def _free(objective: Objective, feasible: Feasible, held: Array, profit: Array, width: int) -> Index:
    """The candidates to be free: those between their bounds, and of either bound those that pay most to leave it."""
    low, high = held <= 0, held >= feasible.cap
    free = ~(low | high)
    for side, pays in ((low, profit), (high, -profit)):
        where = np.flatnonzero(side)
        if len(where) > width:
            where = where[np.argpartition(-pays[where], width)[:width]]
        free[where] = True
    free = _seeing(objective, feasible, held, free)
    left = feasible.total - float(feasible.cost @ np.where(free, 0.0, held))
    fits = 0 < left < feasible.cost[free] @ feasible.cap[free]
    return np.flatnonzero(free) if fits else np.arange(len(free))


def _seeing(objective: Objective, feasible: Feasible, held: Array, free: BoolArray) -> BoolArray:
    """Some candidates to be free, and as many more as it takes to see all parameters."""
    info, free = objective.information, free.copy()
    while not free.all():
        roots, seen = inverse_root(info.total(np.where(free, feasible.cap, held)))
        if seen.all():
            break
        scenario = int(np.argmin(seen))
        unseen = roots[scenario, :, 0]
        brings = np.where(free, -1.0, info.blocks[scenario] @ unseen @ unseen)
        free[np.argpartition(-brings, min(FREE, len(free) - 1))[:FREE]] = True
    return free
