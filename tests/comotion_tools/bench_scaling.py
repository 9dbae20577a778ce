"""``comotion dev bench --scaling``: many scenes on one machine, with and without standbys."""

import os
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from comotion_clients.subscribe import subscribe
from comotion_clients.subscription import Subscription
from comotion_deploy.child import Child
from comotion_deploy.demo import free_endpoint
from comotion_deploy.errors import UserError
from comotion_deploy.processes import PYTHON, ProcessSpec, comotion
from comotion_experiments.bench.scaling import RATE, Load, Share, busy_seconds, seconds_of
from comotion_schemas import ObservationBatch, Status, encode

# s; the window of the service is then full of tracks.
_SETTLE_S = 12.0
_READY_S = 120.0
_MODULE = "comotion_experiments.bench.scaling"


def run_scaling(
    loads: Sequence[Load], seconds: float, fusion: Sequence[str], progress: Callable[[str], None]
) -> list[Share]:
    """Run each configuration and measure it.

    Parameters
    ----------
    loads
        What to run, one after another.
    seconds
        Duration of each measurement.
    fusion
        Options of ``comotion serve``.
    progress
        Called with a line for each configuration.

    Raises
    ------
    UserError
        If a process does not start, or a configuration needs etcd and there is none.
    """
    found = []
    for load in loads:
        progress(f"{load}{' with standby' if load.standby else ''}")
        with ExitStack() as stack:
            found.append(_run(load, seconds, fusion, stack))
        progress(f"  {found[-1].total:.2f} cores, {found[-1].overruns} overruns")
    return found


def _run(load: Load, seconds: float, fusion: Sequence[str], stack: ExitStack) -> Share:
    folder = Path(stack.enter_context(TemporaryDirectory(prefix="comotion-scaling-")))
    url, etcd = stack.enter_context(_etcd(folder)) if load.standby else ("", [])
    endpoint = free_endpoint()
    children: dict[str, list[Child]] = {}

    def start(kind: str, specs: Sequence[ProcessSpec]) -> None:
        started = [Child(spec, folder, lambda _line: None) for spec in specs]
        children.setdefault(kind, []).extend(started)
        for child in started:
            child.start()
            stack.callback(_stop, child)
        _wait_ready(started)

    scenes = [f"bench-{k}" for k in range(load.scenes)]
    start("router", [comotion("router", "router", "--listen", endpoint)])
    for kind in ("service", *(["standby"] if url else [])):
        replica = ["--standby", "--etcd", url] if url else []
        start(kind, [_serve(scene, kind, endpoint, replica, fusion) for scene in scenes])
    common = (*PYTHON, _MODULE, endpoint)
    size = str(load.features), str(load.bodies)
    start("source", [_source(scene, (*common, scene, *size)) for scene in scenes])
    pids = {kind: [child.pid for child in some if child.pid] for kind, some in children.items()}
    return _measure(load, endpoint, scenes, pids | {"etcd": etcd, "client": [os.getpid()]}, seconds)


def _serve(
    scene: str, kind: str, endpoint: str, replica: Sequence[str], fusion: Sequence[str]
) -> ProcessSpec:
    name = f"{scene}-{kind}"
    words = ["serve", "--no-state", "--connect", endpoint, "--scene", scene, "--name", name]
    return comotion(name, *words, *replica, *fusion, restart="never")


def _source(scene: str, command: tuple[str, ...]) -> ProcessSpec:
    return ProcessSpec(name=f"{scene}-source", command=command, restart="never")


def _measure(
    load: Load, endpoint: str, scenes: Sequence[str], pids: dict[str, list[int]], seconds: float
) -> Share:
    with ExitStack() as stack:
        streams = [stack.enter_context(subscribe(scene, endpoint)) for scene in scenes]
        statuses = [stack.enter_context(subscribe(scene, endpoint, message=Status)) for scene in scenes]
        _drain_for(_SETTLE_S, [*streams, *statuses])
        overruns = _overruns(statuses)
        for stream in streams:
            stream.drain()
        before, busy, began = seconds_of(pids), busy_seconds(), time.monotonic()
        offset = time.time() - began
        ages: list[float] = []
        size = 0
        while time.monotonic() < began + seconds:
            threading.Event().wait(0.2)
            for stream in streams:
                for at, update in stream.drain():
                    ages.append((at + offset) * 1e3 - update.stamp_ns * 1e-6)
                    size = len(encode(update))
        took, after, busy = time.monotonic() - began, seconds_of(pids), busy_seconds() - busy
        grown = _overruns(statuses) - overruns
        batch = next(iter(stack.enter_context(subscribe(scenes[0], endpoint, message=ObservationBatch))))
    cores = {kind: (after[kind] - before[kind]) / took for kind in after}
    spread = (float(np.median(ages)), float(np.percentile(ages, 99))) if ages else (np.nan, np.nan)
    others = max(0.0, busy / took - sum(cores.values()))
    rates = {
        "observations": len(encode(batch)) * RATE,
        "updates": size * len(ages) / took / len(scenes),
    }
    return Share(load, took, cores, others, rates, len(ages), grown, spread)


def _drain_for(seconds: float, streams: Sequence[Subscription[Any]]) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        threading.Event().wait(0.5)
        for stream in streams:
            stream.drain()


def _overruns(statuses: Sequence[Subscription[Any]]) -> int:
    """Overruns of all services that speak, as of their last Status."""
    threading.Event().wait(1.2)
    total = 0
    for stream in statuses:
        mine = [s for _, s in stream.drain() if s.role == "service" and s.replica != "standby"]
        total += mine[-1].counters.get("overruns", 0) if mine else 0
    return total


def _wait_ready(children: Sequence[Child]) -> None:
    end = time.monotonic() + _READY_S
    while not all(child.was_ready for child in children):
        for child in children:
            if child.poll() is not None:
                raise UserError(f"{child.spec.name} has ended: {child.last_line}")
        if time.monotonic() > end:
            raise UserError("the processes are not ready in time")
        threading.Event().wait(0.05)


def _stop(child: Child) -> None:
    child.terminate()
    child.wait(time.monotonic())


@contextmanager
def _etcd(folder: Path) -> Iterator[tuple[str, list[int]]]:
    """An etcd server of one member; its url and process."""
    if shutil.which("etcd") is None:
        raise UserError("standbys need etcd, which is not installed")
    client, peer = (free_endpoint().replace("tcp/", "http://") for _ in range(2))
    words = ["etcd", "--data-dir", str(folder / "etcd"), "--log-level", "error"]
    words += ["--listen-client-urls", client, "--advertise-client-urls", client]
    words += ["--listen-peer-urls", peer, "--initial-advertise-peer-urls", peer]
    words += ["--initial-cluster", f"default={peer}"]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield client, [process.pid]
    finally:
        process.terminate()
        process.wait()
