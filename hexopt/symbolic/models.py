r"""Misclosures as CasADi expressions: each loop equation once, and the six legs of a pose.

A measured pose enters with an error :math:`e = (\delta P, \delta\omega, \delta\rho)`: position :math:`P + \delta P`,
rotation :math:`\exp([\delta\omega]_\times) R`, reading :math:`\rho + \delta\rho`. At e = 0 the derivative by it is the
noise Jacobian B; as an unknown it makes the Gauss–Helmert model exact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import casadi as ca

from ..errors import InputError
from ..geometry.leg import LEG_BLOCKS
from ..loops import FixedDirection, FixedLeg, FixedLength, LegLength, Loop, ReadLeg, ReadLength

__all__ = ["block_sizes", "constants", "loop_function", "pose_function", "rotation_matrix"]

Blocks = Mapping[str, ca.SX]
Misclosure = Callable[[Blocks, ca.SX, ca.SX, ca.SX], ca.SX]


@dataclass(frozen=True)
class _Equation:
    """g by blocks, position, rotation and reading; and constants of a set that it takes as blocks too."""

    misclosure: Misclosure
    constants: Mapping[str, int] = field(default_factory=dict)


# --- the loop equations ---------------------------------------------------------------------------


def _joint(blocks: Blocks, position: ca.SX, rotation: ca.SX) -> ca.SX:
    """V = P + R b."""
    return position + rotation @ blocks["platform_point"]


def _true_length(blocks: Blocks, reading: ca.SX) -> ca.SX:
    """γρ + δ."""
    return blocks["gain"] * reading + blocks["offset"]


def _fixed_direction(blocks: Blocks, position: ca.SX, rotation: ca.SX, reading: ca.SX) -> ca.SX:
    vector = _joint(blocks, position, rotation) - blocks["base_point"]
    return vector - _true_length(blocks, reading) * blocks["direction"]


def _fixed_leg(blocks: Blocks, position: ca.SX, rotation: ca.SX, reading: ca.SX) -> ca.SX:
    return _joint(blocks, position, rotation) - blocks["fixed_point"]


def _fixed_length(blocks: Blocks, position: ca.SX, rotation: ca.SX, reading: ca.SX) -> ca.SX:
    point = (position - blocks["origin"]) + rotation @ blocks["platform_point"]
    centre = blocks["base_point"] - blocks["origin"]
    return ca.dot(point, centre - 0.5 * point) + blocks["sphere"]


def _read_leg(blocks: Blocks, position: ca.SX, rotation: ca.SX, reading: ca.SX) -> ca.SX:
    reach = ca.norm_2(blocks["fixed_point"] - blocks["base_point"])
    return ca.vertcat(_fixed_leg(blocks, position, rotation, reading), _true_length(blocks, reading) - reach)


def _read_length(blocks: Blocks, position: ca.SX, rotation: ca.SX, reading: ca.SX) -> ca.SX:
    distance = ca.norm_2(_joint(blocks, position, rotation) - blocks["base_point"])
    return ca.vertcat(distance, _true_length(blocks, reading)) - blocks["locked_length"]


def _leg_length(blocks: Blocks, position: ca.SX, rotation: ca.SX, reading: ca.SX) -> ca.SX:
    return ca.norm_2(_joint(blocks, position, rotation) - blocks["base_point"]) - _true_length(blocks, reading)


_EQUATIONS: dict[type[Loop], _Equation] = {
    FixedDirection: _Equation(_fixed_direction),
    FixedLeg: _Equation(_fixed_leg),
    FixedLength: _Equation(_fixed_length, {"origin": 3}),
    LegLength: _Equation(_leg_length),
    ReadLeg: _Equation(_read_leg),
    ReadLength: _Equation(_read_length),
}


def _equation(loop: Loop) -> _Equation:
    """The symbolic equation of a loop; a class that changes the equation must bring its own."""
    for kind in type(loop).__mro__:
        if "symbolic_misclosure" in vars(kind):
            return _Equation(loop.symbolic_misclosure)  # type: ignore[attr-defined]  # just found
        if kind in _EQUATIONS:
            return _EQUATIONS[kind]
        if "_misclosure" in vars(kind):
            break
    raise InputError(
        f"{type(loop).__name__} has no symbolic equation; give it a method "
        "symbolic_misclosure(self, blocks, position, rotation, reading) that returns g of one pose"
    )


def constants(loop: Loop) -> dict[str, int]:
    """Names and sizes of what the symbolic equation takes from the set as a whole: attributes of the loop."""
    return dict(_equation(loop).constants)


def block_sizes(loop: Loop) -> dict[str, int]:
    """Names and sizes of all blocks in the equation: the leg's, known or not, then the nuisances."""
    return {name: LEG_BLOCKS[name] for name in loop.involved} | dict(loop.nuisance)


