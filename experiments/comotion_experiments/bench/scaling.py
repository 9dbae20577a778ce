"""Processor time of many scenes side by side: what services, standbys, router, sources and etcd take.

One source process a scene, see :mod:`comotion_deploy.bench_scaling`::

    python -m comotion_experiments.bench.scaling ENDPOINT SCENE FEATURES BODIES
"""

import os
import sys
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..plot import new_figure
from ..tables import Table
from .live import processor_seconds, publish
from .scene import Scene, SceneSpec

RATE = 30.0
BODIES = 6
KINDS = ("service", "standby", "router", "etcd", "source", "client")
_COLOURS = ("#0072b2", "#56b4e9", "#e69f00", "#cc79a7", "#999999", "#dddddd")
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class Load:
    """A configuration: scenes, features and bodies of each, and whether each scene has a standby."""

    scenes: int
    features: int
    bodies: int = BODIES
    standby: bool = False

    def __str__(self) -> str:
        size = f"{self.scenes} x {self.features}"
        return size if self.bodies == BODIES else f"{size}, {self.bodies} bodies"


@dataclass(frozen=True)
class Share:
    """What a configuration took.

    Attributes
    ----------
    cores
        Processor time by kind of process, in cores.
    others
        Processor time of everything else on the machine, in cores.
    bytes_per_s
        Payloads of one scene, by what they are.
    updates, overruns
        Of all active services together, over `seconds`.
    latency_ms
        Median and 99th percentile of the time from the watermark of an update to its receipt, ms.
    """

    load: Load
    seconds: float
    cores: dict[str, float]
    others: float
    bytes_per_s: dict[str, float]
    updates: int
    overruns: int
    latency_ms: tuple[float, float]

    @property
    def total(self) -> float:
        """Cores of all processes."""
        return sum(self.cores.values())


def loads(counts: Sequence[int], features: int) -> list[Load]:
    """All features and bodies in one scene, then in more and more scenes, without and with standbys."""
    most = counts[-1]
    together = [Load(1, features * most), Load(1, features * most, BODIES * most)]
    apart = [Load(count, features, standby=standby) for standby in (False, True) for count in counts]
    return [*(together if most > 1 else []), *apart]


def run_source(endpoint: str, scene: str, features: int, bodies: int) -> None:
    """Publish one scene in real time until stopped."""
    spec = SceneSpec(features=features, bodies=bodies, sources=1, rate=RATE)
    deque(publish(endpoint, scene, "s0", Scene(spec, time.time_ns())), maxlen=0)


def seconds_of(pids: dict[str, list[int]]) -> dict[str, float]:
    """Processor seconds so far, by kind of process."""
    return {kind: sum(map(processor_seconds, pids.get(kind, ()))) for kind in KINDS}


def busy_seconds() -> float:
    """Processor seconds of the whole machine so far, all cores together; 0 where /proc does not tell."""
    stat = Path("/proc/stat")
    if not stat.exists():
        return 0.0
    user, nice, system, _idle, _wait, irq, softirq, *_ = map(int, stat.read_text().split("\n")[0].split()[1:])
    return (user + nice + system + irq + softirq) / _TICKS


def markdown(shares: Sequence[Share]) -> str:
    """A table with one row a configuration."""
    titles = ["scenes x features", "standby", *KINDS, "all", "others", "overruns / updates"]
    titles += ["latency ms, median (p99)", *(f"{what} kB/s" for what in shares[0].bytes_per_s)]
    found = Table(titles, words=2)
    for share in shares:
        cores = [*(share.cores[kind] for kind in KINDS), share.total, share.others]
        middle, p99 = share.latency_ms
        found.add(
            str(share.load),
            "yes" if share.load.standby else "no",
            *(f"{value:.2f}" for value in cores),
            f"{share.overruns} / {share.updates}",
            f"{middle:.0f} ({p99:.0f})",
            *(f"{size / 1000:.1f}" for size in share.bytes_per_s.values()),
        )
    return found.markdown()


def save_picture(path: Path, shares: Sequence[Share]) -> None:
    """Draw the cores of each configuration, stacked by kind of process."""
    figure = new_figure(8, 1 + 0.3 * len(shares), dpi=110)
    axes = figure.subplots()
    names = [f"{share.load}{' + standby' if share.load.standby else ''}" for share in shares]
    left = [0.0] * len(shares)
    for kind, colour in zip(KINDS, _COLOURS, strict=True):
        widths = [share.cores[kind] for share in shares]
        axes.barh(names, widths, left=left, label=kind, color=colour)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("cores")
    axes.set_title("Processor time by kind of process; scenes x features at 30 Hz")
    axes.legend()
    figure.savefig(path)


if __name__ == "__main__":
    run_source(sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
