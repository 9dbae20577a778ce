"""Runs of families: every scene through the core, and its metrics."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_clients.metrics import Truth

from ..offline import run_offline, thesis
from ..processes import Progress, quiet, run_all
from ..tables import mean, means
from . import metrics
from .apart import apart
from .catalogue import FAMILIES, AnyFamily, Family
from .image_experiment import IMAGE_FAMILIES, ImageOutcome, run_image_family
from .moments import Moment, Watcher
from .observe import messages_of
from .scene import Happening, Scene

DEFAULT, THESIS = "comotion", "thesis"
METHODS = (DEFAULT, THESIS)
REPORTED_SEEDS = (1, 3, 5, 7, 9)
"""Even seeds are for development."""


@dataclass(frozen=True)
class Figures:
    """Metrics of one run, or their means; NaN where a metric does not apply.

    Attributes
    ----------
    nmi
        Mean over all updates, against the true bodies.
    nmi_apart
        Likewise, with bodies as one until they have moved apart by five sigma.
    all_bodies
        Mean NMI from a second after all bodies are apart.
    wrong
        1 where the mean NMI (apart) from 5 s after the first update on is below .95.
    delay
        s from apart to a hypothesis of its own, mean over bodies.
    healing
        s after an event until right again, mean over events.
    healed_in_1s
        Share of events after which it was right again within 1 s.
    kept
        Share of bodies with the same id before and after an event.
    ids
        Ids an object over the run.
    spurious, true
        Events a minute beyond the true ones; true events a minute.
    switches
        Tracks with another hypothesis than an update before, per 100.
    hypotheses, bodies
        Mean numbers: confirmed hypotheses, and bodies apart.
    over
        Share of the updates with more confirmed hypotheses than bodies apart.
    ms
        Median time of an update.
    """

    nmi: float
    nmi_apart: float
    all_bodies: float
    wrong: float
    delay: float
    healing: float
    healed_in_1s: float
    kept: float
    ids: float
    spurious: float
    true: float
    switches: float
    hypotheses: float
    bodies: float
    over: float
    ms: float


@dataclass(frozen=True)
class Trace:
    """NMI over time of one run: `seconds`, `nmi`, `nmi_apart`, `hypotheses` of equal length."""

    seconds: list[float]
    nmi: list[float]
    nmi_apart: list[float]
    hypotheses: list[int]


@dataclass(frozen=True)
class Outcome:
    """One seed of a family under one method: means over its scenes, and each scene's trace."""

    family: str
    method: str
    seed: int
    figures: Figures
    traces: list[Trace]


@dataclass
class Results:
    """All outcomes, those of image families apart, and the seeds they are of."""

    seeds: Sequence[int]
    outcomes: list[Outcome] = field(default_factory=list)
    images: list[ImageOutcome] = field(default_factory=list)

    def of(self, family: str, method: str) -> list[Outcome]:
        """Outcomes of a family under a method, in the order of seeds."""
        return [o for o in self.outcomes if (o.family, o.method) == (family, method)]

    @property
    def methods(self) -> list[str]:
        """The methods that were run, in order."""
        return [m for m in METHODS if any(o.method == m for o in self.outcomes)]


def method_config(method: str, scene: Scene) -> FusionConfig:
    """Parameters of a method; the thesis method has equal weights and a switch that suits the noise."""
    if method == DEFAULT:
        return FusionConfig()
    return thesis(scene.sigma_switch)


def run_family(
    name: str, seed: int, config: FusionConfig | None = None, **overrides: Any
) -> dict[str, float]:
    """Run a family of :data:`FAMILIES` and give its metrics by name.

    Parameters
    ----------
    name, seed
        Of the family and its scenes.
    config
        Parameters of the core; by default those of the default method.
    overrides
        Parameters of the family.
    """
    return asdict(_run(FAMILIES[name], seed, lambda _: config or FusionConfig(), **overrides).figures)


