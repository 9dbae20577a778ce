"""Fiducial markers: ArUco and AprilTag markers as 6-DoF features."""

from .detector import MarkerDetector, MarkerOptions, dictionary_names, find_dictionary

__all__ = ["MarkerDetector", "MarkerOptions", "dictionary_names", "find_dictionary"]
