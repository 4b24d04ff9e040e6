"""What a hexapod is: legs, robots, their limits, the ranges of their poses, and their TOML files."""

from .leg import Leg
from .limits import Limits, PoseRanges
from .robot import Hexapod
from .units import LENGTH_UNITS, check_length_unit, length_factor

__all__ = ["LENGTH_UNITS", "Hexapod", "Leg", "Limits", "PoseRanges", "check_length_unit", "length_factor"]
