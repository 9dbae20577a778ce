"""What the core costs, by number of features, rate and method."""

from .experiment import Row, run_bench, scaled
from .scene import Scene, SceneSpec
from .timing import Timing, time_scene

__all__ = ["Row", "Scene", "SceneSpec", "Timing", "run_bench", "scaled", "time_scene"]
