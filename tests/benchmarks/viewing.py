"""What a viewer costs the service, and how old its picture is. Prints; asserts nothing.

    python tests/benchmarks/viewing.py                  # 1000 features in 10 bodies, 10 Hz
    python tests/benchmarks/viewing.py --display        # also what a headless Rerun window shows

Needs the extra `view`.

Router, service and one source run for all of it; a viewer (page and file at once) comes and goes in
turns of `--seconds`, so that what else the machine does meets both alike. Printed per turn: CPU of
the service per update (from /proc), its lag and interval between updates, and the viewer's own CPU
and the age of the updates when it had handed them over.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np

from comotion_clients.subscribe import subscribe
from comotion_clients.viewing.sink import free_port
from comotion_deploy.demo import free_endpoint
from comotion_schemas.transport import SessionSettings
from comotion_sources.runtime import SourcePublisher

TICKS = os.sysconf("SC_CLK_TCK")


def source(endpoint: str, features: int, bodies: int, rate: float) -> None:
    """Features of bodies that move on circles, 1 mm of noise."""
    rng = np.random.default_rng(0)
    body = np.arange(features) % bodies
    middles = rng.uniform(-2, 2, (bodies, 3))[body] + rng.uniform(-0.2, 0.2, (features, 3))
    speeds = rng.uniform(0.3, 1.0, bodies) * (np.arange(bodies) > 0)
    settings = SessionSettings(connect=(endpoint,))
    ready = Path(os.environ["COMOTION_READY_FILE"])
    with SourcePublisher(
        "bench", space="world", unit="m", dim=3, settings=settings, rate=rate, ready_file=ready
    ) as publisher:
        publisher.ready()
        due = time.monotonic()
        while not publisher.stop.is_set():
            phase = (speeds * time.monotonic())[body]
            circle = 0.3 * np.stack([np.cos(phase), np.sin(phase), 0.3 * np.sin(2 * phase)], axis=1)
            noise = rng.normal(0, 0.001, (features, 3))
            publisher.observe(ids=np.arange(features), positions=middles + circle + noise)
            due = max(due + 1 / rate, time.monotonic())
            publisher.stop.wait(due - time.monotonic())


class Processes:
    """Children that are ready when started, and stopped in the end."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0

    def start(self, *command: object, output: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
        self._count += 1
        ready = self._folder / f"{self._count}.ready"
        child = subprocess.Popen(
            [sys.executable, *map(str, command)],
            env={**os.environ, "COMOTION_READY_FILE": str(ready), "OMP_NUM_THREADS": "1"},
            stdout=output,
            text=True,
        )
        while not ready.exists():
            if child.poll() is not None:
                raise SystemExit(f"{command} has ended")
            time.sleep(0.05)
        return child


def cpu_seconds(pid: int) -> float:
    """User and system time of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def turn(service: subprocess.Popen[str], endpoint: str, seconds: float) -> dict[str, float]:
    """Listen to the updates for a while."""
    lags, arrivals = [], []
    with subscribe(connect=endpoint, timeout=10) as updates:
        updates.get(10)
        before, end = cpu_seconds(service.pid), time.monotonic() + seconds
        while time.monotonic() < end:
            update = updates.get(10)
            arrivals.append(time.monotonic())
            lags.append((update.published_ns - update.stamp_ns) / 1e6)
        used = cpu_seconds(service.pid) - before
    intervals = np.diff(arrivals) * 1e3
    return {
        "cpu ms per update": 1e3 * used / len(lags),
        "lag ms": float(np.median(lags)),
        "lag ms p95": float(np.percentile(lags, 95)),
        "interval ms": float(np.median(intervals)),
        "interval ms p95": float(np.percentile(intervals, 95)),
    }


def viewed(
    arguments: argparse.Namespace,
    processes: Processes,
    service: subprocess.Popen[str],
    endpoint: str,
    folder: Path,
) -> dict[str, float]:
    """One turn with a viewer."""
    file, data_port = folder / f"{time.time_ns()}.rrd", free_port()
    ports = ("--port", free_port(), "--data-port", data_port)
    options = ("--web", "--no-browser", "--save", file, "--json", "--connect", endpoint, *ports)
    viewer = processes.start("-m", "comotion_deploy", "view", *options, output=subprocess.PIPE)
    with ExitStack() as stack:
        seen: list[float] = []
        if arguments.display:
            looked = stack.enter_context(Display(data_port))
            time.sleep(5)
        began, at = cpu_seconds(viewer.pid), time.monotonic()
        found = turn(service, endpoint, arguments.seconds)
        share = (cpu_seconds(viewer.pid) - began) / (time.monotonic() - at)
        if arguments.display:
            seen = looked.ages(10)
    viewer.send_signal(signal.SIGINT)
    result = json.loads(viewer.communicate(timeout=60)[0])
    found |= {f"view age ms {k}": 1e3 * v for k, v in result["age_s"].items()}
    found |= {"view cpu %": 100 * share, "view dropped": result["dropped"], "view lost": result["lost"]}
    found["file kB per update"] = file.stat().st_size / 1e3 / max(result["updates"], 1)
    if seen:
        found |= {"display age ms": float(np.median(seen)), "display age ms max": max(seen)}
    return found


class Display:
    """A headless Rerun window, asked what the newest thing is that it holds."""

    def __init__(self, data_port: int) -> None:
        import rerun_cli

        self._port = free_port()
        program = Path(rerun_cli.__file__).with_name("rerun")
        url = f"rerun+http://127.0.0.1:{data_port}/proxy"
        self._window = subprocess.Popen(
            [program, "--headless", "--port", str(self._port), "--window-size", "1280x720", "--connect", url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._window.kill()
        self._window.wait()

    def ages(self, count: int) -> list[float]:
        """How far the cursor is behind the wall clock, in ms; the lag of the service is in it."""
        from rerun.experimental import ViewerClient

        client = ViewerClient(f"rerun+http://127.0.0.1:{self._port}/proxy")
        found = []
        for _ in range(count):
            (recording,) = client.get_state().recordings
            if recording.current_time is not None:
                found.append((time.time_ns() - recording.current_time) / 1e6)
            time.sleep(0.37)
        return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--features", type=int, default=1000)
    parser.add_argument("--bodies", type=int, default=10)
    parser.add_argument("--rate", type=float, default=10.0, help="of the source, Hz")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE")
    parser.add_argument("--display", action="store_true")
    parser.add_argument("--source", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.source:
        source(arguments.source, arguments.features, arguments.bodies, arguments.rate)
        return
    measure(arguments)


def measure(arguments: argparse.Namespace) -> None:
    endpoint = free_endpoint()
    command = ("-m", "comotion_deploy")
    options = [word for value in arguments.set for word in ("--set", value)]
    scene = ("--features", arguments.features, "--bodies", arguments.bodies, "--rate", arguments.rate)
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        processes = Processes(Path(name))
        children = [processes.start(*command, "router", "--listen", endpoint)]
        stack.callback(lambda: [child.terminate() for child in reversed(children)])
        children.append(service := processes.start(*command, "serve", "--connect", endpoint, *options))
        children.append(processes.start(__file__, "--source", endpoint, *scene))
        turn(service, endpoint, 12.0)  # the window fills
        runs: dict[str, list[dict[str, float]]] = {"without": [], "with": []}
        for k in range(arguments.turns):
            for kind in ("without", "with") if k % 2 == 0 else ("with", "without"):
                if kind == "with":
                    found = viewed(arguments, processes, service, endpoint, Path(name))
                else:
                    found = turn(service, endpoint, arguments.seconds)
                runs[kind].append(found)
                print(kind, "  ".join(f"{key} {value:.1f}" for key, value in found.items()), flush=True)
    print()
    for key in runs["with"][0]:
        columns = [[run[key] for run in runs[kind] if key in run] for kind in ("without", "with")]
        words = [f"{np.median(c):8.1f} ({min(c):.1f} to {max(c):.1f})" if c else "       -" for c in columns]
        print(f"{key:22}  without {words[0]:28}  with {words[1]}")


if __name__ == "__main__":
    main()
