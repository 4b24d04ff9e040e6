r"""The implicit equation of one leg: which of its parameters are unknown, and the covariance of its rows.

A subclass gives the misclosure, its derivatives by every parameter block and by the error of the pose.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from ..arrays import Array, matvec
from ..errors import InputError, LockError, UnitError
from ..geometry import Hexapod, Leg
from ..geometry.leg import LEG_BLOCKS
from ..measurements import LegMeasurements, Lock
from ..parameters import Block, Parameters
from ..problem import RowCovariance
from ..result import Estimate
from .known import Known, KnownValues, check_estimate_unit, chosen_unknown, known_values
from .rows import Members, picked
from .set_equation import SetEquation

__all__ = ["LegEquation"]


class LegEquation(SetEquation):
    """An implicit equation of one leg over the poses of a set: what is known, and how sure it is. See :class:`Loop`."""

    #: Locks under which the equation holds.
    locks: ClassVar[tuple[Lock, ...]]
    #: What is estimated by default.
    default_unknown: ClassVar[tuple[str, ...]]
    #: The leg's blocks that the equation contains.
    involved: ClassVar[tuple[str, ...]]
    #: Names of the nuisance blocks with their sizes; sums, products and squares of lengths have units too.
    nuisance: ClassVar[Mapping[str, int]] = {}
    #: Rows a pose.
    rows: ClassVar[int]
    #: What the unit of the nuisance is, with {unit} for the length unit.
    nuisance_unit: ClassVar[str] = "{unit}"

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
        self.data: LegMeasurements = data
        self.unknown = chosen_unknown(name, self.involved, self.default_unknown if unknown is None else unknown, given)
        known = [block for block in self.involved if block not in self.unknown]
        found = known_values(name, known, given, data)
        self._known, self._known_roots, self._sources = found.values, found.roots, found.sources
        self.uncarried = _why_uncarried(found, data)
        self.failed = np.array(False)
        for block, value in self._known.items():
            try:
                np.broadcast_shapes(value.shape[:-1], data.batch_shape)
            except ValueError:
                raise InputError(
                    f"{block}: {value.shape[:-1]} values do not fit a batch of {data.batch_shape} sets"
                ) from None
            self.failed = self.failed | np.isnan(value).any(axis=-1)
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

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions, of the data and of known values: () for one set."""
        return np.broadcast_shapes(self.data.batch_shape, *(value.shape[:-1] for value in self._known.values()))

    def known_otherwise(self, other: LegEquation) -> tuple[str, ...]:
        """Names of what another equation of this kind knows by other values, or from another estimate."""
        return tuple(
            name
            for name, value in self._known.items()
            if self._sources.get(name) is not other._sources.get(name) or not np.array_equal(value, other._known[name])
        )

    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same equation of some members of a batch, as one flat batch."""
        taken = super().take(which, batch)
        taken._known = {name: picked(value, 1, batch, which) for name, value in self._known.items()}
        taken._known_roots = {name: picked(root, 2, batch, which) for name, root in self._known_roots.items()}
        return taken

    def values(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
        """A full vector of values (..., p) from values, a :class:`Leg`, its robot or an :class:`Estimate`.

        What `x` does not say of the nuisance is filled in with what fits the data best.
        """
        if isinstance(x, Hexapod):
            x = x.leg(self.data.leg)
        if isinstance(x, Leg):
            self._check_leg(x)
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

    def _check_leg(self, leg: Leg) -> None:
        """That a leg is in the unit of the measurements, and the measured one if both have numbers."""
        if leg.length_unit != self.data.length_unit:
            raise UnitError(f"the measurements are in {self.data.length_unit}, the leg in {leg.length_unit}")
        measured = self.data.nominal
        if measured is not None and leg.number != measured.number:
            raise InputError(f"leg {measured.number} was measured, and leg {leg.number} is given")

    def start(self) -> Array:
        """The values of the data's nominal, with the nuisance that fits it best."""
        if self.data.nominal is None:
            raise InputError(
                f"{type(self).__name__} is not linear in its unknowns, so it needs an initial guess: "
                "give the estimator start=Leg(…), or the data a nominal"
            )
        return self.values(self.data.nominal)

    def _blocks(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> dict[str, Array]:
        return {**self._known, **self.parameters.split(self.values(x))}

    # --- the equation -----------------------------------------------------------------------------

    def residual(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
        r"""The direct misclosure :math:`g_i(x)`, shape (..., n, d)."""
        return self._misclosure(self._blocks(x))

    def jacobian(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
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

    def noise_jacobian(self, x: npt.ArrayLike | Leg | Hexapod | Estimate) -> Array:
        r""":math:`B_i = \partial g_i/\partial(\delta P, \delta\omega, \delta\rho)`, shape (..., n, d, 7)."""
        return self._noise_columns(self._blocks(x))

    def known_jacobian(self, x: npt.ArrayLike | Leg | Hexapod | Estimate, name: str) -> Array:
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
        blocks = self._blocks(values)
        jacobian = self._noise_columns(blocks)
        own = jacobian @ self.error_covariance @ np.swapaxes(jacobian, -1, -2)
        shape = own.shape[:-2]
        shared = self.shared(values, jacobian)
        return own, [(source, np.broadcast_to(part, (*shape, *part.shape[-2:]))) for source, part in shared]

    def shared(
        self, x: npt.ArrayLike | Leg | Hexapod | Estimate, by_noise: Array
    ) -> list[tuple[Estimate | None, Array]]:
        """How the rows move with a common error, and with the errors of the estimates that known values come from."""
        shared: list[tuple[Estimate | None, Array]] = super().shared(x, by_noise)
        columns = self._columns(self._blocks(x)) if self._sources else {}
        for source in {id(found): found for found in self._sources.values()}.values():
            names = [name for name, found in self._sources.items() if found is source]
            parts = [columns[name] @ self._known_roots[name][..., None, :, :] for name in names]
            shared.append((source, np.sum(np.broadcast_arrays(*parts), axis=0)))
        return shared

    # --- shared pieces ----------------------------------------------------------------------------

    def _arm(self, blocks: Mapping[str, Array]) -> Array:
        """R_i b, shape (..., n, 3)."""
        return matvec(self.data.rotation, blocks["platform_point"][..., None, :])

    def _true_length(self, blocks: Mapping[str, Array]) -> Array:
        """γρ_i + δ, shape (..., n)."""
        return blocks["gain"] * self.data.readings() + blocks["offset"]


def _why_uncarried(known: KnownValues, data: LegMeasurements) -> str:
    lost = known.uncarried or (tuple(known.roots) if data.noise is None else ())
    if not lost:
        return ""
    cause = "it has no covariance" if known.uncarried else "the measurements have no noise model"
    return f"the error of the estimated {' and '.join(lost)} cannot be carried: {cause}"
