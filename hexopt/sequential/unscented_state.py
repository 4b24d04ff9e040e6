"""The state of an unscented filter over a batch of sets, and its update by one pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, norm, transpose
from ..errors import InputError
from ..loops import Loop
from ..numerics.charts import Chart
from ..result import Status
from .state import Moment, RunningState

__all__ = ["SigmaPoints", "UnscentedState", "unscented_state"]


@dataclass(frozen=True)
class SigmaPoints:
    """Merwe's scaled sigma points in q coordinates."""

    size: int
    alpha: float
    beta: float
    kappa: float

    def __post_init__(self) -> None:
        if self.kappa <= -self.size:
            raise InputError(f"kappa: expected more than {-self.size}, of {self.size} unknowns; got {self.kappa!r}")

    def made(self) -> Any:
        """As filterpy has them."""
        from filterpy.kalman import MerweScaledSigmaPoints

        return MerweScaledSigmaPoints(self.size, self.alpha, self.beta, self.kappa)

    def filter(self, rows: int) -> Any:
        """An unscented filter of filterpy with these points, for parameters that stand still."""
        from filterpy.kalman import UnscentedKalmanFilter

        return UnscentedKalmanFilter(self.size, rows, 0.0, None, None, self.made())


@dataclass(frozen=True, eq=False)
class UnscentedState(RunningState):
    """A running estimate by an unscented filter; made by :meth:`Unscented.start`, never changed.

    Attributes
    ----------
    loop : Loop
        The equation of poses to come.
    chart : Chart
        Free coordinates of the values.
    base : ndarray, shape (..., p)
        About which they are; NaN before the filter starts.
    mean, spread : ndarray, shape (..., q) and (..., q, q)
        Estimate and covariance in these coordinates.
    codes, chi2, rows : ndarray, shape (...)
        Whether the filter runs, and what counts.
    first : Loop, or None
        The poses that are fitted together.
    unseen : tuple of str
    """

    loop: Loop
    chart: Chart
    base: Array
    mean: Array
    spread: Array
    codes: npt.NDArray[np.int8]
    chi2: Array
    rows: npt.NDArray[np.int64]
    first: Loop | None = None
    unseen: tuple[str, ...] = ()

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one set."""
        return self.codes.shape

    def recorded(self, nis: Array | None = None, flagged: BoolArray | None = None) -> UnscentedState:
        """The state with what it knows now as its last moment; overconfidence makes it INACCURATE."""
        shape = self.batch_shape
        values, tangent = self.chart.moved(self.base, self.mean), self._tangent()
        now = Moment(
            values=values,
            covariance=tangent @ self.spread @ transpose(tangent),
            codes=self.codes,
            chi2=self.chi2,
            rows=self.rows,
            nis=np.full(shape, np.nan) if nis is None else nis,
            flagged=np.zeros(shape, dtype=bool) if flagged is None else flagged,
            unseen=self.unseen if (self.codes == Status.RANK_DEFICIENT).any() else (),
        )
        after = replace(self, moments=(*self.moments, now))
        running = self.codes == Status.OPTIMAL
        codes = np.where(running & after.overconfident, Status.INACCURATE, self.codes).astype(np.int8)
        return replace(after, moments=(*after.moments[:-1], replace(now, codes=codes)))

    def updated(self, here: Loop, points: SigmaPoints, limit: float) -> UnscentedState:
        """The state after one pose; a set whose covariance is no longer one fails alone."""
        sigma, codes = self._sigma(points)
        misclosure = here.residual(self.chart.moved(self.base, sigma))[..., 0, :]  # (points, ..., d)
        noise = here.covariance(self.chart.moved(self.base, self.mean)).blocks[..., 0, :, :]
        noise = np.broadcast_to(noise, (*self.batch_shape, *noise.shape[-2:]))
        mean, spread, chi2, rows = np.array(self.mean), np.array(self.spread), np.array(self.chi2), np.array(self.rows)
        nis, flagged = np.full(codes.shape, np.nan), np.zeros(codes.shape, dtype=bool)
        ukf = points.filter(here.rows)
        for place in np.ndindex(codes.shape):
            if codes[place] != Status.OPTIMAL:
                continue
            every = (slice(None), *place)
            ukf.x, ukf.P, ukf.sigmas_f = mean[place], spread[place], sigma[every]
            known = iter(misclosure[every])
            ukf.update(np.zeros(here.rows), R=noise[place], hx=lambda _, known=known: next(known))
            nis[place] = ukf.y @ ukf.SI @ ukf.y
            flagged[place] = nis[place] > limit
            if flagged[place] and self.reject:
                continue
            mean[place], spread[place] = ukf.x, 0.5 * (ukf.P + ukf.P.T)
            chi2[place] += nis[place]
            rows[place] += here.rows
        after = replace(self, mean=mean, spread=spread, codes=codes, chi2=chi2, rows=rows)
        return after.recorded(nis, flagged)

    def _sigma(self, points: SigmaPoints) -> tuple[Array, npt.NDArray[np.int8]]:
        """The sigma points of every set, (2q + 1, ..., q), and the codes: FAILED where the covariance is none."""
        made, codes = points.made(), np.array(self.codes)
        sigma = np.full((made.num_sigmas(), *self.mean.shape), np.nan)
        for place in np.ndindex(codes.shape):
            if codes[place] != Status.OPTIMAL:
                continue
            try:
                sigma[(slice(None), *place)] = made.sigma_points(self.mean[place], self.spread[place])
            except (np.linalg.LinAlgError, ValueError):  # not positive definite; not finite
                codes[place] = Status.FAILED
        return sigma, codes

    def _tangent(self) -> Array:
        """∂values/∂coordinates at the mean, (..., p, q)."""
        tangent, moved = self.chart.basis(self.base), self.chart.moved(self.base, self.mean)
        straight = self.base + np.einsum("...pq,...q->...p", tangent, self.mean)
        for unit in self.chart.units:
            n = moved[..., unit]
            across = np.eye(3) - n[..., :, None] * n[..., None, :]
            tangent[..., unit, :] = across @ tangent[..., unit, :] / norm(straight[..., unit])[..., None, None]
        return tangent

    @property
    def _unknowns(self) -> int:
        return self.chart.free


def unscented_state(loop: Loop, *, kind: str, label: str, level: float, reject: bool) -> UnscentedState:
    """Nothing is known yet."""
    batch, chart = loop.batch_shape, loop.chart()
    q = chart.free
    return UnscentedState(
        parameters=loop.parameters,
        moments=(),
        pose_rows=loop.rows,
        level=level,
        reject=reject,
        kind=kind,
        label=label,
        loop=loop,
        chart=chart,
        base=np.full((*batch, chart.size), np.nan),
        mean=np.full((*batch, q), np.nan),
        spread=np.full((*batch, q, q), np.nan),
        codes=np.full(batch, Status.RANK_DEFICIENT, dtype=np.int8),
        chi2=np.full(batch, np.nan),
        rows=np.zeros(batch, dtype=np.int64),
        unseen=loop.parameters.labels,
    )
