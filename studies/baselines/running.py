"""Estimates that run: after every pose, with what they say of their own error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

import hexopt as hx
from studies.baselines.data import Answer, Case, draw, frame, judged
from studies.baselines.methods import ML
from studies.baselines.scenarios import LEG, OFF, Scenario

__all__ = ["FIRST_FIT", "PRIOR", "RECURSIVE", "running"]

RECURSIVE, FIRST_FIT, PRIOR = "Recursive", "Unscented, first poses fitted", "Unscented, from the prior"


def running(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Maximum likelihood of all poses, and of a tenth of the sets estimates after every pose, a row each.

    Priors and starts are normal about the truth, `off` a coordinate.
    """
    case, exact = draw(scenario, n_sets, rng)
    truth, leg = case.truth, case.truth.leg(LEG)
    away = {name: scenario.off * rng.standard_normal(value.shape) for name, value in case.nominals.items()}
    case = replace(case, nominals={name: getattr(truth, name) + off for name, off in away.items()})
    bound = exact.bound()
    batch = Answer.of(hx.estimate(case.model, hx.MaximumLikelihood(), throw=False))
    seen = {"poses_seen": np.full(n_sets, float(scenario.n_poses))}
    frames = [frame(ML, batch.codes, judged(batch, leg, bound) | seen)]
    few = case.sets(0, max(1, n_sets // 10))
    for method, state in _states(few, scenario):
        history, nees = state.history, state.nees(leg)
        sure = {short: state.predicted_error[name] for short, name in Answer.names(history).items()}
        for i in range(state.n_poses):
            now = Answer.of(history[:, i])
            said = {f"{short}_predicted": error[:, i] for short, error in sure.items()}
            said |= {"poses_seen": np.full(few.n_sets, i + 1.0), "nees": nees[:, i]}
            frames.append(frame(method, now.codes, judged(now, leg, bound[: few.n_sets]) | said))
    return pd.concat(frames, ignore_index=True)


def _states(case: Case, scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """The filters after all poses."""
    if scenario.off == OFF:
        if scenario.setting == "I":
            yield RECURSIVE, hx.Recursive().scan(case.model)
        yield FIRST_FIT, hx.Unscented().scan(case.model)
    # of the nuisance a prior says nothing: one pose has to
    alone = 1 if scenario.setting == "I" else 0
    yield PRIOR, hx.Unscented(_prior(case, scenario.off), first=alone).scan(case.model)


def _prior(case: Case, size: float) -> hx.GaussianPrior:
    nominal = case.nominal
    mean = {"platform_point": nominal.platform_point, "base_point": nominal.base_point}
    if case.setting == "free":
        mean["offset"] = nominal.block("offset")
    return hx.GaussianPrior(mean, dict.fromkeys(mean, size**2), unit=nominal.length_unit)
