"""Runs the fusion experiment: all scenes, seeds and variants, with camera A open and covered."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comotion import FusionConfig
from comotion_sources.workcell import Scene

from ..processes import Progress, quiet
from .recording import record
from .setup import ALL, ALONE_A, ALONE_B, VARIANTS, Setup, Variant
from .study import Outcome, run_variant

AFTER_S = 3.0
"""Length of the interval "after the cover", s, from the uncovering of the lens."""


@dataclass(frozen=True)
class Case:
    """One variant on one scene: an outcome per seed, with camera A open or covered."""

    scene: str
    covered: bool
    variant: Variant
    outcomes: list[Outcome]

    def nmi_a(self, start: float = 0.0, stop: float = np.inf) -> np.ndarray:
        """Mean NMI over the features of camera A in start <= t < stop, float64 [seeds]."""
        return np.array([o.mean(o.nmi_a, start, stop) for o in self.outcomes])

    def nmi(self) -> np.ndarray:
        """Mean NMI over all features, float64 [seeds]."""
        return np.array([o.mean(o.nmi) for o in self.outcomes])

    def surface(self) -> np.ndarray:
        """Mean share of the surface covered, float64 [seeds]."""
        return np.array([o.mean(o.surface) for o in self.outcomes])

    def kept(self, cover: tuple[float, float]) -> np.ndarray:
        """Share of hypothesis ids kept while A is covered, float64 [seeds]."""
        return np.array([o.kept(*cover) for o in self.outcomes])


@dataclass(frozen=True)
class Results:
    """All cases of an experiment, and what they were run with."""

    cases: list[Case]
    setup: Setup
    method: str
    seeds: Sequence[int]

    def case(self, scene: str, *, covered: bool, variant: Variant) -> Case:
        """Look up a case; camera B alone does not depend on the cover of A."""
        covered = covered and variant is not ALONE_B
        return next(c for c in self.cases if (c.scene, c.covered, c.variant) == (scene, covered, variant))

    @property
    def scenes(self) -> list[str]:
        """Names of the scenes, in order."""
        return list(dict.fromkeys(case.scene for case in self.cases))


def run_experiment(
    scenes: Sequence[str],
    seeds: Sequence[int],
    config: FusionConfig,
    *,
    setup: Setup | None = None,
    cache: Path | None = None,
    period: float = 1 / 3,
    progress: Progress = quiet,
) -> Results:
    """Run every scene with every seed in every variant.

    Parameters
    ----------
    scenes, seeds
        Of the workcell.
    config
        Parameters of the core.
    setup
        Cameras, rates and cover.
    cache
        Where tracks are kept, so that a second run need not render.
    period
        Seconds between updates.
    progress
        Receives what is being run.
    """
    setup = setup or Setup()
    cases = {
        (scene, covered, variant.name): Case(scene, covered, variant, [])
        for scene, covered, variant in _plan(scenes)
    }
    for scene in scenes:
        for seed in seeds:
            progress(f"{scene}, seed {seed}")
            recording, truth = record(scene, seed, setup, cache), Scene.named(scene, seed)
            for _, covered, variant in _plan([scene]):
                outcome = run_variant(recording, truth, variant, config, covered=covered, period=period)
                cases[scene, covered, variant.name].outcomes.append(outcome)
    return Results(list(cases.values()), setup, config.method, seeds)


def _plan(scenes: Sequence[str]) -> Iterator[tuple[str, bool, Variant]]:
    for scene in scenes:
        for covered in (False, True):
            for variant in VARIANTS:
                if not (covered and variant is ALONE_B):
                    yield scene, covered, variant


@dataclass(frozen=True)
class Verdict:
    """Gain of fusing all sources compared with camera A alone and the best single source.

    Attributes
    ----------
    gain, worst_gain, worst_seed
        NMI on camera A's features, fused less A alone: mean over scenes, seeds and covers; the worst scene's
        mean over seeds; the worst single seed.
    gain_after
        The same within the seconds after the cover.
    kept
        Share of hypothesis ids of what B sees or the robot carries that stay while A is covered.
    surface, surface_single
        Share of the objects' surface covered: fused, and the best single source of each scene.
    nmi, nmi_single
        NMI over all features: fused, and the best single source of each scene.
    """

    gain: float
    worst_gain: float
    worst_seed: float
    gain_after: float
    kept: float
    surface: float
    surface_single: float
    nmi: float
    nmi_single: float


def verdict(results: Results) -> Verdict:
    """Compute the gains of an experiment."""
    stop = results.setup.cover[1]
    gains, after, kept = [], [], []
    fused, single = [], []
    for scene in results.scenes:
        for covered in (False, True):
            alone = results.case(scene, covered=covered, variant=ALONE_A)
            together = results.case(scene, covered=covered, variant=ALL)
            gains.append(together.nmi_a() - alone.nmi_a())
            fused.append((together.surface().mean(), together.nmi().mean()))
            other = results.case(scene, covered=covered, variant=ALONE_B)
            pairs = [(case.surface().mean(), case.nmi().mean()) for case in (alone, other)]
            single.append(np.max(pairs, axis=0))
        window = (stop, stop + AFTER_S)
        after.append(together.nmi_a(*window) - alone.nmi_a(*window))
        kept.append(together.kept(results.setup.cover))
    known = np.array(gains)
    return Verdict(
        gain=float(known.mean()),
        worst_gain=float(known.mean(axis=1).min()),
        worst_seed=float(known.min()),
        gain_after=float(np.mean(after)),
        kept=float(np.nanmean(kept)) if np.isfinite(kept).any() else float("nan"),
        surface=float(np.mean([s for s, _ in fused])),
        surface_single=float(np.mean([s for s, _ in single])),
        nmi=float(np.mean([n for _, n in fused])),
        nmi_single=float(np.mean([n for _, n in single])),
    )
