"""Latency of a well-behaved source beside one that floods a secure router at 100 times its rate.

``python tests/benchmarks/flood.py [RUNS]`` prints, run by run, the latency of a source of 30 Hz alone and
beside the flood, and how much of the flood has passed.
"""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import zenoh

from comotion_deploy.demo import free_endpoint
from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.grants import Grant
from comotion_schemas import Keys
from comotion_schemas.tls import load_tls
from comotion_schemas.transport import SessionSettings, connect

RATE, FLOOD_RATE, LIMIT = 30, 3000, 60.0
SECONDS = 10.0
PAYLOAD = b"x" * 2000
KEYS = Keys()


def log_in(folder: Path, name: str, endpoint: str) -> zenoh.Session:
    return connect(SessionSettings(connect=(endpoint,), tls=load_tls(folder / name)), timeout=30)


def publish(session: zenoh.Session, name: str, rate: int, seconds: float) -> int:
    """Publish at a rate, each message with the time it is sent; returns how many."""
    drop = zenoh.CongestionControl.DROP
    publisher = session.declare_publisher(KEYS.stream("obs", name), congestion_control=drop)
    began, sent = time.monotonic(), 0
    while (elapsed := time.monotonic() - began) < seconds:
        while sent < elapsed * rate:
            publisher.put(time.time_ns().to_bytes(8, "little") + PAYLOAD)
            sent += 1
        time.sleep(min(1 / rate, 0.001))
    return sent


class Listener:
    """Latencies, in ms, of the messages of a source."""

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self.latencies: list[float] = []
        self._subscriber = session.declare_subscriber(KEYS.stream("obs", name), self._receive)

    def _receive(self, sample: zenoh.Sample) -> None:
        sent_ns = int.from_bytes(sample.payload.to_bytes()[:8], "little")
        self.latencies.append((time.time_ns() - sent_ns) / 1e6)

    def take(self) -> np.ndarray:
        time.sleep(0.5)
        taken, self.latencies = np.array(self.latencies), []
        return taken


def line(what: str, sent: int, latencies: np.ndarray) -> str:
    median, p99, largest = np.percentile(latencies, (50, 99, 100))
    times = f"{median:.2f} ms median, {p99:.2f} p99, {largest:.1f} max"
    return f"{what}: {sent} sent, {len(latencies)} arrived, {times}"


def measure(folder: Path, endpoint: str, runs: int) -> None:
    with log_in(folder, "fusion", endpoint) as service, log_in(folder, "good", endpoint) as good:
        listener, flooded = Listener(service, "good"), Listener(service, "bad")
        for _ in range(runs):
            print(line("alone", publish(good, "good", RATE, SECONDS), listener.take()))
            # A process of its own: in this one it would take the interpreter from the others.
            command = [sys.executable, __file__, "flood", str(folder), endpoint]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as flood:
                assert flood.stdout is not None
                flood.stdout.readline()
                print(line("flood", publish(good, "good", RATE, SECONDS), listener.take()))
                sent = int(flood.communicate()[0])
            print(f"  of the flood: {sent} sent, {len(flooded.take())} arrived")


def flood(folder: Path, endpoint: str) -> None:
    with log_in(folder, "bad", endpoint) as session:
        print("begins", flush=True)
        print(publish(session, "bad", FLOOD_RATE, SECONDS + 1))


def main(runs: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "pki"
        authority = Authority.create(folder)
        roles = {"hall": "router", "good": "source", "bad": "source", "fusion": "service"}
        for component, role in roles.items():
            sources = (component,) if role == "source" else ()
            grant = Grant(role=role, name=component, common_name="new", sources=sources, rate=LIMIT)
            authority.issue(grant, hosts=("localhost", "127.0.0.1") if role == "router" else ())
        endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")
        listen = endpoint.replace("localhost", "127.0.0.1")
        command = [
            sys.executable,
            "-m",
            "comotion_deploy",
            "router",
            "--secure",
            str(folder),
            "--listen",
            listen,
        ]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as router:
            assert router.stdout is not None
            router.stdout.readline()
            try:
                measure(folder, endpoint, runs)
            finally:
                router.terminate()


if __name__ == "__main__":
    if sys.argv[1:2] == ["flood"]:
        flood(Path(sys.argv[2]), sys.argv[3])
    else:
        main(int(sys.argv[1]) if sys.argv[1:] else 3)
