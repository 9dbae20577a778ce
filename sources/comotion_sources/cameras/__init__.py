"""Cameras: one interface and one opening function for devices, streams, videos and folders."""

from .opening import open_frames
from .types import Camera, Frame

__all__ = ["Camera", "Frame", "open_frames"]
