r"""Small semidefinite programmes by Clarabel's own interface; nothing that it says is taken as proof.

:math:`\min_x\, q^T x` s.t. :math:`b - A x \in \mathcal K`, a product of cones: zero, the orthant, second-order cones
:math:`\lVert (s_2, s_3)\rVert \le s_1`, and positive semidefinite matrices. These are packed: the upper triangle column
by column, off the diagonal times :math:`\sqrt 2`, so that :math:`\langle Z, M\rangle` is a scalar product.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..arrays import Array

__all__ = ["Rows", "packed", "root_of", "solve_cones", "unpacked"]

#: Of Clarabel: absolute and relative, for programmes scaled to about 1.
TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows b − A x in cones of one kind: `size` is that of the matrix where it is semidefinite, 3 of every ball."""

    kind: Literal["zero", "orthant", "ball", "semidefinite"]
    matrix: Array
    rhs: Array
    size: int = 0

    def widened(self, width: int) -> Rows:
        """The same rows, with zeros for the last variables, which they lack."""
        return replace(self, matrix=np.pad(self.matrix, ((0, 0), (0, width - self.matrix.shape[1]))))


def packed(matrix: Array) -> Array:
    """The upper triangles of symmetric (..., m, m) column by column, shape (..., m(m + 1)/2)."""
    column, row = np.tril_indices(matrix.shape[-1])
    return matrix[..., row, column] * np.where(column == row, 1.0, np.sqrt(2.0))


def unpacked(vector: Array, size: int) -> Array:
    """The symmetric matrices (..., m, m) of packed ones."""
    column, row = np.tril_indices(size)
    out = np.zeros((*vector.shape[:-1], size, size))
    out[..., row, column] = out[..., column, row] = vector / np.where(column == row, 1.0, np.sqrt(2.0))
    return out


def root_of(matrix: Array) -> Array:
    """F with :math:`F F^T` the positive semidefinite part of symmetric (..., m, m)."""
    values, vectors = np.linalg.eigh(matrix)
    return vectors * np.sqrt(np.clip(values, 0.0, None))[..., None, :]


def solve_cones(cost: Array, rows: Sequence[Rows]) -> tuple[Array, list[Array]] | None:
    """Clarabel's x, and its multipliers of every part of the rows; None where it gives no numbers."""
    import clarabel
    import scipy.sparse as sp

    settings = clarabel.DefaultSettings()
    settings.verbose = settings.presolve_enable = settings.chordal_decomposition_enable = False
    settings.equilibrate_enable = False  # the rows come in good units; balanced again, it fails where κ is large
    settings.max_threads = 1
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = TOLERANCE
    made = {"zero": clarabel.ZeroConeT, "orthant": clarabel.NonnegativeConeT}
    cones: list[Any] = []
    for part in rows:
        if part.kind == "semidefinite":
            cones.append(clarabel.PSDTriangleConeT(part.size))
        elif part.kind == "ball":
            cones += [clarabel.SecondOrderConeT(3)] * (len(part.rhs) // 3)
        else:
            cones.append(made[part.kind](len(part.rhs)))
    matrix = sp.vstack([sp.csc_matrix(part.matrix) for part in rows], format="csc")
    rhs = np.concatenate([part.rhs for part in rows])
    none = sp.csc_matrix((len(cost), len(cost)))
    try:
        found = clarabel.DefaultSolver(none, cost, matrix, rhs, cones, settings).solve()
    except BaseException as error:  # pyo3's PanicException is no Exception
        if type(error).__name__ != "PanicException":
            raise
        return None
    x, z = np.array(found.x), np.array(found.z)
    if not (np.isfinite(x).all() and np.isfinite(z).all()):
        return None
    return x, np.split(z, np.cumsum([len(part.rhs) for part in rows])[:-1])
