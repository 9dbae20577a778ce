"""Runs the benchmark: every method at every number of features, each in a separate process."""

import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from comotion import FusionConfig
from comotion_experiments.inputs import find_inputs
from comotion_experiments.processes import Progress, alone, quiet
from comotion_schemas.plain import plain

from .scene import SceneSpec
from .timing import Row, time_input, time_scene

_MIN_FITTED = 500
_PACKAGES = ("comotion", "numpy", "numba", "scikit-learn", "scipy")
# From this number of features on the default method gets a longer period, s.
_MANY = 5000
_LONG_PERIOD = 0.25


@dataclass(frozen=True)
class Machine:
    """Hardware, load and versions."""

    processor: str
    cores: int
    load: float
    versions: dict[str, str]


def describe_machine() -> Machine:
    """Describe this machine."""
    return Machine(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        load=os.getloadavg()[0],
        versions={"python": platform.python_version()} | {name: version(name) for name in _PACKAGES},
    )


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@dataclass(frozen=True)
class Costs:
    """Results of a run."""

    machine: Machine
    rows: list[Row]

    def exponents(self) -> dict[str, float]:
        """Exponent of the cost in the number of features, by method, from scenes with at least 500."""
        found = {}
        for method in dict.fromkeys(row.method for row in self.rows):
            rows = [r for r in self.scenes(method) if r.features >= _MIN_FITTED]
            if len({row.features for row in rows}) > 1:
                sizes = np.log([row.features for row in rows])
                found[method] = float(np.polyfit(sizes, np.log([row.median_ms for row in rows]), 1)[0])
        return found

    def scenes(self, method: str) -> list[Row]:
        """Rows of generated scenes at the lowest rate."""
        rows = [row for row in self.rows if row.method == method and row.scene == "made up"]
        return [row for row in rows if row.rate == min(r.rate for r in rows)]

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
            sized = _sized(config, spec)
            rows.append(alone(time_scene, spec, sized, updates))
        for item in inputs:
            progress(f"{config.method}, {item.name}")
            rows.append(alone(time_input, item.name, config))
    return Costs(describe_machine(), rows)


def _sized(config: FusionConfig, spec: SceneSpec) -> FusionConfig:
    changes: dict[str, Any] = {"max_tracks": max(config.max_tracks, 2 * spec.features)}
    given = config.period != FusionConfig().period
    if config.method == "comotion" and spec.features >= _MANY and not given:
        changes["period"] = _LONG_PERIOD
    return config.model_copy(update=changes)


def scaled(spec: SceneSpec, sizes: Iterable[int], rates: Iterable[float]) -> list[SceneSpec]:
    """Vary the number of features and the rate (Hz) of a scene."""
    rates = list(rates)
    return [replace(spec, features=n, rate=rate) for n in sizes for rate in rates]
