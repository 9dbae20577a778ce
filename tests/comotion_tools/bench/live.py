"""End-to-end latency over a router: sources log their puts, a probe logs the updates it receives.

:func:`run_live` runs router, service, and these as processes::

    python -m comotion_tools.bench.live source ENDPOINT FOLDER INDEX FEATURES START
    python -m comotion_tools.bench.live probe ENDPOINT FOLDER SECONDS SETTLE
"""

import json
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_clients.subscribe import subscribe
from comotion_deploy.demo import free_endpoint
from comotion_deploy.errors import UserError
from comotion_deploy.launcher import launch
from comotion_deploy.processes import PYTHON, ProcessSpec, comotion
from comotion_schemas import Status
from comotion_schemas.errors import KnownError
from comotion_sources.runtime import SourcePublisher

from .scene import Scene, SceneSpec

SCENE = "bench"
SOURCES = 3
RATE = 30.0
COUNTERS = frozenset({"updates", "overruns", "late", "lost", "batches"})
_READY = "COMOTION_READY_FILE"
_RESULT = "live.json"
_LEAD_S = 10.0  # until the sources start: all processes are then ready
_MODULE = "comotion_tools.bench.live"

Stamps = NDArray[np.int64]
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Live:
    """Result of a run; latencies in ms, each as median, 99th percentile and largest.

    Attributes
    ----------
    last_batch
        From the put of the last batch in an update to receipt of the update.
    every_batch
        From the put of every batch to receipt of the first update that includes it.
    cpu_share
        Processor time of the service, as a share of one core.
    counters
        Growth of the counters of the service over the run.
    """

    seconds: float
    updates: int
    tracks: int
    last_batch: tuple[float, float, float]
    every_batch: tuple[float, float, float]
    cpu_share: float
    memory_mb: float
    counters: dict[str, int]


def run_live(features: int, seconds: float, fusion: Sequence[str], settle: float) -> dict[str, Any]:
    """Run the complete system and measure it.

    Parameters
    ----------
    features
        Features of the scene, over all sources.
    seconds
        Duration of the measurement.
    fusion
        Options of ``comotion serve``.
    settle
        Seconds from the first track to the start of the measurement, for the window to fill.

    Raises
    ------
    UserError
        If there is no result; the message has the last lines of the processes.
    """
    endpoint = free_endpoint()
    with TemporaryDirectory(prefix="comotion-bench-") as name:
        folder = Path(name)
        start = time.time() + _LEAD_S
        common = (*PYTHON, _MODULE)
        sources = [
            ProcessSpec(
                name=f"s{k}",
                command=(*common, "source", endpoint, name, str(k), str(features), f"{start:.3f}"),
                restart="never",
            )
            for k in range(SOURCES)
        ]
        probe = (*common, "probe", endpoint, name, f"{seconds:g}", f"{settle:g}")
        launch(
            [
                comotion("router", "router", "--listen", endpoint),
                comotion("serve", "serve", "--no-state", *fusion, "--connect", endpoint, "--scene", SCENE),
                *sources,
                ProcessSpec(name="probe", command=probe, restart="never", foreground=True),
            ],
            log=folder / "log",
        )
        result = folder / _RESULT
        if not result.exists():
            last = " | ".join((folder / "log").read_text(encoding="utf-8").splitlines()[-3:])
            raise UserError(f"no result; last lines: {last}")
        found: dict[str, Any] = json.loads(result.read_text(encoding="utf-8"))
        return found


def live_lines(found: dict[str, Any]) -> list[str]:
    """Format the result as text."""
    seconds, updates, tracks = found["seconds"], found["updates"], found["tracks"]

    def spread(name: str) -> str:
        middle, p99, largest = found[name]
        return f"median {middle:.1f} ms, p99 {p99:.1f} ms, largest {largest:.1f} ms"

    counters = ", ".join(f"{value} {name}" for name, value in found["counters"].items())
    return [
        f"{tracks} tracks from three source processes, {updates} updates in {seconds:.0f} s",
        f"service: {counters}; {100 * found['cpu_share']:.0f} % of a core, {found['memory_mb']:.0f} MB",
        f"put of the last batch in an update to its receipt: {spread('last_batch')}",
        f"put of a batch to receipt of the first update that includes it: {spread('every_batch')}",
    ]


