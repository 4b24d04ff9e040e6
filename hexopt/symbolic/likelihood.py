"""Exact maximum likelihood by IPOPT: the errors of the measurements are unknowns, the equations hold exactly."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array
from ..errors import InputError
from ..loops import PlatformPose
from ..loops.implicit import Implicit
from ..loops.known import square_root
from ..loops.set_equation import SetEquation
from .equations import Roots, Standard, implicit_rows
from .ipopt import Programme, minimise
from .terms import Fit, Start, Terms, checked_start, norm_equations, residual_unit, result_of

__all__ = ["maximum_likelihood", "pose_fit"]


def maximum_likelihood(
    target: Implicit,
    start: Start | None = None,
    *,
    unit_norm: bool = True,
    lower: npt.ArrayLike | None = None,
    upper: npt.ArrayLike | None = None,
    prior: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    max_iterations: int = 500,
) -> Fit:
    r"""Minimise :math:`\tfrac12\sum_i e_i^T\Sigma_i^{-1}e_i` subject to :math:`g_i(x, m_i + e_i) = 0`.

    The Gauss–Helmert model with no step of it linearised: :math:`e_i = F_i z_i`, :math:`F_i F_i^T = \Sigma_i`, with x
    and all z as unknowns of one programme; :math:`\Sigma_i` may be singular. What all poses share has a z of its own:
    an error of the set (``noise.common()``), and the errors of known values that are estimates with a covariance.

    Parameters
    ----------
    target : Loop, Sets, WholeRobot or PlatformPose
        With noise models, of one problem; take a batch set by set. A :class:`~hexopt.loops.PlatformPose` has the six
        leg equations of every pose, and needs no forward kinematics.
    start : values, geometry or Estimate, optional
        By default ``target.start()``.
    unit_norm : bool, default True
        Keep directions at length 1.
    lower, upper : array_like, shape (p,), optional
    prior : (mean, root), shapes (p,) and (q, p), optional
        Adds :math:`\tfrac12\lVert\Lambda(x - \mu)\rVert^2`.
    max_iterations : int, default 500

    Returns
    -------
    Fit
        With the errors (n, e) of each set, shared parts included; "equations" among the multipliers.

    Raises
    ------
    InputError
        For a batch, measurements without a noise model, or one that leaves all equations without any error.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    >>> data = hx.simulate_leg(robot, 3, "direction", n_poses=7, noise=noise, nominal=robot, rng=1)
    >>> loop = hx.loops.FixedDirection(data)
    >>> found = hx.symbolic.maximum_likelihood(loop)
    >>> found.status, float(np.linalg.norm(found.values[loop.parameters["direction"]]).round(9))
    ('Solve_Succeeded', 1.0)
    """
    values = checked_start(target, start)
    terms = Terms.of(target, lower, upper, prior, target.unit_vectors if unit_norm else ())
    roots = [_roots(part) for part, _ in target.parts]
    return _solved(target, values, roots, terms, max_iterations)


def pose_fit(
    loop: PlatformPose,
    start: Start | None = None,
    *,
    weights: npt.ArrayLike | None = None,
    lower: npt.ArrayLike | None = None,
    upper: npt.ArrayLike | None = None,
    prior: tuple[npt.ArrayLike, npt.ArrayLike] | None = None,
    max_iterations: int = 500,
) -> Fit:
    r"""Minimise :math:`\tfrac12\sum_i\lVert W_i g_i\rVert^2`, :math:`g_i = (\hat P_i - P_i, \log(\hat R_i R_i^T))`.

    The forward-kinematics calibration without forward kinematics: the computed poses :math:`(\hat P_i, \hat R_i)` are
    unknowns too, under :math:`\lVert\hat P_i + \hat R_i b_k - a_k\rVert = \gamma_k\rho_{ik} + \delta_k` for all legs.

    Parameters
    ----------
    loop : PlatformPose
        Of one set of poses.
    start : values, Hexapod or Estimate, optional
        By default the data's nominal; the poses start where they were measured.
    weights : array_like, shape (6, 6) or (n, 6, 6), optional
        :math:`W_i`, invertible; by default positions and radians as they are.
    lower, upper : array_like, shape (p,), optional
    prior : (mean, root), shapes (p,) and (q, p), optional
    max_iterations : int, default 500

    Returns
    -------
    Fit
        With the rows :math:`g_i` as the first six columns of its errors, (n, 12).

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate(robot, n_poses=10, nominal=robot.perturbed(0.3, offsets=0.3, rng=0), rng=1)
    >>> loop = hx.loops.PlatformPose(data)
    >>> bool(abs(hx.symbolic.pose_fit(loop).values - loop.values(robot)).max() < 1e-9)
    True
    """
    if not isinstance(loop, PlatformPose):
        raise InputError(f"pose_fit: expected a PlatformPose, got {type(loop).__name__}; use fit or maximum_likelihood")
    values = checked_start(loop, start)
    terms = Terms.of(loop, lower, upper, prior, ())
    blocks = np.eye(6) if weights is None else as_array("weights", weights, (6, 6))
    if blocks.ndim > 3 or np.linalg.matrix_rank(blocks).min() < 6:
        raise InputError(f"weights: expected invertible matrices, (6, 6) or (n, 6, 6), got shape {blocks.shape}")
    root = np.zeros((loop.data.n_poses, 12, 6))
    root[:, :6] = np.linalg.inv(blocks)
    return _solved(loop, values, [(root, None)], terms, max_iterations)


def _solved(target: Implicit, values: Array, roots: Sequence[Roots], terms: Terms, max_iterations: int) -> Fit:
    """Minimise ½‖z‖² and the prior under the equations, first scaled at the start, then at the solution."""
    standard, x = Standard(), ca.SX.sym("x", len(values))
    rows, errors = implicit_rows(target, x, values, roots, standard)
    z, extra = ca.vertcat(*standard.parts), terms.prior_rows(x)
    both, size, free = ca.vertcat(x, z), len(values), np.full(z.numel(), np.inf)
    lower, upper = np.concatenate([terms.lower, -free]), np.concatenate([terms.upper, free])
    objective = 0.5 * (ca.sumsqr(z) + ca.sumsqr(extra))
    norms = norm_equations(target, x, terms.unit_norm)
    sides = ca.Function("sides", [both], [ca.jacobian(part, by) for part, by in ((rows, x), (rows, z), (extra, x))])
    point, iterations = np.concatenate([values, np.zeros(z.numel())]), 0
    for _ in range(2):
        by_value, by_error, by_prior = (part.full() for part in sides(point))
        deviation = _deviations(by_error)
        unit = residual_unit(point[size:], by_value / deviation[:, None], point[:size])
        length = np.sqrt(np.sum(np.vstack([by_value / deviation[:, None], by_prior]) ** 2, axis=0))
        scale = unit * np.concatenate([1.0 / np.where(length > 0, length, 1.0), np.ones(z.numel())])
        deviation = unit * deviation
        programme = Programme(both, objective, {"equations": rows / ca.DM(deviation), **norms}, lower, upper)
        found = minimise(programme, point, scale, unit=unit**2, max_iterations=max_iterations)
        found.multipliers["equations"] /= deviation
        iterations += found.iterations
        if not found.success:
            break
        point = found.values
    moved = [part.full() for part in ca.Function("errors", [both], errors).call([ca.DM(found.values)])]
    return result_of(found, size, iterations, tuple(part if found.success else np.nan * part for part in moved))


def _roots(part: SetEquation) -> Roots:
    """Roots of the covariances that the noise model of a set gives its errors."""
    own = square_root(part.error_covariance)
    common = part.data.noise.common(own.shape[-2] - 6)
    return own, None if common is None else square_root(common)


def _deviations(by_error: Array) -> Array:
    """The standard deviation of each equation; those without error borrow that of the others."""
    deviation = np.sqrt(np.sum(by_error**2, axis=1))
    if not deviation.any():
        raise InputError("the noise model leaves all equations without any error: there is nothing to adjust")
    return np.where(deviation > 0, deviation, deviation[deviation > 0].mean())
