"""The accuracy report: the default method and the thesis method on scenes and recordings."""

from .cases import displaced_cases, recorded_cases, scene_cases
from .experiment import PARTS, run_experiment

__all__ = ["PARTS", "displaced_cases", "recorded_cases", "run_experiment", "scene_cases"]
