r"""Information matrices of poses, :math:`M(w) = M_0 + \sum_i w_i M_i`, and the covariance that weights promise.

What is of interest stands first, in units of its expected spread, and all that is estimated on the way (nuisances,
shared errors) behind it. The covariance of what is of interest is :math:`C(w) = K^T M(w)^{-1} K`,
:math:`K = [I\;0]^T`: the inverse of the Schur complement.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, frozen, transpose
from ..numerics.lstsq import null_combinations
from ..parameters import Block, Parameters

__all__ = ["PoseInformation", "inverse_root", "main_covariance"]

#: Eigenvalues of M(w), with a unit diagonal, below this are rounding: the poses do not see all parameters.
RANK = 1e-12


@dataclass(frozen=True, eq=False)
class PoseInformation:
    r"""Information of n poses about m coordinates, of which the first k are of interest, in S scenarios.

    Attributes
    ----------
    blocks : ndarray, shape (S, n, m, m)
        :math:`M_i` of every pose.
    fixed : ndarray, shape (S, m, m)
        :math:`M_0`, what is there before.
    labels, units : tuple of str
        The k scalars of interest.
    spread : ndarray, shape (k,)
        The unit of each coordinate of interest: its parameter's expected spread.
    others : tuple of str
        What the m − k other coordinates are, for messages.
    """

    blocks: Array
    fixed: Array
    labels: tuple[str, ...]
    units: tuple[str, ...]
    spread: Array
    others: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("blocks", "fixed", "spread"):
            object.__setattr__(self, name, frozen(np.ascontiguousarray(getattr(self, name))))

    @property
    def n_poses(self) -> int:
        """n."""
        return int(self.blocks.shape[-3])

    @property
    def size(self) -> int:
        """m, all coordinates."""
        return int(self.blocks.shape[-1])

    @property
    def main(self) -> int:
        """k, those of interest, which stand first."""
        return len(self.labels)

    def take(self, index: Any) -> Self:
        """Some of the poses."""
        return replace(self, blocks=self.blocks[:, index])

    def total(self, weights: npt.NDArray[Any]) -> Array:
        r""":math:`M(w)` of weights (n,), shape (S, m, m)."""
        used = np.flatnonzero(weights)
        blocks = self.blocks if len(used) == len(weights) else self.blocks[:, used]
        return self.fixed + (weights[used] @ blocks.reshape(*blocks.shape[:2], self.size**2)).reshape(self.fixed.shape)

    def unseen(self, total: Array) -> tuple[str, ...]:
        """What one singular information matrix (m, m) does not see, in words."""
        scale = np.sqrt(np.diag(total))
        safe = np.where(scale > 0, scale, 1.0)
        scaled = total / safe[:, None] / safe
        lost = int((np.linalg.eigvalsh(scaled) <= RANK).sum())
        scalars = Parameters(tuple(Block(label, 1, unit) for label, unit in zip(self.labels, self.units, strict=True)))
        words = []
        for vector in null_combinations(scaled, threshold=0.05, at_least=max(lost, 1)) / safe:
            main = vector[: self.main] * self.spread
            words.append(scalars.combination(main) if np.abs(main).max() > 0 else self._on_the_way(vector))
        return tuple(words)

    def _on_the_way(self, vector: Array) -> str:
        """What is not of interest, and not seen."""
        found = [name for name, share in zip(self.others, vector[self.main :], strict=False) if share != 0]
        return f"{', '.join(dict.fromkeys(found)) or 'something'} (estimated on the way)"

    def covariance(self, weights: Array) -> Array:
        r""":math:`K^T M(w)^{-1} K`, shape (S, k, k), in units of the spread; infinite where M(w) is singular."""
        return main_covariance(self.total(weights), self.main)


def inverse_root(total: Array) -> tuple[Array, BoolArray]:
    r"""R with :math:`R R^T = M^{-1}` for matrices (..., m, m), and which of them have an inverse, shape (...)."""
    scale = np.sqrt(np.einsum("...ii->...i", total))
    safe = np.where(scale > 0, scale, 1.0)
    scaled = total / safe[..., :, None] / safe[..., None, :]
    finite: BoolArray = np.asarray(np.isfinite(scaled).all(axis=(-2, -1)))
    values, vectors = np.linalg.eigh(np.where(finite[..., None, None], scaled, 0.0))
    seen = (values[..., 0] > RANK) & finite
    return vectors / np.sqrt(np.where(seen[..., None], values, 1.0))[..., None, :] / safe[..., None], seen


def main_covariance(total: Array, main: int) -> Array:
    """The first k rows and columns of the inverses of (..., m, m); infinite on the diagonal where there is none."""
    root, seen = inverse_root(total)
    root = root[..., :main, :]
    return np.where(seen[..., None, None], root @ transpose(root), np.diag(np.full(main, np.inf)))
