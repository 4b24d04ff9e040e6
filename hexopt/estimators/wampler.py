"""The implicit loop method of Wampler, Hollerbach and Arai: maximum likelihood of unlocked poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..loops import LegLength, WholeRobot
from .maximum_likelihood import MaximumLikelihood

__all__ = ["WamplerImplicit"]


@dataclass(frozen=True)
class WamplerImplicit(MaximumLikelihood):
    r"""Implicit loops of unlocked poses: :math:`\min\tfrac12\sum e_i^T\Sigma_i^{-1}e_i`, :math:`g_i(x, m_i + e_i) = 0`.

    Leg lengths and measured poses, inputs and outputs, are noisy alike, and no lock is needed. It is
    :class:`MaximumLikelihood` by the name of its authors, for the targets that they had: the lengths of a leg, or of
    the whole robot.

    Parameters
    ----------
    start : Leg or Hexapod, optional
        Where the iteration starts; by default the nominal.
    unit_norm : bool, default True
        As in :class:`MaximumLikelihood`; without effect where no direction is locked.
    max_iterations : int, default 100

    References
    ----------
    Wampler, Hollerbach and Arai (1995), "An implicit loop method for kinematic calibration and its application to
    closed-chain mechanisms"; Daney (1998), section 1.2.

    Examples
    --------
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(0.01, 1e-4, 0.01)
    >>> data = hx.simulate_leg(robot, 3, "none", 20, noise=noise, nominal=robot.perturbed(0.3, rng=0), rng=1)
    >>> found = hx.estimate(hx.loops.LegLength(data), hx.WamplerImplicit())
    >>> bool(found.error(robot.leg(3))["base_point"] < 0.2)
    True
    """

    accepts: ClassVar[tuple[type, ...]] = (LegLength, WholeRobot)
    hint: ClassVar[str] = "write estimate(loops.LegLength(data), WamplerImplicit())"
