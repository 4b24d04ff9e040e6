"""Sets and legs that are used together: all readings at once, the pose that a robot then takes, II and III."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd

import hexopt as hx
from studies.baselines.data import BLOCKS, Answer, frame, judged, noisy
from studies.baselines.scenarios import LEG, OFF, Array, Scenario

__all__ = [
    "ALONE",
    "CARRIED",
    "IGNORED",
    "JOINTLY",
    "PAPER_STEPS",
    "SEPARATE",
    "TOGETHER",
    "chain",
    "home",
    "joint",
    "one_set",
]

TOGETHER, ALONE, SEPARATE = "ML, whole robot", "ML, leg by leg", "ML, coupling dropped"
JOINTLY, CARRIED, IGNORED = "joint ML", "three steps, weighted", "three steps, weighted, b taken as exact"
PAPER_STEPS = "three steps (paper)"
_LEGS = range(1, 7)
_Z95 = 1.959963984540054


def _nominal(robot: hx.Hexapod, rng: np.random.Generator) -> hx.Hexapod:
    return robot.perturbed(OFF, offsets=OFF, rng=rng)


def joint(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Six DIRECTION sets, one a leg: every leg by its own, with its offset known, and all readings in one likelihood.

    Errors are root mean squares over the six legs.
    """
    robot = scenario.robot
    ranges = None if scenario.cone is None else robot.ranges
    sets = []
    for k in _LEGS:
        exact = hx.simulate(robot, "direction", scenario.n_poses, n_sets, ranges=ranges, leg=k, rng=rng)
        sets.append(noisy(exact, scenario, rng))
    whole = hx.estimate(hx.loops.WholeRobot(*sets, nominal=_nominal(robot, rng)), hx.MaximumLikelihood(), throw=False)
    alone, bounds = [], []
    for k, data in zip(_LEGS, sets, strict=True):
        loop = hx.loops.FixedDirection(data.leg(k))
        alone.append(hx.estimate(loop, hx.MaximumLikelihood(), throw=False))
        bounds.append(loop.crlb(robot.leg(k)))
    legs = [judged(Answer.of(one), robot.leg(k), bound) for k, one, bound in zip(_LEGS, alone, bounds, strict=True)]
    all_legs = [judged(Answer.of(whole, k), robot.leg(k), None) for k in _LEGS]
    bound = _robot_bound(hx.loops.WholeRobot(*sets, nominal=robot), robot)
    frames = [
        frame(TOGETHER, whole.codes, _rms(all_legs) | bound),
        frame(ALONE, np.max([one.codes for one in alone], axis=0), _rms(legs)),
    ]
    return pd.concat(frames, ignore_index=True)


def _rms(parts: list[dict[str, Array]]) -> dict[str, Array]:
    names = [name for name in parts[0] if name.endswith(("_error", "_bound"))]
    return {name: np.sqrt(np.mean([np.square(part[name]) for part in parts], axis=0)) for name in names}


def _robot_bound(loop: Any, robot: hx.Hexapod) -> dict[str, Array]:
    """The bound on the root mean square over the legs, of every kind of parameter."""
    variance = np.einsum("...ii->...i", loop.crlb(robot))
    main, columns = loop.parameters.main, {}
    for short, block in BLOCKS.items():
        places = np.concatenate([np.r_[main[f"leg{k}.{block}"]] for k in _LEGS])
        columns[f"{short}_bound"] = np.sqrt(variance[..., places].sum(axis=-1) / len(_LEGS))
    return columns


