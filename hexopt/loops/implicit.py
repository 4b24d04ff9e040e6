r"""What every nonlinear estimator sees: implicit equations :math:`g_i(\theta, m_i) = 0` of noisy measurements.

Pose i has the measurement :math:`m_i` with an error of covariance :math:`\Sigma_i`; to first order its misclosure
has the covariance :math:`S_i = B_i\Sigma_i B_i^T`, :math:`B_i = \partial g_i/\partial m_i`. Rows are whitened by the
inverse Cholesky factor of :math:`S_i`. From this follow the information of a pose and the Cramér–Rao bound.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, transpose
from ..errors import InputError, RankDeficientError
from ..numerics.charts import Chart
from ..numerics.lstsq import null_combinations, solve_svd
from ..parameters import Parameters
from ..problem import LinearProblem

__all__ = ["Implicit", "Place", "Rows", "WhitenedRows", "check_errors", "degrees_of_freedom"]

#: Places of a set's parameters among those of a model.
Place = npt.NDArray[np.intp]


@dataclass(frozen=True)
class Rows:
    """Rows of one set.

    Attributes
    ----------
    misclosure : ndarray, shape (..., n, d)
    jacobian : ndarray, shape (..., n, d, p)
        By the parameters of the set.
    common : ndarray, shape (..., n, d, r)
        By standard errors of what the poses of the set share; r may be 0.
    """

    misclosure: Array
    jacobian: Array
    common: Array


@dataclass(frozen=True)
class WhitenedRows(Rows):
    """Rows of unit variance of one set.

    Attributes
    ----------
    root : ndarray, shape (..., n, d, d)
        The left factor that whitened them.
    error : ndarray, shape (..., n, e)
        The errors of the measurements that make the equations hold.
    """

    root: Array
    error: Array


class Implicit(ABC):
    """Implicit equations of one set of poses or several, in shared parameters."""

    parameters: Parameters
    #: The blocks that are unit vectors.
    unit_vectors: tuple[str, ...] = ()
    #: Problems of which a known value is an estimate that failed, broadcastable to the batch.
    failed: BoolArray = np.array(False)

    @property
    @abstractmethod
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one problem."""

    @property
    @abstractmethod
    def parts(self) -> Sequence[tuple[Any, Place]]:
        """The sets, each a :class:`~hexopt.loops.set_equation.SetEquation`, and where their parameters stand."""

    @abstractmethod
    def values(self, x: Any) -> Array:
        """A full vector of values (..., p) from values, a geometry or an estimate."""

    @abstractmethod
    def start(self) -> Array:
        """Where a nonlinear estimator starts, (..., p): what is known beforehand, and the nuisance that fits it."""

    @property
    @abstractmethod
    def minimum_poses(self) -> int:
        """How few poses a set determine the unknowns, in general position."""

    @property
    def is_linear(self) -> bool:
        """Whether the equations are linear in the unknowns, so that `linear` gives a start without a guess."""
        return False

    def linear(self) -> LinearProblem:
        """The direct equations as a linear problem, where they are linear."""
        raise InputError(f"{type(self).__name__} has no linear form")

    @property
    def blind_spots(self) -> tuple[str, ...]:
        """What the lock hides from the equation, though noise in the measurements makes it look seen; in words."""
        return ()

    def chart(self, unit_norm: bool = True, shared: int = 0) -> Chart:
        """Free coordinates of the values and, behind them, some shared errors; unit vectors count two, or three."""
        units = tuple(self.parameters[name] for name in self.unit_vectors if unit_norm)
        return Chart(self.parameters.size + shared, units)

    def information(self, x: Any) -> Array:
        r"""Information that each pose brings: :math:`T^T G_i^T S_i^{-1} G_i T`, shape (..., n, q, q).

        Additive over poses. The q coordinates are the parameters, in which a unit vector counts two
        (:meth:`chart` has the basis T, which stands last); no reading enters but where `x` leaves a nuisance open.
        What all poses of a set share (a common error, the error of known values) is not in it.

        Parameters
        ----------
        x : values, geometry or Estimate
            Where it is evaluated.

        Raises
        ------
        InputError
            If a set has no noise model, or one that leaves an equation without any error.
        """
        chart = self.chart()
        values, rows = self._rows_at(x, chart)
        blocks = []
        for part, (_, place) in zip(rows, self.parts, strict=True):
            reduced = chart.reduced(self._spread(part.jacobian, place), values[..., None, :])
            blocks.append(transpose(reduced) @ reduced)
        batch = np.broadcast_shapes(*(block.shape[:-3] for block in blocks))
        return np.concatenate([np.broadcast_to(block, (*batch, *block.shape[-3:])) for block in blocks], axis=-3)

    def crlb(self, x: Any) -> Array:
        r"""The Cramér–Rao bound: the least covariance of any unbiased estimate under normal noise, (..., m, m).

        The inverse of the information of all poses, with nuisances and shared errors eliminated by a Schur
        complement; in the order of ``parameters.main``. Evaluate it at the truth.

        Parameters
        ----------
        x : values, geometry or Estimate
            NaN, as of an estimate that failed, gives NaN.

        Raises
        ------
        InputError
            If a set has no noise model.
        RankDeficientError
            If the poses do not see all parameters: there is no bound.
        """
        values, rows = self._rows_at(x, self.chart())
        count = sum(part.common.shape[-1] for part in rows)
        chart = self.chart(shared=count)
        degrees_of_freedom(self, rows, chart)
        unknowns = np.concatenate([values, np.zeros((*values.shape[:-1], count))], -1)
        _, jacobian = self.stacked(rows, unknowns, chart)
        finite = np.asarray(np.isfinite(jacobian).all(axis=(-2, -1)))
        solution = solve_svd(np.where(finite[..., None, None], jacobian, 0.0), np.zeros(jacobian.shape[:-1]))
        seen = solution.full_rank | ~finite
        if not seen.all():
            worst = np.unravel_index(int(np.argmin(seen)), seen.shape)
            here = np.broadcast_to(unknowns, (*jacobian.shape[:-2], chart.size))[worst]
            unseen = self.combinations(jacobian[worst], chart.basis(here))
            raise RankDeficientError(f"no bound: the poses do not see {'; '.join(unseen)}", unseen)
        gain = chart.basis(unknowns) @ solution.inverse
        main = np.concatenate([np.r_[self.parameters[name]] for name in self.parameters.main.names])
        covariance = gain[..., main, :] @ transpose(gain[..., main, :])
        return np.where(finite[..., None, None], covariance, np.nan)

    def _rows_at(self, x: Any, chart: Chart) -> tuple[Array, list[WhitenedRows]]:
        """Values with unit vectors of unit length, and the rows of every set there."""
        values = chart.normalised(self.values(x))
        rows = [part.whitened(values[..., place]) for part, place in self.parts]
        check_errors(self, values, rows)
        return values, rows

    def combinations(self, jacobian: Array, basis: Array) -> tuple[str, ...]:
        """What rows (m, q) by free coordinates do not see, in words; `basis` (p + r, q) is that of the coordinates."""
        unseen = null_combinations(jacobian, np.ones(basis.shape[-1]), threshold=0.05, at_least=1)
        size = self.parameters.size
        return tuple(self.parameters.combination((basis @ vector)[:size], threshold=0.05) for vector in unseen)

    def stacked(self, rows: Sequence[Rows], unknowns: Array, chart: Chart) -> tuple[Array, Array]:
        """All sets below each other: misclosures (..., M), and the Jacobian by free coordinates, (..., M, q).

        The unknowns (..., p + r) are the values and the shared errors of the sets, which have a last block of rows:
        their unit variances.
        """
        size, shared = self.parameters.size, unknowns[..., self.parameters.size :]
        batch = np.broadcast_shapes(unknowns.shape[:-1], *(part.misclosure.shape[:-2] for part in rows))
        misclosures, jacobians, first = [], [], size
        for part, (_, place) in zip(rows, self.parts, strict=True):
            n, d, r = part.common.shape[-3:]
            columns = np.zeros((*batch, n * d, unknowns.shape[-1]))
            columns[..., place] = part.jacobian.reshape(*part.jacobian.shape[:-3], n * d, len(place))
            columns[..., first : first + r] = part.common.reshape(*part.common.shape[:-3], n * d, r)
            first += r
            jacobians.append(columns)
            misclosures.append(np.broadcast_to(part.misclosure, (*batch, n, d)).reshape(*batch, n * d))
        if shared.shape[-1]:
            jacobians.append(np.broadcast_to(np.eye(unknowns.shape[-1])[size:], (*batch, *shared.shape[-1:], first)))
            misclosures.append(np.broadcast_to(shared, (*batch, *shared.shape[-1:])))
        jacobian = np.concatenate(jacobians, axis=-2)
        return np.concatenate(misclosures, axis=-1), chart.reduced(jacobian, unknowns)

    def _spread(self, columns: Array, place: Place) -> Array:
        """Columns by a set's parameters as columns by all."""
        if len(place) == self.parameters.size:  # one set has them all, in order
            return columns
        out = np.zeros((*columns.shape[:-1], self.parameters.size))
        out[..., place] = columns
        return out


