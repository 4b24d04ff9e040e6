"""A calibrated robot beside its nominal: what a person looks at first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..arrays import Array, norm
from ..calibration import Calibration
from ..calibration.methods import leg_views, length_residual
from ..geometry import Hexapod
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements, Measurements

__all__ = ["comparison"]


def comparison(found: Calibration, sets: Sequence[Measurements | LegMeasurements]) -> str:
    """How far the joints moved, what the nominal made of the data, and where to look for a bad pose."""
    unit = found.robot.length_unit
    moves = [
        (float(norm(part.leg.block(name) - found.nominal.leg(number).block(name))), f"{name} of leg {number}")
        for number, part in found.legs.items()
        for name in ("base_point", "platform_point")
    ]
    move, joint = max(moves)
    lines = [f"  largest move of a joint: {move:.4g} {unit}, {joint}"]
    views = list(_views(sets, locked=found.estimate is None))
    if views:
        before = np.concatenate([_residual(found.nominal, view) for _, view in views])
        after = [np.abs(_residual(found.robot, view)) for _, view in views]
        place, view = views[worst := int(np.argmax([part.max() for part in after]))]
        where = f"leg {view.leg}, pose {after[worst].argmax() + 1}" + (f" of set {place}" if len(sets) > 1 else "")
        lines.append(f"  largest residual: {after[worst].max():.4g} {unit}, {where}")
        rms = float(np.sqrt(np.mean(before**2)))
        doubt = "; that is much for its size: is the length unit right?" if rms > found.nominal.size / 4 else ""
        lines.append(f"  residual of the nominal, RMS: {rms:.4g} {unit}{doubt}")
    return "\n".join(lines)


def _views(sets: Sequence[Measurements | LegMeasurements], *, locked: bool) -> Iterator[tuple[int, LegMeasurements]]:
    """Every leg whose readings were used, with the number of its set; under `locked` only those of locked legs."""
    for place, data in enumerate(sets, start=1):
        yield from ((place, view) for _, view in leg_views(data, locked=locked) if view.length is not None)


def _residual(robot: Hexapod, view: LegMeasurements) -> Array:
    """Length by geometry minus length by the sensor, of one leg over the poses of a set."""
    leg = robot.leg(view.leg)
    return length_residual({name: leg.block(name) for name in LEG_BLOCKS}, view)
