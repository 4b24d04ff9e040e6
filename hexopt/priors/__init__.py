r"""Priors on named parameters: losses of their deviation from a nominal, added to the programme.

A prior is a loss of a linear function of x, so that every route and the certificate take it as further rows.
"""

from .base import Prior, PriorRows
from .deviation import Lasso, Ridge
from .gaussian import GaussianPrior

__all__ = ["GaussianPrior", "Lasso", "Prior", "PriorRows", "Ridge"]
