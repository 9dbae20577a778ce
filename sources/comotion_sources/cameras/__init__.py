"""Cameras: one interface and one opening function for devices, streams, videos and folders."""

from .opening import open_frames
from .types import Camera, CameraError, Frame

__all__ = ["Camera", "CameraError", "Frame", "open_frames"]
