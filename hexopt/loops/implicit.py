r"""What every nonlinear estimator sees: implicit equations :math:`g_i(\theta, m_i) = 0` of noisy measurements.

Pose i has the measurement :math:`m_i` with an error of covariance :math:`\Sigma_i`; to first order its misclosure
has the covariance :math:`S_i = B_i\Sigma_i B_i^T`, :math:`B_i = \partial g_i/\partial m_i`. Rows are whitened by the
inverse Cholesky factor of :math:`S_i`. From this follow the information of a pose and the Cramér–Rao bound.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from ..arrays import Array, BoolArray, transpose
from ..errors import InputError, RankDeficientError
from ..numerics.charts import Chart
from ..numerics.lstsq import null_combinations, solve_svd
from ..parameters import Parameters
from ..problem import LinearProblem
from .rows import Members, Place, Rows, SharedPlaces, WhitenedRows, shared_places

__all__ = ["Implicit", "check_errors", "degrees_of_freedom"]


class Implicit(ABC):
    """Implicit equations of one set of poses or several, in shared parameters."""

    parameters: Parameters
    #: The blocks that are unit vectors.
    unit_vectors: tuple[str, ...] = ()
    #: Problems of which a known value is an estimate that failed, broadcastable to the batch.
    failed: BoolArray = np.array(False)
    #: Why a covariance would leave out the error of a known estimate; empty where it does not.
    uncarried: str = ""

    @property
    @abstractmethod
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one problem."""

    @property
    @abstractmethod
    def parts(self) -> Sequence[tuple[Any, Place]]:
        """The sets, each a :class:`~hexopt.loops.set_equation.SetEquation`, and where their parameters stand."""

    @abstractmethod
    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same model of some members of a batch that its own broadcasts to, as one flat batch."""

    @abstractmethod
    def values(self, x: Any) -> Array:
        """A full vector of values (..., p) from values, a geometry or an estimate."""

    @abstractmethod
    def start(self) -> Array:
        """Where a nonlinear estimator starts, (..., p): what is known beforehand, and the nuisance that fits it."""

    @property
    @abstractmethod
    def minimum_poses(self) -> int:
        """How few poses a set determine the unknowns, in general position; 0 where that has no general answer."""

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

        Additive over poses. The q coordinates are the parameters, in which a unit vector counts two: T is the basis
        that ``chart().basis(values)`` gives, with the columns of unit vectors last. What all poses of a set share (a
        common error, the error of known values) is not in it.

        Parameters
        ----------
        x : values, geometry or Estimate
            Where it is evaluated.

        Raises
        ------
        InputError
            If a set has no noise model, or one that leaves an equation without any error.
        """
        free = self.chart().free
        return self.joint_information(x)[0][..., :free, :free]

    def joint_information(self, x: Any, over: Implicit | None = None) -> tuple[Array, Array]:
        r"""Information that each pose brings of the parameters and of what the poses share, and what is there before.

        Parameters
        ----------
        x : values, geometry or Estimate
            Where it is evaluated.
        over : Implicit, optional
            The same equations over other poses under the same clamps: the information of those poses.

        Returns
        -------
        blocks : ndarray, shape (..., n, q + r, q + r)
            Of the free coordinates, as in :meth:`information`, and of the r shared errors (a common error of all
            poses, the error of known values), in their standard deviations.
        prior : ndarray, shape (q + r, q + r)
            What is known without any pose: the unit variances of the shared errors.
        """
        chart = self.chart()
        values, rows = self._rows_at(x, chart, over)
        shared = shared_places(rows)
        blocks = []
        for part, (_, place), common in zip(rows, self.parts, shared.of_sets, strict=True):
            reduced = chart.reduced(self._spread(part.jacobian, place), values[..., None, :])
            wide = np.zeros((*reduced.shape[:-1], chart.free + shared.count))
            wide[..., : chart.free] = reduced
            wide[..., chart.free + common] = part.common
            blocks.append(transpose(wide) @ wide)
        batch = np.broadcast_shapes(*(block.shape[:-3] for block in blocks))
        whole = [np.broadcast_to(block, (*batch, *block.shape[-3:])) for block in blocks]
        prior = np.diag(np.repeat([0.0, 1.0], [chart.free, shared.count]))
        return whole[0] if len(whole) == 1 else np.concatenate(whole, axis=-3), prior

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
        if self.uncarried:
            raise InputError(f"no bound: {self.uncarried}")
        if self.blind_spots:
            raise RankDeficientError(f"no bound: the poses do not see {'; '.join(self.blind_spots)}", self.blind_spots)
        values, rows = self._rows_at(x, self.chart())
        shared = shared_places(rows)
        chart = self.chart(shared=shared.count)
        degrees_of_freedom(self, rows, chart)
        unknowns = np.concatenate([values, np.zeros((*values.shape[:-1], shared.count))], axis=-1)
        _, jacobian = self.stacked(rows, unknowns, chart, shared)
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

    def _rows_at(self, x: Any, chart: Chart, over: Implicit | None = None) -> tuple[Array, list[WhitenedRows]]:
        """Values with unit vectors of unit length, and the rows of every set there, or of other poses."""
        values = chart.normalised(self.values(x))
        parts = [part for part, _ in self.parts]
        if over is not None:
            parts = [part.over(other.data) for part, (other, _) in zip(parts, over.parts, strict=True)]
        places = [place for _, place in self.parts]
        rows = [part.whitened(values[..., place]) for part, place in zip(parts, places, strict=True)]
        check_errors(self, values, rows)
        return values, rows

    def combinations(self, jacobian: Array, basis: Array) -> tuple[str, ...]:
        """What rows (m, q) by free coordinates do not see, in words; `basis` (p + r, q) is that of the coordinates."""
        unseen = null_combinations(jacobian, np.ones(basis.shape[-1]), threshold=0.05, at_least=1)
        size = self.parameters.size
        return tuple(self.parameters.combination((basis @ vector)[:size], threshold=0.05) for vector in unseen)

    def direct_rows(self, values: Array) -> tuple[Array, Array]:
        """The unweighted rows of all sets below each other, (..., M), and their Jacobian by the values, (..., M, p)."""
        rows = []
        for part, place in self.parts:
            residual = part.residual(values[..., place])
            rows.append(Rows(residual, part.jacobian(values[..., place]), np.zeros((*residual.shape, 0)), ()))
        return self.stacked(rows, values, self.chart(unit_norm=False), shared_places(rows))

    def stacked(self, rows: Sequence[Rows], unknowns: Array, chart: Chart, shared: SharedPlaces) -> tuple[Array, Array]:
        """All sets below each other: misclosures (..., M), and the Jacobian by free coordinates, (..., M, q).

        The unknowns (..., p + r) are the values and the shared errors of the sets, which have a last block of rows:
        their unit variances.
        """
        size = self.parameters.size
        batch = np.broadcast_shapes(unknowns.shape[:-1], *(part.misclosure.shape[:-2] for part in rows))
        misclosures, jacobians = [], []
        for part, (_, place), common in zip(rows, self.parts, shared.of_sets, strict=True):
            n, d, r = part.common.shape[-3:]
            own = part.jacobian.reshape(*part.jacobian.shape[:-3], n * d, len(place))
            if len(place) == unknowns.shape[-1]:  # one set has them all, in order
                columns = np.broadcast_to(own, (*batch, *own.shape[-2:]))
            else:
                columns = np.zeros((*batch, n * d, unknowns.shape[-1]))
                columns[..., place] = own
                columns[..., size + common] = part.common.reshape(*part.common.shape[:-3], n * d, r)
            jacobians.append(columns)
            misclosures.append(np.broadcast_to(part.misclosure, (*batch, n, d)).reshape(*batch, n * d))
        if shared.count:
            prior = np.eye(size + shared.count)[size:]
            jacobians.append(np.broadcast_to(prior, (*batch, *prior.shape)))
            misclosures.append(np.broadcast_to(unknowns[..., size:], (*batch, shared.count)))
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
        rootless = ~np.isfinite(whitened.root).all(axis=(-3, -2, -1))
        if rootless.any() and (rootless & np.isfinite(part.residual(values[..., place])).all(axis=(-2, -1))).any():
            raise InputError(
                f"{type(model).__name__}: the noise model leaves some equations without any error, so they cannot be "
                "weighted; give every reading that enters them a noise level > 0"
            )


def degrees_of_freedom(model: Implicit, rows: Sequence[Rows], chart: Chart) -> int:
    """Rows minus unknowns, by the free coordinates of `chart`; fewer rows than unknowns are a wrong call."""
    count = sum(part.misclosure.shape[-2] * part.misclosure.shape[-1] for part in rows)
    unknowns = chart.free - shared_places(rows).count
    if count >= unknowns:
        return count - unknowns
    names = model.parameters.names
    need = f"; {type(model).__name__} needs at least {model.minimum_poses} poses" if model.minimum_poses else ""
    raise RankDeficientError(
        f"too few poses: {count} equations for {unknowns} unknowns ({', '.join(names)}){need}", names
    )
