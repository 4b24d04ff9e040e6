"""Least squares and Huber fits of one loop's direct rows by IPOPT: the reference of every nonlinear estimator."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import InputError
from ..loops import Loop
from .equations import row_expressions
from .ipopt import Programme, minimise
from .terms import Fit, Start, Terms, checked_start, norm_equations, residual_unit, result_of

__all__ = ["fit"]


def fit(
    loop: Loop,
    start: Start | None = None,
    *,
    weights: npt.ArrayLike | None = None,
    huber: float | None = None,
    lower: npt.ArrayLike | None = None,
    upper: npt.ArrayLike | None = None,
    prior: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    unit_norm: Sequence[str] = (),
    max_iterations: int = 500,
) -> Fit:
    r"""Minimise :math:`\sum_i\sum_j\rho((W_i g_i(x))_j) + \tfrac12\lVert\Lambda(x - \mu)\rVert^2` for one set of poses.

    :math:`\rho(z) = z^2/2`, or Huber's: :math:`t|z| - t^2/2` beyond the threshold t. Exact Hessians (of Huber's loss on
    either side of the threshold); solved twice, the second time scaled at the first solution. A local minimum: it
    is the start's.

    Parameters
    ----------
    loop : Loop
        Of one set of poses; take a batch set by set.
    start : values, Leg or Estimate, optional
        By default the data's nominal.
    weights : array_like, shape (k, e, e), optional
        Whitening blocks :math:`W_i` of the direct rows, such as ``loop.linearised(x).whitening().blocks``.
    huber : float, optional
        The threshold, in units of the (whitened) rows.
    lower, upper : array_like, shape (p,), optional
        Bounds of the values, infinite where there is none.
    prior : (mean, root), shapes (p,) and (q, p), optional
        :math:`\mu` and :math:`\Lambda`, with :math:`\Lambda^T\Lambda` the precision.
    unit_norm : sequence of str
        Blocks that are kept at length 1, such as "direction".
    max_iterations : int, default 500

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        For a batch, or arguments that do not fit the loop.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "none", n_poses=10, nominal=robot.perturbed(0.3, rng=0), rng=1)
    >>> found = hx.symbolic.fit(hx.loops.LegLength(data))
    >>> found.status, found.values.round(6)
    ('Solve_Succeeded', array([ 7.822, -1.052,  0.   , 12.76 ,  3.9  ,  0.   , 15.25 ]))
    """
    if not isinstance(loop, Loop):
        raise InputError(f"fit: expected a loop of one leg, got {type(loop).__name__}; use maximum_likelihood")
    values = checked_start(loop, start)
    terms = Terms.of(loop, lower, upper, prior, unit_norm)
    if huber is not None and not as_array("huber", huber, (), batch=False) > 0:
        raise InputError(f"huber: expected a threshold > 0, got {huber!r}")
    x = ca.SX.sym("x", len(values))
    blocks = {name: x[loop.parameters[name]] for name in loop.parameters.names}
    rows = ca.vertcat(*row_expressions(loop, blocks, values))
    if weights is not None:
        rows = _weighted(rows, as_array("weights", weights, ("k", "e", "e"), batch=False))
    extra = terms.prior_rows(x)
    loss = 0.5 * ca.sumsqr(rows) if huber is None else _huber(rows, huber)
    programme = Programme(
        x,
        loss + 0.5 * ca.sumsqr(extra),
        norm_equations(loop, x, terms.unit_norm),
        terms.lower,
        terms.upper,
    )
    all_rows = ca.vertcat(rows, extra)
    both = ca.Function("rows", [x], [all_rows, ca.jacobian(all_rows, x)])
    iterations = 0
    for _ in range(2):
        residual, jacobian = (part.full() for part in both(values))
        unit, scale = _units(residual[:, 0], jacobian, values)
        found = minimise(programme, values, scale, unit=unit**2, max_iterations=max_iterations)
        iterations += found.iterations
        if not found.success:
            break
        values = found.values
    return result_of(found, len(values), iterations)


def _weighted(rows: ca.SX, blocks: Array) -> ca.SX:
    count, size = blocks.shape[:2]
    if blocks.shape[2] != size:
        raise InputError(f"weights: expected square blocks (k, e, e), got shape {blocks.shape}")
    if count * size != rows.numel():
        raise InputError(f"weights: {count} blocks of {size} rows do not fit {rows.numel()} rows")
    return ca.vertcat(*(ca.DM(block) @ rows[i * size : (i + 1) * size] for i, block in enumerate(blocks)))


def _huber(rows: ca.SX, threshold: float) -> ca.SX:
    """Huber's loss of all rows, with its second derivative on either side of the threshold."""
    size = ca.fabs(rows)
    return ca.sum1(ca.if_else(size <= threshold, 0.5 * rows**2, threshold * (size - 0.5 * threshold)))


def _units(residual: Array, jacobian: Array, values: Array) -> tuple[float, Array]:
    """A typical residual of the solution, and what changes each value makes such residuals."""
    rest = residual - jacobian @ np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    unit = residual_unit(rest, jacobian, values)
    length = np.sqrt(np.sum(jacobian**2, axis=0))
    return unit, unit / np.where(length > 0, length, 1.0)
