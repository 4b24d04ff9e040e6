"""What poses see: singular values, standard errors, correlations, and the leverage of every pose."""

from __future__ import annotations

from itertools import pairwise
from textwrap import fill
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from ..arrays import Array, brief
from ..errors import InputError
from ..observing import Observability
from ..selection.design import Design
from .look import ACCENT, BASE, COLOURS, FAINT, INK, block_of, flat_axes, quantity, unit_text

__all__ = ["correlation", "leverage", "singular_values", "standard_errors"]

HATCHES = ("", "///", "...", "xxx", "\\\\\\", "++", "oo")
MOST_NUMBERS = 14  # a larger matrix has no room for its entries


def singular_values(observability: Observability, ax: Axes | None = None) -> Axes:
    r"""The singular values of the whitened, scaled rows, from the largest to the smallest, on a logarithmic scale.

    Twice: by all unknowns, and by the parameters of interest with nuisances eliminated, where there are any. The
    distance of the first from the last is the condition number, which the legend states. Values of 0 are crosses at the
    bottom: what they belong to is not seen at all.

    Parameters
    ----------
    observability : Observability
    ax : matplotlib Axes, optional
        Where it is drawn; by default in a new figure.

    Returns
    -------
    matplotlib Axes

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", 7, noise=hx.UniformNoise(0.01, 2e-4, 0.01), rng=0)
    >>> ax = hx.plots.singular_values(hx.observability(hx.loops.FixedLeg(data)))
    >>> ax.get_ylabel()
    'singular value (scaled, no unit)'
    """
    found = _observed(observability)
    ax = flat_axes(ax, (6.4, 4.2))
    curves = [("all unknowns", found.singular_values, "s-", COLOURS[0])]
    if found.main_singular_values.size < found.singular_values.size:  # else there are no nuisances
        curves.append(("nuisances eliminated", found.main_singular_values, "o-", COLOURS[1]))
    seen = np.concatenate([values[values > 0] for _, values, _, _ in curves])
    bottom = seen.min() / 4
    for name, values, style, colour in curves:
        number, nonzero = np.arange(1, values.size + 1), values > 0
        about = (
            f"condition number {values[0] / values[-1]:.3g}" if nonzero.all() else f"{(~nonzero).sum()} not seen (×)"
        )
        ax.plot(number[nonzero], values[nonzero], style, color=colour, linewidth=1.2, label=f"{name}: {about}")
        if not nonzero.all():
            ax.plot(number[~nonzero], np.full((~nonzero).sum(), bottom), "X", color=colour, markersize=9)
    ax.set(yscale="log", xlabel="number", ylabel="singular value (scaled, no unit)")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_title("Singular values", loc="left")
    ax.legend(frameon=False)
    return ax


def standard_errors(source: Design | Observability, ax: Axes | None = None) -> Axes:
    r"""The predicted standard error :math:`\sqrt{C_{jj}}` of every parameter, as bars by block.

    Every bar ends in its number and unit. The axis is logarithmic where the errors span more than two powers of ten or
    have several units, and each bar then counts in its own. What the poses do not see has no bar but says so.

    Parameters
    ----------
    source : Design or Observability
    ax : matplotlib Axes, optional
        Where it is drawn; by default in a new figure.

    Returns
    -------
    matplotlib Axes

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", 7, noise=hx.UniformNoise(0.01, 2e-4, 0.01), rng=0)
    >>> ax = hx.plots.standard_errors(hx.observability(hx.loops.FixedLeg(data)))
    >>> ax.get_xlabel()
    'predicted standard error (cm)'
    """
    found = source if isinstance(source, Design) else _observed(source)
    doubtful = () if isinstance(found, Design) else found.doubtful
    errors, blocks = found.standard_errors, [block_of(label) for label in found.labels]
    names = list(dict.fromkeys(block.rpartition(".")[2] for block in blocks))
    place = np.arange(errors.size) + 0.6 * np.cumsum([0, *(a != b for a, b in pairwise(blocks))])
    ax = flat_axes(ax, (7.2, 1.3 + 0.3 * place[-1]), grid="x")
    for where, error, label, unit in zip(place, errors, found.labels, found.units, strict=True):
        kind = names.index(block_of(label).rpartition(".")[2])
        if np.isfinite(error):
            colour, hatch = COLOURS[kind % len(COLOURS)], HATCHES[kind % len(HATCHES)]
            ax.barh(where, error, height=0.8, color=colour, hatch=hatch, edgecolor="white")
            text = f"{error:.3g} {unit_text(unit)}".rstrip() + ", as good as not seen" * (label in doubtful)
            ax.annotate(text, (error, where), (5, 0), textcoords="offset points", va="center", fontsize="small")
        else:
            at_edge: dict[str, Any] = {"transform": ax.get_yaxis_transform(), "fontstyle": "italic"}
            ax.text(0.01, where, "not seen by these poses", va="center", fontsize="small", color=ACCENT, **at_edge)
    ax.set_yticks(place, found.labels)
    ax.set_ylim(place[-1] + 0.8, -0.8)
    ax.tick_params(axis="y", length=0)
    _scale_bars(ax, errors[np.isfinite(errors)], tuple(dict.fromkeys(found.units)))
    caveat = "" if isinstance(found, Design) else found.caveat
    ax.set_title(fill(f"Standard errors: {caveat}", 60) if caveat else "Predicted standard errors", loc="left")
    return ax


