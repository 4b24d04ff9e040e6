r"""The condition number and the observability indices, as criteria to compare designs with.

They are functions of the singular values :math:`\sigma_1 \ge … \ge \sigma_k` of the whitened, scaled rows: of the
eigenvalues :math:`1/\sigma_j^2` of a covariance. What a design minimises is 1/O.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array, as_count, brief, transpose
from ..errors import InputError
from .criteria import Criterion, DOptimal, EOptimal

__all__ = ["RESOLVED", "ConditionNumber", "ObservabilityIndex"]

#: A condition number beyond this is rounding.
RESOLVED = 1e7
#: Eigenvalues below this share of the largest are rounding.
FLOOR = float(np.finfo(float).eps)
#: Of these, 1/O is convex in the weights.
CONVEX = (1, 3, 5)


class _Index(Criterion):
    """1/O of an index of given number."""

    least = 0.0

    def _number(self) -> int:
        raise NotImplementedError

    def pieces(self, covariance: Array) -> Array:
        """1/O; infinite for infinite C."""
        finite = np.isfinite(np.einsum("...ii->...", covariance))
        safe = np.where(finite[..., None, None], covariance, np.eye(covariance.shape[-1]))
        if self._number() == 1:  # keeps the digits of small eigenvalues
            index = np.exp(np.linalg.slogdet(safe)[1] / (2 * safe.shape[-1]))
        else:
            index = _inverse_index(self._number(), _raised(np.linalg.eigvalsh(safe)))[0]
        return np.where(finite, index, np.inf)[..., None]

    def slopes(self, covariance: Array) -> Array:
        """The gradient of 1/O by C; where an extreme eigenvalue is multiple, not the only one."""
        values, vectors = np.linalg.eigh(covariance)
        slopes = _inverse_index(self._number(), _raised(values))[1]
        return ((vectors * slopes[..., None, :]) @ transpose(vectors))[..., None, :, :]

    def efficiency(self, bound: Array | float, value: Array | float, main: int) -> Array:
        """The squared ratio: as of variances, where 1/O goes as a standard deviation."""
        return (np.asarray(bound) / np.asarray(value)) ** 2


@dataclass(frozen=True)
class ConditionNumber(_Index):
    r"""The condition number :math:`\kappa = \sigma_1/\sigma_m` of the whitened rows by *all* unknowns.

    That is the root of the condition number of M(w), nuisances and shared errors included. It says nothing of the
    size of errors, and it depends on how unknowns are scaled: parameters of interest by their expected spread, the
    others so that their columns, over all candidates, are as long as those of interest. So it is for comparison;
    design by :class:`AOptimal` or :class:`DOptimal`. It is not convex in the weights, so that its gradient gives no
    bound; but it is quasi-convex, and least by the exact programme :math:`\min t,\; I \preceq M(w) \preceq tI` with
    weights free in scale (:mod:`hexopt.selection.condition`). After the nuisance is eliminated not even that is true.

    References
    ----------
    Driels and Pathre (1990).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> float(hx.ConditionNumber().value(np.diag([1.0, 4.0, 9.0])))
    3.0
    """

    name = "κ"
    full = True
    convex = False

    def _number(self) -> int:
        return 2


@dataclass(frozen=True)
class ObservabilityIndex(_Index):
    r"""One of the indices O1…O5 of the parameters of interest, nuisances eliminated; a design minimises 1/O.

    .. math:: \frac{1}{O_1} = \Bigl(\prod\frac{1}{\sigma_j}\Bigr)^{1/k}, \quad
              \frac{1}{O_2} = \frac{\sigma_1}{\sigma_k}, \quad \frac{1}{O_3} = \frac{1}{\sigma_k}, \quad
              \frac{1}{O_4} = \frac{\sigma_1}{\sigma_k^2}, \quad \frac{1}{O_5} = \sum\frac{1}{\sigma_j}.

    The factor :math:`\sqrt{N}` of O1 is left out: designs of so many poses share it.

    Parameters
    ----------
    number : int
        1…5.

    Raises
    ------
    InputError
        For another number.

    Notes
    -----
    O1 chooses as D does, :math:`1/O_1 = (\det C)^{1/2k}`, and O3 as E does, :math:`1/O_3 = \lambda_{\max}(C)^{1/2}`.
    O5 is Kiefer's criterion with p = 1/2, :math:`\operatorname{tr} C^{1/2}`. These three are convex in the weights:
    each is a convex, decreasing function of the Schur complement :math:`C^{-1}`, which is concave. O2 and O4 reward a
    small :math:`\sigma_1`; they are not convex, and nothing is proven of their designs.

    References
    ----------
    O1: Borm and Menq (1991). O2: Driels and Pathre (1990). O3: Nahvi, Hollerbach and Hayward (1994). O4: Nahvi and
    Hollerbach (1996). O5, and the kinship with the criteria A, D, E: Sun and Hollerbach (2008). Kiefer (1974).

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> [round(float(hx.ObservabilityIndex(i).value(np.diag([1.0, 4.0]))), 3) for i in range(1, 6)]
    [1.414, 2.0, 2.0, 4.0, 3.0]
    """

    number: int

    def __post_init__(self) -> None:
        if as_count("number", self.number) > 5:
            raise InputError(f"number: expected 1…5, got {brief(self.number)}")
        object.__setattr__(self, "name", f"O{self.number}")
        object.__setattr__(self, "convex", self.number in CONVEX)

    @property
    def twin(self) -> Criterion | None:
        """D of O1, and E of O3."""
        twins: dict[int, Criterion] = {1: DOptimal(), 3: EOptimal()}
        return twins.get(self.number)

    def of_twin(self, value: float, main: int) -> float:
        """1/O1 of log det C, and 1/O3 of the largest eigenvalue."""
        return float(np.exp(value / (2 * main)) if self.number == 1 else np.sqrt(value))

    def _number(self) -> int:
        return self.number


def _raised(values: Array) -> Array:
    """Eigenvalues that rounding may have made too small, raised."""
    return np.maximum(values, FLOOR * values[..., -1:])


def _inverse_index(number: int, values: Array) -> tuple[Array, Array]:
    """1/O (...) of the eigenvalues (..., k) of a covariance, in ascending order, and its derivatives by them."""
    if number == 5:
        roots = np.sqrt(values)
        return roots.sum(axis=-1), 0.5 / roots
    k = values.shape[-1]
    first, last = np.eye(k)[0], np.eye(k)[-1]
    powers = (np.full(k, 0.5 / k), (last - first) / 2, last / 2, last - first / 2)[number - 1]
    index = np.exp(np.log(values) @ powers)
    return index, index[..., None] * powers / values
