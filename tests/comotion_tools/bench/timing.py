"""Timing of the core: scene or recording -> time, processor time and memory per update."""

import gc
import resource
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from comotion import Fusion, FusionConfig
from comotion_clients.metrics import nmi
from comotion_experiments.inputs import Input
from comotion_experiments.offline import run_offline
from comotion_schemas import HypothesisUpdate, ObservationBatch

from .scene import Scene, SceneSpec


@dataclass
class Timing:
    """Costs of the updates after the window is full.

    Attributes
    ----------
    method
        Name of the method.
    features
        Number of tracks, per update.
    ingest_ms, update_ms
        Per update: ingest and fusion of its batches, and the update itself.
    cpu_ms
        Processor time of all threads per update, user and system.
    memory_mb
        Peak resident memory of the process.
    nmi
        Per update; NaN without truth.
    """

    method: str
    period: float
    features: list[int] = field(default_factory=list)
    ingest_ms: list[float] = field(default_factory=list)
    update_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    nmi: list[float] = field(default_factory=list)
    memory_mb: float = 0.0

    @property
    def total_ms(self) -> NDArray[np.float64]:
        """Time per update including ingest, float64 [updates]."""
        return np.array(self.ingest_ms) + self.update_ms


def time_scene(spec: SceneSpec, config: FusionConfig, updates: int) -> Timing:
    """Time the core on a scene after the window is full.

    Updates run in every period while the window fills, since methods have memory.
    """
    scene = Scene(spec)
    fill = round(config.window / config.period) + 5
    batches = scene.merged((fill + updates + 1) * config.period)
    timing = Timing(config.method, config.period)
    # As in the service: garbage collection is not part of an update.
    gc.disable()
    with threadpool_limits(limits=1, user_api="blas"):
        _run(batches, config, timing, scene, fill)
    timing.memory_mb = _peak_mb()
    return timing


def time_input(item: Input, config: FusionConfig) -> Timing:
    """Time the core on a recording after the window is full, or in the second half of a short one."""
    timing = Timing(config.method, config.period)
    sizes: list[int] = []
    with threadpool_limits(limits=1, user_api="blas"):
        cpu = time.process_time()
        run = run_offline(item.open(), config, on_update=lambda update, _: sizes.append(len(update.track_id)))
        cpu = time.process_time() - cpu
    first = min(round(config.window / config.period), len(run.update_ms) // 2)
    timing.features = sizes[first:]
    timing.update_ms = run.update_ms[first:].tolist()
    # Ingest is not measured separately here, and processor time includes reading and scoring.
    timing.ingest_ms = [0.0] * len(timing.update_ms)
    timing.cpu_ms = [1e3 * cpu / len(run.update_ms)] * len(timing.update_ms)
    timing.nmi = run.nmi[first:].tolist()
    timing.memory_mb = _peak_mb()
    return timing


def _run(
    batches: Iterable[ObservationBatch], config: FusionConfig, timing: Timing, scene: Scene, fill: int
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


def _peak_mb() -> float:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
