r"""Priors on named parameters: losses of their deviation from a nominal, added to the programme.

A prior is a loss of a linear function of x, so that every route and the certificate take it as further rows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from .arrays import Array, as_array, transpose
from .errors import InputError
from .geometry import Leg
from .losses import L1, GroupL1, Loss, Quadratic
from .named import NamedArrays, chosen_blocks, named_points, per_name, rows_of, sized
from .parameters import Parameters

__all__ = ["GaussianPrior", "Lasso", "Prior", "PriorRows", "Ridge"]


@dataclass(frozen=True, eq=False)
class PriorRows:
    """A loss of the rows C x − d, in blocks of `size` rows.

    Parameters
    ----------
    loss : Loss
    matrix : ndarray, shape (..., q, p)
    rhs : ndarray, shape (..., q)
    size : int, default 1
    """

    loss: Loss
    matrix: Array
    rhs: Array
    size: int = 1


class Prior(ABC):
    """What is known of some parameters before the measurements: write `rows` to make your own."""

    #: Whether x + prior is normally distributed, so that the estimate has a posterior covariance.
    gaussian: ClassVar[bool] = False

    @abstractmethod
    def rows(self, parameters: Parameters) -> list[PriorRows]:
        """The losses that the prior adds to a problem of these parameters."""

    @abstractmethod
    def centre(self, parameters: Parameters) -> Array:
        """Where the prior alone is least, shape (..., p); NaN for parameters that it does not speak of."""


def _centre(kind: Any, values: Mapping[str, Array], parameters: Parameters) -> Array:
    """The named values in their places, NaN elsewhere."""
    blocks = chosen_blocks(type(kind).__name__, values, parameters, if_present=kind.if_present, length_unit=kind.unit)
    parts = {block.name: sized(block.name, values[block.name], block) for block in blocks}
    out = np.full((*np.broadcast_shapes(*(part.shape[:-1] for part in parts.values())), parameters.size), np.nan)
    for name, part in parts.items():
        out[..., parameters[name]] = part
    return out


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
        return _centre(self, self.mean, parameters)

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


@dataclass(frozen=True, eq=False, repr=False)
class _Deviation(NamedArrays, Prior):
    """A penalty of strength λ on the deviation from a nominal."""

    mean: Mapping[str, Array]
    strength: float
    unit: str | None = None
    if_present: bool = False

    def __post_init__(self) -> None:
        kind = type(self).__name__
        mean = {name: as_array(name, value, own=True) for name, value in per_name(kind, "mean", self.mean).items()}
        object.__setattr__(self, "mean", mean)
        number = isinstance(self.strength, Real) and not isinstance(self.strength, bool)
        if not number or not 0 < float(self.strength) < np.inf:
            raise InputError(f"{kind}: strength must be a number > 0, got {self.strength!r}")

    def centre(self, parameters: Parameters) -> Array:
        """The mean; NaN for parameters without a prior."""
        return _centre(self, self.mean, parameters)

    def _deviations(self, parameters: Parameters) -> list[tuple[Array, Array]]:
        """Rows and right-hand side of each block's x − μ."""
        kind = type(self).__name__
        blocks = chosen_blocks(kind, self.mean, parameters, if_present=self.if_present, length_unit=self.unit)
        return [(rows_of(parameters, block.name), sized(block.name, self.mean[block.name], block)) for block in blocks]


@dataclass(frozen=True, eq=False, repr=False)
class Ridge(_Deviation):
    r"""A quadratic penalty: :math:`\tfrac{\lambda}{2}\lVert x - \mu\rVert^2` on named parameters.

    Parameters
    ----------
    mean : dict of str to array_like
        :math:`\mu` by parameter name.
    strength : float
        :math:`\lambda`, in squared standard deviations of rows per squared unit of the parameters: a normal prior
        of standard deviation :math:`1/\sqrt{\lambda}`.
    unit, if_present
        As in :class:`GaussianPrior`.

    Examples
    --------
    >>> Ridge({"offset": 15.25}, strength=4.0)
    Ridge(mean={'offset': 15.25}, strength=4.0, unit=None, if_present=False)
    """

    gaussian: ClassVar[bool] = True

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], strength: float) -> Ridge:
        """Both points of a leg, or of several."""
        points, unit = named_points(cls.__name__, leg, 0.0)
        return cls({name: centre for name, (centre, _) in points.items()}, strength, unit=unit, if_present=True)

    def rows(self, parameters: Parameters) -> list[PriorRows]:
        r"""Rows :math:`\sqrt\lambda(x - \mu)` under a quadratic loss."""
        root = np.sqrt(self.strength)
        return [PriorRows(Quadratic(), root * pick, root * mean) for pick, mean in self._deviations(parameters)]


@dataclass(frozen=True, eq=False, repr=False)
class Lasso(_Deviation):
    r"""A sparse deviation: :math:`\lambda\sum_j \lVert x_j - \mu_j\rVert`: only what really moved leaves the nominal.

    Parameters
    ----------
    mean : dict of str to array_like
        :math:`\mu` by parameter name.
    strength : float
        :math:`\lambda`, per unit of the parameters.
    by : {"joint", "entry"}, default "joint"
        "joint": the length of each block's deviation, the same in every frame (the group lasso); "entry": the
        sum of absolute values of all entries.
    unit, if_present
        As in :class:`GaussianPrior`.

    Notes
    -----
    The estimate is biased towards the nominal by design, and has no covariance.

    Examples
    --------
    >>> Lasso({"base_point": [12.76, 3.9, 0.0]}, strength=10.0, by="entry").by
    'entry'
    """

    by: Literal["joint", "entry"] = "joint"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.by not in ("joint", "entry"):
            raise InputError(f"Lasso: by is 'joint' or 'entry', got {self.by!r}")

    @classmethod
    def around(cls, leg: Leg | Iterable[Leg], strength: float, by: Literal["joint", "entry"] = "joint") -> Lasso:
        """Both points of a leg, or of several."""
        points, unit = named_points(cls.__name__, leg, 0.0)
        return cls({name: centre for name, (centre, _) in points.items()}, strength, unit, if_present=True, by=by)

    def rows(self, parameters: Parameters) -> list[PriorRows]:
        """Rows x − μ under ``λ|·|``, or under λ‖·‖ of each block."""
        loss: Loss = GroupL1(self.strength) if self.by == "joint" else L1(self.strength)
        return [
            PriorRows(loss, pick, mean, len(pick) if self.by == "joint" else 1)
            for pick, mean in self._deviations(parameters)
        ]
