"""hexopt: kinematic calibration of Gough–Stewart platforms by convex optimisation and estimation.

A calibration is *a loop equation* × *an estimator* × *a choice of poses*:

    robot = hexopt.robots.left_hand()
    data = hexopt.simulate_leg(robot, leg=3, lock="direction", n_poses=7, rng=0)
    loop = hexopt.loops.FixedDirection(data)
    found = hexopt.estimate(loop.linear("consecutive"), hexopt.LeastSquares())
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

#: Public names and where they live; each is imported when it is first used.
_HOMES = {
    "errors": (
        "EstimationError FileFormatError HexoptError InputError LockError MeasuringError NumericalWarning "
        "RankDeficientError SamplingError UnitError"
    ),
    "geometry": "Hexapod Leg Limits PoseRanges",
    "noise": "NormalNoise Outliers UniformNoise",
    "measurements": "LegMeasurements Lock Measurements",
    "parameters": "Block Parameters",
    "kinematics": "inverse_kinematics reachable",
    "numerics.burmester": "BurmesterSolutions",
    "problem": "LinearProblem",
    "result": "Certificate Estimate Status estimate",
    "forward": "PoseSolution forward_kinematics",
    "loops.joining": "join",
    "simulation": "simulate simulate_leg",
    "pools": "candidates candidates_at",
    "information": "PoseInformation pose_information",
    "observing": "Observability observability",
    "selection.choosing": "select_poses",
    "selection.design": "Design",
    "selection.criteria": "AOptimal Criterion DOptimal EOptimal",
    "selection.indices": "ConditionNumber ObservabilityIndex",
    "selection.prediction": "GOptimal",
    "selection.lock_choice": "LockChoice",
    "selection.lock_search": "select_lock",
    "selection.refinement": "refine_poses",
    "selection.ordering": "measuring_order",
    "losses": "Chebyshev GroupHuber GroupL1 Huber L1 Quadratic",
    "priors": "GaussianPrior Lasso Ridge",
    "constraints": "Ball Box Linear",
    "estimators.convex": "ConvexEstimator",
    "estimators.geng_haynes": "GengHaynes",
    "estimators.innocenti": "Innocenti",
    "estimators.inverse_kinematics": "InverseKinematics",
    "estimators.least_squares": "LeastSquares",
    "estimators.maximum_likelihood": "MaximumLikelihood",
    "estimators.wampler": "WamplerImplicit",
    "estimators.murareci": "Murareci",
    "estimators.pose_fit": "ForwardKinematics",
    "estimators.reweighted": "Reweighted",
    "estimators.total_least_squares": "TotalLeastSquares",
    "estimators.unit_norm": "UnitNormLeastSquares",
    "estimators.zhuang_roth": "ZhuangRoth",
    "sequential": "Recursive RecursiveState SequentialDesign SequentialState Unscented UnscentedState",
    "calibration": "Calibration FreePoses Joint OneStep ThreeStep calibrate pose_covariance",
    "readers": "read_measurements write_measurements",
    "report": "design_report",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}
_MODULES = ("errors", "loops", "plots", "robots", "rotations", "symbolic", "testing")

__all__ = sorted([*_HOME_OF, *_MODULES, "__version__"])  # built from the table above


def __getattr__(name: str) -> Any:
    if name in _HOME_OF:
        value = getattr(import_module(f".{_HOME_OF[name]}", __name__), name)
    elif name in _MODULES:
        value = import_module(f".{name}", __name__)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
