r"""What the clamp should hold: a direction, a point or a length, the one whose best design promises most.

For every value v that is tried, the relaxation over its candidates bounds all designs, :math:`f \ge \beta_v`. In the
order of the bounds, designs are made until the best of them is below the next bound: then no other value can win.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, as_count, as_generator, brief, frozen
from ..errors import InputError, RankDeficientError, SamplingError
from ..geometry import Hexapod, PoseRanges
from ..loops import FixedDirection, FixedLeg, FixedLength, Loop
from ..measurements import LegMeasurements, Lock
from ..noise import Noise
from ..pools import Clamp, candidates
from ..pools.exact import Accept, lock_and_leg
from ..poses import limit_ranges, sample_poses
from ..result import Estimate
from ..simulation import check_robot
from .choosing import answer, relaxation_of
from .criteria import Criterion
from .design import Design
from .feasible import Feasible
from .lock_choice import LockChoice
from .question import Question, criterion_of

__all__ = ["select_lock"]

#: The equation of one leg under each lock.
LOOPS: Mapping[Lock, Callable[[LegMeasurements], Loop]] = {
    Lock.DIRECTION: FixedDirection,
    Lock.LEG: FixedLeg,
    Lock.LENGTH: FixedLength,
}


def select_lock(
    robot: Hexapod,
    leg: int,
    lock: Lock | str,
    n_poses: int,
    noise: Noise,
    *,
    criterion: str | Criterion = "A",
    n_locks: int = 20,
    n_candidates: int = 1000,
    given: npt.ArrayLike | None = None,
    loop: Callable[[LegMeasurements], Any] | None = None,
    of: Sequence[str] | None = None,
    spread: Mapping[str, float] | None = None,
    measured: Estimate | Sequence[Estimate] = (),
    nominal: Hexapod | None = None,
    ranges: PoseRanges | None = None,
    accept: Accept | None = None,
    starts: int = 8,
    rng: int | np.random.Generator,
) -> LockChoice:
    r"""The direction, point or length on which n poses tell most: :math:`\min_v \min_w f_v(w)`.

    Every value v of the clamp has candidates of its own, whose relaxation is a lower bound on all their designs.
    Designs are made in the order of the bounds, until the best one is below all that are left: it beats every design
    on the other values, from their candidates.

    Parameters
    ----------
    robot : Hexapod
    leg : int
        1…6, the leg to be locked.
    lock : Lock or str
        "direction", "leg" or "length".
    n_poses : int
        Of a design.
    noise : Noise
    criterion : str or Criterion, default "A"
        As in :func:`select_poses`. Where it has no bounds ("O2", "O4") a design is made on every value.
    n_locks : int, default 20
        How many values to try, where none are given: that of home, and random ones, drawn as often as the poses on them
        can be reached.
    n_candidates : int, default 1000
        On each.
    given : array_like, shape (t, 3) or (t,), optional
        The directions, points of the platform joint in the base frame, or true lengths to try.
    loop : callable, optional
        From the measurements of the locked leg to the loop equation; by default ``FixedDirection``, ``FixedLeg`` or
        ``FixedLength``, with all that they know from the nominal.
    of, spread, measured, starts
        As in :func:`select_poses`; what was measured on other clamps is an estimate.
    nominal, ranges, accept
        As in :func:`candidates`.
    rng : int or numpy.random.Generator
        Seed or generator; there is no default.

    Returns
    -------
    LockChoice

    Raises
    ------
    InputError
        For the lock "none", values of the wrong shape, and wrong settings.
    SamplingError
        If no value has candidates, or none has a design; the message has the first reason.
    RankDeficientError
        If so few poses see the parameters on no value.

    Notes
    -----
    The values are compared over finite sets of candidates, so near winners may be exchanged by another seed.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> choice = hx.select_lock(hx.robots.left_hand(), 3, "length", 7, noise, n_locks=5, n_candidates=200, rng=0)
    >>> choice.tried.shape, bool(choice.design.value <= choice.bounds.max())
    ((5,), True)
    """
    kind, number = _checked(robot, leg, lock, noise, loop)
    if as_count("n_candidates", n_candidates) < as_count("n_poses", n_poses):
        raise InputError(f"n_poses: {n_poses} poses asked for, of {n_candidates} candidates; raise n_candidates")
    as_count("starts", starts)
    generator, wanted, equation = as_generator(rng), criterion_of(criterion), loop or LOOPS[kind]
    tried = _to_try(robot, number, kind, as_count("n_locks", n_locks), ranges, given, generator)
    some = partial(candidates, nominal=nominal, ranges=ranges, accept=accept, rng=generator)
    feasible = Feasible(np.ones(n_candidates), np.ones(n_candidates), float(n_poses))

    def entered(value: Any) -> _Entry:
        try:
            pool = some(robot, number, kind, n_candidates, noise, value)
            question = Question(equation(pool.leg(number)), wanted, of=of, spread=spread, measured=measured)
            objective = question.objective()
            relaxed = relaxation_of(objective, feasible)
        except (SamplingError, RankDeficientError) as error:
            return _Entry(error=error)
        bound = relaxed.bound if relaxed else np.nan
        return _Entry(pool, bound, lambda: answer(question, objective, feasible, starts))

    entries = _raced([entered(value) for value in tried])
    values = np.array([np.nan if one.design is None else one.design.value for one in entries])
    if np.isnan(values).all():
        raise _no_design(entries)
    best = int(np.nanargmin(values))
    return LockChoice(
        lock=kind,
        leg=number,
        tried=frozen(tried),
        bounds=frozen(np.array([one.bound for one in entries])),
        values=frozen(values),
        reasons=tuple("" if one.error is None else str(one.error) for one in entries),
        best=best,
        design=entries[best].design,
        pool=entries[best].pool,
    )


def _checked(robot: Hexapod, leg: int, lock: Lock | str, noise: object, loop: object) -> tuple[Lock, int]:
    """The lock and the number of its leg, with settings of the right kind."""
    check_robot(robot)
    kind, number = lock_and_leg(lock, leg)
    if kind is Lock.NONE:
        raise InputError("lock: expected 'direction', 'leg' or 'length'; the lock 'none' holds nothing to choose")
    if not isinstance(noise, Noise):
        raise InputError(f"noise: expected a noise model such as UniformNoise(…), got {brief(noise)}")
    if loop is not None and not callable(loop):
        raise InputError(f"loop: expected a loop equation such as loops.ReadLength, not a value: {brief(loop)}")
    return kind, number


@dataclass(frozen=True)
class _Entry:
    """One value of the clamp: its candidates and their bound, how its design is made, and what became of it."""

    pool: Any = None
    bound: float = np.nan
    make: Callable[[], Design] | None = None
    design: Any = None
    error: SamplingError | RankDeficientError | None = None


def _raced(entries: Sequence[_Entry]) -> list[_Entry]:
    """Designs by the order of the bounds, until the best one is below the bounds that are left."""
    done, best = list(entries), np.inf
    for i in np.argsort([-np.inf if np.isnan(one.bound) else one.bound for one in entries], kind="stable"):
        make = done[i].make
        if make is None or done[i].bound >= best:
            continue
        try:
            design = make()
        except RankDeficientError as error:
            done[i] = replace(done[i], error=error)
        else:
            done[i], best = replace(done[i], design=design), min(best, design.value)
    return done


def _no_design(entries: Sequence[_Entry]) -> SamplingError | RankDeficientError:
    """Why no value has a design: the first reason, of too few poses before others."""
    errors = sorted((one.error for one in entries if one.error), key=lambda error: isinstance(error, SamplingError))
    message = f"no design on any of the {len(entries)} values tried; the first reason: {errors[0]}"
    return SamplingError(message) if isinstance(errors[0], SamplingError) else RankDeficientError(message)


def _to_try(
    robot: Hexapod,
    leg: int,
    lock: Lock,
    count: int,
    ranges: PoseRanges | None,
    given: npt.ArrayLike | None,
    rng: np.random.Generator,
) -> Array:
    """What the user gives; or the clamp of home, and those of random poses that all legs reach."""
    if given is not None:
        tried = as_array("given", given, ("t",) if lock is Lock.LENGTH else ("t", 3), batch=False)
        if not len(tried):
            raise InputError("given: there is nothing to try; leave it out for random values")
        return tried
    drawn = robot, leg, lock, (count - 1, 1), ranges or limit_ranges(robot), rng
    position, rotation, _ = sample_poses(*drawn, all_legs=True)
    clamps = [Clamp.of_poses(robot, leg, lock, *pose) for pose in zip(position, rotation, strict=True)]
    return np.stack([clamp.value for clamp in [Clamp.at_home(robot, leg, lock), *clamps]])
