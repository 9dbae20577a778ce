"""Camera calibration: models, files, and the extrinsics of two cameras that observe one target."""

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
