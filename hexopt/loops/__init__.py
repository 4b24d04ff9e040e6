"""Loop equations: one file an equation, each written once as its direct misclosure and two Jacobians."""

from .base import Loop
from .fixed_direction import FixedDirection
from .fixed_leg import FixedLeg
from .fixed_length import FixedLength
from .joining import join
from .leg_length import LegLength
from .platform_pose import PlatformPose
from .read_lock import ReadLeg, ReadLength
from .sets import Sets
from .whole_robot import WholeRobot

__all__ = [
    "FixedDirection",
    "FixedLeg",
    "FixedLength",
    "LegLength",
    "Loop",
    "PlatformPose",
    "ReadLeg",
    "ReadLength",
    "Sets",
    "WholeRobot",
    "join",
]
