"""Runs of the default method without each of its rules, beside the whole method."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from comotion import FusionConfig

from ..accuracy.cases import recorded_cases
from ..accuracy.study import PERIOD
from ..offline import run_offline
from ..processes import Progress, quiet, run_all
from ..stress import run_family
from .rules import RULES, Rule

WHOLE = "whole"
"""Stands for the method with all its rules."""
SCATTER = 0.003
"""NMI; changes below it are those of chance."""


@dataclass(frozen=True)
class Run:
    """One run: the rule that was left out, the scene, its seed (0 for a recording), and the mean NMI."""

    rule: str
    scene: str
    seed: int
    recorded: bool
    nmi: float


@dataclass
class Results:
    """All runs, and the seeds of families."""

    seeds: Sequence[int]
    runs: list[Run] = field(default_factory=list)

    def means(self, rule: str, *, recorded: bool) -> dict[str, float]:
        """Mean NMI of each scene, or of each recording, without a rule."""
        scores: dict[str, list[float]] = {}
        for run in self.runs:
            if (run.rule, run.recorded) == (rule, recorded):
                scores.setdefault(run.scene, []).append(run.nmi)
        return {scene: float(np.mean(values)) for scene, values in sorted(scores.items())}


def run_experiment(
    rules: Sequence[str],
    families: Sequence[str],
    seeds: Sequence[int],
    folders: Sequence[Path] = (),
    *,
    jobs: int = 2,
    progress: Progress = quiet,
) -> Results:
    """Run families and recordings with all rules, and without each of `rules`.

    Parameters
    ----------
    rules, families, seeds
        Names of :data:`~.rules.RULES`, of stress families, and seeds of their scenes.
    folders
        Folders of labelled recordings.
    jobs
        Processes at once.
    progress
        Called with one line for each run that is done.
    """
    paths = [(folder, case.name) for folder in folders for case in recorded_cases(folder)]
    work = [
        *((rule, None, name, seed) for rule in [WHOLE, *rules] for name in families for seed in seeds),
        *((rule, folder, name, 0) for rule in [WHOLE, *rules] for folder, name in paths),
    ]
    return Results(seeds, list(run_all(_run, work, jobs, _said, progress)))


def _said(run: Run) -> str:
    return f"without {run.rule}, {run.scene}: NMI {run.nmi:.3f}"


def _run(name: str, folder: Path | None, scene: str, seed: int) -> Run:
    rule = RULES.get(name, Rule("nothing"))
    with rule.left_out():
        nmi = _scored(rule.config(), folder, scene, seed)
    return Run(name, scene, seed, folder is not None, nmi)


def _scored(config: FusionConfig, folder: Path | None, scene: str, seed: int) -> float:
    if folder is None:
        return run_family(scene, seed, config)["nmi_apart"]
    case = next(recorded for recorded in recorded_cases(folder) if recorded.name == scene)
    run = run_offline(case.open(0), config, period=PERIOD, duration=case.duration)
    return float(np.nanmean(run.nmi))
