"""How sure a point is: the regions that hold it with 95 % probability, in the three coordinate planes."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from matplotlib.ticker import MaxNLocator

from ..arrays import Array, as_array, brief
from ..errors import InputError
from ..selection.design import Design
from .look import COLOURS, flat_axes, quantity

__all__ = ["error_ellipsoids"]

STYLES = ("-", "--", "-.", ":")
PLANES = ((0, 1), (0, 2), (1, 2))


def error_ellipsoids(
    designs: Design | Sequence[Design | npt.ArrayLike],
    labels: Sequence[str] | None = None,
    which: str = "base_point",
    level: float = 0.95,
    unit: str = "unstated",
) -> Figure:
    r"""Where the error of a point lies: its confidence ellipses in the planes xy, xz and yz, of several designs.

    In each plane the two coordinates lie in the ellipse :math:`e^T C_2^{-1} e \le \chi^2_2(p) = -2\ln(1 - p)` together
    with probability p, :math:`C_2` their 2 × 2 part of the covariance: 5.99 for 95 %. These are regions of each *pair*;
    the shadows of the ellipsoid of all three coordinates, with :math:`\chi^2_3`, are 1.14 times as large.

    Parameters
    ----------
    designs : Design, or a list of them or of array_like, shape (3, 3)
        Designs, or covariances of the point.
    labels : sequence of str, optional
        What they are called; by default their criterion and number of poses.
    which : str, default "base_point"
        The block, a point; of several legs "leg3.base_point".
    level : float, default 0.95
        p.
    unit : str, default "unstated"
        With covariances: the length unit.

    Returns
    -------
    matplotlib Figure
        With three axes of the same scale.

    Raises
    ------
    InputError
        For unknown blocks, covariances that are not finite or not positive definite, designs in different units, or a
        level outside (0, 1).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> figure = hx.plots.error_ellipsoids([np.diag([1.0, 1.0, 9.0]), np.eye(3)], ["random", "chosen"], unit="mm")
    >>> [ax.get_xlabel() for ax in figure.axes]
    ['x (mm)', 'x (mm)', 'y (mm)']
    """
    given = [designs] if isinstance(designs, Design) else designs
    if not isinstance(given, (Sequence, np.ndarray)) or not len(given):
        raise InputError(f"designs: expected one or more designs, or covariances (3, 3); got {brief(designs)}")
    if not isinstance(level, Real) or not 0 < level < 1:
        raise InputError(f"level: expected a probability in (0, 1), such as 0.95; got {brief(level)}")
    found = [_covariance(one, which, unit) for one in given]
    units = {text for _, text in found}
    if len(units) > 1:
        raise InputError(f"designs: they are in different units, {', '.join(sorted(units))}")
    names = [_name(one, i) for i, one in enumerate(given, start=1)] if labels is None else list(labels)
    if len(names) != len(given):
        raise InputError(f"labels: expected {len(given)}, one a design, got {len(names)}")
    factor = -2 * np.log1p(-level)
    reach = 1.1 * np.sqrt(factor * max(float(np.diag(covariance).max()) for covariance, _ in found))
    figure = plt.figure(figsize=(10.0, 3.9), layout="constrained")
    for i, plane in enumerate(PLANES):
        ax = flat_axes(figure.add_subplot(1, 3, i + 1), (0, 0))
        for k, (covariance, _) in enumerate(found):
            ax.add_patch(_ellipse(factor * covariance[np.ix_(plane, plane)], k, names[k]))
        _finish(ax, plane, reach, units.pop() if i == 2 else next(iter(units)))
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{which}: regions of {100 * level:g} % probability", x=0.01, ha="left")
    return figure


def _ellipse(shape: Array, k: int, name: str) -> Ellipse:
    """The set of e with eᵀ shape⁻¹ e = 1: its semi-axes are the roots of the eigenvalues."""
    values, vectors = np.linalg.eigh(shape)
    width, height = 2 * np.sqrt(values)
    angle = np.rad2deg(np.arctan2(vectors[1, 0], vectors[0, 0]))
    colour, style = COLOURS[k % len(COLOURS)], STYLES[k % len(STYLES)]
    return Ellipse(
        (0, 0), width, height, angle=angle, fill=False, edgecolor=colour, linestyle=style, linewidth=2, label=name
    )


def _finish(ax: Axes, plane: tuple[int, int], reach: float, unit: str) -> None:
    ax.plot(0, 0, "+", color="black", markersize=7)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    ax.set(xlabel=quantity("xyz"[plane[0]], unit), ylabel=quantity("xyz"[plane[1]], unit))
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_locator(MaxNLocator(3))  # the numbers may be long


def _covariance(one: Any, which: str, unit: str) -> tuple[Array, str]:
    """The point's covariance (3, 3), and its unit."""
    covariance, text = one, unit
    if isinstance(one, Design):
        wanted = [f"{which}.{axis}" for axis in "xyz"]
        if not set(wanted) <= set(one.labels):
            raise InputError(f"which: no point {which!r}; this design has {', '.join(one.labels)}")
        place = [one.labels.index(label) for label in wanted]
        covariance, text = one.covariance[np.ix_(place, place)], one.units[place[0]]
    matrix = as_array("covariance", covariance, (3, 3), batch=False)
    if not np.allclose(matrix, matrix.T) or np.linalg.eigvalsh(matrix)[0] <= 0:
        raise InputError("covariance: expected a symmetric, positive definite matrix of the point's errors")
    return matrix, text


def _name(one: Any, number: int) -> str:
    return f"{one.criterion}, {len(one.indices)} poses" if isinstance(one, Design) else f"design {number}"
