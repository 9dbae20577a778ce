"""What a client notices when a secure router restarts in place.

``python tests/benchmarks/restart.py [TIMES]`` runs router, service and a simulated source of 30 Hz as
processes, and adds a component before each restart.
"""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from comotion_clients.subscribe import subscribe
from comotion_deploy.demo import free_endpoint
from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.grants import Grant
from comotion_schemas import HypothesisUpdate, Status

SETTLE_S, WATCH_S = 8.0, 4.0
COMOTION = (sys.executable, "-m", "comotion_deploy")


def start(stack: ExitStack, *words: object) -> subprocess.Popen[str]:
    """Run a command until the end; returns when it is ready."""
    command = [*COMOTION, *map(str, words)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def grant(role: str, name: str) -> Grant:
    return Grant(role=role, name=name, common_name="new", sources=(name,) if role == "source" else ())


def lost(endpoint: str, tls: Path) -> int:
    with subscribe("default", endpoint, tls=tls, message=Status, timeout=30) as statuses:
        return next(s.counters["lost"] for s in statuses if s.role == "service")


def main(times: int) -> None:
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        authority = Authority.create(Path(name) / "pki")
        authority.issue(grant("router", "hall"), hosts=("localhost", "127.0.0.1"))
        for role, component in (("source", "cam"), ("service", "fusion"), ("viewer", "laptop")):
            authority.issue(grant(role, component))
        listen = free_endpoint().replace("tcp/", "tls/")
        endpoint, pki = listen.replace("127.0.0.1", "localhost"), authority.folder
        router = start(stack, "router", "--secure", pki, "--listen", listen)
        at = ("--connect", endpoint, "--tls")
        start(stack, "serve", "--no-state", *at, pki / "fusion")
        start(stack, "source", "simulator", "fig4_4", "--rate", 30, "--loop", *at, pki / "cam")
        seen: list[tuple[float, HypothesisUpdate]] = []
        stop = threading.Event()

        def listen_on() -> None:
            with subscribe("default", endpoint, tls=pki / "laptop") as updates:
                for update in updates:
                    seen.append((time.monotonic(), update))
                    if stop.is_set():
                        return

        thread = threading.Thread(target=listen_on)
        thread.start()
        time.sleep(SETTLE_S)
        for number in range(times):
            authority.issue(grant("viewer", f"added-{number}"))
            before = lost(endpoint, pki / "laptop")
            seen.clear()
            time.sleep(1.0)
            os.kill(router.pid, signal.SIGHUP)
            time.sleep(WATCH_S)
            gap = np.diff([at for at, _ in seen]).max()
            missed = sum(np.diff([update.seq for _, update in seen]) - 1)
            tracks = [len(update.track_id) for _, update in seen]
            batches = lost(endpoint, pki / "laptop") - before
            print(
                f"{1e3 * gap:.0f} ms without an update, {missed} updates and {batches} batches lost, ", end=""
            )
            print(f"{min(tracks)} to {max(tracks)} tracks")
        stop.set()
        thread.join()


if __name__ == "__main__":
    main(int(sys.argv[1]) if sys.argv[1:] else 3)
