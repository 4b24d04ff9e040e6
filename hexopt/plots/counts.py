"""How many poses: the predicted error against their number, and the knee after which more of them help little."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, StrMethodFormatter

from ..arrays import Array, as_array, brief
from ..errors import InputError
from ..selection.design import Design
from .look import BASE, COLOURS, INK, block_of, flat_axes, quantity

__all__ = ["error_against_poses", "knee"]

TICKS = np.array([1, 2, 3, 4, 5, 7, 10, 15, 20, 30, 50, 70, 100, 200, 500, 1000])
MARKERS = ("o", "s", "^", "D", "v", "P", "X")


def knee(counts: npt.ArrayLike, errors: npt.ArrayLike, share: float = 0.05) -> int | None:
    r"""How many poses are enough: the least N from which on each further pose lowers the error by less than `share`.

    Between two counts the error is taken to fall by the same factor with every pose,
    :math:`q = (e_{i+1}/e_i)^{1/(N_{i+1} - N_i)}`; a step helps where :math:`1 - q \ge` `share`. An error that falls as
    :math:`1/\sqrt N` does so by :math:`1/(2N)` a pose: less than 5 % from N = 10 on.

    Parameters
    ----------
    counts : array_like of int, shape (n,)
        N, ascending.
    errors : array_like, shape (n,)
        Predicted errors > 0; infinite where the poses are too few.
    share : float, default 0.05
        What one more pose must gain to be worth it.

    Returns
    -------
    int or None
        One of the counts; None where the last step still helps, or is the only one that is not known.

    Raises
    ------
    InputError
        For counts that do not ascend, errors that are not > 0, shapes that disagree, or a share outside (0, 1).

    Examples
    --------
    >>> import hexopt as hx
    >>> hx.plots.knee([4, 5, 6, 7, 8], [10.0, 6.0, 4.0, 3.9, 3.8])
    6
    """
    number = as_array("counts", counts, ("n",), batch=False)
    size = _amounts(errors)
    if size.shape != number.shape or number.size < 2:
        raise InputError(f"counts and errors: expected two or more of both, got {number.shape} and {size.shape}")
    if (np.diff(number) <= 0).any() or (number != np.round(number)).any() or number[0] < 1:
        raise InputError(f"counts: expected ascending numbers of poses, got {number}")
    if not (size > 0).all():
        raise InputError(f"errors: expected values > 0 (infinite where the poses are too few), got {size}")
    if not isinstance(share, Real) or not 0 < share < 1:
        raise InputError(f"share: expected a share in (0, 1), such as 0.05, got {brief(share)}")
    known = np.isfinite(size)
    step = np.log(np.where(known, size, 1.0))
    fall = np.where(known[1:] & known[:-1], np.diff(step), -np.inf) / np.diff(number)
    helps = np.flatnonzero(-np.expm1(fall) >= share)
    first = helps[-1] + 1 if helps.size else 0
    return int(number[first]) if first < number.size - 1 else None


def _amounts(errors: Any) -> Array:
    """Predicted errors, of which some may be infinite."""
    try:
        return np.asarray(errors, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"errors: expected numbers, got {brief(errors)}") from None


def error_against_poses(
    counts: Any,
    errors: Mapping[str, npt.ArrayLike] | None = None,
    bound: npt.ArrayLike | None = None,
    unit: str = "unstated",
    share: float = 0.05,
    ax: Axes | None = None,
    *,
    new: bool = False,
) -> Axes:
    r"""How many poses are needed: the predicted error of every block against their number N, with the knee.

    The error of a block is :math:`\sqrt{\mathrm{tr}\,C}` over its scalars: of a point, the predicted distance, as a
    root mean square. The knee (:func:`knee`) is that of the geometric mean of the blocks. The dotted line falls as
    :math:`1/\sqrt N`, which repeating the same poses would give, from the last error on backwards; where poses were
    measured before, N counts the new ones, and there is no such line. Designs whose
    criterion is the trace of this very covariance (A, one unit, spreads of 1) have two more lines: the error of
    everything together, and the proven bound that no choice of so many of these candidates goes below.

    Parameters
    ----------
    counts : list of Design, or array_like of int, shape (n,)
        Designs with different numbers of poses, or these numbers, ascending.
    errors : dict of str to array_like, shape (n,)
        With numbers: predicted errors by block; infinite where the poses are too few.
    bound : array_like, shape (n,), optional
        With numbers: a lower bound of these errors, taken together.
    unit : str, default "unstated"
        With numbers: the unit of the errors.
    share : float, default 0.05
        What one more pose must gain to be worth it.
    ax : matplotlib Axes, optional
        Where it is drawn; by default in a new figure.
    new : bool, default False
        With numbers: whether others were measured before.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    InputError
        For designs of different parameters, or with equal numbers of poses, and as :func:`knee`.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> n = np.arange(4, 31)
    >>> ax = hx.plots.error_against_poses(n, {"base_point": 0.1 / np.sqrt(n), "platform_point": 0.04 / np.sqrt(n)})
    >>> ax.get_title(loc="left")
    'From 10 poses on, one more gains less than 5 %'
    """
    if errors is None:
        number, lines, units, together, least = _of_designs(counts)
        new = any(one.question.measured for one in counts)
    else:
        if not isinstance(errors, Mapping):
            raise InputError(f"errors: expected a dict of errors by block, got {brief(errors)}")
        number = as_array("counts", counts, ("n",), batch=False)
        lines = {name: _amounts(values) for name, values in errors.items()}
        units, together = dict.fromkeys(lines, unit), None
        least = None if bound is None else as_array("bound", bound, (number.size,), batch=False)
    if not lines or any(values.shape != number.shape or not (values > 0).all() for values in lines.values()):
        raise InputError(f"errors: expected blocks with one error > 0 for each of the {number.size} counts")
    enough = knee(number, np.exp(np.mean([np.log(values) for values in lines.values()], axis=0)), share)
    ax = flat_axes(ax, (7.2, 4.4))
    several = len(set(units.values())) > 1
    for k, (name, values) in enumerate(lines.items()):
        label = quantity(name, units[name]) if several else name
        ax.plot(number, values, marker=MARKERS[k % 7], color=COLOURS[k % 7], linewidth=1.5, markersize=5, label=label)
    if together is not None:
        ax.plot(number, together, color=INK, linewidth=1.5, label="all together")
    if least is not None:
        ax.plot(number, least, color=INK, linewidth=1.2, linestyle="--", label="bound: no choice is better")
    if not new:
        last = (together if together is not None else next(iter(lines.values())))[-1]
        ax.plot(number, last * np.sqrt(number[-1] / number), ":", color=BASE, linewidth=1.5, label="as 1/√N")
    ax.set_ylabel(quantity("predicted error", "each in its unit" if several else next(iter(units.values()))))
    return _finish(ax, number, enough, share, "new poses" if new else "poses")


def _finish(ax: Axes, number: Array, enough: int | None, share: float, poses: str) -> Axes:
    """Scales and the knee."""
    ax.set(xscale="log", yscale="log", xlabel=f"{poses}, N")
    ticks = number if number.size <= 9 else TICKS[(number[0] <= TICKS) & (number[-1] >= TICKS)]
    ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 3, 5, 7)))
    ax.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    ax.set_xticks(ticks, [f"{n:g}" for n in ticks])
    ax.minorticks_off()
    if enough is None:
        title = f"Up to {number[-1]:g} {poses}, one more gains {100 * share:g} % or more"
    elif enough == number[0]:
        title = f"One more pose gains less than {100 * share:g} % at all of these numbers"
    else:
        ax.axvline(enough, color=BASE, linewidth=1, linestyle="-.", zorder=1)
        title = f"From {enough} {poses} on, one more gains less than {100 * share:g} %"
    ax.set_title(title, loc="left")
    ax.legend(frameon=False)
    return ax


def _of_designs(designs: Any) -> tuple[Array, dict[str, Array], dict[str, str], Array | None, Array | None]:
    """Counts, errors and units by block, and where they are one quantity their sum and its bound."""
    if not isinstance(designs, (list, tuple)) or not designs or not all(isinstance(one, Design) for one in designs):
        raise InputError("counts: expected a list of designs, or numbers of poses with errors={block: …}")
    ordered = sorted(designs, key=lambda design: len(design.indices))
    first = ordered[0]
    if any(one.labels != first.labels or one.units != first.units for one in ordered):
        raise InputError("counts: these designs are of different parameters")
    number = np.array([float(len(one.indices)) for one in ordered])
    variances = np.stack([np.diag(one.covariance) for one in ordered])
    blocks = np.array([block_of(label) for label in first.labels])
    names = dict.fromkeys(blocks.tolist())
    lines = {name: np.sqrt(variances[:, blocks == name].sum(axis=1)) for name in names}
    units = {name: first.units[int(np.argmax(blocks == name))] for name in names}
    total = variances.sum(axis=1)
    value = np.array([one.value for one in ordered])
    if all(one.criterion == "A" for one in ordered) and len(set(units.values())) == 1 and np.allclose(value, total):
        return number, lines, units, np.sqrt(total), np.sqrt([one.bound for one in ordered])
    return number, lines, units, None, None