def run_source(endpoint: str, folder: Path, index: int, features: int, start: float) -> None:
    """Publish one source of the scene in real time until stopped, and write (stamp, time of put).

    The acquisition time is the time at which a batch is due, also if its put is delayed.
    """
    scene = Scene(SceneSpec(features=features, sources=SOURCES, rate=RATE), round(start * 1e9))
    log: list[tuple[int, int]] = []
    publisher = SourcePublisher(
        f"s{index}", space="world", unit="m", dim=3, scene=SCENE, connect=endpoint,
        ready_file=Path(os.environ[_READY]), rate=RATE,
    )  # fmt: skip
    with publisher as live:
        live.ready()
        for batch in scene.frames(index):
            if live.stop.wait(max(0.0, batch.stamp_ns * 1e-9 - time.time())):
                break
            live.observe(ids=batch.ids, positions=batch.positions, stamp_ns=batch.stamp_ns, ended=batch.ended)
            log.append((batch.stamp_ns, time.time_ns()))
            if len(log) % round(RATE) == 0:
                _write(folder / f"s{index}.npy", log)
    _write(folder / f"s{index}.npy", log)


def _write(path: Path, log: list[tuple[int, int]]) -> None:
    partial = path.with_suffix(".part.npy")
    np.save(partial, np.array(log, np.int64).reshape(-1, 2))
    partial.replace(path)


def run_probe(endpoint: str, folder: Path, seconds: float, settle: float) -> None:
    """Log updates for `seconds`, starting `settle` seconds after the first track."""
    updates: list[tuple[int, int]] = []
    tracks: list[int] = []
    with (
        subscribe(SCENE, endpoint, message=Status) as statuses,
        subscribe(SCENE, endpoint) as stream,
    ):
        Path(os.environ[_READY]).touch()
        before: dict[str, int] = {}
        began, start = (0.0, 0.0), math.inf
        for update in stream:
            now = time.time()
            if len(update.track_id):
                start = min(start, now + settle)
            if now < start:
                continue
            if not updates:
                pid = _service(endpoint)
                before, began = _counters(statuses.drain()), (now, _processor_seconds(pid))
            updates.append((update.stamp_ns, time.time_ns()))
            tracks.append(len(update.track_id))
            if now > start + seconds:
                break
        took = now - began[0]
        cpu = (_processor_seconds(pid) - began[1]) / took
        after = _counters(statuses.drain())
    time.sleep(1.5)
    puts = np.concatenate([np.load(folder / f"s{k}.npy") for k in range(SOURCES)])
    last, every = latencies(np.array(updates), puts)
    live = Live(
        took,
        len(updates),
        int(np.median(tracks)),
        _spread(last),
        _spread(every),
        cpu,
        _memory_mb(pid),
        _grown(before, after),
    )
    (folder / _RESULT).write_text(json.dumps(asdict(live)))


def latencies(updates: Stamps, puts: Stamps) -> tuple[Floats, Floats]:
    """Compute the latency of updates and of batches in ms.

    Parameters
    ----------
    updates
        int64 [n, 2]: watermark and time of receipt, ns, in order.
    puts
        int64 [m, 2]: stamp and time of the put of every batch, ns.

    Returns
    -------
    last
        float64 [n]: since the latest put of the batches in an update.
    every
        float64 [k]: from a put to the first update that includes the batch, for covered batches.
    """
    puts = puts[np.argsort(puts[:, 0])]
    held = np.searchsorted(puts[:, 0], updates[:, 0], side="right")
    latest = np.maximum.accumulate(puts[:, 1])
    last = (updates[:, 1] - latest[np.maximum(held - 1, 0)]) * 1e-6
    first = np.searchsorted(updates[:, 0], puts[:, 0], side="left")
    covered = (first > 0) & (first < len(updates))
    every = (updates[first[covered], 1] - puts[covered, 1]) * 1e-6
    return last.astype(np.float64), every.astype(np.float64)


def _spread(values: Floats) -> tuple[float, float, float]:
    return float(np.median(values)), float(np.percentile(values, 99)), float(values.max())


def _counters(statuses: list[tuple[float, Status]]) -> dict[str, int]:
    return next((dict(s.counters) for _, s in reversed(statuses) if s.role == "service"), {})


def _grown(before: dict[str, int], after: dict[str, int]) -> dict[str, int]:
    return {name: count - before.get(name, 0) for name, count in after.items() if name in COUNTERS}


def _service(endpoint: str) -> int:
    """Find the process id of the service that is connected to an endpoint."""
    for command in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = command.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if words[1:4] == ["-m", "comotion_deploy", "serve"] and endpoint in words:
            return int(command.parent.name)
    raise KnownError("the service has ended, or this system has no /proc")


def _processor_seconds(pid: int) -> float:
    """Processor time of a process so far, s; its threads included."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(pid: int) -> float:
    for line in Path(f"/proc/{pid}/status").read_text(encoding="utf-8").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024 / 1e6
    return 0.0


if __name__ == "__main__":
    what, endpoint, folder, *numbers = sys.argv[1:]
    if what == "source":
        run_source(endpoint, Path(folder), int(numbers[0]), int(numbers[1]), float(numbers[2]))
    else:
        run_probe(endpoint, Path(folder), float(numbers[0]), float(numbers[1]))
