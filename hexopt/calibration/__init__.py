"""Whole calibrations: the paper's two methods and unlocked poses, leg by leg, into a new robot."""

from .accuracy import pose_covariance
from .assembly import calibrate
from .joint import Joint
from .methods import FreePoses, Method, OneStep, ThreeStep
from .report import Calibration, LegCalibration

__all__ = [
    "Calibration",
    "FreePoses",
    "Joint",
    "LegCalibration",
    "Method",
    "OneStep",
    "ThreeStep",
    "calibrate",
    "pose_covariance",
]
