r"""The spatial Burmester problem: which points of a body stay on a sphere through seven of its poses, and on which one.

The squared loops of a pose, :math:`\lVert P_i + R_i b - a\rVert^2 = \ell^2`, minus their mean over the poses are six
equations bilinear in (1, b) and (1, a), :math:`F(b)\,(1, a)^T = 0` with F (6 × 4) affine in b. Each of them times each
monomial of b up to degree 3 is a row of a block Macaulay matrix (120 × 140). Its null space N has dimension 20, and
holds at a solution the vector of all monomials up to degree 4 times (1, a). With :math:`N_u` the part of N that
monomials of degree 3 times the linear form :math:`u^T(1, b)` are read from,

.. math:: N_v\, x = \lambda\, N_u\, x, \qquad \lambda = \frac{v^T (1, b)}{u^T (1, b)},

is an eigenproblem of size 20 for two forms u, v in general position, and N x gives b and a. Newton's method on the six
equations brings them to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, frozen, norm, transpose

__all__ = ["COUNT", "POSES", "BurmesterSolutions", "burmester_solutions"]

ComplexArray = npt.NDArray[np.complex128]

#: Poses, and complex solutions, of a regular problem.
POSES, COUNT = 7, 20
#: The linear forms u and v: fixed, and in no special position to any pose.
_FORMS = np.array([[0.4172, 0.6215, -0.2963, 0.5934], [0.3387, -0.5561, 0.5129, 0.5597]])
_CUBIC = tuple(combinations_with_replacement(range(4), 3))
_QUARTIC: dict[tuple[int, ...], int] = {m: i for i, m in enumerate(combinations_with_replacement(range(4), 4))}
#: Which quartic monomial of (1, b) a cubic one becomes times each entry of (1, b), (20, 4).
_TIMES = np.array([[_QUARTIC[tuple(sorted((*monomial, j)))] for j in range(4)] for monomial in _CUBIC])
#: Pivots below this share are rounding (regular problems have 1e-4 and more, degenerate ones 1e-13 and less).
_RANK = 1e-10
#: Residuals up to this are solutions; solutions nearer to each other than this share may be one.
_RESIDUAL, _APART = 1e-12, 1e-5
_NEWTON_STEPS = 4
_CHUNK = 64  # problems at once, so that their matrices of 120 × 140 stay near the processor


@dataclass(frozen=True, eq=False)
class BurmesterSolutions:
    """All solutions of the spatial Burmester problem, one after the other.

    Attributes
    ----------
    platform_points, base_points : ndarray of complex, shape (..., 20, 3)
        b and a; NaN where the problem is not regular.
    residual : ndarray, shape (..., 20)
        The largest violation of an equation, relative to the size of its terms.
    real : ndarray of bool, shape (..., 20)
        Which solutions are real; the others come in conjugate pairs.
    regular : ndarray of bool, shape (...)
        Whether there are exactly 20 solutions; else there are infinitely many, or more than the method can tell.
    complete : ndarray of bool, shape (...)
        Whether all 20 were found: all to rounding, no two alike.
    """

    platform_points: ComplexArray
    base_points: ComplexArray
    residual: Array
    real: BoolArray
    regular: BoolArray
    complete: BoolArray


def burmester_solutions(position: Array, rotation: Array) -> BurmesterSolutions:
    r"""All (b, a) whose distance :math:`\lVert P_i + R_i b - a\rVert` is the same in seven poses.

    Parameters
    ----------
    position, rotation : ndarray, shape (..., 7, 3) and (..., 7, 3, 3)

    Notes
    -----
    About 1.1 ms a problem, two fifths of it for the QR of the Macaulay matrix.

    References
    ----------
    Innocenti (1995), "Polynomial solution of the spatial Burmester problem".

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), leg=3, lock="length", n_poses=7, rng=0)
    >>> found = burmester_solutions(data.position, data.rotation)
    >>> found.base_points.shape, bool(found.complete)
    ((20, 3), True)
    """
    batch = position.shape[:-2]
    origin = position.mean(axis=-2).reshape(-1, 1, 3)
    forms, unit, regular = _equations(position.reshape(-1, POSES, 3) - origin, rotation.reshape(-1, POSES, 3, 3))
    points = np.full((len(forms), COUNT, 6), np.nan, dtype=complex)
    residual = np.full((len(forms), COUNT), np.nan)
    real, complete = np.zeros((len(forms), COUNT), dtype=bool), np.zeros(len(forms), dtype=bool)
    solvable = np.flatnonzero(regular)
    for start in range(0, len(solvable), _CHUNK):
        part = solvable[start : start + _CHUNK]
        null, full = _null_space(forms[part])
        regular[part] = full
        part = part[full]
        with np.errstate(all="ignore"):  # a solution that runs away to infinity is not complete
            points[part], residual[part] = _polished(forms[part], *_roots(null[full]))
            real[part], apart = _sorted_out(points[part])
        complete[part] = apart & (residual[part] < _RESIDUAL).all(axis=-1)
    points.imag[real] = 0.0
    points *= unit[:, None, None]
    points[..., 3:] += origin
    points = points.reshape(*batch, COUNT, 6)
    return BurmesterSolutions(
        frozen(points[..., :3]),
        frozen(points[..., 3:]),
        frozen(residual.reshape(*batch, COUNT)),
        frozen(real.reshape(*batch, COUNT)),
        frozen(regular.reshape(batch)),
        frozen(complete.reshape(batch)),
    )


def _equations(position: Array, rotation: Array) -> tuple[Array, Array, BoolArray]:
    """Six orthonormal bilinear forms in (1, b) and (1, a), (k, 6, 4, 4), the unit of b and a in them, and their rank.

    The unit balances turns against shifts: :math:`s/r` for poses that are s and r apart.
    """
    count = len(position)
    back = transpose(rotation)
    forms = np.empty((count, POSES, 4, 4))
    forms[..., 0, 0] = 0.5 * np.einsum("kni,kni->kn", position, position)
    forms[..., 1:, 0] = np.einsum("knij,knj->kni", back, position)
    forms[..., 0, 1:] = -position
    forms[..., 1:, 1:] = -back
    forms -= forms.mean(axis=1, keepdims=True)
    shift = np.sqrt(np.mean(forms[..., 0, 1:] ** 2, axis=(1, 2)))
    turn = np.sqrt(np.mean(forms[..., 1:, 1:] ** 2, axis=(1, 2, 3)))
    unit = np.divide(shift, turn, out=np.ones(count), where=(shift > 0) & (turn > 0))
    scale = np.ones((count, 4))
    scale[:, 1:] = unit[:, None]
    forms *= (scale[:, :, None] * scale[:, None, :])[:, None]
    _, size, rows = np.linalg.svd(forms.reshape(count, POSES, 16), full_matrices=False)
    independent: BoolArray = size[:, POSES - 2] > _RANK * size[:, 0]
    return rows[:, : POSES - 1].reshape(count, POSES - 1, 4, 4), unit, independent


def _null_space(forms: Array) -> tuple[Array, BoolArray]:
    """A basis (k, 35, 4, 20) of what the block Macaulay matrix maps to zero, and whether there is no more."""
    count = len(forms)
    matrix = np.zeros((count, len(_CUBIC), POSES - 1, len(_QUARTIC), 4))
    for rows, columns in enumerate(_TIMES):
        matrix[:, rows][:, :, columns] = forms
    full, triangle = np.linalg.qr(transpose(matrix.reshape(count, 120, 140)), mode="complete")
    pivots = np.abs(np.diagonal(triangle, axis1=-2, axis2=-1))
    return (
        full[..., 120:].reshape(count, len(_QUARTIC), 4, COUNT),
        pivots.min(axis=-1) > _RANK * pivots.max(axis=-1),
    )


def _roots(null: Array) -> tuple[ComplexArray, ComplexArray]:
    """(1, b) and (1, a) of all solutions, (k, 20, 4), from the eigenvectors of the shift between two linear forms."""
    count = len(null)
    shifted = np.einsum("fj,kmjlv->fkmlv", _FORMS, null[:, _TIMES]).reshape(2, count, 80, COUNT)
    _, vectors = np.linalg.eig(np.linalg.pinv(shifted[0]) @ shifted[1])
    whole = np.swapaxes(null.reshape(count, 140, COUNT) @ vectors, -1, -2).reshape(count, COUNT, 35, 4)
    by_entry = whole[:, :, _TIMES]  # cubics × (1, b) × (1, a), of rank one in each pair
    platform = np.einsum("ksmjl,ksml->ksj", by_entry, by_entry[..., 0, :].conj())
    base = np.einsum("ksml,ksm->ksl", whole, whole[..., 0].conj())
    return platform / platform[..., :1], base / base[..., :1]


def _polished(forms: Array, platform: ComplexArray, base: ComplexArray) -> tuple[ComplexArray, Array]:
    """The solutions (k, 20, 6) after Newton's method on the six equations, and their residuals (k, 20)."""
    # an exactly singular member would raise for the whole batch; this is too small to matter to Newton's method
    guard = np.finfo(float).eps * np.eye(6)
    for step in range(_NEWTON_STEPS + 1):
        of_base = np.einsum("kijl,ksj->ksil", forms, platform)
        of_platform = np.einsum("kijl,ksl->ksij", forms, base)
        misclosure = np.einsum("ksil,ksl->ksi", of_base, base)
        if step < _NEWTON_STEPS:
            jacobian = np.concatenate([of_platform[..., 1:], of_base[..., 1:]], axis=-1) + guard
            change = np.linalg.solve(jacobian, misclosure[..., None])[..., 0]
            platform[..., 1:] -= change[..., :3]
            base[..., 1:] -= change[..., 3:]
    size = norm(np.abs(platform)) * norm(np.abs(base))
    return np.concatenate([platform[..., 1:], base[..., 1:]], axis=-1), np.abs(misclosure).max(axis=-1) / size


def _sorted_out(points: ComplexArray) -> tuple[BoolArray, BoolArray]:
    """Which solutions (k, 20, 6) are their own conjugates, and of which problems no two are alike."""
    conjugate = norm(np.abs(points.conj()[:, :, None] - points[:, None]))
    apart = norm(np.abs(points[:, :, None] - points[:, None])) + np.where(np.eye(COUNT, dtype=bool), np.inf, 0.0)
    distinct: BoolArray = (apart.min(axis=-1) > _APART * (1.0 + norm(np.abs(points)))).all(axis=-1)
    return conjugate.argmin(axis=-1) == np.arange(COUNT), distinct
