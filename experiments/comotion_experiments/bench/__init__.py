"""Benchmark: cost of the core by number of features, rate and method."""

from .experiment import Costs, Row, run_bench, scaled
from .scene import Scene, SceneSpec
from .timing import Timing, time_scene

__all__ = ["Costs", "Row", "Scene", "SceneSpec", "Timing", "run_bench", "scaled", "time_scene"]
