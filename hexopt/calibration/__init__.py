"""Whole calibrations: the paper's two methods and unlocked poses, leg by leg, into a new robot."""

from .assembly import calibrate
from .methods import FreePoses, Method, OneStep, ThreeStep
from .report import Calibration, LegCalibration

__all__ = ["Calibration", "FreePoses", "LegCalibration", "Method", "OneStep", "ThreeStep", "calibrate"]
