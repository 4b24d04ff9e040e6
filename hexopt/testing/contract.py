"""One contract for all estimators: :func:`check_estimator` tells the author of a new one what it breaks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..arrays import as_generator
from ..errors import InputError
from ..geometry import Hexapod
from ..loops import FixedDirection, FixedLeg, FixedLength, LegLength, Loop
from ..measurements import Lock
from ..problem import LinearProblem
from ..result import Estimator
from ..robots import left_hand
from .suite import CLAIMS, COMMON, Suite, TargetFactory

__all__ = ["CLAIMS", "check_estimator"]


def check_estimator(
    estimator: Estimator,
    target_factory: TargetFactory | None = None,
    *,
    lock: Lock | str = Lock.NONE,
    claims: Sequence[str] = CLAIMS,
    n_poses: int = 10,
    tolerance: float = 1e-6,
    exactness: float = 1e-9,
    robot: Hexapod | None = None,
    rng: int | np.random.Generator = 0,
) -> None:
    r"""Run the contract suite on an estimator: return silently, or say what it breaks.

    For all estimators:

    - *input*: the target and its arrays stay as they are, flags included;
    - *repeat*: the same target gives the same bits again;
    - *batch*: a batch equals its members;
    - *certificate*: a success has finite values, a gap of at most 1e-8·(1 + \|objective\|) or NaN, and a
      covariance that is one, of a named kind, or a reason for none;
    - *proof*: where the estimator has a method ``certificate(target, found)``, it passes the estimator's own
      answers, and neither a tampered nor a NaN one;
    - *throw*: ``estimate(…, throw=)`` raises or returns as documented, a wrong target says what to write;
    - *few*: too few poses are a one-line :class:`~hexopt.HexoptError`, whatever `throw` is, unless a prior or
      bounds make the answer unique, and ``found.decided`` says so;
    - *value*: the estimator pickles, equals its copy, and its repr evaluates to it.

    Where the estimator claims it:

    - *exact*: readings without error give the truth;
    - *order*: the order of the poses does not matter;
    - *scale*: another length unit, and other scales of the columns, change the answer accordingly;
    - *frame*: so do a turn and a shift of the base frame, and of the platform frame;
    - *rank*: a set that does not determine the parameters fails alone in its batch, with NaN and a status;
      by itself it raises and names what is unseen.

    Parameters
    ----------
    estimator : Estimator
        With `accepts`, `hint` and `fit`.
    target_factory : callable, optional
        From :class:`~hexopt.LegMeasurements` (one set or a batch, of leg 3, with a noise model) to what the
        estimator accepts. By default, as its `accepts` says, the direct form of the three locked loops, or
        the loops themselves.
    lock : Lock or str, default "none"
        The lock of the sets that `target_factory` gets.
    claims : sequence of str, default all
        What the estimator promises beyond what holds for all.
    n_poses : int, default 10
        Poses in a set.
    tolerance : float, default 1e-6
        How far two answers that should agree may be apart, in standard errors (the readings have errors of
        1e-3 in a robot of size 20).
    exactness : float, default 1e-9
        Largest error without noise, relative to the robot's size, unless 100·eps·κ is larger.
    robot : Hexapod, optional
        By default the Left Hand.
    rng : int or numpy.random.Generator, default 0

    Raises
    ------
    AssertionError
        Naming the estimator, the target, the broken contract and the difference.

    Examples
    --------
    >>> import hexopt as hx
    >>> from hexopt.testing import check_estimator
    >>> check_estimator(hx.LeastSquares())
    >>> check_estimator(hx.LeastSquares(), lambda data: hx.loops.FixedLeg(data).linear("centred"), lock="leg")

    The consecutive form depends on the order of the poses, so least squares on it must not claim otherwise:

    >>> def paper(data):
    ...     return hx.loops.FixedLeg(data).linear("consecutive")
    >>> check_estimator(hx.LeastSquares(), paper, lock="leg")
    Traceback (most recent call last):
    ...
    AssertionError: LeastSquares(...) on its target breaks 'order': ...
    >>> check_estimator(hx.LeastSquares(), paper, lock="leg", claims=("exact", "scale", "frame", "rank"))
    """
    strange = set(claims) - set(CLAIMS)
    if strange:
        raise InputError(f"claims: known are {', '.join(CLAIMS)}; got {', '.join(sorted(map(str, strange)))}")
    made = list(_default_targets(estimator))
    if target_factory is not None:
        made = [("its target", Lock.of(lock), target_factory)]
    if not made:
        names = ", ".join(kind.__name__ for kind in estimator.accepts)
        raise InputError(f"check_estimator makes no {names} by itself; give target_factory=… and lock=…")
    seed = int(as_generator(rng).integers(2**31))
    for label, kind, factory in made:
        suite = Suite(
            estimator,
            label,
            kind,
            factory,
            n_poses,
            tolerance,
            exactness,
            left_hand() if robot is None else robot,
            seed,
        )
        for name in (*COMMON, *claims):
            suite.run(name)


def _default_targets(estimator: Estimator) -> Iterator[tuple[str, Lock, TargetFactory]]:
    """What the estimator accepts, made of one set: its loops, or their linear problems."""

    def linear(loop: type[Loop]) -> TargetFactory:
        return lambda data: loop(data).linear()

    loops: tuple[type[Loop], ...] = (FixedDirection, FixedLeg, FixedLength, LegLength)
    for loop in loops:
        lock = loop.locks[0]
        if issubclass(LinearProblem, estimator.accepts) and loop is not LegLength:
            yield f"{loop.__name__}.linear()", lock, linear(loop)
        linear_only = loop is LegLength and issubclass(LinearProblem, estimator.accepts)  # its unknowns are not linear
        if issubclass(loop, estimator.accepts) and not linear_only:
            yield loop.__name__, lock, loop