def _scale_bars(ax: Axes, errors: Array, units: tuple[str, ...]) -> None:
    """The scale of horizontal bars, with room for their numbers."""
    low, high = (errors.min(), errors.max()) if errors.size else (1.0, 1.0)
    if len(units) > 1 or high > 100 * low:
        ax.set_xscale("log")
        ax.set_xlim(low / 3, high * (high / low) ** 0.4 * 2)
    else:
        ax.set_xlim(0, high * 1.25)
    one = len(units) == 1
    ax.set_xlabel(
        quantity("predicted standard error", units[0]) if one else "predicted standard error, each in its unit"
    )


def correlation(observability: Observability, ax: Axes | None = None) -> Axes:
    r"""The correlation of the predicted errors, :math:`C_{ij}/\sqrt{C_{ii}C_{jj}}`, from −1 to 1.

    Orange is positive, purple negative, white none, grey not seen. Up to 14 parameters have their numbers, in
    hundredths.

    Parameters
    ----------
    observability : Observability
    ax : matplotlib Axes, optional
        Where it is drawn; by default in a new figure.

    Returns
    -------
    matplotlib Axes

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", 7, noise=hx.UniformNoise(0.01, 2e-4, 0.01), rng=0)
    >>> ax = hx.plots.correlation(hx.observability(hx.loops.FixedLeg(data)))
    >>> ax.get_title(loc="left")
    'Correlation of the predicted errors (hundredths)'
    """
    found = _observed(observability)
    matrix, labels = found.correlation, found.labels
    numbered = len(labels) <= MOST_NUMBERS
    side = min(max(4.5, 0.42 * len(labels) + 2.2), 14.0)
    ax = flat_axes(ax, (side + 1.0, side), grid="")
    image = ax.imshow(matrix, cmap=mpl.colormaps["PuOr_r"].with_extremes(bad=FAINT), vmin=-1, vmax=1)
    ax.set_xticks(range(len(labels)), labels, rotation=45, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(labels)), labels)
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    for i, j in np.ndindex(matrix.shape if numbered else (0, 0)):
        one = matrix[i, j]
        text = f"{100 * one:.0f}".replace("-", "−") if np.isfinite(one) else "–"
        ax.text(j, i, text, ha="center", va="center", fontsize="small", color="white" if abs(one) > 0.55 else INK)
    ax.figure.colorbar(image, ax=ax, label="correlation", shrink=0.8)
    ax.set_title("Correlation of the predicted errors" + " (hundredths)" * numbered, loc="left")
    return ax


def leverage(observability: Observability, ax: Axes | None = None) -> Axes:
    r"""How much each pose counts: its leverage :math:`\operatorname{tr} M^{-1}M_i`, the parameters it decides alone.

    The dashed line is the mean. Poses with more than twice the mean are drawn in another colour and hatched: an error
    in one of these goes into the result nearly whole.

    Parameters
    ----------
    observability : Observability
    ax : matplotlib Axes, optional
        Where it is drawn; by default in a new figure.

    Returns
    -------
    matplotlib Axes

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", 7, noise=hx.UniformNoise(0.01, 2e-4, 0.01), rng=0)
    >>> ax = hx.plots.leverage(hx.observability(hx.loops.FixedLeg(data)))
    >>> ax.get_xlabel()
    'pose, counted from 0'
    """
    found = _observed(observability)
    values = found.leverage
    ax = flat_axes(ax, (7.2, 4.0), grid="y")
    number, mean = np.arange(values.size), float(values.mean())
    high = values > 2 * mean
    ax.bar(number[~high], values[~high], color=COLOURS[0])
    if high.any():
        ax.bar(
            number[high], values[high], color=ACCENT, hatch="///", edgecolor="white", label="more than twice the mean"
        )
    ax.axhline(mean, color=BASE, linestyle="--", linewidth=1.2, label=f"mean {mean:.3g}")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.set_ylim(0, 1.25 * values.max())
    ax.set(xlim=(-0.7, values.size - 0.3), xlabel=f"{found.per}, counted from 0", ylabel="leverage (no unit)")
    ax.set_title(f"How much each {found.per} counts", loc="left")
    ax.legend(loc="upper right", frameon=False)
    return ax


def _observed(given: object) -> Observability:
    if not isinstance(given, Observability):
        raise InputError(f"expected what observability(loop) returns, got {brief(given)}")
    return given
