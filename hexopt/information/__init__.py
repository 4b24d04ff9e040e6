"""The information that poses bring, in the coordinates that choices of poses work in."""

from .gathering import point_of, pose_information, scenario_values
from .matrices import PoseInformation, inverse_root, main_covariance
from .scalars import chosen_scalars, coordinate_units, expected_spreads

__all__ = [
    "PoseInformation",
    "chosen_scalars",
    "coordinate_units",
    "expected_spreads",
    "inverse_root",
    "main_covariance",
    "point_of",
    "pose_information",
    "scenario_values",
]
