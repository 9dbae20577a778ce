"""The simulator: scenes of rigid bodies with known truth."""

from ..streams import batches
from .simulation import Simulation, simulate
from .spec import SceneSpec, load_scene, scene_names

__all__ = [
    "SceneSpec",
    "Simulation",
    "batches",
    "load_scene",
    "scene_names",
    "simulate",
]