def check_errors(model: Implicit, values: Array, rows: Sequence[WhitenedRows]) -> None:
    """A noise model that leaves an equation without any error is a wrong call: that equation cannot be weighted."""
    for whitened, (part, place) in zip(rows, model.parts, strict=True):
        known = np.isfinite(part.residual(values[..., place])).all(axis=(-2, -1))
        if (known & ~np.isfinite(whitened.root).all(axis=(-3, -2, -1))).any():
            raise InputError(
                f"{type(model).__name__}: the noise model leaves some equations without any error, so they cannot be "
                "weighted; give every reading that enters them a noise level > 0"
            )


def degrees_of_freedom(model: Implicit, rows: Sequence[Rows], chart: Chart) -> int:
    """Rows minus unknowns, by the free coordinates of `chart`; fewer rows than unknowns are a wrong call."""
    count = sum(part.misclosure.shape[-2] * part.misclosure.shape[-1] for part in rows)
    unknowns = chart.free - sum(part.common.shape[-1] for part in rows)
    if count >= unknowns:
        return count - unknowns
    names = model.parameters.names
    raise RankDeficientError(
        f"too few poses: {count} equations for {unknowns} unknowns ({', '.join(names)}); "
        f"{type(model).__name__} needs at least {model.minimum_poses}",
        names,
    )
