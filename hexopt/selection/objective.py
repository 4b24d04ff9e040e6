r"""What a choice of poses minimises: a criterion, averaged over scenarios or at the worst of them.

:math:`f(w) = \sum_g \alpha_g \max_{p \in g} f_{gp}(w)`, with a group for each scenario (an average), or one for all
(the worst). The pieces of a group are those of the criterion: one as a rule, one a task pose for G.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, transpose
from ..errors import RankDeficientError
from ..information import PoseInformation, inverse_root, main_covariance
from .criteria import Criterion

__all__ = ["Local", "Objective", "curvature_root"]


@dataclass(frozen=True, eq=False)
class Local:
    r"""An objective near some weights.

    Attributes
    ----------
    pieces : ndarray, shape (S, j)
        Values of all pieces.
    covariance : ndarray, shape (S, k, k)
        C.
    root : ndarray, shape (S, m, m)
        R with :math:`R R^T = M^{-1}`.
    slopes : ndarray, shape (S, j, k, k)
        Gradients of the pieces by C: :math:`\partial f_{sp}/\partial w_i = -\langle \Gamma_{sp}, M_{si}\rangle` with
        :math:`\Gamma_{sp} = M^{-1}K\,\varphi'_p K^T M^{-1}`.
    """

    pieces: Array
    covariance: Array
    root: Array
    slopes: Array

    @property
    def columns(self) -> Array:
        r""":math:`M^{-1}K`, shape (S, m, k)."""
        return self.root @ transpose(self.root[:, : self.covariance.shape[-1]])

    def sensitivity(self, mix: Array) -> Array:
        r""":math:`\sum_p \mu_{sp}\Gamma_{sp}` for multipliers (S, j), shape (S, m, m)."""
        inner = np.einsum("sj,sjkl->skl", mix, self.slopes)
        return self.columns @ inner @ transpose(self.columns)


@dataclass(frozen=True, eq=False)
class Objective:
    r"""A criterion of the poses' information.

    Attributes
    ----------
    information : PoseInformation
    criterion : Criterion
    worst : bool
        The worst scenario; otherwise their average.
    """

    information: PoseInformation
    criterion: Criterion
    worst: bool = False

    def take(self, index: np.ndarray) -> Objective:
        """The same for some of the poses."""
        return Objective(self.information.take(index), self.criterion, self.worst)

    @property
    def main(self) -> int:
        """k: of how many coordinates C is, which stand first."""
        return self.information.size if self.criterion.full else self.information.main

    def of_totals(self, totals: Array) -> Array:
        """The objective of information matrices (..., S, m, m), shape (...); infinite where a parameter is not seen."""
        return self.of_covariances(main_covariance(totals, self.main))

    def of_covariances(self, covariances: Array) -> Array:
        """The objective of covariances (..., S, k, k) of what is of interest, shape (...)."""
        values = self.criterion.value(covariances)
        return values.max(axis=-1) if self.worst else values.mean(axis=-1)

    def value(self, weights: npt.NDArray[Any]) -> float:
        """The objective of weights (n,)."""
        return float(self.of_totals(self.information.total(weights)))

    def local(self, weights: npt.NDArray[Any]) -> Local:
        """Values and derivatives at weights (n,) that see all parameters."""
        total, k = self.information.total(weights), self.main
        root, seen = inverse_root(total)
        if not seen.all():
            unseen = self.information.unseen(total[int(np.argmin(seen))])
            raise RankDeficientError(f"these poses do not see {'; '.join(unseen)}", unseen)
        covariance = root[:, :k] @ transpose(root[:, :k])
        return Local(self.criterion.pieces(covariance), covariance, root, self.criterion.slopes(covariance))

    def mix(self, pieces: Array) -> Array:
        """Multipliers (S, j) of a subgradient: of every group its largest piece."""
        out = np.zeros(pieces.shape)
        if self.worst:
            out.flat[int(pieces.argmax())] = 1.0
        else:
            out[np.arange(len(pieces)), pieces.argmax(axis=1)] = 1 / len(pieces)
        return out

    def shares(self, mix: Array) -> Array:
        """Multipliers (S, j), not all zero in a group, made those of a convex combination of the pieces."""
        out = np.maximum(mix, 0.0)
        return out / out.sum() if self.worst else out / out.sum(axis=1, keepdims=True) / len(out)

    def gains(self, sensitivity: Array) -> Array:
        r""":math:`\sum_s\langle\Gamma_s, M_{si}\rangle` of every pose, (n,): by how much its weight lowers f."""
        blocks = self.information.blocks
        flat = blocks.reshape(*blocks.shape[:2], -1)
        gains: Array = (flat @ sensitivity.reshape(len(flat), -1, 1))[..., 0].sum(axis=0)
        return gains


def curvature_root(root: Array, main: Array, logdet: bool) -> Array:
    r"""V with :math:`V V^T = \Theta`, of the second derivatives :math:`\operatorname{tr}\Gamma M_i\Theta M_j`.

    :math:`\Theta` is 2 M⁻¹ for :math:`\varphi` linear in C, and :math:`2M^{-1} - \Gamma` for its logarithm.

    Parameters
    ----------
    root : ndarray, shape (..., m, m)
        R with :math:`R R^T = M^{-1}`.
    main : ndarray, shape (..., k, m)
        :math:`K^T R`.
    logdet : bool
    """
    right = np.sqrt(2) * root
    if logdet:
        # Θ = R (2I − P) R', P the projection on the rows of K'R; 2I − P is the square of √2 I − (√2 − 1) P
        across = transpose(main)
        right = right - (np.sqrt(2) - 1) * root @ across @ np.linalg.solve(main @ across, main)
    return right
