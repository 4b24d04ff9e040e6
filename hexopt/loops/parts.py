"""Sets that go together: each of them, what has to fit, and the names of what they share and do not."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, UnitError
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements, Measurements
from ..parameters import Block, Parameters
from ..problem import LinearProblem, RowNoise
from .base import Loop
from .joined_noise import JoinedNoise, Place

__all__ = ["Part", "check_alike", "joined_names", "joined_parameters", "numbered", "places_of", "share_a_pose"]


@dataclass(frozen=True)
class Part:
    """One argument: a loop or a direct problem, and what it is called.

    Attributes
    ----------
    target : Loop or LinearProblem
    label : str
    problem : LinearProblem, optional
        Its direct equations, where they are linear.
    """

    target: Loop | LinearProblem
    label: str
    problem: LinearProblem | None = None

    @property
    def rows(self) -> int:
        """Rows a pose."""
        return self.target.rows_per_block if isinstance(self.target, LinearProblem) else self.target.rows

    @property
    def data(self) -> tuple[LegMeasurements, ...]:
        """The measurements behind it, as far as they are known."""
        return _data(self.target.noise) if isinstance(self.target, LinearProblem) else (self.target.data,)

    @property
    def silent(self) -> bool:
        """Whether it has no noise model."""
        return (self.target if isinstance(self.target, LinearProblem) else self.target.data).noise is None

    @property
    def legs(self) -> set[int]:
        """The numbers of the legs that were measured, as far as they are known."""
        return {data.nominal.number for data in self.data if data.nominal is not None}


def _data(noise: RowNoise | None) -> tuple[LegMeasurements, ...]:
    """The measurements that a noise model is of, where it is a loop's."""
    if isinstance(noise, JoinedNoise):
        return tuple(data for part in noise.noises for data in _data(part))
    return (noise.data,) if isinstance(noise, Loop) else ()


def check_alike(who: str, parts: Sequence[Part]) -> None:
    """Noise, units and batches that fit, and no pose twice."""
    silent = [part.label for part in parts if part.silent]
    if 0 < len(silent) < len(parts):
        raise InputError(f"{who}: {', '.join(silent)}: no noise model, the others have one; give all noise=…, or none")
    units = sorted({data.length_unit for part in parts for data in part.data})
    if len(units) > 1:
        raise UnitError(f"{who}: the sets are in {' and '.join(units)}; convert them to one unit")
    shapes = [(part.problem or part.target).batch_shape for part in parts]
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise InputError(f"{who}: the batches {', '.join(map(str, shapes))} do not fit each other") from None
    _check_poses(who, parts)


def _check_poses(who: str, parts: Sequence[Part]) -> None:
    """No pose stands twice: its error would count twice."""
    for i, two in enumerate(parts):
        for one in parts[:i]:
            same = any(share_a_pose(a, b) for a in one.data for b in two.data)
            if not (one.data and two.data):  # then only the equations can tell
                same = all(np.array_equal(getattr(one.problem, k), getattr(two.problem, k)) for k in ("rhs", "matrix"))
            if same:
                raise InputError(
                    f"{who} is for different poses: {one.label} and {two.label} have a pose in common; give each pose "
                    "once. Legs seen in the same pose share its error: they belong in one WholeRobot equation"
                )


def share_a_pose(one: LegMeasurements | Measurements, two: LegMeasurements | Measurements) -> bool:
    """Whether some pose of a set is, to the bit, one of the other set (of the same member of the batch)."""
    for i in range(two.n_poses):
        same = (one.position == two.position[..., i : i + 1, :]).all(axis=-1)
        if same.any() and (same & (one.rotation == two.rotation[..., i : i + 1, :, :]).all(axis=(-2, -1))).any():
            return True
    return False


def joined_names(who: str, parts: Sequence[Part]) -> list[dict[str, str]]:
    """The joined name of every block, for each part."""
    several = len(set().union(*(part.legs for part in parts))) > 1
    prefixes = [_prefix(who, part) if several else "" for part in parts]
    names = [
        {block.name: prefix + block.name for block in part.target.parameters}
        for part, prefix in zip(parts, prefixes, strict=True)
    ]
    owned = [
        (own, block.name)
        for own, part in zip(names, parts, strict=True)
        for block in part.target.parameters
        if block.nuisance
    ]
    for (own, name), joined in zip(owned, numbered([own[name] for own, name in owned]), strict=True):
        own[name] = joined
    return names


def numbered(names: Sequence[str]) -> list[str]:
    """Names in their order, where those that several sets have are told apart: "direction.1", "direction.2"."""
    count, seen = Counter(names), Counter[str]()
    seen_as = []
    for name in names:
        seen[name] += 1
        seen_as.append(f"{name}.{seen[name]}" if count[name] > 1 else name)
    return seen_as


def _prefix(who: str, part: Part) -> str:
    """What stands before the names of one of several legs; the names of a problem are the caller's."""
    if not isinstance(part.target, LinearProblem):
        if not part.legs:
            raise InputError(
                f"{who}: which leg is {part.label}? other loops are of several legs; give its data nominal=robot.leg(k)"
            )
        return f"leg{min(part.legs)}."
    bare = [name for name in part.target.parameters.names if name in LEG_BLOCKS]
    if part.legs and bare:
        legs = " and ".join(map(str, sorted(part.legs)))
        raise InputError(
            f"{who}: {part.label} is of leg {legs} beside other legs, but has the bare name {bare[0]}; give {who} the "
            f"loops themselves, whose names become leg{min(part.legs)}.{bare[0]} and so on"
        )
    return ""


def joined_parameters(who: str, parts: Sequence[Part], names: Sequence[Mapping[str, str]]) -> Parameters:
    """The joined blocks: leg by leg in a leg's order, then the nuisances in the order of the sets."""
    blocks: dict[str, Block] = {}
    for part, own_names in zip(parts, names, strict=True):
        for own in part.target.parameters:
            block = Block(own_names[own.name], own.size, own.unit, own.scale, own.nuisance)
            other = blocks.setdefault(block.name, block)
            if (other.size, other.nuisance) != (block.size, block.nuisance) or (other is not block and block.nuisance):
                raise InputError(
                    f"{who}: {block.name} of {part.label} is not what another set calls so: {block} and {other}; "
                    "give one of them another name"
                )
            if other.unit != block.unit:
                raise UnitError(f"{who}: {block.name} is in {other.unit}, and in {block.unit} in {part.label}")
    main = [block for block in blocks.values() if not block.nuisance]
    order, owners = list(LEG_BLOCKS), list(dict.fromkeys(block.name.rpartition(".")[0] for block in main))

    def rank(block: Block) -> tuple[int, int]:
        owner, _, bare = block.name.rpartition(".")
        return owners.index(owner), order.index(bare) if bare in order else len(order)

    return Parameters((*sorted(main, key=rank), *(block for block in blocks.values() if block.nuisance)))


def places_of(parts: Sequence[Part], names: Sequence[Mapping[str, str]], parameters: Parameters) -> tuple[Place, ...]:
    """Where the parameters of every part stand among the joined ones."""
    index = np.arange(parameters.size)
    return tuple(
        np.concatenate([index[parameters[own[name]]] for name in part.target.parameters.names])
        for part, own in zip(parts, names, strict=True)
    )
