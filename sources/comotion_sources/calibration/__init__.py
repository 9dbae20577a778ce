"""Camera calibration: models, and the files that hold them."""

from .files import Calibration, format_calibration, read_calibration
from .model import Extrinsics, Intrinsics

__all__ = [
    "Calibration",
    "Extrinsics",
    "Intrinsics",
    "format_calibration",
    "read_calibration",
]
