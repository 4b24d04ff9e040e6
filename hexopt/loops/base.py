r"""The base of every loop equation of one leg.

A loop is :math:`g_i(\theta, m_i) = 0` per pose. A subclass gives the misclosure, its derivatives by
every parameter block and by the error of the pose; the base classes derive known and unknown
parameters, linear problems in their forms, and the covariance of the rows.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import frozen
from ..errors import InputError
from ..geometry import Hexapod, Leg
from ..numerics.forms import Centred, Consecutive, Direct, Form, cancellation
from ..problem import ConstantRowNoise, LinearProblem
from ..result import Estimate
from .leg_equation import LegEquation

__all__ = ["Loop"]


class Loop(LegEquation):
    r"""One loop equation of one leg over the poses of a set, or a batch of sets.

    Parameters
    ----------
    data : LegMeasurements
    unknown : sequence of str, optional
        The leg's blocks to estimate, of "platform_point", "base_point", "offset", "gain".
    platform_point, base_point, offset, gain : array_like or Estimate, optional
        Known values; an :class:`Estimate` brings its covariance along. What is neither unknown nor
        given comes from ``data.nominal``.

    Raises
    ------
    LockError
        If the data has a lock that the equation does not hold for.
    InputError
        If a known value is missing, or a name is not a leg's.
    """

    #: Sets of unknowns in which the equation is linear (any subset of one of them).
    linear_in: ClassVar[tuple[frozenset[str], ...]]
    #: Forms that `linear` offers.
    forms: ClassVar[tuple[str, ...]] = ("direct", "consecutive", "centred")

    @property
    def is_linear(self) -> bool:
        """Whether the equation is linear in its unknowns, so that :meth:`linear` and a start without a guess exist."""
        return any(set(self.unknown) <= names for names in self.linear_in)

    def linear(self, form: str = "direct", at: npt.ArrayLike | Leg | Hexapod | Estimate | None = None) -> LinearProblem:
        r"""The equations as :math:`A x = y` in one of three forms.

        Parameters
        ----------
        form : {"direct", "consecutive", "centred"}
            "direct" keeps the nuisance as unknowns, one block row a pose; "consecutive" takes the
            paper's differences of neighbours; "centred" subtracts the mean over poses.
        at : values, Leg, Hexapod or Estimate, optional
            Where the covariance of the rows is evaluated for weights; by default at the unweighted
            solution, so that neither a guess nor the truth leaks in.

        Returns
        -------
        LinearProblem

        Raises
        ------
        InputError
            For an unknown form, or unknowns in which the equation is not linear.
        """
        name = type(self).__name__
        if form not in self.forms:
            raise InputError(f"form: {name} offers {', '.join(self.forms)}; got {form!r}")
        if not self.is_linear:
            options = " or ".join("{" + ", ".join(sorted(names)) + "}" for names in self.linear_in)
            raise InputError(
                f"{name} is linear in {options}, not in {{{', '.join(self.unknown)}}} together; "
                "give some of them as known, or use a nonlinear estimator on the loop itself"
            )
        multiplier: Form = Direct()
        parameters = self.parameters
        if form != "direct":
            multiplier = self._consecutive() if form == "consecutive" else Centred()
            parameters = parameters.main
        zero = self._blocks(np.zeros((*self.data.batch_shape, self.parameters.size)))
        direct = self._assembled(self._columns(zero), parameters)
        matrix = multiplier.apply(direct)
        rhs = -multiplier.apply(self._misclosure(zero)[..., None])[..., 0]
        lost = cancellation(multiplier, direct, matrix)
        if self.failed.any():  # a known value that failed: no equations, so that these sets fail alone
            matrix = np.where(self.failed[..., None, None, None], 0.0, matrix)
            rhs = np.where(self.failed[..., None, None], 0.0, rhs)
            lost = np.where(self.failed[..., None], 1.0, lost)
        batch = np.broadcast_shapes(matrix.shape[:-3], rhs.shape[:-2])
        rows = rhs.shape[-2] * rhs.shape[-1]
        return LinearProblem(
            frozen(np.broadcast_to(matrix, (*batch, *matrix.shape[-3:])).reshape(*batch, rows, parameters.size)),
            frozen(np.broadcast_to(rhs, (*batch, *rhs.shape[-2:])).reshape(*batch, rows)),
            parameters,
            rows_per_block=self.rows,
            form=multiplier,
            noise=self if self.data.noise is not None else None,
            at=None if at is None else self.values(at),
            cancellation=lost,
            minimum_poses=self.minimum_poses,
            name=name,
            uncarried=self.uncarried,
        )

    def linearised(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> LinearProblem:
        """The direct rows to first order about x, in the unknown *change* of x; any unknowns are allowed."""
        values = self.values(x)
        residual, jacobian = self.residual(values), self.jacobian(values)
        residual = np.where(self.failed[..., None, None], 0.0, residual)
        jacobian = np.where(self.failed[..., None, None, None], 0.0, jacobian)
        batch = np.broadcast_shapes(residual.shape[:-2], jacobian.shape[:-3])
        rows = residual.shape[-2] * residual.shape[-1]
        return LinearProblem(
            np.broadcast_to(jacobian, (*batch, *jacobian.shape[-3:])).reshape(*batch, rows, self.parameters.size),
            -np.broadcast_to(residual, (*batch, *residual.shape[-2:])).reshape(*batch, rows),
            self.parameters,
            rows_per_block=self.rows,
            noise=None if self.data.noise is None else ConstantRowNoise(self.covariance(values)),
            minimum_poses=self.minimum_poses,
            name=type(self).__name__,
            uncarried=self.uncarried,
        )

    def _consecutive(self) -> Consecutive:
        """Plain differences of neighbours; each eliminates a nuisance that is the same in all poses."""
        ones = np.ones(self.data.n_poses - 1)
        return Consecutive(ones, ones)
