r"""What a good choice of poses makes small: functions of the predicted covariance C of what is of interest."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..arrays import Array
from ..information import PoseInformation

__all__ = ["AOptimal", "Criterion", "DOptimal", "EOptimal"]


class Criterion(ABC):
    r"""A function :math:`\varphi(C)` of the covariance :math:`C = K^T M(w)^{-1} K`, convex in the weights w.

    A subclass gives its value and its gradient; the exchange of poses and the certificate need no more. With `curved`
    it also has a relaxation by our interior-point method.

    Attributes
    ----------
    name : str
        What designs and errors call it.
    curved : {"linear", "logdet", ""}
        "linear" where :math:`\varphi` is linear in C (or a maximum of such functions), "logdet" for
        :math:`\log\det C`; empty where the method does not know its second derivative.
    least : float
        No covariance has a lower value.
    convex : bool
        Whether it is convex in the weights, as bounds need: not so for indices that are there for comparison.
    full : bool
        Whether it is of all coordinates, :math:`C = M(w)^{-1}`, instead of those of interest.
    """

    name: str
    curved: ClassVar[str] = ""
    least: ClassVar[float] = -np.inf
    convex: bool = True
    full: ClassVar[bool] = False

    @abstractmethod
    def pieces(self, covariance: Array) -> Array:
        r"""Functions (..., j) of C (..., k, k), the largest of which is the criterion; infinite for infinite C."""

    @abstractmethod
    def slopes(self, covariance: Array) -> Array:
        r"""Their gradients by C, positive semidefinite, shape (..., j, k, k)."""

    def on(self, target: Any, at: Any, information: PoseInformation) -> Criterion:
        """The criterion for candidates and what is of interest of them; as it is, unless it depends on these."""
        return self

    @property
    def twin(self) -> Criterion | None:
        """A criterion that chooses as this one does, if it is an increasing function of one: see `of_twin`."""
        return None

    def of_twin(self, value: float, main: int) -> float:
        """The value of this criterion, of k parameters, from that of its twin."""
        return value

    def value(self, covariance: Array) -> Array:
        """The criterion, shape (...)."""
        return self.pieces(covariance).max(axis=-1)

    def efficiency(self, bound: Array | float, value: Array | float, main: int) -> Array:
        """How much of the best possible a value reaches, in [0, 1]: as a ratio of variances."""
        return np.asarray(bound) / np.asarray(value)


@dataclass(frozen=True)
class AOptimal(Criterion):
    r"""The sum of variances, :math:`\operatorname{tr} C`: the mean squared error, each parameter by its spread."""

    name = "A"
    curved = "linear"
    least = 0.0

    def pieces(self, covariance: Array) -> Array:
        """tr C."""
        return np.einsum("...ii->...", covariance)[..., None]

    def slopes(self, covariance: Array) -> Array:
        """The identity."""
        return np.broadcast_to(np.eye(covariance.shape[-1]), covariance.shape)[..., None, :, :]


@dataclass(frozen=True)
class DOptimal(Criterion):
    r"""The volume of the confidence ellipsoid, :math:`\log\det C`; it does not depend on units or spreads."""

    name = "D"
    curved = "logdet"

    def pieces(self, covariance: Array) -> Array:
        """log det C."""
        finite = np.isfinite(np.einsum("...ii->...", covariance))
        safe = np.where(finite[..., None, None], covariance, np.eye(covariance.shape[-1]))
        return np.asarray(np.where(finite, np.linalg.slogdet(safe)[1], np.inf), dtype=float)[..., None]

    def slopes(self, covariance: Array) -> Array:
        """The inverse of C."""
        return np.asarray(np.linalg.inv(covariance), dtype=np.float64)[..., None, :, :]

    def efficiency(self, bound: Array | float, value: Array | float, main: int) -> Array:
        """The ratio of geometric means of variances."""
        ratio: Array = np.exp(np.subtract(bound, value) / main)
        return ratio


@dataclass(frozen=True)
class EOptimal(Criterion):
    r"""The largest variance of any combination, :math:`\lambda_\max(C)`: the longest axis of the ellipsoid."""

    name = "E"
    least = 0.0

    def pieces(self, covariance: Array) -> Array:
        """The largest eigenvalue."""
        finite = np.isfinite(np.einsum("...ii->...", covariance))
        safe = np.where(finite[..., None, None], covariance, 0.0)
        return np.where(finite, np.linalg.eigvalsh(safe)[..., -1], np.inf)[..., None]

    def slopes(self, covariance: Array) -> Array:
        """The projection on one of its eigenvectors: where it is multiple, not the only gradient."""
        vector = np.linalg.eigh(covariance)[1][..., -1]
        return (vector[..., :, None] * vector[..., None, :])[..., None, :, :]
