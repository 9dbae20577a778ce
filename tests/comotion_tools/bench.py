"""Times the core on scenes of any size, every method and number of features in a process of its own.

Half of the features are on a background at rest, the others on bodies that move, made by the generator of the
stress families. Features end and are replaced at a constant rate, on the same body at another place.
"""

import gc
import os
import platform
import resource
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from comotion import FusionConfig
from comotion_experiments.inputs import Arrived, Incoming
from comotion_experiments.offline import run_offline
from comotion_experiments.stress.observe import messages_of
from comotion_experiments.stress.scene import (
    Source,
    background,
    lasting,
    made,
    renewed,
    rng_of,
    swinging_bodies,
)
from comotion_experiments.study import Progress, Row, alone, quiet
from comotion_experiments.tables import Column, Table, document
from comotion_schemas import ObservationBatch

_NOISE_M = 0.002
# A fixed camera without depth: distance to the scene in m; focal length and principal point in px.
_CAMERA_Z = 3.0
_FOCAL_PX = 500.0
_CENTRE_PX = np.array([320.0, 240.0])


@dataclass(frozen=True, kw_only=True)
class SceneSpec:
    """Specification of the scene."""

    features: int = 1000  # at any time, over all sources
    bodies: int = 6  # that move
    sources: int = 3  # whose phases are evenly spread
    rate: float = 30.0  # Hz of each
    churn: float = 0.03  # share of the features that is replaced per second
    pixels: bool = False  # cameras without depth instead, each with its own space and noise of 0.3 px


def messages(spec: SceneSpec, seconds: float, sources: Iterable[int] | None = None) -> Iterator[Incoming]:
    """Yield the truth of a scene, and the batches of its sources, or of some of them, as they arrive."""
    share, rest = divmod(spec.features - spec.features // 2, spec.bodies)
    moving = swinging_bodies(0, spec.bodies, share, _NOISE_M)
    moving = [replace(body, features=share + (k < rest)) for k, body in enumerate(moving)]
    bodies = [background(spec.features // 2, _NOISE_M), *moving]
    spans, lives = lasting(bodies), rng_of(0, "lives")
    if spec.churn:
        spans = renewed(len(spans), seconds, lives, lambda rng: float(rng.exponential(1 / spec.churn)))
    observers = [Source(f"s{k}", spec.rate, k / spec.sources) for k in range(spec.sources)]
    (scene,) = made(0, bodies, seconds, spans, sources=observers)
    published = messages_of(scene, sources)
    yield from published.truth
    for arrived in published.batches:
        yield Arrived(_seen(arrived.batch), arrived.now_ns) if spec.pixels else arrived


def _seen(batch: ObservationBatch) -> ObservationBatch:
    """What a camera without depth sees of a batch in metres."""
    places = batch.positions.astype(np.float64)
    image = _FOCAL_PX * places[:, :2] / (places[:, 2:] + _CAMERA_Z) + _CENTRE_PX
    space = f"{batch.source}/pixels"
    return replace(batch, space=space, unit="px", dim=2, positions=image.astype(np.float32))


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
    Column("cpu_share", "CPU, %", 0, 100.0),
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
