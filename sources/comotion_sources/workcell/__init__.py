"""The simulated workcell: MuJoCo scenes with RGB-D cameras, rendered on the CPU, with truth."""

from .camera import CameraSpec, WorkcellCamera, open_camera
from .scene import Scene, scene_names
from .viewpoint import Viewpoint, calibration

__all__ = [
    "CameraSpec",
    "Scene",
    "Viewpoint",
    "WorkcellCamera",
    "calibration",
    "open_camera",
    "scene_names",
]
