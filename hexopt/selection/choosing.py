"""Which poses to measure: relax, prove, round, exchange."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import BoolArray, as_array, as_count, as_generator, brief
from ..errors import InputError, RankDeficientError
from ..information import PoseInformation
from ..loops.implicit import Implicit
from ..problem import LinearProblem
from ..result import Estimate
from .branching import prove as prove_best
from .condition import relax_condition
from .criteria import AOptimal, Criterion
from .design import Design
from .exchange import Counts, best_of, factors
from .feasible import Feasible
from .indices import RESOLVED, ConditionNumber
from .objective import Objective
from .question import Question, criterion_of
from .relaxation import Relaxation, relax
from .rounding import starts_of

__all__ = ["select_poses"]


def select_poses(
    candidates: Implicit | LinearProblem | PoseInformation,
    n: int | None = None,
    criterion: str | Criterion = "A",
    *,
    measured: Implicit | Estimate | Sequence[Implicit | Estimate] | None = None,
    at: Any = None,
    worst: bool = False,
    of: Sequence[str] | None = None,
    spread: Mapping[str, float] | None = None,
    repeat: bool | int = False,
    cost: npt.ArrayLike | None = None,
    budget: float | None = None,
    starts: int = 8,
    rng: int | np.random.Generator | None = None,
    prove: float | None = None,
) -> Design:
    r"""The n poses that make a criterion of the predicted covariance small: :math:`\min_w \varphi(K^T M(w)^{-1} K)`.

    :math:`M(w) = M_0 + \sum_i w_i M_i` is the information of the candidates, with what was measured before in
    :math:`M_0`, and K picks the parameters of interest: nuisances are eliminated. Weights in [0, 1] give a convex
    programme, whose certificate bounds every design from below. From its weights, designs of whole poses are rounded,
    and improved by exchanging pose for pose until no exchange helps.

    Parameters
    ----------
    candidates : loop, or LinearProblem
        Over the candidates, with a noise model; readings are used only where `at` needs them.
    n : int
        How many poses to choose, without those measured before.
    criterion : {"A", "D", "E", "kappa", "O1", …, "O5"} or Criterion, default "A"
        "A", the sum of variances (in units of `spread`); "D", the volume of the confidence ellipsoid; "E", its longest
        axis; :class:`GOptimal` the worst predicted leg length. "kappa" and the observability indices are for
        comparison: they say nothing of the size of errors, or depend on scaling.
    measured : loop or Estimate, or a list of them, optional
        What is known before. A loop like that over the candidates: poses on the same clamp. An estimate: from
        anywhere, its parameters that are no nuisance; its error must have nothing in common with the candidates', such
        as a known b (give the loop then).
    at : values, geometry or Estimate, or a list of them, optional
        Where the information is evaluated, by default at the nominal. Several are scenarios of a nominal that is wrong.
    worst : bool, default False
        Make the worst scenario good; by default their average.
    of : sequence of str, optional
        The blocks of interest, by default all that are no nuisance.
    spread : dict of str to float, optional
        Expected spread of blocks, by which the criteria A and E compare parameters; by default 1 in their own units.
    repeat : bool or int, default False
        Whether a pose may be measured again; or how often at most. By default every candidate is chosen once at most,
        and none that is a pose of `measured`, within five standard errors of the instruments.
    cost, budget : array_like (candidates,) and float, optional
        The cost of each pose and what may be spent, instead of n.
    starts : int, default 8
        How many roundings are exchanged.
    rng : int or numpy.random.Generator, optional
        Adds as many random starts; without it nothing is random.
    prove : float, optional
        Seconds for branch and bound, to find the best design of all and prove it.

    Returns
    -------
    Design

    Raises
    ------
    InputError
        For more poses than candidates, two candidates that are one pose, wrong names or values.
    RankDeficientError
        If no such design determines all unknowns, those that are not of interest included; the message says how many
        poses it takes at least, or names what no candidate sees.

    References
    ----------
    Pukelsheim (1993) on the criteria; Fedorov (1972) on the exchange; Boyd and Vandenberghe (2004), section 7.5, on
    the relaxation. Daney (1998), section 5, asks for this study.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> pool = hx.candidates(hx.robots.left_hand(), 3, "direction", 500, noise, rng=0)
    >>> design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 7)
    >>> design.poses.n_poses, bool(design.efficiency > 0.9)
    (7, True)
    """
    question = Question(candidates, criterion_of(criterion), worst, at, of, spread, measured)
    _check(worst, starts, prove)
    again = question.same_pose()
    if again is not None and repeat is False:
        raise InputError(f"candidates: {again[0]} and {again[1]} are the same pose; remove one, or say repeat=True")
    objective = question.objective()
    feasible = _feasible(objective.information.n_poses, n, repeat, cost, budget)
    if repeat is False:
        feasible = _fresh(feasible, question.measured_before())
    _check_enough(objective.information, feasible)
    return answer(question, objective, feasible, starts, rng, prove)


def answer(
    question: Question,
    objective: Objective,
    feasible: Feasible,
    starts: int,
    rng: int | np.random.Generator | None = None,
    prove: float | None = None,
) -> Design:
    """The design for an objective and a budget; that of the criterion's twin, if it has one.

    Poses with a cap of zero are left out.
    """
    allowed = np.flatnonzero(feasible.cap)
    if len(allowed) < len(feasible.cap):
        found = answer(question, objective.take(allowed), feasible.take(allowed), starts, rng, prove)
        indices, weights = allowed[found.indices], np.zeros(len(feasible.cap))
        weights[allowed] = found.weights
        return replace(found, indices=indices, weights=weights, poses=_chosen(question, indices))
    twin = objective.criterion.twin
    if twin is not None and (objective.worst or len(objective.information.blocks) == 1):
        found = answer(question, replace(objective, criterion=twin), feasible, starts, rng, prove)
        value, bound, relaxed = (
            objective.criterion.of_twin(part, objective.main) for part in (found.value, found.bound, found.relaxed)
        )
        return replace(found, criterion=objective.criterion.name, value=value, bound=bound, relaxed=relaxed)
    if prove is not None and not objective.criterion.convex:
        raise InputError(
            f"prove: {objective.criterion.name} is not convex: nothing bounds designs of which some poses are set"
        )
    generator = None if rng is None else as_generator(rng)
    relaxation = relaxation_of(objective, feasible)
    guide = relaxation or relax(replace(objective, criterion=AOptimal()), feasible)
    rows = factors(objective.information.blocks)
    begun = starts_of(objective, feasible, guide.weights, starts, generator, rows)
    counts, _ = best_of(objective, feasible, begun, rows)
    stopped = f"no exchange of a pose helps, from {len(begun)} starts"
    bound, proven = relaxation.bound if relaxation else np.nan, False
    if prove is not None and relaxation is not None:
        proof = prove_best(objective, feasible, counts, relaxation, seconds=prove)
        counts, bound, proven, stopped = proof.counts, max(bound, proof.bound), proof.proven, proof.stopped
    return design_of(question, objective, counts, relaxation, bound, proven, stopped)


def relaxation_of(objective: Objective, feasible: Feasible) -> Relaxation | None:
    """The relaxation of a criterion that has one."""
    if objective.criterion.convex:
        return relax(objective, feasible)
    if isinstance(objective.criterion, ConditionNumber) and len(objective.information.blocks) == 1:
        relaxation = relax_condition(objective.information, feasible)
        return relaxation if relaxation.value < RESOLVED else None
    return None


def design_of(
    question: Question,
    objective: Objective,
    counts: Counts,
    relaxed: Relaxation | None,
    bound: float,
    proven: bool,
    stopped: str,
) -> Design:
    """The answer in the user's units."""
    information = objective.information
    indices = np.repeat(np.arange(len(counts)), counts)
    value = objective.value(counts)
    each = information.covariance(counts.astype(float))
    worst = int(objective.criterion.value(each).argmax()) if objective.worst and not objective.criterion.full else None
    scaled = each.mean(axis=0) if worst is None else each[worst]
    return Design(
        indices=indices,
        poses=_chosen(question, indices),
        criterion=objective.criterion.name,
        value=value,
        bound=bound,
        weights=np.full(len(counts), np.nan) if relaxed is None else relaxed.weights,
        relaxed=np.nan if relaxed is None else relaxed.value,
        covariance=scaled * np.outer(information.spread, information.spread),
        labels=information.labels,
        units=information.units,
        efficiency=float(objective.criterion.efficiency(bound, value, information.main)),
        proven=proven,
        stopped=stopped,
        question=question,
    )


