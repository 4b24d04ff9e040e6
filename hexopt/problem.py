"""A linear calibration problem: matrix, right-hand side, named parameters, and the noise of its rows."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .arrays import Array, as_array, matvec, transpose
from .errors import InputError
from .numerics.forms import Direct, Form
from .numerics.lstsq import solve_svd
from .parameters import Parameters

__all__ = ["ConstantRowNoise", "LinearProblem", "RowCovariance", "RowNoise"]


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
        flat = gain.reshape(*gain.shape[:-2], -1)
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
    at : array_like, shape (..., p), optional
        Where the noise is evaluated for weights; by default at the unweighted solution.
    minimum_poses : int, optional
        How many poses the loop equation needs, for error messages.
    name : str
        What made the problem, for error messages.

    Raises
    ------
    InputError
        For shapes that do not fit, or values that are not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from hexopt import Block, LinearProblem, Parameters, LeastSquares, estimate
    >>> line = LinearProblem(np.array([[1, 0], [1, 1], [1, 2.0]]), np.array([1, 3, 5.0]),
    ...                      Parameters((Block("level", 1, "cm"), Block("slope", 1, "cm/s"))))
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
    minimum_poses: int | None = None
    name: str = "the problem"

    def __post_init__(self) -> None:
        object.__setattr__(self, "matrix", as_array("matrix", self.matrix, ("m", self.parameters.size)))
        object.__setattr__(self, "rhs", as_array("rhs", self.rhs, ("m",)))
        if self.rhs.shape != self.matrix.shape[:-1]:
            raise InputError(f"matrix {self.matrix.shape} and rhs {self.rhs.shape} disagree")
        if self.matrix.shape[-2] == 0:
            raise InputError(f"{self.name}: there is no equation; are there any poses?")
        if self.matrix.shape[-2] % self.rows_per_block:
            raise InputError(f"{self.matrix.shape[-2]} rows are no multiple of rows_per_block={self.rows_per_block}")
        if self.at is not None:
            object.__setattr__(self, "at", as_array("at", self.at, (self.parameters.size,)))

    @property
    def batch_shape(self) -> tuple[int, ...]:
        """Leading dimensions: () for one problem."""
        return self.rhs.shape[:-1]

    def residual(self, values: Array) -> Array:
        """``A x − y``, shape (..., m)."""
        return matvec(self.matrix, values) - self.rhs

    def direct_gain(self, gain: Array) -> Array:
        """The gain on direct rows, (..., p, n, d), of a gain on this form's rows, (..., p, m)."""
        p, d = gain.shape[-2], self.rows_per_block
        blocks = np.moveaxis(gain.reshape(*gain.shape[:-1], -1, d), -3, -1)  # (..., k, d, p)
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
            values = self.at if self.at is not None else solve_svd(self.matrix, self.rhs).values
        return self.noise.covariance(values)

    def whitened(self) -> tuple[Array, Array]:
        r"""Rows in units of their standard deviation: :math:`(W A, W y)` with :math:`W = (D S D^T)^{-1/2}`.

        W is the symmetric root, so a whitened row still belongs to its own row, and a threshold of
        1.345 means 1.345 σ. Where :math:`D S D^T` is singular by construction (the centred form) the
        root is that of the pseudo-inverse.

        Returns
        -------
        matrix, rhs : ndarray, shape (..., m, p) and (..., m)

        Raises
        ------
        InputError
            If the noise is unknown, or leaves some row without any error.
        """
        covariance = self.row_covariance()
        stacked = np.concatenate([self.matrix, self.rhs[..., None]], axis=-1)
        if isinstance(self.form, Direct) and covariance.common is None:
            blocks = stacked.reshape(*self.batch_shape, -1, self.rows_per_block, stacked.shape[-1])
            white = (self._inverse_root(covariance.blocks, 0) @ blocks).reshape(stacked.shape)
        else:
            dense = self._dense(covariance)
            singular = self.rows_per_block if self.form.name == "centred" else 0
            white = self._inverse_root(dense, singular) @ stacked
        return white[..., :-1], white[..., -1]

    def _dense(self, covariance: RowCovariance) -> Array:
        """D S D', (..., m, m)."""
        n, d = covariance.blocks.shape[-3:-1]
        dense = np.zeros((*covariance.blocks.shape[:-3], n, d, n, d))
        pose = np.arange(n)
        # two index arrays split by a slice: NumPy puts the pose axis first
        dense[..., pose, :, pose, :] = np.moveaxis(covariance.blocks, -3, 0)
        dense = dense.reshape(*dense.shape[:-4], n, d, n * d)
        if covariance.common is not None:
            flat = covariance.common.reshape(*covariance.common.shape[:-3], n * d, -1)
            dense = dense + (flat @ transpose(flat)).reshape(dense.shape[:-3] + (n, d, n * d))
        left = self.form.apply(dense)  # (..., k, d, n d)
        m = left.shape[-3] * d
        right = transpose(left.reshape(*left.shape[:-3], m, n * d))
        both = self.form.apply(right.reshape(*right.shape[:-2], n, d, m))
        return both.reshape(*both.shape[:-3], m, m)

    def _inverse_root(self, covariance: Array, singular: int) -> Array:
        """Symmetric inverse square root; the `singular` smallest eigenvalues are known to be zero."""
        values, vectors = np.linalg.eigh(covariance)
        smallest = values[..., singular] if values.shape[-1] > singular else values[..., -1]
        if not (smallest > 1e-13 * values[..., -1]).all():
            raise InputError(
                f"{self.name}: the noise model leaves some equations without any error, so they cannot be "
                "weighted; give every reading that enters them a noise level > 0, or use weights=None"
            )
        values = values.copy()
        values[..., :singular] = np.inf
        root: Array = (vectors / np.sqrt(values)[..., None, :]) @ transpose(vectors)
        return root
