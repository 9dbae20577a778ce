"""Runs of families: every scene through the core, and its metrics."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_clients.metrics import Truth

from ..offline import run_offline, thesis
from ..study import Row
from ..tables import mean, means
from . import metrics
from .apart import apart
from .catalogue import FAMILIES, Family
from .moments import Watcher
from .observe import messages_of
from .scene import Happening, Scene

DEFAULT, THESIS = "comotion", "thesis"
METHODS = (DEFAULT, THESIS)
REPORTED_SEEDS = (1, 3, 5, 7, 9)
"""Even seeds are for development."""


def run_family(
    name: str, seed: int, config: FusionConfig | None = None, *, method: str = DEFAULT, **overrides: Any
) -> Row:
    """Run a family of :data:`FAMILIES` and give its metrics by name, means over its scenes.

    Parameters
    ----------
    name, seed
        Of the family and its scenes.
    config
        Parameters of the core; by default those of a `method`: its defaults, or for the thesis method equal
        weights and a switch that suits the noise.
    overrides
        Parameters of the family.
    """
    scenes = FAMILIES[name].scenes(seed, **overrides)
    usual = [FusionConfig() if method == DEFAULT else thesis(scene.sigma_switch) for scene in scenes]
    return means([run_scene(scene, config or own) for scene, own in zip(scenes, usual, strict=True)])


def run_method(family: Family, method: str, seed: int) -> Row:
    """Run a family under a method."""
    return run_family(family.name, seed, method=method)


def run_scene(scene: Scene, config: FusionConfig) -> dict[str, float]:
    """Run one scene through the core; metrics by name, NaN where one does not apply.

    `nmi_apart` is the mean with bodies as one until they are apart, `nmi` that against the true bodies;
    `delay` (s) and `ids` are means over bodies, `healing` (s) and `kept` over events; `spurious` are events a
    minute beyond the true ones, `switches` tracks per 100 with another hypothesis than an update before,
    `hypotheses` the mean number of confirmed ones, `ms` the median time of an update.
    """
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
    spurious = sum(len(m.events) for m in moments) - metrics.true_events(since, last, scene.happenings)
    return {
        "nmi": metrics.mean_nmi(moments, apart=False),
        "nmi_apart": metrics.mean_nmi(moments),
        "delay": mean(metrics.delays(moments, since, last)),
        "healing": mean(metrics.healing(moments, h, until) for h, until in _until(scene.happenings, last)),
        "kept": mean(metrics.kept(moments, h) for h in scene.happenings),
        "ids": metrics.ids_per_object(moments, since),
        "spurious": max(spurious, 0) / ((last - scene.start) / 60.0),
        "switches": run.summary.switches_per_100,
        "hypotheses": mean(float(len(m.confirmed)) for m in moments),
        "ms": float(np.median(run.update_ms)),
    }


def _until(happenings: Sequence[Happening], last: float) -> Iterator[tuple[Happening, float]]:
    following = [*(happening.begin for happening in happenings[1:]), last]
    for happening, end in zip(happenings, following, strict=False):
        yield happening, min(end, happening.end + 10.0)
