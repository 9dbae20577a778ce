"""Processor time of many scenes side by side: what services, standbys, router and sources take.

One source process a scene, see :mod:`comotion_deploy.bench_scaling`::

    python -m comotion_experiments.bench.scaling ENDPOINT SCENE FEATURES
"""

import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

from comotion_schemas.transport import SessionSettings
from comotion_sources.runtime import SourcePublisher

from .live import processor_seconds
from .scene import Scene, SceneSpec

RATE = 30.0
KINDS = ("service", "standby", "router", "source")


@dataclass(frozen=True)
class Load:
    """A configuration: scenes, features of each, and whether each scene has a standby."""

    scenes: int
    features: int
    standby: bool = False


@dataclass(frozen=True)
class Share:
    """What a configuration took.

    Attributes
    ----------
    cores
        Processor time by kind of process, in cores.
    updates, overruns
        Of all active services together, over `seconds`.
    latency_ms
        Median and 99th percentile of the time from the watermark of an update to its receipt, ms.
    """

    load: Load
    seconds: float
    cores: dict[str, float]
    updates: int
    overruns: int
    latency_ms: tuple[float, float]

    @property
    def total(self) -> float:
        """Cores of all processes."""
        return sum(self.cores.values())


def run_source(endpoint: str, scene: str, features: int) -> None:
    """Publish one scene in real time until stopped."""
    spec = SceneSpec(features=features, sources=1, rate=RATE)
    publisher = SourcePublisher(
        "s0", space="world", unit="m", dim=3, scene=scene, settings=SessionSettings(connect=(endpoint,)),
        ready_file=Path(os.environ["COMOTION_READY_FILE"]), rate=RATE,
    )  # fmt: skip
    with publisher as source:
        source.ready()
        for batch in Scene(spec, time.time_ns()).frames(0):
            if source.stop.wait(max(0.0, batch.stamp_ns * 1e-9 - time.time())):
                break
            source.observe(
                ids=batch.ids, positions=batch.positions, stamp_ns=batch.stamp_ns, ended=batch.ended
            )


def seconds_of(pids: dict[str, list[int]]) -> dict[str, float]:
    """Processor seconds so far, by kind of process."""
    return {kind: sum(map(processor_seconds, pids.get(kind, ()))) for kind in KINDS}


def markdown(shares: Sequence[Share]) -> str:
    """A table with one row a configuration."""
    lines = [
        "| scenes x features | standby | services | standbys | router | sources | all | "
        "overruns / updates | latency ms, median (p99) |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for share in shares:
        cells = [f"{share.cores[kind]:.2f}" for kind in KINDS]
        middle, p99 = share.latency_ms
        lines.append(
            f"| {share.load.scenes} x {share.load.features} | {'yes' if share.load.standby else 'no'} | "
            + " | ".join(cells)
            + f" | {share.total:.2f} | {share.overruns} / {share.updates} | {middle:.0f} ({p99:.0f}) |"
        )
    return "\n".join(lines)


def save_picture(path: Path, shares: Sequence[Share]) -> None:
    """Draw the cores of each configuration, stacked by kind of process."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(8, 4.5), layout="constrained")
    names = [f"{s.load.scenes} x {s.load.features}{' + standby' if s.load.standby else ''}" for s in shares]
    left = [0.0] * len(shares)
    for kind, colour in zip(KINDS, cycle(("#0072b2", "#56b4e9", "#e69f00", "#999999")), strict=False):
        widths = [share.cores[kind] for share in shares]
        axes.barh(names, widths, left=left, label=kind, color=colour)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("cores")
    axes.set_title("Processor time by kind of process; scenes x features at 30 Hz")
    axes.legend()
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    run_source(sys.argv[1], sys.argv[2], int(sys.argv[3]))
