"""The simulator: scenes of rigid bodies with known truth."""

from .motion import Poses
from .offline import batches, streams
from .simulation import Simulation, Split, simulate
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
