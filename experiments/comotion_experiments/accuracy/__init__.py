"""The accuracy report: the default method and the thesis method on scenes and recordings."""

from .cases import Case, displaced_cases, recorded_cases, scene_cases
from .experiment import PARTS, Experiment, Results, run_experiment

__all__ = [
    "PARTS",
    "Case",
    "Experiment",
    "Results",
    "displaced_cases",
    "recorded_cases",
    "run_experiment",
    "scene_cases",
]
