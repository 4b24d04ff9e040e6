"""The normal prior, such as CAD values ± tolerance."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from ..arrays import Array, as_array, transpose
from ..errors import InputError
from ..geometry import Leg
from ..losses import Quadratic
from ..named import NamedArrays, chosen_blocks, named_points, per_name, rows_of, sized
from ..parameters import Parameters
from .base import Prior, PriorRows, named_centre

__all__ = ["GaussianPrior"]


@dataclass(frozen=True, eq=False, repr=False)
class GaussianPrior(NamedArrays, Prior):
    r"""A normal prior: :math:`\tfrac12 (x - \mu)^T \Lambda^{-1} (x - \mu)`, such as CAD values ± tolerance.

    Parameters
    ----------
    mean : dict of str to array_like
        :math:`\mu` by parameter name, (..., size); a leading batch dimension is allowed.
    covariance : dict of str to array_like, or array_like
        :math:`\Lambda`: by name a variance or a matrix (..., size, size), or one matrix of all named entries in
        the order of `mean`. In squared units of the parameters.
    unit : str, optional
        The length unit of the values, checked against the problem.
    if_present : bool, default False
        Whether names that a problem does not have are left out instead of being an error.

    Raises
    ------
    InputError
        If a covariance is not symmetric and positive definite, or names disagree.

    Notes
    -----
    The rows of the problem must count in standard deviations: weights="model", or a scale.

    Examples
    --------
    >>> import hexopt as hx
    >>> nominal = hx.robots.left_hand().leg(3)
    >>> prior = hx.GaussianPrior.around(nominal, 0.1)  # ± 0.1 cm on both points
    >>> prior == hx.GaussianPrior(
    ...     {"platform_point": nominal.platform_point, "base_point": nominal.base_point},
    ...     {"platform_point": 0.1**2, "base_point": 0.1**2},
    ...     unit="cm",
    ...     if_present=True,
    ... )
    True
    """

    mean: Mapping[str, Array]
    covariance: Mapping[str, Array] | Array
    unit: str | None = None
    if_present: bool = False

    gaussian: ClassVar[bool] = True

    def __post_init__(self) -> None:
        mean = {
            name: as_array(name, value, own=True)
            for name, value in per_name("GaussianPrior", "mean", self.mean).items()
        }
        object.__setattr__(self, "mean", mean)
        if not isinstance(self.covariance, Mapping):
            joint = as_array("covariance", self.covariance, ("q", "q"), own=True)
            object.__setattr__(self, "covariance", joint)
            _check_definite("covariance", joint)
            return
        if set(self.covariance) != set(mean):
            raise InputError(f"GaussianPrior: mean names {', '.join(mean)}; covariance {', '.join(self.covariance)}")
        parts = {name: as_array(f"covariance of {name}", self.covariance[name], own=True) for name in mean}
        for name, part in parts.items():
            if part.ndim == 1:
                raise InputError(
                    f"covariance of {name}: expected a variance or a matrix, got shape {part.shape}; write np.diag(…)"
                )
            _check_definite(f"covariance of {name}", part if part.ndim else part[None, None])
        object.__setattr__(self, "covariance", parts)

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], tolerance: npt.ArrayLike | Mapping[str, Any]) -> GaussianPrior:
        """A leg's points, each entry ± `tolerance` (one standard deviation; by name, or the same for both points)."""
        points, unit = named_points(cls.__name__, leg, tolerance)
        mean = {name: centre for name, (centre, _) in points.items()}
        variance = {name: _variance(np.square(size)) for name, (_, size) in points.items()}
        return cls(mean, variance, unit=unit, if_present=True)

    def centre(self, parameters: Parameters) -> Array:
        """The mean; NaN for parameters without a prior."""
        return named_centre(self, self.mean, parameters)

    def rows(self, parameters: Parameters) -> list[PriorRows]:
        r"""Rows :math:`\Lambda^{-1/2}(x - \mu)` under a quadratic loss."""
        blocks = chosen_blocks(
            "GaussianPrior", self.mean, parameters, if_present=self.if_present, length_unit=self.unit
        )
        pick = np.concatenate([rows_of(parameters, block.name) for block in blocks])
        means = [sized(block.name, self.mean[block.name], block) for block in blocks]
        shape = np.broadcast_shapes(*(mean.shape[:-1] for mean in means))
        mean = np.concatenate([np.broadcast_to(part, (*shape, part.shape[-1])) for part in means], axis=-1)
        root = _inverse_root(self._joint([block.name for block in blocks], [block.size for block in blocks]))
        return [PriorRows(Quadratic(), root @ pick, (root @ mean[..., None])[..., 0])]

    def _joint(self, names: list[str], sizes: list[int]) -> Array:
        """The covariance of the chosen blocks, (..., q, q)."""
        if not isinstance(self.covariance, Mapping):
            if self.covariance.shape[-1] != sum(sizes) or names != list(self.mean):
                raise InputError(
                    f"covariance: expected {sum(sizes)} × {sum(sizes)} for {', '.join(names)}, "
                    f"got shape {self.covariance.shape}"
                )
            return self.covariance
        parts = []
        for name, size in zip(names, sizes, strict=True):
            part = self.covariance[name]
            part = part * np.eye(size) if part.ndim == 0 else part
            if part.shape[-1] != size:
                raise InputError(f"covariance of {name}: expected {size} × {size}, got shape {part.shape}")
            parts.append(part)
        out = np.zeros((*np.broadcast_shapes(*(part.shape[:-2] for part in parts)), sum(sizes), sum(sizes)))
        end = 0
        for part in parts:
            own = slice(end, end := end + part.shape[-1])
            out[..., own, own] = part
        return out


def _variance(square: Array) -> Array:
    """One variance, or a diagonal matrix of several."""
    return square if square.ndim == 0 else square[..., None] * np.eye(square.shape[-1])


def _check_definite(name: str, matrix: Array) -> None:
    if matrix.ndim < 2 or matrix.shape[-1] != matrix.shape[-2]:
        raise InputError(f"{name}: expected a square matrix, got shape {matrix.shape}")
    if not np.allclose(matrix, transpose(matrix), rtol=1e-9, atol=0):
        raise InputError(f"{name}: the matrix is not symmetric")
    values = np.linalg.eigvalsh(matrix)
    if not (values[..., 0] > 1e-14 * np.abs(values[..., -1])).all():
        raise InputError(
            f"{name}: expected a positive definite matrix, its smallest eigenvalue is {values[..., 0].min():.3g}; "
            "to fix a parameter use bounds=Linear(…, equal=…)"
        )


def _inverse_root(covariance: Array) -> Array:
    values, vectors = np.linalg.eigh(covariance)
    root: Array = (vectors / np.sqrt(values)[..., None, :]) @ transpose(vectors)
    return root
