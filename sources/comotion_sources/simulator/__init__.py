"""The simulator: scenes of rigid bodies with known truth."""

from .motion import Poses
from .simulation import Simulation, Split, batches, simulate, streams
from .spec import SceneSpec, load_scene, scene_names

__all__ = [
    "Poses",
    "SceneSpec",
    "Simulation",
    "Split",
    "batches",
    "load_scene",
    "scene_names",
    "simulate",
    "streams",
]
