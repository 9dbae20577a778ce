"""Runs of families: every scene or image sequence through the core, and its metrics."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_clients.metrics import Truth

from ..offline import run_offline, thesis
from ..pixels.methods import engine, one_object, spectral_interaction
from ..pixels.sequences import Sequence as ImageSequence
from ..pixels.sequences import score
from ..processes import Progress, quiet, run_all
from ..tables import mean, means
from . import metrics
from .apart import apart
from .catalogue import FAMILIES, Family
from .moments import Watcher
from .motion import Array
from .observe import messages_of
from .scene import Happening, Scene

DEFAULT, THESIS = "comotion", "thesis"
METHODS = (DEFAULT, THESIS)
REPORTED_SEEDS = (1, 3, 5, 7, 9)
"""Even seeds are for development."""


@dataclass(frozen=True)
class Outcome:
    """One seed of a family under one method."""

    family: str
    method: str
    seed: int
    figures: dict[str, float]  # means over its scenes, or over its image sequences, named in the report
    traces: Sequence[Array] = ()  # of each scene, float64 [updates, 4]: s, NMI, NMI (apart), hypotheses
    errors: Sequence[float] = ()  # of each image sequence, per cent


def run_family(
    name: str, seed: int, config: FusionConfig | None = None, **overrides: Any
) -> dict[str, float]:
    """Run a family of :data:`FAMILIES` and give its metrics by name, see :mod:`.report`.

    Parameters
    ----------
    name, seed
        Of the family and its scenes.
    config
        Parameters of the core; by default those of the default method.
    overrides
        Parameters of the family.
    """
    return run_outcome(name, seed, config=config, **overrides).figures


def run_outcome(
    name: str, seed: int, method: str = DEFAULT, *, config: FusionConfig | None = None, **overrides: Any
) -> Outcome:
    """Run a seed of a family under a method, or with other parameters of the core.

    The thesis method has equal weights and a switch that suits the noise.
    """
    family = FAMILIES[name]
    scenes = family.scenes(seed, **overrides)
    if family.of_images:
        rows = [_score_images(sequence, config or FusionConfig()) for sequence in scenes]
        figures = means(rows) | {"ms": float(np.median([row["ms"] for row in rows]))}
        return Outcome(name, method, seed, figures, errors=[row["error"] for row in rows])
    runs = []
    for scene in scenes:
        usual = FusionConfig() if method == DEFAULT else thesis(scene.sigma_switch)
        runs.append(run_scene(scene, config or usual))
    return Outcome(name, method, seed, means([row for row, _ in runs]), [trace for _, trace in runs])


def _score_images(sequence: ImageSequence, config: FusionConfig) -> dict[str, float]:
    """Group a sequence with one update at its end, K unknown; metrics by name."""
    labels, seconds = engine(sequence, config.pixels)
    true, count = sequence.objects(), len(np.unique(labels[labels >= 0]))
    return score(sequence, labels) | {
        "exact": float(count == true),
        "over": float(count > true),
        "under": float(count < true),
        "found": float(count),
        "true": float(true),
        "given": score(sequence, spectral_interaction(sequence))["error"],
        "one": score(sequence, one_object(sequence))["error"],
        "ms": 1e3 * seconds,
    }


def run_experiment(
    families: Sequence[Family],
    seeds: Sequence[int],
    *,
    methods: Sequence[str] = METHODS,
    jobs: int = 2,
    progress: Progress = quiet,
) -> list[Outcome]:
    """Run families with every seed and method; in the order of seeds.

    Image families run with the default method only, beside baselines of their own. `jobs` are processes at
    once; `progress` is called with one line for each run that is done.
    """
    # Long ones first, so that the processes end together.
    order = sorted(families, key=lambda family: not family.slow)
    work = [
        (family.name, seed, method)
        for family in order
        for method in methods
        for seed in seeds
        if method == DEFAULT or not family.of_images
    ]
    outcomes = run_all(run_outcome, work, jobs, _said, progress)
    return sorted(outcomes, key=lambda outcome: list(seeds).index(outcome.seed))


def _said(outcome: Outcome) -> str:
    which = f"{outcome.family}, seed {outcome.seed}"
    if outcome.errors:
        return f"{which}: error {outcome.figures['error']:.1f} %"
    return f"{which}, {outcome.method}: NMI {outcome.figures['nmi_apart']:.3f}"


def run_scene(scene: Scene, config: FusionConfig) -> tuple[dict[str, float], Array]:
    """Run one scene through the core; metrics by name, and a trace as in :class:`Outcome`."""
    messages, since = messages_of(scene), apart(scene)
    truth = Truth(messages.truth)
    watcher = Watcher(truth, since)
    run = run_offline(
        watcher.passing(messages.batches),
        config,
        truth=truth,
        period=scene.period,
        on_update=lambda update, _: watcher.add(update),
    )
    moments = watcher.moments
    last = moments[-1].t
    minutes = (last - scene.start) / 60.0
    true = metrics.true_events(since, last, scene.happenings)
    events = sum(len(m.events) for m in moments)
    healings = [metrics.healing(moments, h, until) for h, until in _until(scene.happenings, last)]
    counts = [float(len(m.confirmed)) for m in moments]
    apart_now = [float(len(set(since.components(m.t)[m.bodies].tolist()))) for m in moments]
    figures = {
        "nmi": metrics.mean_nmi(moments, apart=False),
        "nmi_apart": metrics.mean_nmi(moments),
        "all_bodies": metrics.mean_nmi(moments, since.complete + metrics.SETTLING_S, apart=False),
        "wrong": metrics.wrong_late(moments),
        "delay": mean(metrics.delays(moments, since, last)),
        "healing": mean(healings),
        "healed_in_1s": mean([float(h <= 1.0) for h in healings if not np.isnan(h)]),
        "kept": mean([metrics.kept(moments, h) for h in scene.happenings]),
        "ids": metrics.ids_per_object(moments, since),
        "spurious": max(events - true, 0) / minutes,
        "true": true / minutes,
        "switches": run.summary.switches_per_100,
        "hypotheses": mean(counts),
        "bodies": mean(apart_now),
        "over": mean([float(k > true_k) for k, true_k in zip(counts, apart_now, strict=True)]),
        "ms": float(np.median(run.update_ms)),
    }
    trace = np.array([(m.t, m.nmi, m.nmi_apart, len(m.confirmed)) for m in moments])
    return figures, trace


def _until(happenings: Sequence[Happening], last: float) -> Iterator[tuple[Happening, float]]:
    following = [*(happening.begin for happening in happenings[1:]), last]
    for happening, end in zip(happenings, following, strict=False):
        yield happening, min(end, happening.end + 10.0)
