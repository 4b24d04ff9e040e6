r"""Losses of whitened residuals, each with a NumPy face and a cvxpy face.

One convention: :math:`\rho(z) = z^2/2` near zero, thresholds in standard deviations. Every built-in loss is
the support function of a ball, smoothed (M = 1) or not (M = 0),

.. math:: \rho(z) = \sup_{u \in U} u^T z - \tfrac{M}{2}\lVert u\rVert^2,

so that three attributes say it all: what the ball holds together (`per`: a row, the block of a pose, or all
rows), its radius (`bound`) and M (`curvature`). U is the ball of the dual norm: an interval per row, a
Euclidean ball per pose, and for the largest residual :math:`\lVert u\rVert_1 \le 1`.
"""

from .base import Loss
from .chebyshev import Chebyshev
from .posewise import GroupHuber, GroupL1
from .rowwise import L1, Huber, Quadratic

__all__ = ["L1", "Chebyshev", "GroupHuber", "GroupL1", "Huber", "Loss", "Quadratic"]
