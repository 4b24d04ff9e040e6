r"""Batched minimisation of a quadratic on the unit sphere, globally and with proof.

.. math:: \min_n \tfrac12 n^T H n - g^T n \quad\text{subject to}\quad \lVert n\rVert = 1 .

A quadratic with one quadratic equality has no duality gap: n is a global minimiser exactly if some multiplier
:math:`\lambda` has :math:`(H + \lambda I)\, n = g` and :math:`H + \lambda I \succeq 0`. In the axes of H, with
eigenvalues :math:`h_1 \le \ldots \le h_q` and :math:`\gamma = V^T g`, that is one equation in
:math:`\mu = \lambda + h_1 \ge 0`,

.. math:: \lVert z(\mu)\rVert = 1, \qquad z_i(\mu) = \gamma_i / (h_i - h_1 + \mu) .

Its form :math:`1/\lVert z(\mu)\rVert - 1` increases and is concave, so that Newton's steps from any point left of the
root approach it from the left, quadratically; a step from the right of it lands on the left (Moré and Sorensen 1983;
Conn, Gould and Toint 2000, section 7.3). In the hard case, :math:`\gamma_1 = 0` and
:math:`\lVert z(0)\rVert < 1`, :math:`z_1` of either sign completes z: there are two minimisers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, BoolArray, matvec, norm

__all__ = ["SphereMinimum", "minimise_on_sphere"]

EPS = float(np.finfo(float).eps)
TINY = float(np.finfo(float).tiny)
#: Newton steps; convergence is quadratic, from the left at every step but the first.
MAX_ITERATIONS = 100
#: A last step of this share of μ is rounding.
SETTLED = 4 * EPS


@dataclass(frozen=True, eq=False)
class SphereMinimum:
    r"""Global minimisers on the unit sphere, and the proof that they are.

    Attributes
    ----------
    values : ndarray, shape (..., q)
        n.
    multiplier : ndarray, shape (...)
        :math:`\lambda`, with :math:`H + \lambda I` positive definite by at least the rounding of H.
    bound : ndarray, shape (...)
        The dual value :math:`-\tfrac12 g^T(H + \lambda I)^{-1}g - \tfrac12\lambda`: nothing on the sphere is below it.
    gap : ndarray, shape (...)
        Objective minus bound, :math:`\tfrac12 r^T(H + \lambda I)^{-1}r` for :math:`r = (H + \lambda I)n - g`.
    unique : ndarray of bool, shape (...)
        Whether that minimiser is the only one; in the hard case it is not.
    mirror : ndarray, shape (..., q)
        n with the other sign along the first axis: the other minimiser, where there is one.
    """

    values: Array
    multiplier: Array
    bound: Array
    gap: Array
    unique: BoolArray
    mirror: Array


def minimise_on_sphere(curvature: Array, axes: Array, pull: Array, rounding: Array | None = None) -> SphereMinimum:
    r"""Minimise :math:`\tfrac12 n^T H n - g^T n` on the unit sphere, each member of the batch by itself.

    H comes by its axes, so that its small eigenvalues keep the digits that the caller has.

    Parameters
    ----------
    curvature : ndarray, shape (..., q)
        Eigenvalues of H, ascending, of any sign.
    axes : ndarray, shape (..., q, q)
        Eigenvectors of H, in columns.
    pull : ndarray, shape (..., q)
        :math:`\gamma = V^T g`, the linear term along the axes.
    rounding : ndarray, shape (...), optional
        How wrong the smallest eigenvalue may be; by default 16 roundings of the largest. A smaller :math:`\mu`
        cannot be told from the hard case.
    """
    if rounding is None:
        rounding = 16 * EPS * np.abs(curvature).max(axis=-1)
    floor = np.maximum(rounding, TINY)
    above = curvature - curvature[..., :1]
    shift = _secular_root(above, pull, floor, curvature[..., 0])
    stiff = above + shift[..., None]
    z = pull / stiff
    missing = 1.0 - np.einsum("...i,...i->...", z[..., 1:], z[..., 1:])
    hard = (shift <= floor) & (missing - np.square(z[..., 0]) > SETTLED)
    z[..., 0] = np.where(hard, np.copysign(np.sqrt(np.maximum(missing, 0.0)), pull[..., 0]), z[..., 0])
    z /= norm(z)[..., None]
    left = stiff * z - pull
    gap = 0.5 * np.einsum("...i,...i->...", left, left / stiff)
    objective = np.einsum("...i,...i->...", z, 0.5 * curvature * z - pull)
    turned = z * np.where(np.arange(z.shape[-1]) == 0, -1.0, 1.0)
    return SphereMinimum(
        matvec(axes, z), shift - curvature[..., 0], objective - gap, gap, np.asarray(~hard), matvec(axes, turned)
    )


def _secular_root(above: Array, pull: Array, floor: Array, start: Array) -> Array:
    """The μ ≥ floor at which z(μ) has length one, or the floor where it is shorter even there.

    The root lies right of every |γ_i| − (h_i − h_1), and from there on no |z_i| exceeds one.
    """
    lower = np.maximum(floor, ((1 - SETTLED) * np.abs(pull) - (1 + SETTLED) * above).max(axis=-1))
    shift = np.maximum(lower, start)
    for _ in range(MAX_ITERATIONS):
        stiff = above + shift[..., None]
        z = pull / stiff
        size = norm(z)
        slope = np.einsum("...i,...i->...", z, z / stiff)
        wanted = np.divide((size - 1) * np.square(size), slope, out=np.full(shift.shape, -np.inf), where=slope > 0)
        after = np.maximum(lower, shift + wanted)
        settled = np.abs(after - shift) <= SETTLED * shift
        shift = np.where(settled, shift, after)
        if settled.all():
            break
    return shift
