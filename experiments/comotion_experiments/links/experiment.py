"""The whole experiment: every scene and seed, scored with and without links."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comotion import FusionConfig
from comotion.config import LinkingConfig

from ..processes import Progress, quiet
from .recording import plain_camera, record
from .setup import PLAIN_SPACE, Setup
from .study import Count, Outcome, run_seed


@dataclass(frozen=True)
class Case:
    """One scene: an outcome per seed."""

    scene: str
    outcomes: list[Outcome]

    def count(self, what: str) -> Count:
        """Links of the `moving`, the `pure` or the `resting`, of all seeds together."""
        return sum((getattr(o, what) for o in self.outcomes), Count())

    def scores(self, what: str, reading: str) -> NDArray[np.float64]:
        """Scores `nmi`, `nmi_plain` or `error_plain` of one reading, float64 [seeds]."""
        return np.array([getattr(getattr(o, what), reading) for o in self.outcomes])


@dataclass(frozen=True)
class Results:
    """All cases, and what they were run with."""

    cases: list[Case]
    setup: Setup
    seeds: Sequence[int]

    def all(self) -> Case:
        """Everything as one case: each scene and seed counts as much."""
        return Case("all", [outcome for case in self.cases for outcome in case.outcomes])


def run_experiment(
    scenes: Sequence[str],
    seeds: Sequence[int],
    config: FusionConfig,
    *,
    setup: Setup | None = None,
    cache: Path | None = None,
    period: float = 1 / 3,
    turned: float = 0.0,
    progress: Progress = quiet,
) -> Results:
    """Run every scene with every seed.

    Parameters
    ----------
    scenes, seeds
        Of the workcell.
    config
        Parameters of the core; the plain camera's calibration is added.
    setup
        Size, rate and length of what is rendered.
    cache
        Where tracks are kept, so that a second run need not render.
    period
        Seconds between updates.
    turned
        Degrees by which the plain camera's calibration is wrong.
    progress
        Receives what is being run.
    """
    setup = setup or Setup()
    cases = []
    for scene in scenes:
        outcomes = []
        for seed in seeds:
            progress(f"{scene}, seed {seed}")
            sources = record(scene, seed, setup, cache)
            cameras = config.linking.cameras | {PLAIN_SPACE: plain_camera(scene, seed, setup, turned)}
            known = config.model_copy(update={"linking": LinkingConfig(cameras=cameras)})
            outcomes.append(run_seed(sources, known, period=period))
        cases.append(Case(scene, outcomes))
    return Results(cases, setup, seeds)
