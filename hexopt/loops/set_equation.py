"""The implicit equation of one set of poses: its misclosure, its derivatives, and its rows of unit variance."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Self

import numpy as np

from ..arrays import Array, matvec, transpose
from ..errors import InputError
from ..numerics.roots import inverse_cholesky
from ..rotations import rotation_vector_jacobian
from .implicit import Implicit
from .known import square_root
from .rows import Members, Place, WhitenedRows, picked

__all__ = ["SetEquation"]

#: Moved measurements have settled when none moves by more, in standard deviations.
SETTLED = 1e-9


class SetEquation(Implicit):
    """The implicit equation of one set of poses."""

    data: Any
    #: What errors call it.
    title: str = ""
    #: Readings of a pose: its error has 6 numbers more.
    n_readings: int = 1

    @property
    def parts(self) -> Sequence[tuple[SetEquation, Place]]:
        """The set itself."""
        return ((self, np.arange(self.parameters.size)),)

    @abstractmethod
    def residual(self, x: Any) -> Array:
        r"""The direct misclosure :math:`g_i(x)`, shape (..., n, d)."""

    @abstractmethod
    def jacobian(self, x: Any) -> Array:
        r""":math:`G_i = \partial g_i/\partial x`, shape (..., n, d, p)."""

    @abstractmethod
    def noise_jacobian(self, x: Any) -> Array:
        r""":math:`B_i = \partial g_i/\partial(\delta P, \delta\omega, \delta\rho)`, shape (..., n, d, e)."""

    @cached_property
    def error_covariance(self) -> Array:
        r""":math:`\Sigma_i`, the covariance of every pose's error, shape (..., n, e, e).

        Raises
        ------
        InputError
            If the data has no noise model.
        """
        noise = self.data.noise
        if noise is None:
            raise InputError(
                f"{self.title or type(self).__name__}: the measurements have no noise model; give them noise=…"
            )
        covariance: Array = noise.covariance(self.data.position, self.data.rotation, self.n_readings)
        return covariance

    @cached_property
    def error_scale(self) -> Array:
        """Standard deviations of every pose's errors, shape (..., n, e)."""
        scale: Array = np.sqrt(np.einsum("...ii->...i", self.error_covariance))
        return scale

    def shared(self, x: Any, by_noise: Array) -> list[tuple[Any, Array]]:
        """How the rows move with what all poses share, by its standard errors (..., n, d, r), and by its source.

        The source of the common error of the set itself is None. `by_noise` is the :meth:`noise_jacobian` at x.
        """
        common = None if self.data.noise is None else self.data.noise.common(self.n_readings)
        return [] if common is None else [(None, by_noise @ square_root(common))]

    def on(self, data: Any) -> Self:
        """The same equation of other values of the measurements."""
        moved = copy.copy(self)
        moved.data = data
        return moved

    def over(self, data: Any) -> Self:
        """The same equation, with the same known values, over other poses."""
        other = self.on(data)
        for name in ("error_covariance", "error_scale"):
            vars(other).pop(name, None)  # of the poses before
        return other

    def known_otherwise(self, other: Any) -> tuple[str, ...]:
        """Names of what another equation of this kind knows by other values, or from another estimate."""
        return ()

    def take(self, which: Members, batch: tuple[int, ...]) -> Self:
        """The same equation of some members of a batch, as one flat batch."""
        data = self.data
        length = (
            None
            if data.length is None
            else picked(data.length, data.length.ndim - data.position.ndim + 2, batch, which)
        )
        taken = self.on(
            data.moved_to(picked(data.position, 2, batch, which), picked(data.rotation, 3, batch, which), length)
        )
        vars(taken)["error_covariance"] = picked(self.error_covariance, 3, batch, which)
        vars(taken)["error_scale"] = picked(self.error_scale, 2, batch, which)
        taken.failed = picked(self.failed, 0, batch, which)
        return taken

    def shifted(self, error: Array) -> Self:
        """The same equation at measurements moved by errors (..., n, e)."""
        return self.on(self.data.shifted(error))

    def whitened(
        self,
        x: Array,
        common: Array | None = None,
        error: Array | None = None,
        *,
        adjust: int = 0,
    ) -> WhitenedRows:
        r"""Rows of unit variance at `x`: :math:`W_i g_i` and :math:`W_i G_i`, where :math:`W_i S_i W_i^T = I`.

        Parameters
        ----------
        x : ndarray, shape (..., p)
        common : ndarray, shape (..., r), optional
            Values of the shared errors, in standard errors.
        error : ndarray, shape (..., n, e), optional
            By how much the measurements are moved first.
        adjust : int, default 0
            How often at most to move them by the least errors that make the equations hold, until these settle,
            :math:`e_i = -\Sigma_i B_i^T S_i^{-1}(g_i - B_i e_i)`. Then half the sum of squares is the least
            :math:`\tfrac12\sum e_i^T\Sigma_i^{-1}e_i` under :math:`g_i(x, m_i + e_i) = 0`, and the Jacobian times the
            rows is its derivative by x.
        """
        here = self if error is None else self.shifted(error)
        rows, after = here._whitened(x, common, self.error_covariance, error)
        small = SETTLED * self.error_scale
        for _ in range(adjust):
            if error is not None and not (np.abs(after - error) > small).any():
                break
            error = after
            here = self.shifted(error)
            rows, after = here._whitened(x, common, self.error_covariance, error)
        misclosure, common_columns, sources, root = rows
        return WhitenedRows(misclosure, root @ here.jacobian(x), common_columns, sources, root, after)

    def _whitened(
        self, x: Array, common: Array | None, covariance: Array, error: Array | None
    ) -> tuple[tuple[Array, Array, tuple[tuple[Any, int], ...], Array], Array]:
        """Misclosure, common columns, their sources and the root at measurements moved by `error`; the next error."""
        noise = self.noise_jacobian(x)
        misclosure = self.residual(x)
        shared = self.shared(x, noise)
        if error is not None:  # derivatives by the rotation vector itself
            noise[..., 3:6] = noise[..., 3:6] @ rotation_vector_jacobian(error[..., 3:6])
            misclosure = misclosure - matvec(noise, error)
        wide = [np.broadcast_to(columns, (*noise.shape[:-1], columns.shape[-1])) for _, columns in shared]
        columns = np.concatenate([np.zeros((*noise.shape[:-1], 0)), *wide], axis=-1)
        if common is not None:
            misclosure = misclosure + np.einsum("...ndr,...r->...nd", columns, common)
        through = noise @ covariance
        root = inverse_cholesky(through @ transpose(noise))
        whitened = matvec(root, misclosure)
        least = -matvec(transpose(through), matvec(transpose(root), whitened))
        least[~np.isfinite(least).all(axis=(-2, -1))] = 0.0  # a member that failed stays where it was measured
        sources = tuple((source, part.shape[-1]) for source, part in shared)
        return (whitened, root @ columns, sources, root), least
