"""Everything that was measured in one likelihood: all sets, all legs, all readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ..estimators.maximum_likelihood import MaximumLikelihood
from ..geometry import Hexapod
from ..geometry.leg import LEG_BLOCKS
from ..loops import WholeRobot
from ..measurements import LegMeasurements, Measurements
from ..result import Estimator, estimate
from .methods import leg_calibration, leg_views, model_blocks
from .report import Calibration

__all__ = ["Joint"]


@dataclass(frozen=True)
class Joint:
    r"""All sets and all readings in one likelihood: Model 36 (b, a), 42 (and the offset) or 48 (and the gain).

    Sets under any lock, as many as there are; the legs that are seen in one pose share its error. The offset of a leg
    is seen by its own locked sets only where these have several directions, a locked length, or other legs' readings.

    Parameters
    ----------
    model : {36, 42, 48}, default 42

    References
    ----------
    Daney (1998), section 3, treats each leg by itself and leaves the other readings unused; see
    :class:`~hexopt.loops.WholeRobot`.
    """

    model: Literal[36, 42, 48] = 42

    def __post_init__(self) -> None:
        model_blocks(self.model)

    def calibrate_robot(
        self, robot: Hexapod, sets: Sequence[LegMeasurements | Measurements], estimator: Estimator | None = None
    ) -> Calibration:
        """All measured legs at once."""
        loop = WholeRobot(*sets, unknown=model_blocks(self.model), nominal=robot)
        found = estimate(loop, estimator or MaximumLikelihood())
        views = [view for data in sets for view in leg_views(data)]
        legs = {}
        for k in sorted({number for number, _ in views}):
            names = {name: f"leg{k}.{name}" for name in LEG_BLOCKS if f"leg{k}.{name}" in found.parameters}
            legs[k] = leg_calibration(
                {"robot": found},
                {name: found.params[joint] for name, joint in names.items()},
                None if found.covariance is None else found.covariance_of(*names.values()),
                found.covariance_kind,
                [view for number, view in views if number == k],
                robot.leg(k),
            )
        calibrated = robot.with_legs({number: part.leg for number, part in legs.items()})
        return Calibration(calibrated, robot, legs, repr(self), found)
