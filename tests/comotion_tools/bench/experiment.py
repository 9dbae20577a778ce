"""Runs the benchmark: every method at every number of features, each in a separate process."""

import gc
import os
import platform
import resource
import sys
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from comotion import FusionConfig
from comotion_experiments.offline import run_offline
from comotion_experiments.study import Progress, Row, alone, quiet
from comotion_experiments.tables import Column, Table, document

from .scene import SceneSpec, messages

_PACKAGES = ("comotion", "numpy", "numba", "scikit-learn", "scipy")
# From this number of features on the default method gets a longer period, s.
_MANY = 5000
_LONG_PERIOD = 0.25
_COLUMNS = (
    Column("features", "N", 0),
    Column("rate", "Hz", 0),
    Column("period", "period", 0, 1e3),
    Column("median_ms", "ms", 1),
    Column("p99_ms", "p99", 1),
    Column("ingest_ms", "ingest", 1),
    Column("cpu_ms", "CPU ms", 1),
    Column("cpu_share", "CPU", 0, 100.0, " %"),
    Column("memory_mb", "MB", 0),
    Column("nmi", "NMI", 3),
)


def run_bench(
    scenes: Sequence[SceneSpec], configs: Sequence[FusionConfig], updates: int, progress: Progress = quiet
) -> list[Row]:
    """Time `updates` of every configuration on every scene.

    Each runs in a fresh process, so that peak memory and threads are not shared.
    """
    rows = []
    for config in configs:
        for spec in scenes:
            progress(f"{config.method}, {spec.features} features at {spec.rate:g} Hz")
            rows.append(alone(time_scene, spec, _sized(config, spec), updates))
    return rows


def markdown(rows: Sequence[Row], machine: dict[str, Any]) -> str:
    """A page: the machine, and a line for each scene and method."""
    table = Table(("method", *(column.title for column in _COLUMNS)))
    for row in rows:
        table.add(row["method"], *(column.of(row) for column in _COLUMNS))
    versions = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    what = f"{machine['processor']}, {machine['cores']} cores, load {machine['load']:.1f}; {versions}"
    return document([what, table])


def this_machine() -> dict[str, Any]:
    """Hardware, load and versions."""
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


def time_scene(spec: SceneSpec, config: FusionConfig, updates: int) -> Row:
    """Time the core on a scene after the window is full; times in ms per update, ingest included.

    Updates run in every period while the window fills, since methods have memory. `cpu_ms` is of all threads,
    user and system.
    """
    fill = round(config.window / config.period) + 5
    # As in the service: garbage collection is not part of an update.
    gc.disable()
    with threadpool_limits(limits=1, user_api="blas"):
        run = run_offline(messages(spec, (fill + updates + 1) * config.period), config, spread=True)
    ingest_ms, ms, cpu_ms = run.costs_ms[:, fill:]
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "method": config.method,
        "features": spec.features,
        "rate": spec.rate,
        "period": config.period,
        "median_ms": float(np.median(ms)),
        "p99_ms": float(np.percentile(ms, 99)),
        "ingest_ms": float(np.median(ingest_ms)),
        "cpu_ms": float(np.median(cpu_ms)),
        "cpu_share": float(cpu_ms.sum()) / (1e3 * config.period * len(ms)),
        "memory_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6,
        "nmi": float(np.nanmean(run.nmi[fill:])),
    }
