"""Live jitter and restart time of the whole path, with real processes. Prints; asserts nothing.

    python tests/benchmarks/jitter.py                             # figure 4.4 as three sources
    python tests/benchmarks/jitter.py RECORDING --set method=thesis --set thesis.sigma_switch=0.01

Starts router, three sources and the service under the launcher, measures the intervals of the
updates where a client receives them, then kills the service by SIGKILL and measures how long its
tracks are without a hypothesis of the same id.
"""

import argparse
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import zenoh

from comotion_deploy.demo import RATES, free_endpoint
from comotion_schemas import HypothesisUpdate, Keys, Status, decode_as
from comotion_schemas.transport import SessionSettings, declare_subscriber, open_session

KEYS = Keys()
Arrival = tuple[float, HypothesisUpdate]


def system(arguments: argparse.Namespace, endpoint: str, folder: Path) -> str:
    if arguments.recording is None:
        source, start = "source simulator fig4_4", f"--start-at {time.time() + 4:.0f}"
        rates = [f"--rate {rate}" for rate in RATES]
    else:
        # Its own rate, half of it and a third.
        source, start = f"source replay '{Path(arguments.recording).resolve()}'", "--start-at aligned"
        rates = [""] * len(RATES)
    parts = [
        f'[process.s{k}]\nrun = "{source} {rate} --part {k}/{len(rates)} --name s{k} --loop {start}"'
        for k, rate in enumerate(rates, 1)
    ]
    options = " ".join(f"--set {value}" for value in arguments.set)
    return "\n".join(
        [
            f'connect = ["{endpoint}"]\n[router]\nlisten = ["{endpoint}"]',
            f'[serve]\nstate = "{folder / "state"}"',
            f'[process.router]\nrun = "router"\n[process.serve]\nrun = "serve {options}"',
            *parts,
        ]
    )


class Client:
    """Receives updates with their time of arrival."""

    def __init__(self, session: zenoh.Session) -> None:
        self.updates: queue.SimpleQueue[Arrival] = queue.SimpleQueue()
        self.status: Status | None = None
        self._subscribers = [
            declare_subscriber(session, KEYS.hypotheses, "hypotheses", self._on_update),
            declare_subscriber(session, KEYS.stream("status", "fusion"), "status", self._on_status),
        ]

    def _on_update(self, sample: zenoh.Sample) -> None:
        arrived = time.monotonic()
        self.updates.put((arrived, decode_as(HypothesisUpdate, sample.payload.to_bytes())))

    def _on_status(self, sample: zenoh.Sample) -> None:
        self.status = decode_as(Status, sample.payload.to_bytes())

    def collect(self, seconds: float) -> list[Arrival]:
        arrivals, end = [], time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            try:
                arrivals.append(self.updates.get(timeout=left))
            except queue.Empty:
                break
        return arrivals


def labels(update: HypothesisUpdate) -> dict[tuple[str, str, int], int]:
    sources = [(source.name, source.session) for source in update.sources]
    rows = zip(update.track_source, update.track_id, update.track_hypothesis, strict=True)
    return {(*sources[source], int(track)): int(label) for source, track, label in rows}


def show_intervals(name: str, times_ms: np.ndarray, period_ms: float) -> None:
    intervals = np.diff(times_ms)
    deviation = np.abs(intervals - period_ms)
    print(
        f"{name:<10} {len(intervals)} intervals  p50 {np.median(intervals):.2f} ms  "
        f"p1 {np.percentile(intervals, 1):.2f}  p99 {np.percentile(intervals, 99):.2f}  "
        f"max {intervals.max():.2f}   jitter |interval - period| p50 {np.median(deviation):.2f}  "
        f"p99 {np.percentile(deviation, 99):.2f} ms"
    )


def measure_intervals(client: Client, seconds: float) -> None:
    arrivals = client.collect(seconds)
    updates = [update for _, update in arrivals]
    period_ms = updates[0].period_ns / 1e6
    show_intervals("published", np.array([u.published_ns for u in updates]) / 1e6, period_ms)
    show_intervals("received", 1e3 * np.array([t for t, _ in arrivals]), period_ms)
    ages = np.array([u.published_ns - u.stamp_ns for u in updates]) / 1e6
    missing = updates[-1].seq - updates[0].seq + 1 - len(updates)
    print(
        f"age of the data at publication p50 {np.median(ages):.1f} ms, p99 {np.percentile(ages, 99):.1f} ms; "
        f"{missing} updates missing; {np.mean([len(u.track_id) for u in updates]):.0f} tracks, "
        f"{np.mean([len(u.hypotheses) for u in updates]):.1f} hypotheses"
    )
    if client.status is not None:
        print(f"service: {client.status.state}, {client.status.message}; {client.status.counters}")


def measure_restart(client: Client, pid: int) -> None:
    _, before = client.collect(0.5)[-1]
    killed = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    while True:
        arrived, update = client.updates.get(timeout=60)
        if update.session == before.session:
            continue
        now, then = labels(update), labels(before)
        common = sorted(set(now) & set(then))
        if common:
            same = sum(now[key] == then[key] for key in common)
            print(
                f"service killed: updates again after {arrived - killed:.2f} s, "
                f"{same} of {len(common)} tracks that are still there keep their hypothesis id"
            )
            return


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("recording", nargs="?")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--seconds", type=float, default=30.0)
    arguments = parser.parse_args()
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "system.toml"
        file.write_text(system(arguments, endpoint, Path(name)))
        launcher = subprocess.Popen(
            [sys.executable, "-m", "comotion_deploy", "up", str(file)],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            run(launcher, endpoint, arguments.seconds)
        finally:
            launcher.terminate()
            launcher.wait()


def run(launcher: subprocess.Popen[str], endpoint: str, seconds: float) -> None:
    assert launcher.stdout is not None
    lines: list[str] = []
    for line in launcher.stdout:
        lines.append(line)
        if "all processes are ready" in line:
            break
    else:
        sys.exit("".join(lines))
    # Nobody reads on: keep the pipe from filling up.
    threading.Thread(target=launcher.stdout.read, daemon=True).start()
    match = re.search(r"started serve, pid (\d+)", "".join(lines))
    assert match is not None
    with open_session(SessionSettings(connect=(endpoint,))) as session:
        client = Client(session)
        while not len(client.updates.get(timeout=60)[1].track_id):
            pass
        client.collect(2.0)
        measure_intervals(client, seconds)
        measure_restart(client, int(match[1]))


if __name__ == "__main__":
    main()
