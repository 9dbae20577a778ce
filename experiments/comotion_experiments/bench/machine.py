"""Description of the machine: processor, versions, memory bandwidth."""

import os
import platform
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comotion.compiled import compiled, numba_range

Singles = NDArray[np.float32]

_ELEMENTS = 32_000_000
_TURNS = 7
_PACKAGES = ("comotion", "numpy", "numba", "scikit-learn", "scipy")


@dataclass(frozen=True)
class Machine:
    """Hardware, load and versions.

    `triad_gb_s` is the best of several runs of a[k] = b[k] + s·c[k] on float32 arrays larger than the
    cache, on all cores, counting 12 bytes per element (the STREAM triad).
    """

    processor: str
    cores: int
    load: float
    triad_gb_s: float
    versions: dict[str, str]


def describe_machine() -> Machine:
    """Describe this machine; takes about a second."""
    return Machine(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        load=os.getloadavg()[0],
        triad_gb_s=triad(),
        versions={"python": platform.python_version()} | {name: version(name) for name in _PACKAGES},
    )


def triad() -> float:
    """Measure the memory bandwidth, GB/s."""
    a, b, c = (np.ones(_ELEMENTS, np.float32) for _ in range(3))
    times = []
    for _ in range(_TURNS + 1):
        begun = time.perf_counter()
        _triad(a, b, c, np.float32(2))
        times.append(time.perf_counter() - begun)
    return 12 * _ELEMENTS / min(times[1:]) / 1e9


@compiled(parallel=True)
def _triad(a: Singles, b: Singles, c: Singles, s: np.float32) -> None:
    for k in numba_range(len(a)):
        a[k] = b[k] + s * c[k]


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
