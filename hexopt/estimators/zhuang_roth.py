"""A leg of locked length: both joint centres from differences of squared lengths (Zhuang and Roth 1993)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..arrays import Array
from ..errors import InputError
from ..geometry import Leg
from ..loops import FixedLength
from ..problem import ConstantRowNoise, LinearProblem
from ..result import Estimate
from .least_squares import check_rows
from .local_fit import AgainstFirst, check_settings, first_guess, local_estimate, minimise

__all__ = ["ZhuangRoth"]


@dataclass(frozen=True)
class ZhuangRoth:
    r"""Equal lengths: :math:`\min_{a,b}\tfrac18\sum_{i>1}(\lVert V_i - a\rVert^2 - \lVert V_1 - a\rVert^2)^2`.

    With :math:`V_i = P_i + R_i b`. The lock removes the offset, and no reading is used. This is the historical form:
    every pose against the first, unweighted, so that the answer depends on which pose is the first. The rows are
    differences of those of :class:`~hexopt.loops.FixedLength`, whose "sphere" they eliminate.

    Parameters
    ----------
    start : Leg, optional
        Where the iteration starts; by default the data's nominal. Its other values are not used.
    max_iterations : int, default 200

    Notes
    -----
    At least 7 poses. Levenberg–Marquardt on the whole batch; the equations have up to 20 complex solutions at 7
    poses (:class:`~hexopt.Innocenti` finds them all), and there is no certificate (gap is NaN). The covariance is the
    sandwich of the noise model.

    References
    ----------
    Zhuang and Roth (1993), as Daney (1998), section 1.2, describes it.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> data = hx.simulate_leg(robot, 3, "length", n_poses=10, nominal=robot.perturbed(0.3, rng=0), rng=1)
    >>> loop = hx.loops.FixedLength(data, unknown=("platform_point", "base_point"))
    >>> found = hx.estimate(loop, hx.ZhuangRoth())
    >>> bool(max(found.error(robot.leg(3)).values()) < 1e-9)
    True
    """

    start: Leg | None = None
    max_iterations: int = 200

    accepts: ClassVar[tuple[type, ...]] = (FixedLength,)
    hint: ClassVar[str] = (
        'write estimate(loops.FixedLength(data, unknown=("platform_point", "base_point")), ZhuangRoth())'
    )

    def __post_init__(self) -> None:
        check_settings(self.start, self.max_iterations)

    def fit(self, target: FixedLength) -> Estimate:
        """Fit every set of the batch; one that does not converge, or is not determined, fails alone."""
        if set(target.unknown) != {"platform_point", "base_point"}:
            raise InputError(
                f"ZhuangRoth finds both points, the loop has the unknown {', '.join(target.unknown)}: {self.hint}"
            )
        main = target.parameters.main
        first = first_guess(self, self.start, target, main, target.data.batch_shape)
        check_rows(self._linearised(target, first))

        found = minimise(lambda x: self._differences(target, x)[:2], first, self.max_iterations)
        return local_estimate(
            self._linearised(target, found.values), found.values, found.converged, found.iterations, self
        )

    @staticmethod
    def _differences(loop: FixedLength, x: Array) -> tuple[Array, Array, Array]:
        """Residual (..., m), matrix (..., m, p), and what the differences lost of its columns (..., p)."""
        full = _with_sphere(x)
        form = AgainstFirst((loop.data.n_poses,))
        return form.differences(loop.residual(full), loop.jacobian(full)[..., : x.shape[-1]])

    def _linearised(self, loop: FixedLength, x: Array) -> LinearProblem:
        """The rows to first order about x, in the unknown change of x."""
        residual, matrix, lost = self._differences(loop, x)
        return LinearProblem(
            matrix,
            -residual,
            loop.parameters.main,
            form=AgainstFirst((loop.data.n_poses,)),
            noise=None if loop.data.noise is None else ConstantRowNoise(loop.covariance(_with_sphere(x))),
            cancellation=lost,
            minimum_poses=loop.minimum_poses,
            name=type(loop).__name__,
        )


def _with_sphere(x: Array) -> Array:
    """Values with a sphere: whatever it is, it drops out of the differences."""
    return np.concatenate([x, np.zeros((*x.shape[:-1], 1))], axis=-1)
