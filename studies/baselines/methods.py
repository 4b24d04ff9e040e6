"""Every baseline: one entry each, with the settings that it takes part in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import ceil
from typing import Any

import hexopt as hx
from studies.baselines.data import Answer, Case
from studies.baselines.scenarios import SETTINGS, Scenario

__all__ = ["FK", "IK", "INNOCENTI", "METHODS", "ML", "PAPER", "Method", "answer", "methods_for"]

LINEAR = ("I", "II", "III")
PAPER, ML = "consecutive (paper)", "ML"


@dataclass(frozen=True)
class Method:
    """How to solve a case.

    Attributes
    ----------
    settings : tuple of str
        Where it takes part.
    solve : callable
    slow : bool
        Whether it is run on fewer of the sets.
    starts : bool
        Whether it needs an initial guess.
    robot : bool
        Whether it estimates all six legs, and so takes one nominal robot for all sets: that of the first.
    poses : int, optional
        The only number of poses that it takes.
    """

    settings: tuple[str, ...]
    solve: Callable[[Case], Answer]
    slow: bool = False
    starts: bool = False
    robot: bool = False
    poses: int | None = None


def _linear(estimator: Any, form: str = "direct") -> Callable[[Case], Answer]:
    return lambda case: Answer.of(hx.estimate(case.linear(form), estimator, throw=False))


def _model(estimator: Any) -> Callable[[Case], Answer]:
    return lambda case: Answer.of(hx.estimate(case.model, estimator, throw=False))


def _robot(case: Case) -> Answer:
    """All readings in one likelihood."""
    loop = hx.loops.WholeRobot(case.readings, nominal=case.nominal_robot)
    return Answer.of(hx.estimate(loop, hx.MaximumLikelihood(), throw=False))


def _forward(estimator: hx.ForwardKinematics) -> Callable[[Case], Answer]:
    def solve(case: Case) -> Answer:
        data = replace(case.readings, nominal=case.nominal_robot)
        return Answer.of(hx.estimate(hx.loops.PlatformPose(data), estimator, throw=False))

    return solve


PAPER, ML, IK, FK, INNOCENTI = "consecutive (paper)", "ML", "IK", "FK", "Innocenti"
_UNLOCKED, _LINEAR = ("free",), ("I", "II", "III")
_WHOLE = {"slow": True, "robot": True}

#: Every method, in the order of figures and tables. A new one is one entry here.
METHODS: dict[str, Method] = {
    PAPER: Method(_LINEAR, _linear(hx.LeastSquares(), "consecutive")),
    "total least squares": Method(_LINEAR, _linear(hx.TotalLeastSquares())),
    "GLS": Method((*_LINEAR, "2 × I"), _linear(hx.LeastSquares(weights="model"))),
    "GLS, ‖n‖ = 1": Method(("I",), _linear(hx.UnitNormLeastSquares(weights="model"))),
    "Recursive": Method(_LINEAR, _model(hx.Recursive()), slow=True),
    "Zhuang–Roth": Method(("III ab",), _model(hx.ZhuangRoth()), starts=True),
    INNOCENTI: Method(("III ab",), _model(hx.Innocenti()), poses=7),
    "Murareci": Method(("2 × I",), _model(hx.Murareci()), starts=True),
    IK: Method(_UNLOCKED, _model(hx.InverseKinematics()), starts=True),
    "IK, weighted": Method(_UNLOCKED, _model(hx.InverseKinematics(weights="model")), starts=True),
    "Geng–Haynes": Method(_UNLOCKED, _model(hx.GengHaynes()), starts=True),
    FK: Method(_UNLOCKED, _forward(hx.ForwardKinematics(approach=False)), starts=True, **_WHOLE),
    "FK, by IK, weighted": Method(_UNLOCKED, _forward(hx.ForwardKinematics(weights="model")), starts=True, **_WHOLE),
    "Wampler": Method(_UNLOCKED, _model(hx.WamplerImplicit()), starts=True),
    "Unscented": Method(("I", "II", "III ab", "free"), _model(hx.Unscented()), slow=True, starts=True),
    ML: Method(tuple(SETTINGS), _model(hx.MaximumLikelihood()), starts=True),
    "ML, whole robot": Method(_UNLOCKED, _robot, **_WHOLE),
}
#: Experiments that only some methods are in.
_ONLY = {"trials": (PAPER, "GLS, ‖n‖ = 1", "GLS", ML), "bias": (PAPER, ML), "ranges": (INNOCENTI,)}


def methods_for(scenario: Scenario) -> dict[str, Method]:
    """The methods that take part in a scenario of one leg."""
    chosen = {
        name: method
        for name, method in METHODS.items()
        if scenario.setting in method.settings
        and method.poses in (None, scenario.n_poses)
        and name in _ONLY.get(scenario.experiment, METHODS)
    }
    if scenario.experiment == "basin":
        return {name: method for name, method in chosen.items() if method.starts}
    return chosen


def answer(method: Method, case: Case, *, each: bool = False) -> Answer:
    """What a method makes of the sets, or of the first tenth of them if it is slow.

    With `each`, methods of the whole robot start each set from its own nominal: set by set.
    """
    count = ceil(case.n_sets / 10) if method.slow else case.n_sets
    if method.robot and each:
        return Answer.joined([method.solve(case.sets(i, i + 1)) for i in range(count)])
    few = case.sets(0, count)
    try:
        return method.solve(few)
    except hx.RankDeficientError:  # so few poses it refuses altogether
        return Answer.failed(few.n_sets, hx.Status.RANK_DEFICIENT)
