"""The user's own poses as candidates, checked."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, as_array, brief
from ..errors import InputError, SamplingError
from ..geometry import Hexapod
from ..kinematics import limit_violations
from ..measurements import Lock, Measurements
from ..noise import Noise
from ..rotations import check_rotation
from ..simulation import check_robot
from .clamp import Clamp
from .exact import Accept, checked_mask, exact_pool, lock_and_leg

__all__ = ["candidates_at", "listed_pool"]


def candidates_at(
    robot: Hexapod,
    position: npt.ArrayLike,
    rotation: npt.ArrayLike,
    leg: int | None = None,
    lock: Lock | str = Lock.NONE,
    noise: Noise | None = None,
    given: npt.ArrayLike | None = None,
    *,
    nominal: Hexapod | None = None,
    accept: Accept | None = None,
    tolerance: float | None = None,
    drop: bool = False,
) -> Measurements:
    r"""Your own poses as candidates, checked, with exact readings :math:`(\lVert P + R b - a\rVert - \delta)/\gamma`.

    A pose cannot be a candidate if a limit of the robot or `accept` refuses it, if it is off the clamp, or if it
    stands in the list before. Poses that were measured need none of this: choose from the measurements themselves.

    Parameters
    ----------
    robot : Hexapod
    position, rotation : array_like, shape (n, 3) and (n, 3, 3)
        For example those of the first set of ``read_measurements("poses.csv", length_unit="cm")``.
    leg : int, optional
        The locked leg; needed unless `lock` is "none".
    lock : Lock or str, default "none"
    noise, nominal, accept
        As in :func:`candidates`.
    given : array_like or float, optional
        What the clamp holds, as in :func:`candidates`; by default the median of what the poses hold.
    tolerance : float, optional
        How far the leg's platform joint may be from where the clamp lets it be (a ray from a, the point c, or a
        sphere about a), length units; by default 1e-4 of the robot's size.
    drop : bool, default False
        Leave out the poses that cannot be candidates, instead of an error.

    Returns
    -------
    Measurements
        One set, in the order of the list.

    Raises
    ------
    InputError
        For NaN, matrices that are no rotations, shapes that disagree; and if poses cannot be candidates: it says how
        many for which reason, and which is the first.
    SamplingError
        If nothing is left.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> heights = [[0.0, 0.0, 18.0], [0.0, 0.0, 19.0], [0.0, 0.0, 40.0]]
    >>> pool = hx.candidates_at(hx.robots.left_hand(), heights, [np.eye(3)] * 3, drop=True)
    >>> pool.n_poses
    2
    """
    if not isinstance(drop, bool):
        raise InputError(f"drop: expected True or False, got {brief(drop)}")
    pool, bad, why = listed_pool(
        robot, position, rotation, leg, lock, noise, given, nominal=nominal, accept=accept, tolerance=tolerance
    )
    if not bad.any():
        return pool
    if not drop:
        raise InputError(f"{why}; the first is pose {int(np.argmax(bad))}, counted from 0; drop=True leaves them out")
    if bad.all():
        raise SamplingError(f"{why}; nothing is left")
    return pool.poses(np.flatnonzero(~bad))


def listed_pool(
    robot: Hexapod,
    position: npt.ArrayLike,
    rotation: npt.ArrayLike,
    leg: int | None,
    lock: Lock | str,
    noise: Noise | None,
    given: npt.ArrayLike | None,
    *,
    nominal: Hexapod | None = None,
    accept: Accept | None = None,
    tolerance: float | None = None,
) -> tuple[Measurements, BoolArray, str]:
    """All poses of a list, which of them (n,) cannot be candidates, and in words why."""
    check_robot(robot)
    p = as_array("position", position, ("n", 3), batch=False, own=True)
    r = check_rotation("rotation", as_array("rotation", rotation, ("n", 3, 3), batch=False, own=True))
    if len(p) != len(r) or not len(p):
        raise InputError(f"expected as many positions as rotations, and at least one; got {len(p)} and {len(r)}")
    kind, number = lock_and_leg(lock, leg)
    clamp = Clamp.of_poses(robot, number, kind, p, r) if given is None else Clamp.given(robot, number, kind, given)
    off = clamp.distance(p, r)
    refused = {
        **limit_violations(robot, p, r),
        "duplicate": _repeated(p, r),
        "off the clamp": off > _tolerance(robot, tolerance),
    }
    if accept is not None:
        refused["accept"] = ~checked_mask(accept, p, r)
    bad = np.logical_or.reduce(list(refused.values()))
    counts = ", ".join(f"{name}: {int(mask.sum())}" for name, mask in refused.items() if mask.any())
    why = f"{int(bad.sum())} of {len(bad)} poses cannot be candidates ({counts})"
    if refused["off the clamp"].any():
        why += f"; up to {off.max():.3g} {robot.length_unit} off {clamp} (given=, tolerance=)"
    return exact_pool(robot, clamp, p, r, noise, nominal), bad, why


def _tolerance(robot: Hexapod, given: float | None) -> float:
    """How far poses may be off the clamp."""
    tolerance = 1e-4 * robot.size if given is None else float(as_array("tolerance", given, (), batch=False))
    if tolerance < 0:
        raise InputError(f"tolerance: expected a length >= 0, got {tolerance:g}")
    return tolerance


def _repeated(position: Array, rotation: Array) -> BoolArray:
    """Which poses stand in the list before, to the last bit."""
    rows = np.concatenate([position, rotation.reshape(-1, 9)], axis=1) + 0.0  # + 0.0: −0 is 0
    first = np.ones(len(rows), dtype=bool)
    first[np.unique(rows, axis=0, return_index=True)[1]] = False
    return first
