"""The pictures of a report on chosen poses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from .. import plots
from ..arrays import Array
from ..geometry import Hexapod
from ..measurements import LegMeasurements, Measurements
from ..observing import Observability
from ..selection.design import Design
from .page import Picture, picture

__all__ = ["counts_picture", "region_pictures", "share_pictures", "space_pictures"]

#: Poses that a gallery shows.
MOST_SHOWN = 24


def space_pictures(
    robot: Hexapod, data: Measurements, candidates: Measurements | LegMeasurements, leg: int | None
) -> list[Picture]:
    """Where the chosen poses are among the candidates, and each of them alone."""
    every = Measurements(
        np.concatenate([data.position, candidates.position]),
        np.concatenate([data.rotation, candidates.rotation]),
        np.zeros((data.n_poses + candidates.n_poses, 6)),
        length_unit=robot.length_unit,
    )
    space = plots.poses(robot, every, chosen=np.arange(data.n_poses), leg=leg)
    space.set_title(f"{robot.name}: {data.n_poses} of {candidates.n_poses} candidates", loc="left")
    shown = min(data.n_poses, MOST_SHOWN)
    gallery = plots.pose_gallery(robot, data.poses(np.arange(shown)), leg=leg)
    first = "" if shown == data.n_poses else f" The first {shown} of {data.n_poses}."
    return [
        picture(
            space,
            "The chosen poses among the candidates: platforms, numbered in their measuring order; grey dots are the "
            "positions of all candidates. Behind them the hexapod at home.",
            "The chosen platforms in space, with the hexapod at home",
        ),
        picture(
            gallery,
            f"Each pose alone, with its position and angles.{first}",
            "A small picture of the hexapod in every chosen pose",
        ),
    ]


def share_pictures(found: Observability) -> list[Picture]:
    """How much each pose counts, numbered as in the table, and the singular values."""
    shares = plots.leverage(found)
    ticks = np.arange(0, len(found.leverage), max(1, len(found.leverage) // 12))
    shares.set_xticks(ticks, [str(tick + 1) for tick in ticks])
    shares.set_xlabel("pose")
    return [
        picture(
            shares,
            "How much each pose counts: its share in what is found out, by its number in the table.",
            "Bars of the leverage of each pose",
        ),
        picture(
            plots.singular_values(found),
            "What the poses see, the best seen combination first: inverse standard errors. The condition number "
            "depends on how parameters are scaled; the standard errors above do not.",
            "The singular values on a logarithmic scale",
        ),
    ]


def region_pictures(design: Design, random: Array) -> list[Picture]:
    """Where the error of a joint lies, beside that of a random set; of several legs the worst."""
    points = [label[: -len(".x")] for label in design.labels if label.endswith("_point.x")]
    kinds: dict[str, list[str]] = {}
    for name in points:
        kinds.setdefault(name.rpartition(".")[2], []).append(name)
    found = []
    for kind, names in kinds.items():
        worst = max(names, key=lambda name: float(np.trace(_part(design, design.covariance, name))))
        unit = design.units[design.labels.index(f"{worst}.x")]
        covariances = [_part(design, matrix, worst) for matrix in (design.covariance, random)]
        labels = ["these poses", f"a random set of {len(design.indices)}"]
        if not np.isfinite(covariances[1]).all():
            covariances, labels = covariances[:1], labels[:1]
        drawn = plots.error_ellipsoids(covariances, labels, which=worst, unit=unit)
        which = f" Of all legs that of leg {worst[3]} is the worst." if len(names) > 1 else ""
        found.append(
            picture(
                drawn,
                f"Where the error of the {kind.replace('_', ' ')} lies, with 95 % probability in each plane.{which}",
                f"Ellipses of the error of the {kind.replace('_', ' ')} in the planes xy, xz and yz",
            )
        )
    return found


def _part(design: Design, covariance: Array, point: str) -> Array:
    place = [design.labels.index(f"{point}.{axis}") for axis in "xyz"]
    return covariance[np.ix_(place, place)]


def counts_picture(designs: Sequence[Design]) -> Picture:
    """How many poses are needed, from designs with different numbers."""
    new = "new poses, beside what was measured before" if any(one.question.measured for one in designs) else "poses"
    return picture(
        _counts(designs),
        f"How many poses are needed: the predicted error (1 σ, of a point its distance) against the number of {new}. "
        "Each number has poses of its own.",
        "Predicted errors against the number of poses",
    )


def _counts(designs: Sequence[Design]) -> Axes:
    """By block; of several legs the root mean square over legs."""
    labels = designs[0].labels
    legs = {label.partition(".")[0] for label in labels if label.startswith("leg")}
    if len(legs) < 2:
        return plots.error_against_poses(designs)
    unit = designs[0].units[0]
    blocks: dict[str, list[int]] = {}
    for place, label in enumerate(labels):
        if designs[0].units[place] == unit:
            blocks.setdefault(label.split(".")[1], []).append(place)
    errors = {
        f"{name}, RMS over legs": [float(np.sqrt(np.diag(one.covariance)[places].sum() / len(legs))) for one in designs]
        for name, places in blocks.items()
    }
    new = any(one.question.measured for one in designs)
    return plots.error_against_poses([len(one.indices) for one in designs], errors, unit=unit, new=new)
