r"""Loop equations as CasADi expressions, and the reference solutions that follow from them.

Each misclosure :math:`g(x, m + e)` is written once, in blocks, measurement and error of a pose. Its derivatives are
exact, by automatic differentiation: :func:`residual`, :func:`jacobian`, :func:`known_jacobian` and
:func:`noise_jacobian` evaluate them over poses and batches, and NumPy's loops must agree. :func:`loop_function` and
:func:`pose_function` are the :class:`casadi.Function` behind them, for programmes of your own.

Four references solve *one* problem each, slowly and exactly: :func:`forward_kinematics` by CasADi's Newton method with
its residual checked; :func:`fit`, :func:`maximum_likelihood` and :func:`pose_fit` by IPOPT with exact Hessians.
The batched estimators must agree with them.

Examples
--------
The point on the platform that moves least between poses, by a programme of one's own:

>>> import casadi as ca
>>> import hexopt as hx
>>> robot = hx.robots.left_hand()
>>> data = hx.simulate_leg(robot, leg=3, lock="leg", n_poses=5, rng=0)
>>> g = hx.symbolic.loop_function(hx.loops.FixedLeg(data))
>>> b, c = ca.SX.sym("b", 3), ca.SX.sym("c", 3)
>>> rows = [g(b, c, p, r, 0, 0) for p, r in zip(data.position, data.rotation)]
>>> problem = {"x": ca.vertcat(b, c), "f": ca.sumsqr(ca.vertcat(*rows))}
>>> solver = ca.nlpsol("solver", "ipopt", problem, {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False})
>>> solver(x0=0)["x"].full()[:3, 0].round(6)
array([ 7.822, -1.052,  0.   ])
"""

from .evaluation import jacobian, known_jacobian, noise_jacobian, residual
from .fitting import fit
from .kinematics import Root, forward_kinematics, inverse_kinematics
from .likelihood import maximum_likelihood, pose_fit
from .models import loop_function, pose_function, rotation_matrix
from .terms import Fit

__all__ = [
    "Fit",
    "Root",
    "fit",
    "forward_kinematics",
    "inverse_kinematics",
    "jacobian",
    "known_jacobian",
    "loop_function",
    "maximum_likelihood",
    "noise_jacobian",
    "pose_fit",
    "pose_function",
    "residual",
    "rotation_matrix",
]
