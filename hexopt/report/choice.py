"""The report on chosen poses: what they promise, how good they are, and how to set them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from .. import __version__
from ..arrays import Array, as_generator, brief
from ..errors import InputError
from ..geometry import Hexapod
from ..measurements import Lock
from ..rotations import matrix_to_euler
from ..selection.design import Design
from ..simulation import check_robot
from .chosen import Choice, check_alike, noise_words, rounded_down, unit_shown
from .comparing import RandomSets, designs_by_count, observed, random_sets
from .page import Page, Section
from .pictures import counts_picture, region_pictures, share_pictures, space_pictures

__all__ = ["design_report"]

RANDOM_SETS = 200
CRITERIA = {
    "A": "the sum of the variances of all parameters",
    "D": "the volume of the confidence ellipsoid",
    "E": "the largest variance of any combination of parameters",
    "G": "the worst predicted leg length over the task",
    "kappa": "the condition number, for comparison only",
}
LOCKS = {
    Lock.NONE: "none: any pose",
    Lock.DIRECTION: "direction (Type I): the leg keeps its direction, its length is free",
    Lock.LEG: "leg (Type II): the leg keeps its direction and its length",
    Lock.LENGTH: "length (Type III): the leg keeps its length, its direction is free",
}


def design_report(
    robot: Hexapod,
    designs: Design | Sequence[Design],
    *,
    counts: bool = True,
    repeat: bool = False,
    settings: Mapping[str, str] | None = None,
    rng: int | np.random.Generator,
) -> str:
    r"""A page of HTML on chosen poses: predicted errors, what is proven, the poses, and pictures of them.

    Poses are numbered in their measuring order (:func:`~hexopt.measuring_order`). They are compared with the medians of
    200 random sets of as many candidates.

    Parameters
    ----------
    robot : Hexapod
    designs : Design, or a list of them
        Each over one set of candidates with a noise model, for example one a locked leg; all under the same lock, with
        the same criterion and noise.
    counts : bool, default True
        Also ask how many poses are needed: designs with 0.4 to 2.5 times as many.
    repeat : bool, default False
        Whether the designs may measure a pose again.
    settings : dict of str to str, optional
        What else the page is to say about them, by name.
    rng : int or numpy.random.Generator
        For the random sets; there is no default.

    Returns
    -------
    str
        One file without links to others: pictures are in it.

    Raises
    ------
    InputError
        For what is no design, has no poses of one set or poses that this robot does not reach by far, and for designs
        that differ in lock, criterion or noise, or are of one leg.
    UnitError
        For poses in another unit than the robot's.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> pool = hx.candidates(robot, 3, "direction", 200, noise, rng=0)
    >>> design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 5)
    >>> page = hx.design_report(robot, design, counts=False, rng=0)
    >>> page.splitlines()[0], "Left Hand: 5 poses" in page
    ('<!DOCTYPE html>', True)
    """
    check_robot(robot)
    found = [designs] if isinstance(designs, Design) else designs
    if not isinstance(found, Sequence) or not found:
        raise InputError(f"designs: expected a Design, or a list of one or more; got {brief(designs)}")
    if settings is not None and not isinstance(settings, Mapping):
        raise InputError(f"settings: expected a dict of texts by name, got {brief(settings)}")
    choices = [Choice(robot, one) for one in found]
    check_alike(robot, choices)
    generator = as_generator(rng)
    page = Page(_title(robot, choices), footer=f"hexopt {__version__}")
    page.facts = _facts(choices)
    _question(page.section("What was asked"), robot, choices, settings or {})
    randoms = [random_sets(one.design, one.objective, RANDOM_SETS, generator) for one in choices]
    _errors(page.section("Predicted standard errors"), choices, randoms)
    for choice, random in zip(choices, randoms, strict=True):
        section = page.section(choice.title if len(choices) > 1 else "The poses")
        section.text(choice.told(robot))
        _poses(section, robot, choice)
        for one in space_pictures(robot, choice.data, choice.candidates, choice.leg):
            section.pictures(one)
        seen = observed(choice.design, choice.order)
        if seen is not None:
            section.pictures(*share_pictures(seen))
        for one in region_pictures(choice.design, random.covariance):
            section.pictures(one)
        if counts:
            section.pictures(counts_picture(designs_by_count(choice.design, repeat)))
    return page.html()


def _title(robot: Hexapod, choices: Sequence[Choice]) -> str:
    numbers = {len(one.order) for one in choices}
    number = numbers.pop() if len(numbers) == 1 else None
    count = "poses" if number is None else "1 pose" if number == 1 else f"{number} poses"
    lock, legs = choices[0].lock, choices[0].legs
    each = " for each leg" if len(choices) > 1 else "" if len(legs) > 1 else f" for leg {legs[0]}"
    held = f" of leg {choices[0].leg}" if len(legs) > 1 else ""
    return f"{robot.name}: {count}{each}" + (
        ", none locked" if lock is Lock.NONE else f" under the lock “{lock}”{held}"
    )


def _facts(choices: Sequence[Choice]) -> list[tuple[str, str]]:
    """Key numbers."""
    facts = [(str(sum(len(one.order) for one in choices)), "poses to measure")]
    known = [one.design.efficiency for one in choices if np.isfinite(one.design.efficiency)]
    if len(known) == len(choices):
        if all(one.design.proven for one in choices):
            facts.append(("100 %", "of the best choice of these candidates, proven"))
        else:
            facts.append((rounded_down(min(known)), "of the best choice of these candidates, at least"))
    units = {unit for one in choices for unit in one.design.units}
    for unit in sorted(units):
        worst = max(
            error
            for one in choices
            for error, its in zip(one.design.standard_errors, one.design.units, strict=True)
            if its == unit
        )
        facts.append((f"{worst:.3g} {unit_shown(unit)}".rstrip(), "largest predicted standard error"))
    return facts


def _question(section: Section, robot: Hexapod, choices: Sequence[Choice], settings: Mapping[str, str]) -> None:
    first = choices[0]
    criterion = first.design.criterion
    said = CRITERIA.get(criterion, "an observability index, for comparison only")
    numbers = sorted({len(one.design.weights) for one in choices})
    pairs = [
        ("Robot", f"{robot.name}; lengths in {unit_shown(robot.length_unit) or 'a unit that is not stated'}"),
        ("Lock", LOCKS[first.lock]),
        ("Limits", robot.limits.describe(unit_shown(robot.length_unit))),
        ("Noise", noise_words(first.candidates.noise, robot)),
        ("Criterion", f"{criterion}: {said}"),
        ("Candidates", " or ".join(map(str, numbers)) + (" for each leg" if len(choices) > 1 else "")),
        *settings.items(),
    ]
    section.given(pairs)


def _errors(section: Section, choices: Sequence[Choice], randoms: Sequence[RandomSets]) -> None:
    """A row a leg: the design's standard errors, and how many times larger those of random sets are."""
    cells: dict[str, dict[str, tuple[str, str]]] = {}
    heads: dict[str, str] = {}
    for choice, random in zip(choices, randoms, strict=True):
        design = choice.design
        for i, (leg, name) in enumerate(choice.places):
            error, usual = design.standard_errors[i], random.standard_errors[i]
            heads[name] = unit_shown(design.units[i])
            ratio = f"{usual / error:.2f}×" if np.isfinite(usual) else "not seen"
            doubt = ", not seen in practice" * bool(design.doubtful[i])
            cells.setdefault(leg, {})[name] = f"{error:.3g}{doubt}", ratio
    none = ("–", "–")
    chosen, ratios = (
        [[leg, *(row.get(name, none)[k] for name in heads)] for leg, row in cells.items()] for k in range(2)
    )
    before = " and what was measured before" if any(one.design.question.measured for one in choices) else ""
    section.table(
        f"Predicted standard errors (1 σ) of the best estimator, from the chosen poses{before}.",
        [("leg", ""), *heads.items()],
        chosen,
    )
    section.table(
        f"How many times larger they are from random sets of as many candidates{before} (the median of {RANDOM_SETS} "
        "sets).",
        [("leg", ""), *((name, "") for name in heads)],
        ratios,
    )


