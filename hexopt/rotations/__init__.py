r"""Rotations as matrices: Euler sequences, rotation vectors and quaternions, batched, with derivatives.

All matrices take platform vectors to base vectors. The derivatives are *spatial*: a small change of
the coordinates, :math:`dq`, turns the matrix by :math:`R \to \exp([\delta\omega]_\times) R` with
:math:`\delta\omega = J(q)\,dq`; each function ``*_jacobian`` returns :math:`J`.
Euler sequences are written as in SciPy: ``"ZXZ"`` intrinsic, ``"zxz"`` extrinsic; angles in radians.
"""

from .checks import check_rotation, skew
from .euler import euler_jacobian, euler_to_matrix, matrix_to_euler
from .quaternions import matrix_to_quaternion, quaternion_jacobian, quaternion_to_matrix
from .vectors import matrix_to_rotation_vector, rotation_vector_jacobian, rotation_vector_to_matrix

__all__ = [
    "check_rotation",
    "euler_jacobian",
    "euler_to_matrix",
    "matrix_to_euler",
    "matrix_to_quaternion",
    "matrix_to_rotation_vector",
    "quaternion_jacobian",
    "quaternion_to_matrix",
    "rotation_vector_jacobian",
    "rotation_vector_to_matrix",
    "skew",
]
