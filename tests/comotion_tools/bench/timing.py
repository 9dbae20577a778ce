"""Timing of the core: scene or recording -> time, processor time and memory per update."""

import gc
import math
import resource
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from comotion import Fusion, FusionConfig
from comotion_clients.metrics import nmi
from comotion_experiments.inputs import find_inputs
from comotion_experiments.offline import run_offline
from comotion_schemas import HypothesisUpdate, ObservationBatch

from .scene import Scene, SceneSpec


@dataclass(frozen=True)
class Row:
    """One line of the table; times in ms per update after the window is full, with the ingest of its batches.

    `features` is the requested number, for a recording the median; `cpu_ms` is of all threads, user and
    system; `nmi` is NaN without truth.
    """

    scene: str
    method: str
    features: int
    rate: float
    period: float
    median_ms: float
    p99_ms: float
    ingest_ms: float
    cpu_ms: float
    cpu_share: float
    memory_mb: float
    nmi: float


# Of an update: features, ms of the ingest of its batches, of the update itself, of the processor, and NMI.
_Figures = tuple[int, float, float, float, float]


def _row(scene: str, config: FusionConfig, rate: float, figures: Sequence[_Figures]) -> Row:
    features, ingest_ms, update_ms, cpu_ms, nmis = np.array(figures, np.float64).T
    total = ingest_ms + update_ms
    unit = 1 if sys.platform == "darwin" else 1024
    return Row(
        scene=scene,
        method=config.method,
        features=int(np.median(features)),
        rate=rate,
        period=config.period,
        median_ms=float(np.median(total)),
        p99_ms=float(np.percentile(total, 99)),
        ingest_ms=float(np.median(ingest_ms)),
        cpu_ms=float(np.median(cpu_ms)),
        cpu_share=float(cpu_ms.sum()) / (1e3 * config.period * len(total)),
        memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6,
        nmi=float(np.nanmean(nmis)) if np.isfinite(nmis).any() else math.nan,
    )


def time_scene(spec: SceneSpec, config: FusionConfig, updates: int) -> Row:
    """Time the core on a scene after the window is full.

    Updates run in every period while the window fills, since methods have memory.
    """
    scene = Scene(spec)
    fill = round(config.window / config.period) + 5
    batches = scene.merged((fill + updates + 1) * config.period)
    # As in the service: garbage collection is not part of an update.
    gc.disable()
    with threadpool_limits(limits=1, user_api="blas"):
        figures = list(_run(batches, config, scene))[fill:]
    return replace(_row("made up", config, spec.rate, figures), features=spec.features)


def time_input(name: str, config: FusionConfig) -> Row:
    """Time the core on a recording after the window is full, or in the second half of a short one."""
    (item,) = find_inputs([name])
    sizes: list[int] = []
    with threadpool_limits(limits=1, user_api="blas"):
        cpu = time.process_time()
        run = run_offline(item.open(), config, on_update=lambda update, _: sizes.append(len(update.track_id)))
        cpu = time.process_time() - cpu
    first = min(round(config.window / config.period), len(run.update_ms) // 2)
    # Ingest is not measured separately here, and processor time includes reading and scoring.
    cpu_ms = 1e3 * cpu / len(run.update_ms)
    rows = zip(sizes, run.update_ms.tolist(), run.nmi.tolist(), strict=True)
    figures = [(size, 0.0, ms, cpu_ms, found) for size, ms, found in rows]
    return _row(Path(item.name).name, config, math.nan, figures[first:])


def _run(batches: Iterable[ObservationBatch], config: FusionConfig, scene: Scene) -> Iterator[_Figures]:
    fusion = Fusion(config)
    period_ns = round(config.period * 1e9)
    due, busy, cpu = scene.start_ns + period_ns, 0.0, 0.0
    for batch in batches:
        while batch.stamp_ns > due:
            begun, cpu_begun = time.perf_counter(), time.process_time()
            update = fusion.update(due)
            took = time.perf_counter() - begun
            cpu += time.process_time() - cpu_begun
            yield len(update.track_id), 1e3 * busy, 1e3 * took, 1e3 * cpu, _nmi_of(update, scene)
            due, busy, cpu = due + period_ns, 0.0, 0.0
        begun, cpu_begun = time.perf_counter(), time.process_time()
        fusion.ingest(batch)
        fusion.advance(batch.stamp_ns)
        busy += time.perf_counter() - begun
        cpu += time.process_time() - cpu_begun


def _nmi_of(update: HypothesisUpdate, scene: Scene) -> float:
    names = [source.name for source in update.sources]
    tracks = zip(update.track_source.tolist(), update.track_id.tolist(), strict=True)
    truth = np.array([scene.truth[names[s]][i] for s, i in tracks])
    return nmi(update.track_hypothesis.astype(np.int64), truth)
