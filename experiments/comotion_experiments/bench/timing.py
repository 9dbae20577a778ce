"""What an update costs in the core: time with its share of ingest, CPU, memory."""

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
from comotion_schemas import HypothesisUpdate, ObservationBatch

from ..inputs import Input
from ..offline import run_offline
from .scene import Scene, SceneSpec


@dataclass
class Timing:
    """Costs of the updates measured, after the window has filled.

    Attributes
    ----------
    method
        Name of the method.
    features
        Tracks in the update, median.
    ingest_ms, update_ms
        Per update: taking in and fusing the batches since the one before, and the update itself.
    cpu_ms
        Processor time of all threads per update, user and system.
    memory_mb
        Peak resident memory of the process.
    nmi
        Mean agreement of the updates with the truth; NaN where it is not known.
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
        """Time per update with its share of ingest, [updates]."""
        return np.array(self.ingest_ms) + self.update_ms


def time_scene(spec: SceneSpec, config: FusionConfig, updates: int) -> Timing:
    """Cost of the core on a scene, once its window is full.

    While the window fills there is an update each period as well: methods learn from them.
    """
    scene = Scene(spec)
    fill = round(config.window / config.period) + 5
    batches = scene.merged((fill + updates + 1) * config.period)
    timing = Timing(config.method, config.period)
    # As the service does: collecting garbage is no part of an update.
    gc.disable()
    with threadpool_limits(limits=1, user_api="blas"):
        _run(batches, config, timing, scene, fill)
    timing.memory_mb = _peak_mb()
    return timing


def time_input(item: Input, config: FusionConfig) -> Timing:
    """Cost of the core on a recording, once its window is full, or from the middle of a short one."""
    timing = Timing(config.method, config.period)
    sizes: list[int] = []
    with threadpool_limits(limits=1, user_api="blas"):
        cpu = time.process_time()
        run = run_offline(item.open(), config, on_update=lambda update, _: sizes.append(len(update.track_id)))
        cpu = time.process_time() - cpu
    first = min(round(config.window / config.period), len(run.update_ms) // 2)
    timing.features = sizes[first:]
    timing.update_ms = run.update_ms[first:].tolist()
    # Ingest is not told apart here, and reading and scoring take processor time as well.
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
                timing.nmi.append(_agreement(update, scene))
            due, done, busy, cpu = due + period_ns, done + 1, 0.0, 0.0
        begun, cpu_begun = time.perf_counter(), time.process_time()
        fusion.ingest(batch)
        fusion.advance(batch.stamp_ns)
        busy += time.perf_counter() - begun
        cpu += time.process_time() - cpu_begun


def _agreement(update: HypothesisUpdate, scene: Scene) -> float:
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
