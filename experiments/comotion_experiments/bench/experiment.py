"""The table of costs: every method at every number of features, each in a process of its own."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comotion import FusionConfig

from .scene import SceneSpec
from .timing import Timing, time_scene


@dataclass(frozen=True)
class Row:
    """One line of the table; times in ms per update."""

    method: str
    features: int
    rate: float
    median_ms: float
    p99_ms: float
    ingest_ms: float
    cpu_ms: float
    cpu_share: float
    memory_mb: float
    nmi: float


def run_bench(
    scenes: Sequence[SceneSpec],
    configs: Sequence[FusionConfig],
    updates: int,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Row]:
    """Time every configuration on every scene.

    Each runs in a fresh process, so that its peak memory is its own and no other's threads disturb.
    """
    rows = []
    for config in configs:
        for spec in scenes:
            progress(f"{config.method}, {spec.features} features")
            room = max(config.max_tracks, 2 * spec.features)
            sized = config.model_copy(update={"max_tracks": room})
            rows.append(_row(spec, alone(time_scene, spec, sized, updates)))
    return rows


def alone(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function in a fresh process."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(function, *arguments).result()


def _row(spec: SceneSpec, timing: Timing) -> Row:
    total = timing.total_ms
    return Row(
        method=timing.method,
        features=spec.features,
        rate=spec.rate,
        median_ms=float(np.median(total)),
        p99_ms=float(np.percentile(total, 99)),
        ingest_ms=float(np.median(timing.ingest_ms)),
        cpu_ms=float(np.median(timing.cpu_ms)),
        cpu_share=float(np.sum(timing.cpu_ms)) / (1e3 * timing.period * len(total)),
        memory_mb=timing.memory_mb,
        nmi=float(np.mean(timing.nmi)),
    )


def scaled(spec: SceneSpec, sizes: Sequence[int]) -> list[SceneSpec]:
    """The same scene with other numbers of features."""
    return [replace(spec, features=n) for n in sizes]
