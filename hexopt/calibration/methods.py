"""How the sets of one leg become its parameters: the paper's one-step and three-step methods, free poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from ..arrays import Array, norm
from ..errors import InputError
from ..estimators.inverse_kinematics import InverseKinematics
from ..estimators.least_squares import LeastSquares
from ..geometry import Leg
from ..geometry.leg import LEG_BLOCKS
from ..kinematics import leg_vector
from ..loops import FixedDirection, FixedLeg, FixedLength, LegLength
from ..measurements import LegMeasurements, Lock, Measurements
from ..propagation import Gain, joint_covariance, pose_gain
from ..result import Estimate, Estimator, estimate
from .report import LegCalibration

__all__ = ["FreePoses", "Method", "OneStep", "ThreeStep", "leg_calibration", "leg_views", "model_blocks"]


class Method(Protocol):
    """How the sets of one leg become its parameters; write a class with these two members to add one."""

    @property
    def locks(self) -> tuple[Lock, ...]:
        """The sets that the method needs, one of each."""
        ...

    def calibrate_leg(self, sets: Mapping[Lock, LegMeasurements], estimator: Estimator | None) -> LegCalibration:
        """Calibrate a leg from one set for each lock."""
        ...


@dataclass(frozen=True)
class OneStep:
    r"""Model 36 in one step: a and b from a DIRECTION set (Type I); the offset is taken as known.

    Parameters
    ----------
    form : {"consecutive", "direct"}, default "consecutive"
        The paper's differences, or one block row a pose.

    References
    ----------
    Daney (1998), section 3.2.
    """

    form: Literal["consecutive", "direct"] = "consecutive"
    locks = (Lock.DIRECTION,)

    def calibrate_leg(self, sets: Mapping[Lock, LegMeasurements], estimator: Estimator | None = None) -> LegCalibration:
        """b and a from the DIRECTION set."""
        data = sets[Lock.DIRECTION]
        found = estimate(FixedDirection(data).linear(self.form), estimator or LeastSquares())
        names = ("platform_point", "base_point")
        covariance = None if found.covariance is None else found.covariance_of(*names)
        return leg_calibration(
            {"direction": found},
            {name: found.params[name] for name in names},
            covariance,
            found.covariance_kind,
            [data],
        )


@dataclass(frozen=True)
class ThreeStep:
    r"""Model 42 in three steps: b from a LEG set (II), a from a LENGTH set (III) with that b, then the offset.

    Parameters
    ----------
    form : {"consecutive", "direct", "centred"}, default "consecutive"

    Notes
    -----
    The offset is the mean of equation (19) over the poses of the LENGTH set. The errors of the poses are
    carried through all three steps to first order, so the covariance of (b, a, δ) holds b's part in a
    and in δ, and the share of the LENGTH poses in both a and δ.

    References
    ----------
    Daney (1998), section 3.3.
    """

    form: Literal["consecutive", "direct", "centred"] = "consecutive"
    locks = (Lock.LEG, Lock.LENGTH)

    def calibrate_leg(self, sets: Mapping[Lock, LegMeasurements], estimator: Estimator | None = None) -> LegCalibration:
        """b, then a, then the offset."""
        leg_set, length_set = sets[Lock.LEG], sets[Lock.LENGTH]
        linear = estimator or LeastSquares()
        first = FixedLeg(leg_set)
        b = estimate(first.linear(self.form), linear)
        second = FixedLength(length_set, platform_point=b)
        a = estimate(second.linear(self.form), linear)
        third = LegLength(length_set, unknown=("offset",), platform_point=b, base_point=a)
        offset = estimate(third.linear(), LeastSquares())

        steps = {"platform_point": b, "base_point": a, "offset": offset}
        kind, covariance = "carried through the three steps", None
        without = [found.covariance_kind for found in (b, a) if found.influence is None]
        if leg_set.noise is None or length_set.noise is None or without:
            kind = without[0] if without else "no noise model: errors cannot be carried through the steps"
        else:
            gains: dict[str, Gain] = {}
            for (name, found), loop in zip(steps.items(), (first, second, third), strict=True):
                gains[name] = pose_gain(loop, found, name, gains)
            covariance = joint_covariance(gains)
        values = {name: found.params[name] for name, found in steps.items()}
        return leg_calibration(steps, values, covariance, kind, [leg_set, length_set])


@dataclass(frozen=True)
class FreePoses:
    r"""Unlocked poses by inverse kinematics: Model 36 (b, a), 42 (and the offset) or 48 (and the gain).

    Parameters
    ----------
    model : {36, 42, 48}, default 42

    References
    ----------
    Masory, Wang and Zhuang (1993); Model 48 is ours: real encoders need the gain.
    """

    model: Literal[36, 42, 48] = 42
    locks = (Lock.NONE,)

    def __post_init__(self) -> None:
        model_blocks(self.model)

    def calibrate_leg(self, sets: Mapping[Lock, LegMeasurements], estimator: Estimator | None = None) -> LegCalibration:
        """All blocks of the model at once."""
        data = sets[Lock.NONE]
        found = estimate(LegLength(data, unknown=model_blocks(self.model)), estimator or InverseKinematics())
        return leg_calibration({"leg": found}, found.params, found.covariance, found.covariance_kind, [data])


def model_blocks(model: int) -> tuple[str, ...]:
    """The blocks of a leg that Model 36, 42 or 48 estimates."""
    counts = {36: 2, 42: 3, 48: 4}
    if model not in counts:
        raise InputError(f"model: expected 36, 42 or 48 parameters, got {model!r}")
    return tuple(LEG_BLOCKS)[: counts[model]]


def leg_views(data: LegMeasurements | Measurements, *, locked: bool = False) -> list[tuple[int, LegMeasurements]]:
    """The legs that were measured in a set, by number; under `locked` the locked one alone, or all where none is."""
    if isinstance(data, LegMeasurements):
        return [(data.leg, data)]
    numbers = data.legs if data.locked_leg is None or not locked else (data.locked_leg,)
    return [(number, data.leg(number)) for number in numbers]


def leg_calibration(
    steps: Mapping[str, Estimate],
    values: Mapping[str, Array],
    covariance: Array | None,
    kind: str,
    data: Sequence[LegMeasurements],
    nominal: Leg | None = None,
) -> LegCalibration:
    """A leg from its estimated blocks; `nominal`, by default that of the data, lends the others."""
    nominal = nominal or data[0].nominal
    if nominal is None:
        raise InputError("which leg was measured? give the measurements nominal=robot.leg(k)")
    ok = np.all([found.ok for found in steps.values()], axis=0)
    blocks = {name: np.where(ok[..., None], value, np.nan) for name, value in values.items()}
    full = {name: blocks.get(name, nominal.block(name)) for name in LEG_BLOCKS}
    squares = [length_residual(full, part) ** 2 for part in data if part.length is not None]
    rms = np.sqrt(np.concatenate(squares, axis=-1).mean(axis=-1)) if squares else None
    n_poses = sum(part.n_poses for part in data)
    return LegCalibration(nominal, blocks, ok, covariance, kind, dict(steps), rms, n_poses)


def length_residual(blocks: Mapping[str, Array], data: LegMeasurements) -> Array:
    """Length by geometry minus length by reading, over poses, (..., n)."""
    vectors = leg_vector(blocks["platform_point"], blocks["base_point"], data.position, data.rotation)
    residual: Array = norm(vectors) - blocks["gain"] * data.readings() - blocks["offset"]
    return residual
