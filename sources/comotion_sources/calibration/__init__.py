"""Calibration of cameras: models, files, and extrinsics from a target seen by two cameras."""

from .files import Calibration, CalibrationError, format_calibration, read_calibration
from .model import Extrinsics, Intrinsics

__all__ = [
    "Calibration",
    "CalibrationError",
    "Extrinsics",
    "Intrinsics",
    "format_calibration",
    "read_calibration",
]
