"""Cameras: everything that yields frames, behind one interface and one function that opens it."""

from .opening import open_frames
from .types import Camera, CameraError, Frame, SceneCamera

__all__ = ["Camera", "CameraError", "Frame", "SceneCamera", "open_frames"]
