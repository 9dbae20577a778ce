"""Timing of the core: scene or recording -> time, processor time and memory per update."""

import gc
import math
import resource
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
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


@dataclass
class _Timing:
    """Per update: features, ingest and fusion of its batches, the update itself, processor time and NMI."""

    features: list[int] = field(default_factory=list)
    ingest_ms: list[float] = field(default_factory=list)
    update_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    nmi: list[float] = field(default_factory=list)

    def row(self, scene: str, config: FusionConfig, rate: float) -> Row:
        total = np.add(self.ingest_ms, self.update_ms)
        unit = 1 if sys.platform == "darwin" else 1024
        return Row(
            scene=scene,
            method=config.method,
            features=int(np.median(self.features)),
            rate=rate,
            period=config.period,
            median_ms=float(np.median(total)),
            p99_ms=float(np.percentile(total, 99)),
            ingest_ms=float(np.median(self.ingest_ms)),
            cpu_ms=float(np.median(self.cpu_ms)),
            cpu_share=float(np.sum(self.cpu_ms)) / (1e3 * config.period * len(total)),
            memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6,
            nmi=float(np.nanmean(self.nmi)) if np.isfinite(self.nmi).any() else math.nan,
        )


def time_scene(spec: SceneSpec, config: FusionConfig, updates: int) -> Row:
    """Time the core on a scene after the window is full.

    Updates run in every period while the window fills, since methods have memory.
    """
    scene = Scene(spec)
    fill = round(config.window / config.period) + 5
    batches = scene.merged((fill + updates + 1) * config.period)
    timing = _Timing()
    # As in the service: garbage collection is not part of an update.
    gc.disable()
    with threadpool_limits(limits=1, user_api="blas"):
        _run(batches, config, timing, scene, fill)
    return replace(timing.row("made up", config, spec.rate), features=spec.features)


def time_input(name: str, config: FusionConfig) -> Row:
    """Time the core on a recording after the window is full, or in the second half of a short one."""
    (item,) = find_inputs([name])
    sizes: list[int] = []
    with threadpool_limits(limits=1, user_api="blas"):
        cpu = time.process_time()
        run = run_offline(item.open(), config, on_update=lambda update, _: sizes.append(len(update.track_id)))
        cpu = time.process_time() - cpu
    first = min(round(config.window / config.period), len(run.update_ms) // 2)
    timing = _Timing(sizes[first:], update_ms=run.update_ms[first:].tolist(), nmi=run.nmi[first:].tolist())
    # Ingest is not measured separately here, and processor time includes reading and scoring.
    timing.ingest_ms = [0.0] * len(timing.update_ms)
    timing.cpu_ms = [1e3 * cpu / len(run.update_ms)] * len(timing.update_ms)
    return timing.row(Path(item.name).name, config, math.nan)


def _run(
    batches: Iterable[ObservationBatch], config: FusionConfig, timing: _Timing, scene: Scene, fill: int
) -> None:
    fusion = Fusion(config)
    period_ns = round(config.period * 1e9)
    due, done, busy, cpu = scene.start_ns + period_ns, 0, 0.0, 0.0
    for batch in batches:
        while batch.stamp_ns > due:
            begun, cpu_begun = time.perf_counter(), time.process_time()
            update = fusion.update(due)
            took = time.perf_counter() - begun
            cpu += time.process_time() - cpu_begun
            if done >= fill:
                timing.features.append(len(update.track_id))
                timing.ingest_ms.append(1e3 * busy)
                timing.update_ms.append(1e3 * took)
                timing.cpu_ms.append(1e3 * cpu)
                timing.nmi.append(_nmi_of(update, scene))
            due, done, busy, cpu = due + period_ns, done + 1, 0.0, 0.0
        begun, cpu_begun = time.perf_counter(), time.process_time()
        fusion.ingest(batch)
        fusion.advance(batch.stamp_ns)
        busy += time.perf_counter() - begun
        cpu += time.process_time() - cpu_begun


def _nmi_of(update: HypothesisUpdate, scene: Scene) -> float:
    names = [source.name for source in update.sources]
    truth = np.array(
        [
            scene.truth[names[s]][i]
            for s, i in zip(update.track_source.tolist(), update.track_id.tolist(), strict=True)
        ]
    )
    return nmi(update.track_hypothesis.astype(np.int64), truth)