def _poses(section: Section, robot: Hexapod, choice: Choice) -> None:
    """A row a pose, in the order of measuring."""
    data, sequence = choice.data, robot.limits.sequence
    angles = np.rad2deg(matrix_to_euler(data.rotation, sequence))
    unit, reading = unit_shown(robot.length_unit), unit_shown(robot.reading_unit)
    heads = [("pose", ""), ("candidate", ""), *((axis, unit) for axis in "xyz")]
    heads += [(f"angle {i}", "°") for i in (1, 2, 3)] + [(f"leg {k}", reading) for k in range(1, 7)]
    columns = [_fixed(data.position, robot.size), _fixed(angles, 100.0), _fixed(data.length, np.abs(data.length).max())]
    numbers = choice.design.indices[choice.order]
    rows = [[str(i + 1), str(numbers[i]), *(cell for part in columns for cell in part[i])] for i in range(data.n_poses)]
    section.table(
        f"In their measuring order: from home to the nearest, then always on to the nearest that is left. Position, "
        f"Euler angles {sequence} ({'intrinsic' if sequence.isupper() else 'extrinsic'}), and the readings of the six "
        "legs by the nominal robot. Candidates are counted from 0, those left out are not.",
        heads,
        rows,
        texts=0,
    )


def _fixed(values: Array, size: float) -> list[list[str]]:
    """Numbers (n, k) with so many decimals that they are exact to 1e-5 of the size."""
    decimals = max(0, 5 - int(np.ceil(np.log10(size)))) if size > 0 else 5
    rounded = np.round(values, decimals) + 0.0  # no −0
    return [[f"{value:.{decimals}f}".replace("-", "−") for value in row] for row in rounded]