def run_outcome(name: str, seed: int, method: str) -> Outcome | ImageOutcome:
    """Run a seed of a family under a method."""
    if name in IMAGE_FAMILIES:
        return run_image_family(name, seed)
    return _run(FAMILIES[name], seed, lambda scene: method_config(method, scene), method=method)


def run_experiment(
    families: Sequence[AnyFamily],
    seeds: Sequence[int],
    *,
    methods: Sequence[str] = METHODS,
    jobs: int = 2,
    progress: Progress = quiet,
) -> Results:
    """Run families with every seed and method.

    Parameters
    ----------
    families, seeds, methods
        What to run. Image families run with the default method only, beside baselines of their own.
    jobs
        Processes at once.
    progress
        Called with one line for each run that is done.
    """
    # Long ones first, so that the processes end together.
    order = sorted(families, key=lambda family: not family.slow)
    work = [
        (family.name, seed, method)
        for family in order
        for method in methods
        for seed in seeds
        if isinstance(family, Family) or method == DEFAULT
    ]
    results = Results(seeds)
    for outcome in run_all(run_outcome, work, jobs, _said, progress):
        if isinstance(outcome, ImageOutcome):
            results.images.append(outcome)
        else:
            results.outcomes.append(outcome)
    place = list(seeds).index
    results.outcomes.sort(key=lambda o: place(o.seed))
    results.images.sort(key=lambda o: place(o.seed))
    return results


def _said(outcome: Outcome | ImageOutcome) -> str:
    what = f"{outcome.family}, seed {outcome.seed}"
    if isinstance(outcome, ImageOutcome):
        return f"{what}: error {outcome.figures.error:.1f} %"
    return f"{what}, {outcome.method}: NMI {outcome.figures.nmi_apart:.3f}"


def _run(
    family: Family,
    seed: int,
    config: Callable[[Scene], FusionConfig],
    *,
    method: str = "",
    **overrides: Any,
) -> Outcome:
    runs = [run_scene(scene, config(scene)) for scene in family.scenes(seed, **overrides)]
    figures = Figures(**means([figures_of_one for figures_of_one, _ in runs]))
    return Outcome(family.name, method, seed, figures, [trace for _, trace in runs])


def run_scene(scene: Scene, config: FusionConfig) -> tuple[Figures, Trace]:
    """Run one scene through the core."""
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
    figures = Figures(
        nmi=metrics.mean_nmi(moments),
        nmi_apart=metrics.mean_nmi_apart(moments),
        all_bodies=metrics.all_bodies_nmi(moments, since),
        wrong=metrics.wrong_late(moments),
        delay=mean(metrics.delays(moments, since, last)),
        healing=mean(healings),
        healed_in_1s=mean([float(h <= 1.0) for h in healings if not np.isnan(h)]),
        kept=mean([metrics.kept(moments, h) for h in scene.happenings]),
        ids=metrics.ids_per_object(moments, since),
        spurious=max(events - true, 0) / minutes,
        true=true / minutes,
        switches=run.summary.switches_per_100,
        hypotheses=mean(counts),
        bodies=mean(apart_now),
        over=mean([float(k > true_k) for k, true_k in zip(counts, apart_now, strict=True)]),
        ms=float(np.median(run.update_ms)),
    )
    return figures, _trace(moments)


def _until(happenings: Sequence[Happening], last: float) -> Iterator[tuple[Happening, float]]:
    for k, happening in enumerate(happenings):
        following = happenings[k + 1].begin if k + 1 < len(happenings) else last
        yield happening, min(following, happening.end + 10.0)


def _trace(moments: Sequence[Moment]) -> Trace:
    return Trace(
        seconds=[m.t for m in moments],
        nmi=[m.nmi for m in moments],
        nmi_apart=[m.nmi_apart for m in moments],
        hypotheses=[len(m.confirmed) for m in moments],
    )
