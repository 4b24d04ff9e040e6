"""What is known after every pose: the estimates so far, the innovations, and when it is enough."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, as_array, frozen, norm
from ..errors import InputError
from ..geometry import Leg
from ..geometry.leg import LEG_BLOCKS
from ..numerics.lstsq import EPS
from ..parameters import Parameters
from ..result import Estimate, Status

__all__ = ["Moment", "RunningState", "chi2_quantile"]


@dataclass(frozen=True, eq=False)
class Moment:
    """What is known after one pose, of one set or a batch.

    Attributes
    ----------
    values : ndarray, shape (..., p)
        NaN where the code is no success.
    covariance : ndarray, shape (..., p, p)
    codes : ndarray of int, shape (...)
    chi2 : ndarray, shape (...)
        Weighted sum of squared residuals of the poses that count.
    rows : ndarray of int, shape (...)
        Equations that count.
    nis : ndarray, shape (...)
        Normalised innovation squared of the pose; NaN where it could not be tested.
    flagged : ndarray of bool, shape (...)
    unseen : tuple of str
        What the first rank-deficient set does not see.
    """

    values: Array
    covariance: Array
    codes: npt.NDArray[np.int8]
    chi2: Array
    rows: npt.NDArray[np.int64]
    nis: Array
    flagged: BoolArray
    unseen: tuple[str, ...]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name != "unseen":
                object.__setattr__(self, name, frozen(np.asarray(value)))


@dataclass(frozen=True, eq=False)
class RunningState:
    r"""A running estimate: what is known after every pose, from the first to now.

    The innovation of pose i is :math:`\nu_i = z_i - h_i(\hat x_{i-1})`, what the pose says beyond what the poses
    before it foretold, and :math:`\epsilon_i = \nu_i^T C_i^{-1} \nu_i` its square over its covariance. For good poses
    and a true noise model :math:`\epsilon_i \sim \chi^2_d`, d being the rows of a pose.

    Attributes
    ----------
    parameters : Parameters
    moments : tuple of Moment
        At the start, and after every pose.
    pose_rows : int
        d.
    level : float
        Quantile of :math:`\chi^2_d` above which a pose is flagged.
    reject : bool
        Whether flagged poses are left out.
    kind : str
        The covariance's kind, or why there is none.
    label : str
        What estimates say of themselves.
    """

    parameters: Parameters
    moments: tuple[Moment, ...]
    pose_rows: int
    level: float
    reject: bool
    kind: str
    label: str

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, frozen(value))

    @property
    def n_poses(self) -> int:
        """Poses that were seen, whether they count or not."""
        return len(self.moments) - 1

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one set."""
        return self.moments[0].codes.shape

    @property
    def estimate(self) -> Estimate:
        """The estimate from all poses so far, in the shape of the batch."""
        return self._estimate(self.moments[-1])

    @property
    def history(self) -> Estimate:
        """The estimates after every pose: values (..., n, p), covariance (..., n, p, p), and so on.

        `unseen` is that after the first pose, and `degrees_of_freedom` that after the last; after every pose see
        :attr:`freedom`.
        """
        extra = {"values": 1, "covariance": 2}
        names = [name for name in Moment.__dataclass_fields__ if name != "unseen"]
        unseen = next((one.unseen for one in self.moments[1:] if one.unseen), ())
        moment = Moment(**{name: self._of_poses(name, extra.get(name, 0)) for name in names}, unseen=unseen)
        return replace(self._estimate(moment), degrees_of_freedom=self.estimate.degrees_of_freedom)

    @property
    def freedom(self) -> npt.NDArray[np.int64]:
        """Degrees of freedom after every pose, (..., n): equations that count minus unknowns, or 0."""
        return np.maximum(np.asarray(self._of_poses("rows")) - self._unknowns, 0)

    @property
    def nis(self) -> Array:
        r"""Normalised innovation squared :math:`\epsilon_i` of every pose, (..., n); NaN where none was foretold."""
        return np.asarray(self._of_poses("nis"))

    @property
    def flagged(self) -> BoolArray:
        r"""Which poses do not fit those before them, (..., n): :math:`\epsilon_i > \chi^2_d(level)`."""
        return np.asarray(self._of_poses("flagged"))

    @property
    def rejected(self) -> BoolArray:
        """Which poses were left out, (..., n)."""
        return self.flagged if self.reject else np.zeros_like(self.flagged)

    @property
    def consistent(self) -> Any:
        r"""Whether the innovations are as large as the filter says, shape (...) or a bool.

        :math:`\sum_i\epsilon_i \sim \chi^2_{kd}` over the k poses that were tested and count; False where the sum lies
        outside the central `level` of it. Too large: the filter is surer than it may be, the noise is larger, or there
        are bad poses. True before anything was tested.
        """
        total, freedom = self._surprise()
        tail = (1 - self.level) / 2
        low, high = (chi2_quantile(np.maximum(freedom, 1), share) for share in (tail, 1 - tail))
        good = (freedom == 0) | ((low <= total) & (total <= high))
        return good if self.batch_shape else bool(good)

    @property
    def overconfident(self) -> Any:
        r"""Whether the innovations are larger than the filter says, :math:`\sum_i\epsilon_i > \chi^2_{kd}(level)`."""
        total, freedom = self._surprise()
        worse = (freedom > 0) & (total > chi2_quantile(np.maximum(freedom, 1), self.level))
        return worse if self.batch_shape else bool(worse)

    @property
    def predicted_error(self) -> dict[str, Array]:
        r"""The predicted error of every block after every pose: :math:`\sqrt{\mathrm{tr}\,C}`, each (..., n)."""
        errors = self.parameters.split(self.history.standard_errors)
        return {name: norm(part) for name, part in errors.items()}

    def enough(self, **tolerances: float) -> Any:
        r"""Whether there are enough poses: every named block's predicted error is at most its tolerance.

        Parameters
        ----------
        **tolerances : float
            :math:`\tau` by block name, in its unit: ``state.enough(base_point=0.05)``.

        Returns
        -------
        bool, or ndarray of bool, shape (...)
        """
        within = self._within(tolerances)
        now = within.any(axis=-1) if self.n_poses == 0 else within[..., -1]  # of no poses none is enough
        return now if self.batch_shape else bool(now)

    def enough_after(self, **tolerances: float) -> Any:
        """After how many poses it was first :meth:`enough`; 0 if it never was."""
        within = self._within(tolerances)
        ever = within.any(axis=-1)
        first = np.where(ever, within.argmax(axis=-1) + 1 if self.n_poses else 0, 0)
        return first if self.batch_shape else int(first)

    def nees(self, truth: Leg) -> Array:
        r"""Normalised error :math:`(\hat x - x)^T C^{-1} (\hat x - x)` of the leg's blocks after every pose, (..., n).

        If the covariance is true it is :math:`\chi^2` distributed, with as many degrees of freedom as the blocks
        have entries; a filter that is too sure of itself has more.
        """
        names = [name for name in self.parameters.names if name in LEG_BLOCKS]
        if not isinstance(truth, Leg) or not names:
            raise InputError(f"nees: expected a Leg, and leg blocks among {', '.join(self.parameters.names)}")
        leg = np.concatenate([np.r_[self.parameters[name]] for name in names])
        error = self._of_poses("values", 1)[..., leg] - np.concatenate([truth.block(name) for name in names])
        covariance = self._of_poses("covariance", 2)[..., leg[:, None], leg]
        known = np.isin(self._of_poses("codes"), (Status.OPTIMAL, Status.INACCURATE))
        error = np.where(known[..., None], error, np.nan)
        scale = np.where(known[..., None], np.sqrt(np.einsum("...ii->...i", covariance)), 1.0)
        scaled = covariance / scale[..., :, None] / scale[..., None, :]
        values, vectors = np.linalg.eigh(np.where(known[..., None, None], scaled, np.eye(len(leg))))
        along = np.einsum("...ij,...i->...j", vectors, error / scale)
        return np.asarray((along**2 / np.maximum(values, EPS)).sum(axis=-1))

    # --- pieces -----------------------------------------------------------------------------------

    def _surprise(self) -> tuple[Array, Any]:
        """The sum of what was tested and counts, and its degrees of freedom, each (...)."""
        tested = np.isfinite(self.nis) & ~self.rejected
        return np.where(tested, self.nis, 0.0).sum(axis=-1), self.pose_rows * tested.sum(axis=-1)

    def _estimate(self, moment: Moment) -> Estimate:
        good = moment.codes == Status.OPTIMAL
        covariance = np.where(good[..., None, None], moment.covariance, np.nan)
        return Estimate(
            values=np.where(good[..., None], moment.values, np.nan),
            parameters=self.parameters,
            codes=moment.codes,
            covariance=covariance if self.kind in ("model", "posterior") else None,
            covariance_kind=self.kind,
            objective=0.5 * np.where(good, moment.chi2, np.nan),
            gap=np.full(good.shape, np.nan),
            condition=self._condition(covariance),
            degrees_of_freedom=self._freedom(moment),
            chi2=np.where(good, moment.chi2, np.nan),
            estimator=self.label,
            unseen=moment.unseen,
        )

    def _freedom(self, moment: Moment) -> int:
        """Rows that count minus unknowns; of a batch that rejected poses the least, of its successes if any."""
        good = moment.codes == Status.OPTIMAL
        rows = moment.rows[good] if good.any() else moment.rows
        return int(rows.min()) - self._unknowns if rows.size else 0

    @property
    def _unknowns(self) -> int:
        return self.parameters.size

    def _condition(self, covariance: Array) -> Array:
        return np.full(covariance.shape[:-2], np.nan)

    def _of_poses(self, name: str, dimensions: int = 0) -> Any:
        """What every moment after the start has by a name, stacked before its own dimensions: (..., n) or so."""
        parts = [np.asarray(getattr(one, name)) for one in self.moments]
        axis = parts[0].ndim - dimensions
        return np.delete(np.stack(parts, axis), 0, axis)

    def _limits(self, tolerances: dict[str, float]) -> dict[str, float]:
        if not tolerances:
            raise InputError("enough: name a block and its tolerance, such as enough(base_point=0.05)")
        limits = {name: float(as_array(name, value, (), batch=False)) for name, value in tolerances.items()}
        for name, limit in limits.items():
            if limit <= 0:
                raise InputError(f"{name}: expected a tolerance > 0, got {limit:g}")
        self.estimate.covariance_of(*limits)  # an unknown name is an error that lists the known ones
        return limits

    def _within(self, tolerances: dict[str, float]) -> BoolArray:
        limits, error = self._limits(tolerances), self.predicted_error
        within: BoolArray = np.all([error[name] <= limit for name, limit in limits.items()], axis=0)
        return within


def chi2_quantile(freedom: npt.ArrayLike, share: float) -> Any:
    """The value that a χ² variable of some degrees of freedom stays below with probability `share`."""
    from scipy.special import chdtri

    return chdtri(freedom, 1.0 - share)
