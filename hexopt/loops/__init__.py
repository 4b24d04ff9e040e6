"""Loop equations: one file an equation, each written once as its direct misclosure and two Jacobians."""

from .base import Loop
from .fixed_direction import FixedDirection
from .fixed_leg import FixedLeg
from .fixed_length import FixedLength
from .joining import join
from .leg_length import LegLength

__all__ = ["FixedDirection", "FixedLeg", "FixedLength", "LegLength", "Loop", "join"]