def _chosen(question: Question, indices: npt.NDArray[np.intp]) -> Any:
    """The chosen poses of every set of candidates."""
    chosen, before = [], 0
    for data in question.sets():
        inside = (indices >= before) & (indices < before + data.n_poses)
        chosen.append(data.poses(indices[inside] - before))
        before += data.n_poses
    return chosen[0] if len(chosen) == 1 else tuple(chosen) or None


def _check(worst: object, starts: object, prove: object) -> None:
    """Settings of the wrong kind."""
    if not isinstance(worst, bool):
        raise InputError(f"worst: expected True or False, got {brief(worst)}")
    as_count("starts", starts)
    if prove is not None and not (isinstance(prove, Real) and not isinstance(prove, bool) and float(prove) > 0):
        raise InputError(f"prove: expected seconds > 0 for branch and bound, got {brief(prove)}")


def _feasible(
    count: int, n: int | None, repeat: bool | int, cost: npt.ArrayLike | None, budget: float | None
) -> Feasible:
    """What a design may have."""
    if (cost is None) != (budget is None) or (n is None) != (cost is not None):
        raise InputError("n: say how many poses, or give cost= and budget= instead")
    often = None if repeat is True else 1 if repeat is False else as_count("repeat", repeat)
    if cost is None:
        number = as_count("n", n)
        most = count * (often or number)
        if number > most:
            raise InputError(
                f"n: {number} poses asked for, and there are {most} candidates; give more candidates, or repeat=True"
            )
        return Feasible(np.full(count, float(min(often or number, number))), np.ones(count), float(number))
    costs = as_array("cost", cost, (count,), batch=False)
    total = float(as_array("budget", budget, (), batch=False))  # type: ignore[arg-type]  # it is there, see above
    if not (costs > 0).all():
        raise InputError(f"cost: expected costs > 0, got {costs.min():g}")
    if total < costs.min():
        raise InputError(f"budget: {total:g} buys no pose, the cheapest costs {costs.min():g}")
    cap = np.minimum(np.floor(total / costs * (1 + 1e-12)), often or np.inf)
    return Feasible(cap, costs, min(total, float(costs @ cap)))  # it may buy them all


