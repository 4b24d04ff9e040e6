"""One nonlinear programme, in scaled variables, by IPOPT with exact derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from ..arrays import Array, as_count

__all__ = ["Optimum", "Programme", "minimise"]

#: Largest gradient, misclosure and complementarity of a success, in scaled variables.
TOLERANCE = 1e-11


@dataclass(frozen=True)
class Programme:
    """Minimise an objective under equations = 0 and bounds.

    Attributes
    ----------
    variables : casadi.SX, shape (v,)
    objective : casadi.SX
    equations : dict of str to casadi.SX
        By a name for their multipliers.
    lower, upper : ndarray, shape (v,)
        Infinite where there is no bound.
    """

    variables: ca.SX
    objective: ca.SX
    equations: Mapping[str, ca.SX]
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Optimum:
    """What IPOPT found, in the programme's own units.

    Attributes
    ----------
    values : ndarray, shape (v,)
        The last iterate, a success or not.
    objective : float
    success : bool
        Whether IPOPT ended with "Solve_Succeeded": nothing less is a success.
    status : str
        IPOPT's word.
    bounds : ndarray, shape (v,)
        Multipliers of the bounds, positive where the upper one holds.
    multipliers : dict of str to ndarray
        Of the equations.
    iterations : int
    """

    values: Array
    objective: float
    success: bool
    status: str
    bounds: Array
    multipliers: dict[str, Array] = field(default_factory=dict)
    iterations: int = 0


def minimise(
    programme: Programme,
    start: Array,
    scale: Array,
    *,
    unit: float,
    max_iterations: int,
) -> Optimum:
    """Solve a programme from `start`, in variables divided by `scale` and an objective divided by `unit`."""
    x = ca.SX.sym("x", len(start))
    names, equations = list(programme.equations), list(programme.equations.values())
    whole = ca.Function("whole", [programme.variables], [programme.objective, ca.vertcat(*equations)])
    objective, rows = whole(x * ca.DM(scale))
    problem = {"x": x, "f": objective / unit, "g": rows}
    solver = ca.nlpsol("solver", "ipopt", problem, _options(max_iterations))
    found = solver(x0=start / scale, lbx=programme.lower / scale, ubx=programme.upper / scale, lbg=0.0, ubg=0.0)
    stats, force = solver.stats(), unit * np.ravel(found["lam_g"].full())
    ends = np.cumsum([0, *(part.numel() for part in equations)])
    values = scale * np.ravel(found["x"].full())
    return Optimum(
        values,
        unit * float(found["f"]),
        stats["return_status"] == "Solve_Succeeded" and bool(np.isfinite(values).all()),
        str(stats["return_status"]),
        unit * np.ravel(found["lam_x"].full()) / scale,
        {name: force[ends[k] : ends[k + 1]] for k, name in enumerate(names)},
        int(stats["iter_count"]),
    )


def _options(max_iterations: int) -> dict[str, Any]:
    limits = ("tol", "dual_inf_tol", "constr_viol_tol", "compl_inf_tol")
    return {
        "print_time": False,
        "show_eval_warnings": False,
        "error_on_fail": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": as_count("max_iterations", max_iterations),
        "ipopt.acceptable_iter": 0,  # an acceptable point is no success
        "ipopt.nlp_scaling_method": "none",  # the variables are scaled already
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.mu_strategy": "adaptive",
        **{f"ipopt.{name}": TOLERANCE for name in limits},
    }
