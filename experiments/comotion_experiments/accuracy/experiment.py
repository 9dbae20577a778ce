"""Runs all cases of the accuracy report."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from comotion import FusionConfig
from comotion.config import RigidConfig

from ..brox_malik import CLUSTERINGS, compare
from ..offline import thesis
from ..processes import Progress, quiet
from .cases import Case, run_case
from .motion import motion_errors

DEFAULT, THESIS = "comotion", "thesis"
# Scenes of the robustness table: they cover all parameters and are short enough to run for each.
ROBUST_SCENES = ("fig4_1", "fig4_4", "3d_3", "3d_outliers")
_ROBUST_SECONDS = 10.0
PARTS = ("scores", "comparator", "motion", "robustness")
"""Parts of the report: the methods on every case, the affinity of Brox and Malik, poses, and parameters."""


@dataclass
class Results:
    """What was run, and what came of it."""

    cases: Sequence[Case]
    seeds: Sequence[int]
    parts: Sequence[str]
    rows: list[dict[str, Any]] = field(default_factory=list)  # `case`, `method`, and what run_case returns
    # By case and clustering of the comparator: mean NMI at whole seconds, in the order of seeds.
    compared: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    motion: dict[str, float] = field(default_factory=dict)  # medians of errors
    # `scores`: NMI by case, with one parameter scaled by `factor`; first with all as they are.
    variations: list[dict[str, Any]] = field(default_factory=list)

    def of(self, case: str, method: str, figure: str) -> list[Any]:
        """A figure of a case under a method, in the order of seeds."""
        return [row[figure] for row in self.rows if (row["case"], row["method"]) == (case, method)]

    def names(self, group: str) -> list[str]:
        """Cases of a group, in order."""
        return [case.name for case in self.cases if case.group == group]


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
                which = {"case": case.name, "method": method}
                results.rows += [which | run_case(case, config, seed) for seed in own]
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


def _variations(cases: Sequence[Case], progress: Progress) -> list[dict[str, Any]]:
    """Compute scores with the defaults, and with each parameter halved and doubled."""
    tried: list[tuple[str, float, dict[str, Any]]] = [("", 1.0, {})]
    for name, value in RigidConfig().model_dump().items():
        tried += [(name, factor, {name: _scaled(name, value, factor)}) for factor in (0.5, 2.0)]
    variations = []
    for name, factor, scaled in tried:
        progress(f"robustness: {name} x {factor:g}" if name else "robustness")
        config = FusionConfig(rigid=RigidConfig(**scaled))
        scores = {case.name: run_case(case, config, 0, _ROBUST_SECONDS)["nmi"] for case in cases}
        variations.append({"parameter": name, "factor": factor, "scores": scores})
    return variations


def _scaled(name: str, value: float, factor: float) -> float:
    scaled = value * factor
    if isinstance(value, int):
        scaled = max(round(scaled), 2)
    return min(scaled, 1.0) if name == "outlier_share" else scaled