def one_set(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """One DIRECTION set of a leg: the bound on its two points by its own reading, and by those of all legs.

    The leg's offset is known, as one direction does not see it; what else is unknown of the other five legs (their
    points and offsets) counts as such.
    """
    robot = scenario.robot
    data = replace(hx.simulate(robot, "direction", scenario.n_poses, n_sets, leg=LEG, rng=rng), noise=scenario.noise)
    alone = hx.loops.FixedDirection(data.leg(LEG)).crlb(robot.leg(LEG))
    loop = hx.loops.WholeRobot(data, nominal=robot)
    information = loop.information(robot).sum(axis=-3)
    names = loop.parameters
    mine = np.concatenate([np.r_[names[f"leg{LEG}.{block}"]] for block in ("platform_point", "base_point")])
    known = np.r_[names[f"leg{LEG}.offset"]]
    rest = np.setdiff1d(np.arange(information.shape[-1]), np.concatenate([mine, known]))
    nuisance = information[..., rest[:, None], mine]
    seen = np.linalg.pinv(information[..., rest[:, None], rest], rcond=1e-12, hermitian=True)
    left = information[..., mine[:, None], mine] - np.swapaxes(nuisance, -1, -2) @ seen @ nuisance
    frames = []
    for method, bound in ((ALONE, alone), (TOGETHER, np.linalg.inv(left))):
        variance = np.einsum("...ii->...i", bound)
        columns = {
            "platform_bound": np.sqrt(variance[:, :3].sum(axis=-1)),
            "base_bound": np.sqrt(variance[:, 3:].sum(axis=-1)),
        }
        frames.append(frame(method, np.zeros(n_sets, dtype=np.int8), columns))
    return pd.concat(frames, ignore_index=True)


def home(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """Where the robot stands when its calibrated geometry says that it is at home, and the stated 95 % intervals."""
    robot = scenario.robot
    data = noisy(hx.simulate(robot, "none", scenario.n_poses, n_sets, rng=rng), scenario, rng)
    nominal = _nominal(robot, rng)
    whole = hx.estimate(hx.loops.WholeRobot(data, nominal=nominal), hx.MaximumLikelihood(), throw=False)
    legs = {
        k: hx.estimate(
            hx.loops.LegLength(replace(data.leg(k), nominal=nominal.leg(k))), hx.MaximumLikelihood(), throw=False
        )
        for k in _LEGS
    }
    main = whole.parameters.main
    apart = np.concatenate([found.values for found in legs.values()], axis=-1)
    blocks = np.zeros((n_sets, main.size, main.size))
    for row, found in enumerate(legs.values()):
        own = slice(row * found.parameters.size, (row + 1) * found.parameters.size)
        blocks[:, own, own] = found.covariance
    codes = np.max([found.codes for found in legs.values()], axis=0)
    answers = {
        TOGETHER: (whole.values[:, : main.size], whole.covariance_of(*main.names), whole.codes),
        SEPARATE: (apart, blocks, codes),
    }
    return pd.concat(
        [
            frame(method, status, _at_home(robot, main, values, covariance, status))
            for method, (values, covariance, status) in answers.items()
        ],
        ignore_index=True,
    )


def _at_home(robot: hx.Hexapod, main: Any, values: Array, covariance: Array, codes: Array) -> dict[str, Array]:
    """The error of the platform's position at home, and the share of its coordinates that are covered."""
    error, covered = np.full((2, len(values)), np.nan)
    for i in np.flatnonzero(codes == hx.Status.OPTIMAL):
        parts = main.split(values[i])
        calibrated = replace(
            robot,
            base_points=[parts[f"leg{k}.base_point"] for k in _LEGS],
            platform_points=[parts[f"leg{k}.platform_point"] for k in _LEGS],
            offsets=[parts[f"leg{k}.offset"][0] for k in _LEGS],
        )
        reading = hx.inverse_kinematics(calibrated, robot.home_position, robot.home_rotation)
        off = hx.forward_kinematics(robot, reading).position - robot.home_position
        spread = np.sqrt(np.diag(hx.pose_covariance(calibrated, main, covariance[i]))[:3])
        error[i], covered[i] = np.linalg.norm(off), (np.abs(off) <= _Z95 * spread).mean()
    return {"home_error": error, "home_covered": covered}


def chain(scenario: Scenario, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    """A LEG set and a LENGTH set of one leg: three steps, and one likelihood of all poses and readings."""
    robot = scenario.robot
    leg = robot.leg(LEG)
    first, second = (
        noisy(hx.simulate_leg(robot, LEG, lock, count, n_sets, rng=rng), scenario, rng)
        for lock, count in (("leg", scenario.n_poses), ("length", scenario.second))
    )
    sets = {hx.Lock.LEG: first, hx.Lock.LENGTH: second}
    weighted = hx.LeastSquares(weights="model")
    found = hx.ThreeStep("direct").calibrate_leg(sets, weighted)
    step = hx.loops.FixedLength(second, platform_point=found.values["platform_point"])
    exact = hx.estimate(step.linear("direct"), weighted, throw=False)
    loop = hx.loops.WholeRobot(first, second, nominal=_nominal(robot, rng))
    answers = {
        PAPER_STEPS: _of_steps(hx.ThreeStep("consecutive").calibrate_leg(sets, hx.LeastSquares())),
        CARRIED: _of_steps(found),
        IGNORED: Answer.of(exact),
        JOINTLY: Answer.of(hx.estimate(loop, hx.MaximumLikelihood(), throw=False)),
    }
    rows = [frame(method, answer.codes, judged(answer, leg, None)) for method, answer in answers.items()]
    return pd.concat(rows, ignore_index=True)


def _of_steps(found: Any) -> Answer:
    values = {short: found.values[block] for short, block in BLOCKS.items()}
    codes = np.max([step.codes for step in found.steps.values()], axis=0)
    return Answer(values, codes, found.covariance)
