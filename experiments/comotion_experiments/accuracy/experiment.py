"""Runs all cases of the accuracy report."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion.config import RigidConfig

from ..brox_malik import CLUSTERINGS, compare
from ..offline import thesis
from ..processes import Progress, quiet
from .cases import Case
from .motion import MotionErrors, motion_errors
from .study import Outcome, run_case

DEFAULT, THESIS = "comotion", "thesis"
# Scenes of the robustness table: they cover all parameters and are short enough to run for each.
ROBUST_SCENES = ("fig4_1", "fig4_4", "3d_3", "3d_outliers")
_ROBUST_SECONDS = 10.0
PARTS = ("scores", "comparator", "motion", "robustness")
"""Parts of the report: the methods on every case, the affinity of Brox and Malik, poses, and parameters."""


@dataclass(frozen=True)
class Experiment:
    """Cases, seeds, and which of :data:`PARTS` to run."""

    cases: Sequence[Case]
    seeds: Sequence[int]
    parts: Sequence[str] = PARTS


@dataclass(frozen=True)
class Variation:
    """Mean NMI of each case, by name, with one parameter scaled by `factor`; 1: all defaults."""

    parameter: str
    factor: float
    scores: dict[str, float]

    @property
    def mean(self) -> float:
        """Mean over the cases."""
        return float(np.mean(list(self.scores.values())))


@dataclass
class Results:
    """Outcomes by case name and method, in the order of seeds, and the other parts of the report.

    `compared`: mean NMI of the comparator by case and clustering.
    """

    experiment: Experiment
    outcomes: dict[tuple[str, str], list[Outcome]] = field(default_factory=dict)
    compared: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    motion: MotionErrors = field(default_factory=MotionErrors)
    variations: list[Variation] = field(default_factory=list)


def run_experiment(experiment: Experiment, progress: Progress = quiet) -> Results:
    """Run all cases; `progress` is called with the name of the next run."""
    results = Results(experiment)
    for case in experiment.cases:
        if "scores" in experiment.parts or _is_compared(experiment, case):
            progress(case.name)
            _run_case(results, case, experiment.seeds if case.seeded else (0,))
    if "motion" in experiment.parts:
        progress("pose and twist")
        results.motion = motion_errors(list(experiment.seeds))
    if "robustness" in experiment.parts:
        results.variations = _variations(experiment, progress)
    return results


def _is_compared(experiment: Experiment, case: Case) -> bool:
    """Whether the comparator runs on a case; offsets between sources are no part of what it compares."""
    return "comparator" in experiment.parts and case.group != "two sources"


def _run_case(results: Results, case: Case, seeds: Sequence[int]) -> None:
    """Both methods, and what they are compared with."""
    for method in (DEFAULT, THESIS):
        config = _config(method, case)
        results.outcomes[case.name, method] = [run_case(case, config, seed) for seed in seeds]
    if _is_compared(results.experiment, case):
        compared = [compare(case.open(seed), case.duration).means() for seed in seeds]
        results.compared[case.name] = {name: [scores[name] for scores in compared] for name in CLUSTERINGS}


def _config(method: str, case: Case) -> FusionConfig:
    if method == DEFAULT:
        return FusionConfig()
    return thesis(case.sigma_switch)


def _variations(experiment: Experiment, progress: Progress) -> list[Variation]:
    """Compute scores with the defaults, and with each parameter halved and doubled."""
    cases = [c for c in experiment.cases if c.name in ROBUST_SCENES or c.group == "recordings"]
    progress("robustness")
    variations = [Variation("", 1.0, _scores_of(cases, RigidConfig()))]
    for name, value in RigidConfig().model_dump().items():
        progress(f"robustness: {name}")
        for factor in (0.5, 2.0):
            scaled = RigidConfig(**_scaled(name, value, factor))
            variations.append(Variation(name, factor, _scores_of(cases, scaled)))
    return variations


def _scaled(name: str, value: float, factor: float) -> dict[str, Any]:
    scaled = value * factor
    if isinstance(value, int):
        scaled = max(round(scaled), 2)
    return {name: min(scaled, 1.0) if name == "outlier_share" else scaled}


def _scores_of(cases: Sequence[Case], motion: RigidConfig) -> dict[str, float]:
    config = FusionConfig(rigid=motion)
    return {case.name: run_case(case, config, 0, _ROBUST_SECONDS).mean for case in cases}
