"""A linear calibration problem: matrix, right-hand side, named parameters, and the noise of its rows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .arrays import Array, as_array, frozen, matvec, transpose
from .errors import InputError
from .numerics.forms import Centred, Direct, Form
from .numerics.lstsq import solve
from .parameters import Parameters

__all__ = ["ConstantRowNoise", "LinearProblem", "RowCovariance", "RowNoise", "Whitening"]


@dataclass(frozen=True)
class RowCovariance:
    r"""Covariance of the direct rows: :math:`\mathrm{diag}(S_1, …, S_n) + U U^T`.

    Attributes
    ----------
    blocks : ndarray, shape (..., n, d, d)
        :math:`S_i`, what each pose has for itself.
    common : ndarray, shape (..., n, d, r), or None
        :math:`U`, a factor of what all poses share: a constant offset, or the error of known values.
    """

    blocks: Array
    common: Array | None = None

    def propagated(self, gain: Array) -> Array:
        """The covariance of ``gain · rows``, for gain (..., p, n, d): (..., p, p)."""
        flat = gain.reshape(*gain.shape[:-2], gain.shape[-2] * gain.shape[-1])
        through = np.einsum("...pni,...nij->...pnj", gain, self.blocks)
        covariance: Array = through.reshape(flat.shape) @ transpose(flat)
        if self.common is not None:
            shared = np.einsum("...pni,...nir->...pr", gain, self.common)
            covariance = covariance + shared @ transpose(shared)
        return covariance


class RowNoise(Protocol):
    """Where the covariance of the direct rows comes from; it may depend on the parameters."""

    def covariance(self, values: Array) -> RowCovariance:
        """The covariance of the direct rows at `values` (..., p)."""
        ...


@dataclass(frozen=True)
class ConstantRowNoise:
    """A known covariance of the rows, the same at all parameters."""

    rows: RowCovariance

    def covariance(self, values: Array) -> RowCovariance:
        """The known covariance."""
        return self.rows


@dataclass(frozen=True)
class Whitening:
    """A block-diagonal left factor W.

    Attributes
    ----------
    blocks : ndarray, shape (..., k, e, e)
        Its k blocks: one a pose where rows of different poses are independent, else one in all.
    """

    blocks: Array

    def apply(self, rows: Array) -> Array:
        """W rows, for rows (..., m, c)."""
        size = self.blocks.shape[-1]
        split = rows.reshape(*rows.shape[:-2], rows.shape[-2] // size, size, rows.shape[-1])
        return (self.blocks @ split).reshape(rows.shape)

    def after(self, gain: Array) -> Array:
        """gain W, for a gain on whitened rows (..., p, m); W is symmetric."""
        return transpose(self.apply(transpose(gain)))


@dataclass(frozen=True, eq=False)
class LinearProblem:
    r"""Equations :math:`A x \approx y`, in a form :math:`A = D A_\text{direct}`, with the noise of the rows.

    Parameters
    ----------
    matrix : array_like, shape (..., m, p)
    rhs : array_like, shape (..., m)
    parameters : Parameters
        p scalars in named blocks.
    rows_per_block : int, default 1
        d: how many rows each pose (or difference of poses) has.
    form : Form
        How the rows were made of the direct ones.
    noise : RowNoise, optional
        None: unknown noise.
    at : array_like, optional
        Where the noise is evaluated for weights, as its `covariance` takes it (a loop also takes the nuisance
        that its form eliminates); by default at the unweighted solution.
    cancellation : array_like, shape (..., p), optional
        By how much the form's differences shortened each column of the matrix; by default 1, not at all.
    minimum_poses : int, optional
        How many poses the loop equation needs, for error messages.
    name : str
        What made the problem, for error messages.
    uncarried : str
        Why a covariance would leave out an error that is known to be there; estimates then have none.

    Raises
    ------
    InputError
        For shapes that do not fit, or values that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from hexopt import Block, LinearProblem, Parameters, LeastSquares, estimate
    >>> line = LinearProblem(
    ...     np.array([[1, 0], [1, 1], [1, 2.0]]),
    ...     np.array([1, 3, 5.0]),
    ...     Parameters((Block("level", 1, "cm"), Block("slope", 1, "cm/s"))),
    ... )
    >>> estimate(line, LeastSquares()).values.round(12)
    array([1., 2.])
    """

    matrix: Array
    rhs: Array
    parameters: Parameters
    rows_per_block: int = 1
    form: Form = field(default_factory=Direct)
    noise: RowNoise | None = None
    at: Array | None = None
    cancellation: Array = None  # type: ignore[assignment]  # made an array below
    minimum_poses: int | None = None
    name: str = "the problem"
    uncarried: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", as_array("matrix", self.matrix, ("m", self.parameters.size), own=True))
        object.__setattr__(self, "rhs", as_array("rhs", self.rhs, ("m",), own=True))
        if self.rhs.shape != self.matrix.shape[:-1]:
            raise InputError(f"matrix {self.matrix.shape} and rhs {self.rhs.shape} disagree")
        if self.matrix.shape[-2] == 0:
            raise InputError(f"{self.name}: there is no equation; are there any poses?")
        if self.matrix.shape[-2] % self.rows_per_block:
            raise InputError(f"{self.matrix.shape[-2]} rows are no multiple of rows_per_block={self.rows_per_block}")
        if self.at is not None:
            # NaN is allowed: the members of a batch that failed before fail again, alone
            filled = as_array("at", np.nan_to_num(self.at), ("p",))
            object.__setattr__(self, "at", frozen(np.where(np.isnan(self.at), np.nan, filled)))
        size = self.parameters.size
        lost = np.ones(size) if self.cancellation is None else as_array("cancellation", self.cancellation, (size,))
        object.__setattr__(self, "cancellation", lost)

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one problem."""
        return self.rhs.shape[:-1]

    @property
    def worst_cancellation(self) -> Array:
        """The largest factor by which a column was shortened, shape (...)."""
        return self.cancellation.max(axis=-1)

    def residual(self, values: Array) -> Array:
        """``A x − y``, shape (..., m)."""
        return matvec(self.matrix, values) - self.rhs

    def direct_gain(self, gain: Array) -> Array:
        """The gain on direct rows, (..., p, n, d), of a gain on this form's rows, (..., p, m)."""
        p, d = gain.shape[-2], self.rows_per_block
        blocks = np.moveaxis(gain.reshape(*gain.shape[:-1], gain.shape[-1] // d, d), -3, -1)  # (..., k, d, p)
        return np.moveaxis(self.form.adjoint(blocks), -1, -3) if p else blocks

    def row_covariance(self, values: Array | None = None) -> RowCovariance:
        """The covariance of the *direct* rows at `values`, at `at`, or at the unweighted solution.

        Raises
        ------
        InputError
            If the noise is unknown.
        """
        if self.noise is None:
            raise InputError(
                f"{self.name}: the noise is unknown, so there is no covariance; give the measurements "
                "noise=UniformNoise(…) or NormalNoise(…), or use weights=None"
            )
        if values is None:
            values = self.at
        if values is None:
            values = solve(self.matrix, self.rhs, self.worst_cancellation, inverse=False).values
        return self.noise.covariance(values)

    def whitening(self, *, shared: bool = True) -> Whitening:
        r"""The symmetric root :math:`W = (D S D^T)^{-1/2}` that makes rows count in standard deviations.

        A whitened row still belongs to its own row, and a threshold of 1.345 means 1.345 σ. Where
        :math:`D S D^T` is singular by construction (the centred form) W is the root of its pseudo-inverse.
        Without the `shared` part, direct rows are whitened pose by pose by what each pose has for itself.

        Raises
        ------
        InputError
            If the noise is unknown, or leaves some row without any error.
        """
        covariance = self.row_covariance()
        if isinstance(self.form, Direct) and (covariance.common is None or not shared):
            return Whitening(self._inverse_root(covariance.blocks, 0))
        singular = self.rows_per_block if isinstance(self.form, Centred) else 0
        return Whitening(self._inverse_root(self._dense(covariance), singular)[..., None, :, :])

    def whitened(self) -> tuple[Array, Array]:
        """Matrix and right-hand side under :meth:`whitening`, shapes (..., m, p) and (..., m)."""
        return self.whitened_by(self.whitening())

    def whitened_by(self, root: Whitening | None) -> tuple[Array, Array]:
        """Matrix and right-hand side under a whitening, or as they are under None."""
        if root is None:
            return self.matrix, self.rhs
        return root.apply(self.matrix), root.apply(self.rhs[..., None])[..., 0]

    def with_shared(self) -> tuple[Array, Array]:
        """Whitened rows (..., m, p), and by the errors that they share, in their standard deviations, (..., m, r).

        Direct rows of different poses are independent given these; other forms are whitened whole, and share nothing.
        Where the noise is unknown the rows stay as they are.
        """
        nothing = np.zeros((*self.rhs.shape, 0))
        if self.noise is None:
            return self.matrix, nothing
        direct = isinstance(self.form, Direct)
        root, common = self.whitening(shared=not direct), self.row_covariance().common
        if not direct or common is None:
            return root.apply(self.matrix), nothing
        return root.apply(self.matrix), root.apply(common.reshape(*self.rhs.shape, common.shape[-1]))

    def _dense(self, covariance: RowCovariance) -> Array:
        """D S D', (..., m, m)."""
        n, d = covariance.blocks.shape[-3:-1]
        batch = covariance.blocks.shape[:-3]
        direct = np.zeros((*batch, n * d, n * d))
        for i in range(n):
            own = slice(i * d, (i + 1) * d)
            direct[..., own, own] = covariance.blocks[..., i, :, :]
        if covariance.common is not None:
            factor = covariance.common.reshape(*covariance.common.shape[:-3], n * d, covariance.common.shape[-1])
            direct = direct + factor @ transpose(factor)
        return self._form_rows(transpose(self._form_rows(direct)))

    def _form_rows(self, direct: Array) -> Array:
        """D applied to the rows of (..., n d, c)."""
        d = self.rows_per_block
        blocks = direct.reshape(*direct.shape[:-2], direct.shape[-2] // d, d, direct.shape[-1])
        formed = self.form.apply(blocks)
        return formed.reshape(*formed.shape[:-3], formed.shape[-3] * d, direct.shape[-1])

    def _inverse_root(self, covariance: Array, singular: int) -> Array:
        """Symmetric inverse square root; the `singular` smallest eigenvalues are known to be zero."""
        # where the unweighted solution failed there is no covariance: raw rows, which fail again by themselves
        finite = np.isfinite(covariance).all(axis=(-2, -1), keepdims=True)
        values, vectors = np.linalg.eigh(np.where(finite, covariance, np.eye(covariance.shape[-1])))
        if not (values[..., singular] > 1e-13 * values[..., -1]).all():
            raise InputError(
                f"{self.name}: the noise model leaves some equations without any error, so they cannot be "
                "weighted; give every reading that enters them a noise level > 0, or use weights=None"
            )
        values = values.copy()
        values[..., :singular] = np.inf
        root: Array = (vectors / np.sqrt(values)[..., None, :]) @ transpose(vectors)
        return root
