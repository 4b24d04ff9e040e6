"""The rows of :class:`~hexopt.loops.LegLength` in σ, and their derivatives, fast and for chosen members of a batch."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array, matvec
from ..loops import LegLength
from ..problem import ConstantRowNoise, LinearProblem, RowCovariance, Whitening

__all__ = ["LegRows"]


@dataclass(frozen=True, eq=False)
class LegRows:
    r"""Rows :math:`F_i(\lVert P_i + R_i b - a\rVert - \gamma\rho_i - \delta)` of B sets, a flat batch.

    Attributes
    ----------
    loop : LegLength
        Of the whole batch.
    position, rotation : ndarray, shape (3, B, n) and (3, 3, B, n)
        One component after the other, so that every operation is one long pass.
    reading : ndarray, shape (B, n)
    known : dict of str to ndarray, shape (B, size)
    factor : ndarray, shape (B, n) or (B, n, n), or None
        What makes rows count in σ; None for raw rows.
    shared : bool
        Whether `factor` holds the error that all poses share.
    one_direction : bool
        Whether the derivatives by the base point are those of the mean direction: what noise makes of a locked
        direction, that it seems to turn, is then left out.
    """

    loop: LegLength
    position: Array
    rotation: Array
    reading: Array
    known: dict[str, Array]
    factor: Array | None = None
    shared: bool = True
    one_direction: bool = False

    @classmethod
    def of(cls, loop: LegLength) -> LegRows:
        """The raw rows of a loop."""
        data, count = loop.data, int(np.prod(loop.data.batch_shape))
        shape = (*data.batch_shape, data.n_poses)
        return cls(
            loop,
            np.ascontiguousarray(np.moveaxis(data.position.reshape(count, -1, 3), -1, 0)),
            np.ascontiguousarray(np.moveaxis(data.rotation.reshape(count, -1, 3, 3), (-2, -1), (0, 1))),
            np.broadcast_to(data.readings(), shape).reshape(count, -1),
            {
                name: np.broadcast_to(value, (*data.batch_shape, value.shape[-1])).reshape(count, -1)
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
            position=self.position[:, which],
            rotation=self.rotation[:, :, which],
            reading=self.reading[which],
            known={name: value[which] for name, value in self.known.items()},
            factor=None if self.factor is None else self.factor[which],
        )

    def _raw(self, x: Array) -> tuple[Array, Array]:
        parameters = self.loop.parameters
        blocks = {**self.known, **parameters.split(x)}
        b, a = (np.moveaxis(blocks[name], -1, 0)[..., None] for name in ("platform_point", "base_point"))
        r = self.rotation
        vector = self.position + r[:, 0] * b[0] + r[:, 1] * b[1] + r[:, 2] * b[2] - a
        length = np.sqrt(np.square(vector).sum(axis=0))
        residual = length - blocks["gain"] * self.reading - blocks["offset"]
        unit = vector / length
        columns: dict[str, Any] = {
            "platform_point": lambda: unit[0] * r[0] + unit[1] * r[1] + unit[2] * r[2],
            "base_point": lambda: -(unit.mean(axis=-1, keepdims=True) if self.one_direction else unit),
            "offset": lambda: -1.0,
            "gain": lambda: -self.reading,
        }
        jacobian = np.empty((parameters.size, *residual.shape))
        for name in parameters.names:
            jacobian[parameters[name]] = columns[name]()
        jacobian = np.moveaxis(jacobian, 0, -1)
        failed = np.isnan(residual).any(axis=-1)
        if failed.any():  # a known value that failed: no equations, so that these sets fail alone
            residual[failed], jacobian[failed] = 0.0, 0.0
        return residual, jacobian
