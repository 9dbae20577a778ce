"""Description of the machine: processor, load, versions."""

import os
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

_PACKAGES = ("comotion", "numpy", "numba", "scikit-learn", "scipy")


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
