"""The simulated workcell: MuJoCo scenes with RGB-D cameras, rendered on the CPU, with truth."""

from .camera import WorkcellCamera
from .scene import Scene
from .viewpoint import Viewpoint

__all__ = ["Scene", "Viewpoint", "WorkcellCamera"]
