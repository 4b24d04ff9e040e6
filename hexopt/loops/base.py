r"""The base of every loop equation of one leg.

A loop is :math:`g_i(\theta, m_i) = 0` per pose. A subclass gives the misclosure, its derivatives by
every parameter block and by the error of the pose; the base class derives known and unknown
parameters, linear problems in their forms, and the covariance of the rows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import Array, frozen, matvec
from ..errors import InputError, LockError, UnitError
from ..geometry import Leg
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements, Lock
from ..numerics.forms import Centred, Consecutive, Direct, Form
from ..parameters import Block, Parameters
from ..problem import ConstantRowNoise, LinearProblem, RowCovariance
from ..result import Estimate
from .known import Known, KnownValues, check_estimate_unit, chosen_unknown, known_values, square_root

__all__ = ["Loop"]


class Loop(ABC):
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

    #: Locks under which the equation holds.
    locks: ClassVar[tuple[Lock, ...]]
    #: What is estimated by default.
    default_unknown: ClassVar[tuple[str, ...]]
    #: The leg's blocks that the equation contains.
    involved: ClassVar[tuple[str, ...]]
    #: Sets of unknowns in which the equation is linear (any subset of one of them).
    linear_in: ClassVar[tuple[frozenset[str], ...]]
    #: Names of the nuisance blocks with their sizes; sums, products and squares of lengths have units too.
    nuisance: ClassVar[Mapping[str, int]] = {}
    #: Rows a pose.
    rows: ClassVar[int]
    #: What the unit of the nuisance is, with {unit} for the length unit.
    nuisance_unit: ClassVar[str] = "{unit}"
    #: Forms that `linear` offers.
    forms: ClassVar[tuple[str, ...]] = ("direct", "consecutive", "centred")

    def __init__(
        self,
        data: LegMeasurements,
        *,
        unknown: tuple[str, ...] | list[str] | None = None,
        platform_point: Known | None = None,
        base_point: Known | None = None,
        offset: Known | None = None,
        gain: Known | None = None,
    ) -> None:
        name = type(self).__name__
        if not isinstance(data, LegMeasurements):
            raise InputError(
                f"{name}: expected LegMeasurements, got {type(data).__name__}; for six readings write data.leg(k)"
            )
        if data.n_poses == 0:
            raise InputError(f"{name}: there are no poses")
        if data.lock not in self.locks:
            wanted = " or ".join(repr(str(lock)) for lock in self.locks)
            raise LockError(f"{name} holds under the lock {wanted}, the data has {str(data.lock)!r}")
        given = {"platform_point": platform_point, "base_point": base_point, "offset": offset, "gain": gain}
        self.data = data
        self.unknown = chosen_unknown(name, self.involved, self.default_unknown if unknown is None else unknown, given)
        known = [block for block in self.involved if block not in self.unknown]
        found = known_values(name, known, given, data)
        self._known, self._known_roots, self._sources = found.values, found.roots, found.sources
        #: Why a covariance of the unknown would leave out the error of a known estimate; empty where it does not.
        self._uncarried = _why_uncarried(found, data)
        #: Sets of which a known value is an estimate that failed.
        self._failed = np.array(False)
        for block, value in self._known.items():
            try:
                np.broadcast_shapes(value.shape[:-1], data.batch_shape)
            except ValueError:
                raise InputError(
                    f"{block}: {value.shape[:-1]} values do not fit a batch of {data.batch_shape} sets"
                ) from None
            self._failed = self._failed | np.isnan(value).any(axis=-1)
        unit = data.length_unit
        self.parameters = Parameters(
            tuple(Block(key, LEG_BLOCKS[key], unit if key != "gain" else f"{unit}/reading") for key in self.unknown)
            + tuple(
                Block(key, size, self.nuisance_unit.format(unit=unit), nuisance=True)
                for key, size in self.nuisance.items()
            )
        )

    # --- what a subclass writes -------------------------------------------------------------------

    @abstractmethod
    def _misclosure(self, blocks: Mapping[str, Array]) -> Array:
        """g_i for full blocks by name (each (..., size)), shape (..., n, d)."""

    @abstractmethod
    def _columns(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        """∂g_i/∂block for every involved and nuisance block, each broadcastable to (..., n, d, size)."""

    @abstractmethod
    def _noise_columns(self, blocks: Mapping[str, Array]) -> Array:
        """∂g_i/∂(δP, δω, δρ), shape (..., n, d, 7)."""

    def _nuisance_values(self, blocks: Mapping[str, Array]) -> dict[str, Array]:
        """The nuisance that fits the leg's blocks best, in closed form; a loop with a nuisance writes this."""
        if self.nuisance:
            names = ", ".join(self.nuisance)
            raise InputError(f"values: {names} missing; give them, or write {type(self).__name__}._nuisance_values")
        return {}

    @property
    @abstractmethod
    def minimum_poses(self) -> int:
        """How few poses determine the unknowns, in general position."""

    # --- known and unknown ------------------------------------------------------------------------

    def values(self, x: npt.ArrayLike | Leg | Estimate) -> Array:
        """A full vector of values (..., p) from values, a :class:`Leg` or an :class:`Estimate`.

        What `x` does not say of the nuisance is filled in with what fits the data best.
        """
        if isinstance(x, Leg) and x.length_unit != self.data.length_unit:
            raise UnitError(f"the measurements are in {self.data.length_unit}, the leg in {x.length_unit}")
        if isinstance(x, Leg):
            parts = {name: x.block(name) for name in self.unknown}
        elif isinstance(x, Estimate):
            parts = {name: value for name, value in x.params.items() if name in self.parameters}
            for name in parts:
                check_estimate_unit(x, name, self.data.length_unit)
        else:
            main = self.parameters.main
            vector = np.asarray(x, dtype=float)
            if vector.shape[-1:] == (self.parameters.size,):
                return vector
            if vector.shape[-1:] != (main.size,):
                raise InputError(
                    f"values: expected {self.parameters.size} ({', '.join(self.parameters.names)}) or "
                    f"{main.size} without the nuisance, got shape {vector.shape}"
                )
            parts = main.split(vector)
        missing = [name for name in self.unknown if name not in parts]
        if missing:
            raise InputError(f"values: {', '.join(missing)} missing")
        if any(name not in parts for name in self.nuisance):
            parts |= self._nuisance_values({**self._known, **parts})
        shape = np.broadcast_shapes(*(part.shape[:-1] for part in parts.values()))
        ordered = [np.broadcast_to(parts[name], (*shape, parts[name].shape[-1])) for name in self.parameters.names]
        return np.concatenate(ordered, axis=-1)

    def _blocks(self, x: npt.ArrayLike | Leg | Estimate) -> dict[str, Array]:
        return {**self._known, **self.parameters.split(self.values(x))}

    # --- the equation -----------------------------------------------------------------------------

    def residual(self, x: npt.ArrayLike | Leg | Estimate) -> Array:
        r"""The direct misclosure :math:`g_i(x)`, shape (..., n, d)."""
        return self._misclosure(self._blocks(x))

    def jacobian(self, x: npt.ArrayLike | Leg | Estimate) -> Array:
        r""":math:`G_i = \partial g_i/\partial x`, shape (..., n, d, p)."""
        return self._assembled(self._columns(self._blocks(x)), self.parameters)

    @staticmethod
    def _assembled(columns: Mapping[str, Array], parameters: Parameters) -> Array:
        """The columns of some parameters side by side, (..., n, d, p)."""
        shape = np.broadcast_shapes(*(columns[name].shape[:-1] for name in parameters.names))
        out = np.empty((*shape, parameters.size))
        for name in parameters.names:
            out[..., parameters[name]] = columns[name]
        return out

    def noise_jacobian(self, x: npt.ArrayLike | Leg | Estimate) -> Array:
        r""":math:`B_i = \partial g_i/\partial(\delta P, \delta\omega, \delta\rho)`, shape (..., n, d, 7)."""
        return self._noise_columns(self._blocks(x))

    def known_jacobian(self, x: npt.ArrayLike | Leg | Estimate, name: str) -> Array:
        r""":math:`\partial g_i/\partial k` by a *known* block k, shape (..., n, d, size)."""
        return self._columns(self._blocks(x))[name]

    def covariance(self, values: Array) -> RowCovariance:
        r"""Covariance of the direct rows at `values`: :math:`S_i = B_i\Sigma_i B_i^T`, and what all poses share.

        Raises
        ------
        InputError
            If the data has no noise model.
        """
        own, shared = self.covariance_parts(values)
        return RowCovariance(own, np.concatenate([part for _, part in shared], axis=-1) if shared else None)

    def covariance_parts(self, values: Array) -> tuple[Array, list[tuple[Estimate | None, Array]]]:
        r""":math:`S_i` (..., n, d, d), and by its source a factor (..., n, d, r) of what all poses share.

        The source is the estimate that known values come from, or None for the common error of the set itself.
        """
        noise = self.data.noise
        if noise is None:
            raise InputError(f"{type(self).__name__}: the measurements have no noise model; give them noise=…")
        blocks = self._blocks(values)
        jacobian = self._noise_columns(blocks)
        own = jacobian @ noise.covariance(self.data.position, self.data.rotation) @ np.swapaxes(jacobian, -1, -2)
        shared: list[tuple[Estimate | None, Array]] = []
        common = noise.common()
        if common is not None:
            shared.append((None, jacobian @ square_root(common)))
        columns = self._columns(blocks) if self._sources else {}
        for source in {id(found): found for found in self._sources.values()}.values():
            names = [name for name, found in self._sources.items() if found is source]
            parts = [columns[name] @ self._known_roots[name][..., None, :, :] for name in names]
            shared.append((source, np.sum(np.broadcast_arrays(*parts), axis=0)))
        shape = own.shape[:-2]
        return own, [(source, np.broadcast_to(part, (*shape, *part.shape[-2:]))) for source, part in shared]

    # --- linear problems --------------------------------------------------------------------------

    def linear(self, form: str = "direct", at: npt.ArrayLike | Leg | Estimate | None = None) -> LinearProblem:
        r"""The equations as :math:`A x = y` in one of three forms.

        Parameters
        ----------
        form : {"direct", "consecutive", "centred"}
            "direct" keeps the nuisance as unknowns, one block row a pose; "consecutive" takes the
            paper's differences of neighbours; "centred" subtracts the mean over poses.
        at : values, Leg or Estimate, optional
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
        if not any(set(self.unknown) <= names for names in self.linear_in):
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
        lost = _cancellation(multiplier, direct, matrix)
        if self._failed.any():  # a known value that failed: no equations, so that these sets fail alone
            matrix = np.where(self._failed[..., None, None, None], 0.0, matrix)
            rhs = np.where(self._failed[..., None, None], 0.0, rhs)
            lost = np.where(self._failed[..., None], 1.0, lost)
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
            uncarried=self._uncarried,
        )

    def linearised(self, x: npt.ArrayLike | Leg | Estimate) -> LinearProblem:
        """The direct rows to first order about x, in the unknown *change* of x; any unknowns are allowed."""
        values = self.values(x)
        residual, jacobian = self.residual(values), self.jacobian(values)
        residual = np.where(self._failed[..., None, None], 0.0, residual)
        jacobian = np.where(self._failed[..., None, None, None], 0.0, jacobian)
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
            uncarried=self._uncarried,
        )

    def _consecutive(self) -> Consecutive:
        """Plain differences of neighbours; each eliminates a nuisance that is the same in all poses."""
        ones = np.ones(self.data.n_poses - 1)
        return Consecutive(ones, ones)

    # --- shared pieces ----------------------------------------------------------------------------

    def _arm(self, blocks: Mapping[str, Array]) -> Array:
        """R_i b, shape (..., n, 3)."""
        return matvec(self.data.rotation, blocks["platform_point"][..., None, :])

    def _true_length(self, blocks: Mapping[str, Array]) -> Array:
        """γρ_i + δ, shape (..., n)."""
        return blocks["gain"] * self.data.readings() + blocks["offset"]


def _cancellation(form: Form, direct: Array, formed: Array) -> Array:
    """By how much a form's differences shortened each column of the direct rows, shape (..., p)."""
    if isinstance(form, Direct):
        return np.ones(direct.shape[-1])
    before = form.before(np.einsum("...ndp,...ndp->...np", direct, direct))
    after = np.einsum("...ndp,...ndp->...p", formed, formed)
    ratio = np.divide(before, after, out=np.ones(after.shape), where=after > 0)  # no column at all is seen as such
    factor: Array = np.sqrt(np.maximum(ratio, 1.0))
    return factor


def _why_uncarried(known: KnownValues, data: LegMeasurements) -> str:
    lost = known.uncarried or (tuple(known.roots) if data.noise is None else ())
    if not lost:
        return ""
    cause = "it has no covariance" if known.uncarried else "the measurements have no noise model"
    return f"the error of the estimated {' and '.join(lost)} cannot be carried: {cause}"
