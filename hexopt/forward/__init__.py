"""Forward kinematics: the pose that the legs' readings put the platform in, and how it moves with them."""

from .derivatives import pose_derivatives
from .equations import robot_blocks
from .newton import PoseSolution, solve_poses
from .pose import forward_kinematics

__all__ = ["PoseSolution", "forward_kinematics", "pose_derivatives", "robot_blocks", "solve_poses"]
