"""Fiducial markers: ArUco and AprilTag markers as 6-DoF features."""

from .detector import MarkerDetector, MarkerOptions, find_dictionary

__all__ = ["MarkerDetector", "MarkerOptions", "find_dictionary"]
