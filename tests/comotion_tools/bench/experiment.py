"""Runs the benchmark: every method at every number of features, each in a separate process."""

import gc
import math
import os
import platform
import resource
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from comotion import FusionConfig
from comotion_experiments.inputs import Incoming, find_inputs
from comotion_experiments.offline import run_offline
from comotion_experiments.study import Progress, alone, quiet
from comotion_schemas.plain import plain

from .scene import SceneSpec, messages

_MIN_FITTED = 500
_PACKAGES = ("comotion", "numpy", "numba", "scikit-learn", "scipy")
# From this number of features on the default method gets a longer period, s.
_MANY = 5000
_LONG_PERIOD = 0.25


@dataclass(frozen=True)
class Costs:
    """Results of a run: the machine, and rows of :func:`time_scene` and :func:`time_input`."""

    machine: dict[str, Any]
    rows: list[dict[str, Any]]

    def exponents(self) -> dict[str, float]:
        """Exponent of the cost in the number of features, by method, from scenes with at least 500."""
        found = {}
        for method in dict.fromkeys(row["method"] for row in self.rows):
            rows = [r for r in self.scenes(method) if r["features"] >= _MIN_FITTED]
            if len({row["features"] for row in rows}) > 1:
                sizes, costs = ([row[name] for row in rows] for name in ("features", "median_ms"))
                found[method] = float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
        return found

    def scenes(self, method: str) -> list[dict[str, Any]]:
        """Rows of generated scenes at the lowest rate."""
        rows = [row for row in self.rows if row["method"] == method and row["scene"] == "made up"]
        return [row for row in rows if row["rate"] == min(r["rate"] for r in rows)]

    def as_json(self) -> Any:
        """Plain values."""
        return plain({**vars(self), "exponents": self.exponents()})


def run_bench(
    scenes: Sequence[SceneSpec],
    configs: Sequence[FusionConfig],
    updates: int,
    *,
    recordings: Sequence[str] = (),
    progress: Progress = quiet,
) -> Costs:
    """Time `updates` of every configuration on every scene, and every recording or ``sim:NAME``.

    Each runs in a fresh process, so that peak memory and threads are not shared.
    """
    inputs = find_inputs(recordings)
    rows = []
    for config in configs:
        for spec in scenes:
            progress(f"{config.method}, {spec.features} features at {spec.rate:g} Hz")
            rows.append(alone(time_scene, spec, _sized(config, spec), updates))
        for item in inputs:
            progress(f"{config.method}, {item.name}")
            rows.append(alone(time_input, item.name, config))
    return Costs(_machine(), rows)


def _machine() -> dict[str, Any]:
    """This machine: hardware, load and versions."""
    processor, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        named = [line for line in info.read_text(encoding="utf-8").splitlines() if "model name" in line]
        processor = named[0].partition(":")[2].strip() if named else processor
    return {
        "processor": processor,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        "load": os.getloadavg()[0],
        "versions": {"python": platform.python_version()} | {name: version(name) for name in _PACKAGES},
    }


def _sized(config: FusionConfig, spec: SceneSpec) -> FusionConfig:
    changes: dict[str, Any] = {"max_tracks": max(config.max_tracks, 2 * spec.features)}
    given = config.period != FusionConfig().period
    if config.method == "comotion" and spec.features >= _MANY and not given:
        changes["period"] = _LONG_PERIOD
    return config.model_copy(update=changes)


def time_scene(spec: SceneSpec, config: FusionConfig, updates: int) -> dict[str, Any]:
    """Time the core on a scene after the window is full, as :func:`_timed` returns it.

    Updates run in every period while the window fills, since methods have memory.
    """
    fill = round(config.window / config.period) + 5
    given = messages(spec, (fill + updates + 1) * config.period)
    return _timed("made up", given, config, fill) | {"features": spec.features, "rate": spec.rate}


def time_input(name: str, config: FusionConfig) -> dict[str, Any]:
    """Time the core on a recording after the window is full, or in the second half of a short one."""
    (item,) = find_inputs([name])
    return _timed(Path(name).name, item.open(), config, round(config.window / config.period))


def _timed(scene: str, given: Iterable[Incoming], config: FusionConfig, fill: int) -> dict[str, Any]:
    """Figures after `fill` updates; times in ms per update, with the ingest of its batches.

    `features` is the median number, `cpu_ms` is of all threads, user and system; `nmi` is NaN without truth.
    """
    sizes: list[int] = []
    # As in the service: garbage collection is not part of an update.
    gc.disable()
    with threadpool_limits(limits=1, user_api="blas"):
        run = run_offline(
            given, config, spread=True, on_update=lambda update, _: sizes.append(len(update.track_id))
        )
    first = min(fill, len(sizes) // 2)
    (ingest_ms, ms, cpu_ms), nmi = run.costs_ms[:, first:], run.nmi[first:]
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "scene": scene,
        "method": config.method,
        "features": int(np.median(sizes[first:])),
        "rate": math.nan,
        "period": config.period,
        "median_ms": float(np.median(ms)),
        "p99_ms": float(np.percentile(ms, 99)),
        "ingest_ms": float(np.median(ingest_ms)),
        "cpu_ms": float(np.median(cpu_ms)),
        "cpu_share": float(cpu_ms.sum()) / (1e3 * config.period * len(ms)),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6,
        "nmi": float(np.nanmean(nmi)) if np.isfinite(nmi).any() else math.nan,
    }
