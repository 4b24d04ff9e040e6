"""The rows of :class:`~hexopt.loops.LegLength` in σ, and their derivatives, fast and for chosen members of a batch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array, matvec, norm
from ..loops import LegLength
from ..measurements import Lock
from ..numerics.lstsq import EPS
from ..problem import ConstantRowNoise, LinearProblem, RowCovariance, Whitening

__all__ = ["LegRows"]

#: So much of the lengths that a row is a difference of is lost in it.
ROUNDING = 8 * EPS


@dataclass(frozen=True, eq=False)
class LegRows:
    r"""Rows :math:`F_i(\lVert P_i + R_i b - a\rVert - \gamma\rho_i - \delta)` of B sets, a flat batch.

    Attributes
    ----------
    loop : LegLength
        Of the whole batch.
    position, rotation, reading : ndarray, shape (3, n, B), (3, 3, n, B) and (n, B)
        The batch last, so that every operation is one long pass.
    known : dict of str to ndarray, shape (B, size)
    factor : ndarray, shape (B, n) or (B, n, n), or None
        What makes rows count in σ; None for raw rows. The first has the batch last in memory.
    shared : bool
        Whether `factor` holds the error that all poses share.
    noiseless : bool
        Whether what a lock keeps is kept in the derivatives too, the direction or the reading at its mean: noise makes
        it look as if it changed, and so as if the rows saw what they do not.
    """

    loop: LegLength
    position: Array
    rotation: Array
    reading: Array
    known: dict[str, Array]
    factor: Array | None = None
    shared: bool = True
    noiseless: bool = False

    @classmethod
    def of(cls, loop: LegLength) -> LegRows:
        """The raw rows of a loop."""
        data, count, n = loop.data, int(np.prod(loop.data.batch_shape)), loop.data.n_poses
        return cls(
            loop,
            np.ascontiguousarray(data.position.reshape(count, n, 3).transpose(2, 1, 0)),
            np.ascontiguousarray(data.rotation.reshape(count, n, 3, 3).transpose(2, 3, 1, 0)),
            np.ascontiguousarray(np.broadcast_to(data.readings(), (*data.batch_shape, n)).reshape(count, n).T),
            {
                name: np.broadcast_to(value, (*data.batch_shape, value.shape[-1])).reshape(count, value.shape[-1])
                for name, value in loop._known.items()
            },
        )

    def weighted(self, root: Whitening | None, scale: Array | None, *, shared: bool = True) -> LegRows:
        """The rows under a whitening, and divided by a scale (...)."""
        batch, n = self.loop.data.batch_shape, self.loop.data.n_poses
        factor = None if scale is None else np.broadcast_to(1 / scale[..., None], (*batch, n)).reshape(-1, n)
        if root is not None:
            size = root.blocks.shape[-1]
            blocks = np.broadcast_to(root.blocks, (*batch, n // size, size, size)).reshape(-1, n // size, size, size)
            whitened = blocks[:, :, 0, 0] if size == 1 else blocks[:, 0]
            factor = (
                whitened if factor is None else whitened * factor.reshape(factor.shape + (1,) * (whitened.ndim - 2))
            )
        if factor is not None and factor.ndim == 2:
            factor = np.asfortranarray(factor)
        return replace(self, factor=factor, shared=shared)

    @property
    def is_raw(self) -> bool:
        """Whether rows do not count in σ."""
        return self.factor is None

    def at(self, x: Array) -> tuple[Array, Array]:
        """Misclosure (B, n) and its derivatives (B, n, p) at x (B, p)."""
        residual, jacobian = self._raw(x)
        if self.factor is None:
            return residual, jacobian
        if self.factor.ndim == 2:
            return self.factor * residual, self.factor[..., None] * jacobian
        return matvec(self.factor, residual), self.factor @ jacobian

    def rounding(self, x: Array) -> Array:
        r"""By how much each row (B, n) at x is uncertain: a few roundings of the lengths that it is a difference of.

        Those are :math:`\lVert P\rVert, \lVert b\rVert, \lVert a\rVert, |\gamma\rho|, |\delta|`, of which less is left.
        """
        blocks = {**self.known, **self.loop.parameters.split(x)}
        fixed = norm(blocks["platform_point"]) + norm(blocks["base_point"]) + np.abs(blocks["offset"][..., 0])
        size = np.sqrt(np.square(self.position).sum(axis=0)) + fixed + np.abs(blocks["gain"][:, 0] * self.reading)
        size = size.T
        if self.factor is None:
            return np.asarray(ROUNDING * size)
        factor = np.abs(self.factor)
        return np.asarray(ROUNDING * (factor * size if factor.ndim == 2 else matvec(factor, size)))

    def problem(self, x: Array) -> LinearProblem:
        """The rows to first order about x (..., p), as equations of x itself."""
        local, shape = self.loop.linearised(x), x.shape[:-1]
        residual, jacobian = self.at(x.reshape(-1, x.shape[-1]))
        n, noise = residual.shape[-1], local.noise
        if self.factor is not None:
            common = None if noise is None or self.shared else noise.covariance(x).common
            if common is not None:
                flat = common.reshape(-1, n, common.shape[-1])
                flat = self.factor[..., None] * flat if self.factor.ndim == 2 else self.factor @ flat
                common = flat.reshape(common.shape)
            noise = ConstantRowNoise(RowCovariance(np.ones((*shape, n, 1, 1)), common))
        rhs = matvec(jacobian, x.reshape(-1, x.shape[-1])) - residual
        return replace(
            local, matrix=jacobian.reshape(local.matrix.shape), rhs=rhs.reshape(local.rhs.shape), noise=noise, at=x
        )

    def direct(self, influence: Array) -> Array:
        """An influence (..., p, n, 1) of these rows as one of the raw ones."""
        if self.factor is None:
            return influence
        flat = influence.reshape(-1, *influence.shape[-3:-1])
        flat = flat * self.factor[:, None, :] if self.factor.ndim == 2 else flat @ self.factor
        return flat.reshape(influence.shape)

    def take(self, which: Any) -> LegRows:
        """Some members of the batch, by an index array."""
        return replace(
            self,
            position=self.position.take(which, axis=-1),
            rotation=self.rotation.take(which, axis=-1),
            reading=self.reading.take(which, axis=-1),
            known={name: value[which] for name, value in self.known.items()},
            factor=None if self.factor is None else self.factor.T.take(which, axis=-1).T,
        )

    def _raw(self, x: Array) -> tuple[Array, Array]:
        parameters = self.loop.parameters
        blocks = {**self.known, **parameters.split(x)}
        b, a = (np.ascontiguousarray(blocks[name].T)[:, None] for name in ("platform_point", "base_point"))
        r = self.rotation
        vector = self.position - a
        for column in range(3):
            vector += r[:, column] * b[column]
        length = np.sqrt(np.einsum("cnb,cnb->nb", vector, vector))
        residual = length - blocks["gain"][:, 0] * self.reading - blocks["offset"][:, 0]
        unit = np.divide(vector, length, out=vector)
        columns: dict[str, Any] = {
            "platform_point": lambda: unit[0] * r[0] + unit[1] * r[1] + unit[2] * r[2],
            "base_point": lambda: -self._kept(unit, Lock.DIRECTION),
            "offset": lambda: -1.0,
            "gain": lambda: -self._kept(self.reading, Lock.LENGTH),
        }
        jacobian = np.empty((len(residual), parameters.size, len(x)))
        for name in parameters.names:
            jacobian[:, parameters[name]].swapaxes(0, 1)[:] = columns[name]()
        residual, jacobian = residual.T, np.moveaxis(jacobian, -1, 0)
        failed = np.isnan(residual).any(axis=-1)
        if failed.any():  # a known value that failed: no equations, so that these sets fail alone
            residual[failed], jacobian[failed] = 0.0, 0.0
        return residual, jacobian

    def _kept(self, measured: Array, lock: Lock) -> Array:
        """What is measured in every pose (n, B), or its mean where that is to be constant under a lock."""
        constant = self.noiseless and self.loop.data.lock in (lock, Lock.LEG)
        return measured.mean(axis=-2, keepdims=True) if constant else measured
