"""What a design is compared with: random sets of as many poses, and designs of fewer and of more."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import RankDeficientError
from ..information import inverse_root
from ..loops.implicit import Implicit
from ..observing import Observability, observability
from ..selection.choosing import select_poses
from ..selection.design import Design
from ..selection.objective import Objective

__all__ = ["RandomSets", "designs_by_count", "observed", "random_sets"]

#: From a fraction of the chosen number of poses, or from so few, to a multiple of it.
FEWER, FEW, MORE, STEPS = 0.4, 4, 2.5, 9
#: Roundings that are exchanged for each number: less than for the chosen one.
STARTS = 1


@dataclass(frozen=True, eq=False)
class RandomSets:
    """Random sets of as many poses as a design has.

    Attributes
    ----------
    standard_errors : ndarray, shape (k,)
        Of every parameter the median of its predicted standard errors; infinite where most sets do not see it.
    covariance : ndarray, shape (k, k)
        Of the set with the median criterion.
    """

    standard_errors: Array
    covariance: Array


def random_sets(design: Design, objective: Objective, number: int, rng: np.random.Generator) -> RandomSets:
    """So many random sets of the candidates, each without repetition."""
    information = objective.information
    size = min(len(design.indices), information.n_poses)
    chosen = np.stack([rng.choice(information.n_poses, size, replace=False) for _ in range(number)])
    totals = information.fixed + np.moveaxis(information.blocks[:, chosen].sum(axis=2), 0, 1)
    root, seen = inverse_root(totals)
    root = root[..., : information.main, :]
    variances = np.where(seen[..., None], np.square(root).sum(axis=-1), np.inf).mean(axis=1)
    middle = int(np.argsort(objective.of_totals(totals), kind="stable")[number // 2])
    weights = np.zeros(information.n_poses)
    weights[chosen[middle]] = 1.0
    both = np.outer(information.spread, information.spread)
    return RandomSets(
        np.sqrt(np.median(variances, axis=0)) * information.spread, information.covariance(weights).mean(axis=0) * both
    )


def observed(design: Design, order: npt.NDArray[np.intp]) -> Observability | None:
    """What the chosen poses see, in that order, at the nominal; None where others were measured before."""
    question = design.question
    if question.measured:
        return None
    poses = question.over(design.poses.poses(order))
    assert isinstance(poses.target, Implicit)
    at = poses.at[0] if isinstance(poses.at, (list, tuple)) else poses.at
    return observability(poses.target, at, question.of, question.spread)


def _as_candidates(design: Design) -> bool:
    """Whether the poses are still those of the candidates."""
    data = design.question.sets()[0]
    return np.array_equal(data.position[design.indices], design.poses.position) and np.array_equal(
        data.rotation[design.indices], design.poses.rotation
    )


def designs_by_count(design: Design, repeat: bool) -> list[Design]:
    """Designs by the same criterion with fewer and with more poses; numbers that see too little are left out.

    Of several scenarios they are for the first.
    """
    question, chosen = design.question, len(design.indices)
    spaced = np.geomspace(max(1.0, min(FEWER * chosen, FEW)), MORE * chosen, STEPS)
    numbers = np.union1d(np.round(spaced).astype(int), [chosen])
    settings = {name: getattr(question, name) for name in ("measured", "of", "spread")}
    one_nominal = not isinstance(question.at, (list, tuple))
    at = question.at if one_nominal else question.at[0]
    found = []
    for n in numbers if repeat else numbers[numbers <= len(design.weights)]:
        if n == chosen and one_nominal and _as_candidates(design):
            found.append(design)
            continue
        try:
            one = select_poses(
                question.target, int(n), question.criterion, at=at, repeat=repeat, starts=STARTS, **settings
            )
        except RankDeficientError:
            continue
        found.append(one)
    return found