def rotation_matrix(vector: ca.SX) -> ca.SX:
    r""":math:`\exp([v]_\times)`, smooth at v = 0 with all its derivatives.

    Examples
    --------
    >>> import casadi as ca
    >>> v = ca.SX.sym("v", 3)
    >>> turn = ca.Function("turn", [v], [ca.jacobian(rotation_matrix(v) @ ca.DM([0, 0, 1]), v)])
    >>> turn(0).full() + 0.0  # the first two columns turn e_z, the last does not
    array([[ 0.,  1.,  0.],
           [-1.,  0.,  0.],
           [ 0.,  0.,  0.]])
    """
    square = ca.dot(vector, vector)
    small = square < 1e-2  # where series to the fourth power of the square are exact to rounding
    angle = ca.sqrt(ca.if_else(small, 1.0, square))
    half = ca.sin(0.5 * angle) / angle
    sine, cosine, factor = ca.SX(0.0), ca.SX(0.0), 1.0
    for k in range(5):
        sine += factor * square**k
        cosine += factor / (2 * k + 2) * square**k
        factor /= -(2 * k + 2) * (2 * k + 3)
    sine = ca.if_else(small, sine, ca.sin(angle) / angle)
    cosine = ca.if_else(small, cosine, 2.0 * half * half)
    cross = ca.skew(vector)
    return ca.SX.eye(3) + sine * cross + cosine * (cross @ cross)


def loop_function(loop: Loop) -> ca.Function:
    r"""The misclosure :math:`g_i` of one pose of a loop equation as a :class:`casadi.Function`.

    Inputs by name: the leg's blocks that the equation contains, known or not, its nuisances, what it takes from the
    set as a whole ("origin" of :class:`~hexopt.loops.FixedLength`); then "position" (3), "rotation" (3, 3), "reading"
    and "error" (7), which is :math:`(\delta P, \delta\omega, \delta\rho)` with :math:`\exp([\delta\omega]_\times) R`.
    Output: "misclosure" (d).

    Parameters
    ----------
    loop : Loop
        A built-in one; or yours, with a method ``symbolic_misclosure(self, blocks, position, rotation, reading)``
        that returns g of one pose from CasADi expressions, `blocks` by name.

    Returns
    -------
    casadi.Function
        Differentiate it, ``map`` it, or build programmes with it.

    Raises
    ------
    InputError
        If a loop of your own has no such method.

    Examples
    --------
    >>> import hexopt as hx
    >>> data = hx.simulate_leg(hx.robots.left_hand(), leg=3, lock="leg", n_poses=3, rng=0)
    >>> g = hx.symbolic.loop_function(hx.loops.FixedLeg(data))
    >>> g.name_in()
    ['platform_point', 'fixed_point', 'position', 'rotation', 'reading', 'error']
    >>> noise = g.factory("noise", g.name_in(), ["jac:misclosure:error"])  # B, by automatic differentiation
    >>> noise([1, 0, 0], [0, 0, 0], [0, 0, 9], ca.DM.eye(3), 0, 0).full()[:, :6]
    array([[ 1.,  0.,  0.,  0.,  0.,  0.],
           [ 0.,  1.,  0.,  0.,  0.,  1.],
           [ 0.,  0.,  1.,  0., -1.,  0.]])
    """
    equation = _equation(loop)
    blocks = {name: ca.SX.sym(name, size) for name, size in (block_sizes(loop) | dict(equation.constants)).items()}
    position, rotation, reading = ca.SX.sym("position", 3), ca.SX.sym("rotation", 3, 3), ca.SX.sym("reading")
    error = ca.SX.sym("error", 7)
    moved = position + error[:3], rotation_matrix(error[3:6]) @ rotation, reading + error[6]
    inputs = {**blocks, "position": position, "rotation": rotation, "reading": reading, "error": error}
    misclosure = equation.misclosure(blocks, *moved)
    return ca.Function(type(loop).__name__, list(inputs.values()), [misclosure], list(inputs), ["misclosure"])


def pose_function() -> ca.Function:
    r"""All six legs of one pose: :math:`\lVert P + R b_k - a_k\rVert - \gamma_k\rho_k - \delta_k`, and the readings.

    Inputs by name: "platform_point" and "base_point" (18), "offset" and "gain" (6), leg after leg;
    "position" (3), "rotation" (3, 3), "reading" (6) and "error" (12), :math:`(\delta P, \delta\omega, \delta\rho)`.
    Outputs: "closure" (6), the rows of :class:`~hexopt.loops.LegLength`, of which the pose of given readings is a root;
    and "readings" (6), by inverse kinematics.

    Returns
    -------
    casadi.Function

    Examples
    --------
    >>> import hexopt as hx
    >>> hx.symbolic.pose_function().name_out()
    ['closure', 'readings']
    """
    blocks = {name: ca.SX.sym(name, 6 * size) for name, size in LEG_BLOCKS.items()}
    position, rotation, reading = ca.SX.sym("position", 3), ca.SX.sym("rotation", 3, 3), ca.SX.sym("reading", 6)
    error = ca.SX.sym("error", 12)
    moved = position + error[:3], rotation_matrix(error[3:6]) @ rotation
    split = {name: ca.vertsplit(block, LEG_BLOCKS[name]) for name, block in blocks.items()}
    legs = [{name: parts[k] for name, parts in split.items()} for k in range(6)]
    closure = ca.vertcat(*(_leg_length(leg, *moved, reading[k] + error[6 + k]) for k, leg in enumerate(legs)))
    lengths = ca.vertcat(*(_leg_length(leg, *moved, ca.SX(0.0)) for leg in legs))
    inputs = {**blocks, "position": position, "rotation": rotation, "reading": reading, "error": error}
    outputs = {"closure": closure, "readings": lengths / blocks["gain"]}
    return ca.Function("pose", list(inputs.values()), list(outputs.values()), list(inputs), list(outputs))
