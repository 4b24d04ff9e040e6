"""What a calibration returns: a leg, a robot, how sure they are, and a table that says so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array
from ..errors import EstimationError, InputError
from ..geometry import Hexapod, Leg
from ..geometry.leg import LEG_BLOCKS
from ..result import Estimate
from .accuracy import pose_covariance

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["Calibration", "LegCalibration"]


@dataclass(frozen=True, eq=False)
class LegCalibration:
    """One calibrated leg, or a batch of them.

    Attributes
    ----------
    nominal : Leg
        It lends what was not estimated.
    values : dict of str to ndarray
        The estimated blocks by name, (..., 3) or (..., 1), in the order of `covariance`; NaN where not `ok`.
    ok : bool, or ndarray of bool, shape (...)
        Whether every step succeeded.
    covariance : ndarray, shape (..., p, p), or None
    covariance_kind : str
        Its kind, or why there is none.
    steps : dict of str to Estimate
        The estimates that the method made on the way.
    residual_rms : ndarray, shape (...), or None
        Root mean square of the leg-length residual over all poses of the leg; None without readings.
    n_poses : int
    """

    nominal: Leg
    values: Mapping[str, Array]
    ok: Any
    covariance: Array | None
    covariance_kind: str
    steps: Mapping[str, Estimate]
    residual_rms: Array | None
    n_poses: int

    @property
    def names(self) -> tuple[str, ...]:
        """The estimated blocks, in the order of `covariance`."""
        return tuple(self.values)

    @property
    def leg(self) -> Leg:
        """The calibrated leg; where some member of a batch failed there is none, and `values` says which."""
        if not np.all(self.ok):
            raise EstimationError(
                f"leg {self.nominal.number}: {int(np.sum(~np.asarray(self.ok)))} of {np.size(self.ok)} calibrations "
                "failed and have no leg; read .values where .ok"
            )
        return self.nominal.replaced(**{name: _entry(name, value) for name, value in self.values.items()})


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated robot, and how sure every leg is.

    Attributes
    ----------
    robot : Hexapod
        The nominal with every measured leg replaced.
    nominal : Hexapod
    legs : dict of int to LegCalibration
        By leg number; legs that were not measured are absent.
    method : str
    estimate : Estimate, optional
        Of all legs at once, where the method estimates them together.
    """

    robot: Hexapod
    nominal: Hexapod
    legs: Mapping[int, LegCalibration]
    method: str
    estimate: Estimate | None = None

    def pose_covariance(self, position: npt.ArrayLike | None = None, rotation: npt.ArrayLike | None = None) -> Array:
        r"""Covariance of the true pose where this calibration says (P, R), (6, 6); by default at home.

        Of :math:`(\delta P, \delta\omega)`, from the joint covariance of all legs; see :func:`pose_covariance`.

        Raises
        ------
        InputError
            If the legs were calibrated one by one, so that what they share is unknown, or without a covariance.
        """
        if self.estimate is None:
            raise InputError(f"{self.method} calibrates leg by leg: there is no joint covariance; use Joint()")
        main = self.estimate.parameters.main
        return pose_covariance(self.robot, main, self.estimate.covariance_of(*main.names), position, rotation)

    @property
    def covariance(self) -> dict[int, Array | None]:
        """The covariance of every calibrated leg, by number, in the order of its `names`."""
        return {number: leg.covariance for number, leg in self.legs.items()}

    def to_frame(self) -> pd.DataFrame:
        """A tidy table: leg, parameter, nominal, calibrated, standard error, unit."""
        import pandas as pd

        return pd.DataFrame([row for number in self.legs for row in self._rows(number)])

    def _rows(self, number: int) -> list[dict[str, Any]]:
        part, before = self.legs[number], self.nominal.leg(number)
        rows: list[dict[str, Any]] = []
        errors = None if part.covariance is None else np.sqrt(np.diagonal(part.covariance))
        unit, reading = self.robot.length_unit, self.robot.reading_unit
        for name in part.names:
            old, new = before.block(name), part.leg.block(name)
            for i in range(len(new)):
                rows.append(
                    {
                        "leg": number,
                        "parameter": f"{name}.{'xyz'[i]}" if len(new) > 1 else name,
                        "nominal": float(old[i]),
                        "calibrated": float(new[i]),
                        "standard_error": float("nan") if errors is None else float(errors[len(rows)]),
                        "unit": f"{unit}/{reading}" if name == "gain" else unit,
                    }
                )
        return rows

    def summary(self) -> str:
        """A readable table: every calibrated leg, its parameters, their errors, its residual."""
        unit = self.robot.length_unit
        lines = [f"{self.robot.name}: {self.method}, {len(self.legs)} of 6 legs calibrated"]
        lines.append(f"  {'leg':<4s}{'parameter':<20s}{'nominal':>14s}{'calibrated':>14s}{'± 1 σ':>11s}  unit")
        for number in self.legs:
            for row in self._rows(number):
                sure = "" if np.isnan(row["standard_error"]) else f"{row['standard_error']:.2g}"
                lines.append(
                    f"  {number:<4d}{row['parameter']:<20s}{row['nominal']:>z14.5f}{row['calibrated']:>z14.5f}"
                    f"{sure:>11s}  {row['unit']}"
                )
        lines.append(f"  residual of leg length, RMS ({unit}):")
        rms = {number: part.residual_rms for number, part in self.legs.items() if part.residual_rms is not None}
        for number, value in rms.items():
            lines.append(f"    leg {number}: {float(value):.4g} over {self.legs[number].n_poses} poses")
        if rms:
            weights = [self.legs[number].n_poses for number in rms]
            mean = np.sqrt(np.average(np.square(list(rms.values())), weights=weights))
            lines.append(f"    all:   {float(mean):.4g}")
        kinds = sorted({part.covariance_kind for part in self.legs.values()})
        lines.append(f"  covariance: {'; '.join(kinds)}")
        missing = [str(k) for k in range(1, 7) if k not in self.legs]
        if missing:
            lines.append(f"  not measured, nominal kept: leg {', '.join(missing)}")
        return "\n".join(lines)


def _entry(name: str, value: Array) -> Array:
    """A block as a field of :class:`Leg`: scalars lose their last dimension."""
    return value if LEG_BLOCKS[name] > 1 else value[..., 0]
