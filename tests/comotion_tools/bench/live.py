"""End-to-end latency over a router: this process compares the stamps of updates with the time of receipt.

:func:`run_live` runs router, service, and sources as processes::

    python -m comotion_tools.bench.live ENDPOINT FEATURES START SECONDS INDEX
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from comotion_deploy.demo import free_endpoint
from comotion_deploy.processes import PYTHON
from comotion_experiments.inputs import Arrived
from comotion_experiments.stress.observe import EPOCH_NS
from comotion_schemas import HypothesisUpdate, Status
from comotion_schemas.transport import SessionSettings
from comotion_sources.runtime import SourcePublisher

from ..processes import COMOTION, Managed
from ..system import UP_S, System
from .core import SceneSpec, messages

SCENE = "bench"
SOURCES = 3
RATE = 30.0
COUNTERS = ("updates", "overruns", "late", "lost", "batches")
_LEAD_S = 10.0  # until the sources start: all processes are then ready


def run_live(features: int, seconds: float, fusion: Sequence[str], settle: float) -> dict[str, Any]:
    """Run the complete system and measure it, from `settle` s after the first track on: the window is full.

    `fusion` are options of ``comotion serve``. In the result ``last_batch_ms`` is from the stamp of the last
    batch in an update to receipt of the update, as median, 99th percentile and largest in ms; ``cpu_share``
    is the processor time of the service as a share of one core; ``counters`` is the growth of its own.
    """
    endpoint, start = free_endpoint(), time.time() + _LEAD_S
    with TemporaryDirectory(prefix="comotion-bench-") as name:
        folder = Path(name)
        at = ("--connect", endpoint, "--scene", SCENE)
        longest = UP_S + settle + seconds
        source = (*PYTHON, __name__, endpoint, str(features), f"{start:.3f}", f"{longest:g}")
        commands = {
            "router": (*COMOTION, "router", "--listen", endpoint),
            "service": (*COMOTION, "serve", "--no-state", *fusion, *at),
            **{f"s{k}": (*source, str(k)) for k in range(SOURCES)},
        }
        processes = {name: Managed(name, command, folder) for name, command in commands.items()}
        with System(processes, SCENE, SessionSettings(connect=(endpoint,))) as system:
            return _watch(system, seconds, settle)


def _watch(system: System, seconds: float, settle: float) -> dict[str, Any]:
    """Start all and log what arrives for `seconds`, starting `settle` seconds after the first track."""
    updates, statuses = system.subscribe(HypothesisUpdate), system.subscribe(Status)
    service = system.processes["service"]
    system.start("service", *(f"s{k}" for k in range(SOURCES)))
    system.until(lambda: any(len(update.track_id) for _, update in updates.drain()))
    system.wait(settle)
    updates.drain()
    before, cpu_s, began = _counters(statuses.drain()), service.processor_s(), time.monotonic()
    rows: list[tuple[float, int]] = []
    for update in updates:
        rows.append(((time.time_ns() - update.stamp_ns) * 1e-6, len(update.track_id)))
        if time.monotonic() > began + seconds:
            break
    took, after = time.monotonic() - began, _counters(statuses.drain())
    ages, tracks = np.array(rows).T
    return {
        "last_batch_ms": [*np.percentile(ages, (50, 99, 100)).tolist()],
        "seconds": took,
        "updates": len(rows),
        "tracks": int(np.median(tracks)),
        "cpu_share": (service.processor_s() - cpu_s) / took,
        "memory_mb": service.most_mb(),
        "counters": {name: after[name] - before[name] for name in COUNTERS},
    }


def run_source(endpoint: str, features: int, start: float, seconds: float, index: int) -> None:
    """Publish one source of the scene in real time until stopped.

    The acquisition time is the time at which a batch is due, also if its put is delayed.
    """
    spec, start_ns = SceneSpec(features=features, sources=SOURCES, rate=RATE), round(start * 1e9)
    given = messages(spec, seconds, [index])
    publisher = SourcePublisher(
        f"s{index}", space="world", unit="m", dim=3, scene=SCENE, connect=endpoint, rate=RATE
    )
    with publisher as live:
        live.ready()
        for arrived in (message for message in given if isinstance(message, Arrived)):
            batch, now_ns = arrived.batch, arrived.now_ns - EPOCH_NS + start_ns
            if live.stop.wait(max(0.0, now_ns * 1e-9 - time.time())):
                break
            live.observe(ids=batch.ids, positions=batch.positions, stamp_ns=now_ns, ended=batch.ended)


def _counters(statuses: list[tuple[float, Status]]) -> dict[str, int]:
    last = next((status.counters for _, status in reversed(statuses) if status.role == "service"), {})
    return {name: last.get(name, 0) for name in COUNTERS}


if __name__ == "__main__":
    endpoint, features, start, seconds, index = sys.argv[1:]
    run_source(endpoint, int(features), float(start), float(seconds), int(index))
