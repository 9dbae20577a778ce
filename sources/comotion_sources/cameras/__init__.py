"""Cameras: everything that yields frames, behind one interface."""

from .types import Camera, CameraError, Frame, SceneCamera

__all__ = ["Camera", "CameraError", "Frame", "SceneCamera"]