def _fresh(feasible: Feasible, measured: BoolArray) -> Feasible:
    """Without the poses that were measured before."""
    cap = np.where(measured, 0.0, feasible.cap)
    most = float(feasible.cost @ cap)
    if not feasible.counts_poses:
        return replace(feasible, cap=cap, total=min(feasible.total, most))
    if feasible.total > most:
        raise InputError(
            f"n: {feasible.total:g} poses asked for, and {measured.sum()} of the {len(cap)} candidates are measured "
            "already; give more candidates, or repeat=True"
        )
    return replace(feasible, cap=cap)


def _check_enough(information: PoseInformation, feasible: Feasible) -> None:
    """Whether so many poses can see all parameters, by counting equations."""
    rank = np.linalg.matrix_rank
    missing = information.size - int(rank(information.fixed[0], hermitian=True))
    sample = information.blocks[0][:: max(1, information.n_poses // 50)]
    rows = max(1, int(rank(sample, hermitian=True, tol=1e-9 * np.abs(sample).max()).max()))
    most = int(np.minimum(feasible.cap, np.floor(feasible.total / feasible.cost)).sum())
    most = min(most, int(feasible.total / feasible.cost.min()))
    if most * rows < missing:
        raise RankDeficientError(
            f"fewer poses than parameters need: {most} bring at most {most * rows} equations for {missing} unknowns "
            f"that are not yet seen (nuisances included); it takes {-(-missing // rows)} at least",
            information.labels,
        )
