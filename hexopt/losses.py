r"""Losses :math:`\sum_i \rho(z_i)` of whitened residuals, each with a NumPy and a cvxpy face.

One convention: :math:`\rho(z) = z^2/2` near zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .arrays import Array

__all__ = ["Quadratic"]


@dataclass(frozen=True)
class Quadratic:
    r"""Least squares: :math:`\rho(z) = z^2/2`.

    Examples
    --------
    >>> import numpy as np
    >>> Quadratic().rho(np.array([2.0]))
    array([2.])
    """

    def rho(self, residual: Array) -> Array:
        """z²/2."""
        value: Array = 0.5 * np.square(residual)
        return value

    def psi(self, residual: Array) -> Array:
        """z."""
        return residual

    def expression(self, residual: Any) -> Any:
        """½‖z‖², as cvxpy's sum of squares."""
        import cvxpy as cp

        return 0.5 * cp.sum_squares(residual)
