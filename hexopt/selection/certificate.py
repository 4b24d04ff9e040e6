r"""A lower bound on every design, from any weights: nothing that a solver says is taken as proof.

f is convex, so that for every allowed v and multipliers :math:`\mu` of the pieces of f,

.. math:: f(v) \ge \sum_p \mu_p f_p(v) \ge \sum_p \mu_p f_p(w) + g^T w - g^T v, \quad
          g_i = \sum_p \mu_p\langle\Gamma_p, M_i\rangle,

and the largest :math:`g^T v` over the allowed weights is a sorted sum. Designs of whole numbers are among them.
"""

from __future__ import annotations

from ..arrays import Array
from .feasible import Feasible
from .objective import Objective

__all__ = ["lower_bound"]


def lower_bound(
    objective: Objective, feasible: Feasible, weights: Array, mix: Array | None = None
) -> tuple[float, Array]:
    r"""A value that no allowed weights can go below, and the gains g that prove it.

    Parameters
    ----------
    objective : Objective
    feasible : Feasible
    weights : ndarray, shape (n,)
        Any that are allowed; the nearer to the optimum, the tighter.
    mix : ndarray, shape (S, j), optional
        Multipliers of the pieces, by default those of the largest pieces. Negative ones count as zero, and those of
        a group are scaled to sum to its share: nothing is taken on trust.
    """
    local = objective.local(weights)
    share = objective.mix(local.pieces) if mix is None else objective.shares(mix)
    gains = objective.gains(local.sensitivity(share))
    there = float((share * local.pieces).sum())
    return there + float(gains @ (weights - feasible.best(gains))), gains
