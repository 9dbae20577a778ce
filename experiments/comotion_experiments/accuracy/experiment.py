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
from .cases import Case, Outcome, run_case
from .motion import MotionErrors, motion_errors

DEFAULT, THESIS = "comotion", "thesis"
# Scenes of the robustness table: they cover all parameters and are short enough to run for each.
ROBUST_SCENES = ("fig4_1", "fig4_4", "3d_3", "3d_outliers")
_ROBUST_SECONDS = 10.0
PARTS = ("scores", "comparator", "motion", "robustness")
"""Parts of the report: the methods on every case, the affinity of Brox and Malik, poses, and parameters."""


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
    """What was run, and what came of it.

    Attributes
    ----------
    cases, seeds, parts
        What was run, `parts` of :data:`PARTS`.
    outcomes
        By case name and method, in the order of seeds.
    compared
        Mean NMI of the comparator by case and clustering, in the order of seeds.
    motion, variations
        The other parts.
    """

    cases: Sequence[Case]
    seeds: Sequence[int]
    parts: Sequence[str]
    outcomes: dict[tuple[str, str], list[Outcome]] = field(default_factory=dict)
    compared: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    motion: MotionErrors = field(default_factory=MotionErrors)
    variations: list[Variation] = field(default_factory=list)


def run_experiment(
    cases: Sequence[Case], seeds: Sequence[int], parts: Sequence[str] = PARTS, progress: Progress = quiet
) -> Results:
    """Run all cases; `progress` is called with the name of the next run."""
    results = Results(cases, seeds, parts)
    for case in cases:
        # Offsets between sources are no part of what the comparator compares.
        compared = "comparator" in parts and case.group != "two sources"
        own = seeds if case.seeded else (0,)
        if "scores" in parts or compared:
            progress(case.name)
            for method, config in ((DEFAULT, FusionConfig()), (THESIS, thesis(case.sigma_switch))):
                results.outcomes[case.name, method] = [run_case(case, config, seed) for seed in own]
        if compared:
            rows = [compare(case.open(seed), case.duration) for seed in own]
            results.compared[case.name] = {name: [row[name] for row in rows] for name in CLUSTERINGS}
    if "motion" in parts:
        progress("pose and twist")
        results.motion = motion_errors(seeds)
    if "robustness" in parts:
        robust = [c for c in cases if c.name in ROBUST_SCENES or c.group == "recordings"]
        results.variations = _variations(robust, progress)
    return results


def _variations(cases: Sequence[Case], progress: Progress) -> list[Variation]:
    """Compute scores with the defaults, and with each parameter halved and doubled."""
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
