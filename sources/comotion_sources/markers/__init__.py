"""Fiducial markers: ArUco and AprilTag markers as 6-DoF features."""
