r"""What a choice of poses minimises: a criterion, averaged over scenarios or at the worst of them.

:math:`f(w) = \sum_g \alpha_g \max_{p \in g} f_{gp}(w)`, with a group for each scenario (an average), or one for all
(the worst). The pieces of a group are those of the criterion: one as a rule, one a task pose for G.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, transpose
from ..information import PoseInformation, main_covariance
from .criteria import Criterion

__all__ = ["Local", "Objective"]


@dataclass(frozen=True, eq=False)
class Local:
    r"""An objective near some weights.

    Attributes
    ----------
    pieces : ndarray, shape (S, j)
        Values of all pieces.
    covariance : ndarray, shape (S, k, k)
        C.
    columns : ndarray, shape (S, m, k)
        :math:`M^{-1}K`.
    slopes : ndarray, shape (S, j, k, k)
        Gradients of the pieces by C: :math:`\partial f_{sp}/\partial w_i = -\langle \Gamma_{sp}, M_{si}\rangle` with
        :math:`\Gamma_{sp} = M^{-1}K\,\varphi'_p K^T M^{-1}`.
    """

    pieces: Array
    covariance: Array
    columns: Array
    slopes: Array

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

    def of_totals(self, totals: Array) -> Array:
        """The objective of information matrices (..., S, m, m), shape (...); infinite where a parameter is not seen."""
        values = self.criterion.value(main_covariance(totals, self.information.main))
        return values.max(axis=-1) if self.worst else values.mean(axis=-1)

    def value(self, weights: Array) -> float:
        """The objective of weights (n,)."""
        return float(self.of_totals(self.information.total(weights)))

    def local(self, weights: Array) -> Local:
        """Values and derivatives at weights (n,) that see all parameters."""
        total, k = self.information.total(weights), self.information.main
        scale = np.sqrt(np.einsum("sii->si", total))
        scaled = np.linalg.inv(total / scale[:, :, None] / scale[:, None, :])
        columns = (scaled / scale[:, :, None] / scale[:, None, :])[..., :k]
        covariance = columns[:, :k]
        covariance = (covariance + transpose(covariance)) / 2
        return Local(self.criterion.pieces(covariance), covariance, columns, self.criterion.slopes(covariance))

    def mix(self, pieces: Array) -> Array:
        """Multipliers (S, j) of a subgradient: of every group its largest piece."""
        out = np.zeros(pieces.shape)
        if self.worst:
            out.flat[int(pieces.argmax())] = 1.0
        else:
            out[np.arange(len(pieces)), pieces.argmax(axis=1)] = 1 / len(pieces)
        return out

    def gains(self, sensitivity: Array) -> Array:
        r""":math:`\sum_s\langle\Gamma_s, M_{si}\rangle` of every pose, (n,): by how much its weight lowers f."""
        blocks = self.information.blocks
        flat = blocks.reshape(*blocks.shape[:2], -1)
        gains: Array = (flat @ sensitivity.reshape(len(flat), -1, 1))[..., 0].sum(axis=0)
        return gains
