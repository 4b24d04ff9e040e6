"""Penalties on the deviation from a nominal: its square, or its length."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Real
from typing import ClassVar, Literal

import numpy as np

from ..arrays import Array, as_array
from ..errors import InputError
from ..geometry import Leg
from ..losses import L1, GroupL1, Loss, Quadratic
from ..named import NamedArrays, chosen_blocks, named_points, per_name, rows_of, sized
from ..parameters import Parameters
from .base import Prior, PriorRows, named_centre

__all__ = ["Lasso", "Ridge"]


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
        return named_centre(self, self.mean, parameters)

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
        As in :class:`~hexopt.GaussianPrior`.

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
        As in :class:`~hexopt.GaussianPrior`.

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
