"""The five observability indices of the literature, from singular values."""

from __future__ import annotations

import numpy as np

from ..arrays import Array

__all__ = ["observability_indices"]


def observability_indices(singular: Array, n_poses: int = 1) -> Array:
    r"""O1…O5 of singular values :math:`\sigma_1 \ge … \ge \sigma_k`, (..., k), shape (..., 5); larger is better.

    .. math:: O_1 = \frac{(\prod\sigma_j)^{1/k}}{\sqrt{N}}, \quad O_2 = \frac{\sigma_k}{\sigma_1}, \quad
              O_3 = \sigma_k, \quad O_4 = \frac{\sigma_k^2}{\sigma_1}, \quad O_5 = \frac{1}{\sum 1/\sigma_j}.

    Parameters
    ----------
    singular : ndarray, shape (..., k)
        In descending order; all indices are 0 where one is 0.
    n_poses : int, default 1
        N.

    References
    ----------
    O1: Borm and Menq (1991). O2, the inverse of the condition number: Driels and Pathre (1990). O3: Nahvi, Hollerbach
    and Hayward (1994). O4, the noise amplification index: Nahvi and Hollerbach (1996). O5: Sun and Hollerbach (2008).
    """
    seen = singular[..., -1] > 0
    safe = np.where(seen[..., None], singular, 1.0)
    first, last = safe[..., 0], safe[..., -1]
    geometric = np.exp(np.log(safe).mean(axis=-1)) / np.sqrt(n_poses)
    harmonic = 1 / (1 / safe).sum(axis=-1)
    values = np.stack([geometric, last / first, last, last**2 / first, harmonic], axis=-1)
    return np.where(seen[..., None], values, 0.0)
