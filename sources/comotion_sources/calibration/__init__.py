"""Calibration of cameras: models, files, and extrinsics from a target seen by two cameras."""

from .model import Extrinsics, Intrinsics

__all__ = ["Extrinsics", "Intrinsics"]
