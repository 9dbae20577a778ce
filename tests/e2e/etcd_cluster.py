"""Real etcd servers on free loopback ports, for tests."""

import shutil
import signal
import socket
import subprocess
from pathlib import Path
from typing import Self

import pytest

from comotion.runtime.standby import Etcd, EtcdUnavailableError

NEEDS_ETCD = pytest.mark.skipif(shutil.which("etcd") is None, reason="etcd-server is not installed")


def _free_ports(count: int) -> list[int]:
    probes = [socket.socket() for _ in range(count)]
    for probe in probes:
        probe.bind(("127.0.0.1", 0))
    ports = [int(probe.getsockname()[1]) for probe in probes]
    for probe in probes:
        probe.close()
    return ports


class EtcdCluster:
    """Members of a cluster as processes; `kill`, `pause` and `go_on` take the number of one."""

    def __init__(self, folder: Path, members: int = 1) -> None:
        self._folder = folder
        ports = _free_ports(2 * members)
        self._clients, self._peers = ports[:members], ports[members:]
        self.urls = [f"http://127.0.0.1:{port}" for port in self._clients]
        self.processes = [self._start(k) for k in range(members)]

    def __enter__(self) -> Self:
        try:
            self.wait()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def wait(self) -> None:
        """Wait until the cluster has a leader: it answers a write."""
        for _ in range(200):
            try:
                Etcd(self.urls).put("ready", b"")
            except EtcdUnavailableError:
                # Each try waits for the ports itself, or for the election.
                _wait_for_port(self._clients[0])
            else:
                return
        raise TimeoutError("etcd does not answer")

    def leader(self) -> int:
        """The number of the member that leads."""
        from etcd3gw import client  # the extra `cluster`

        for k, port in enumerate(self._clients):
            status = client(host="127.0.0.1", port=port).status()
            if status["leader"] == status["header"]["member_id"]:
                return k
        raise AssertionError("no member leads")

    def kill(self, member: int) -> None:
        self.processes[member].kill()
        self.processes[member].wait()

    def restart(self, member: int) -> None:
        self.processes[member] = self._start(member)

    def pause(self) -> None:
        for process in self.processes:
            process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        for process in self.processes:
            process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()

    def _start(self, k: int) -> subprocess.Popen[bytes]:
        peers = [f"http://127.0.0.1:{port}" for port in self._peers]
        cluster = ",".join(f"m{i}={peer}" for i, peer in enumerate(peers))
        arguments = {
            "--name": f"m{k}",
            "--data-dir": str(self._folder / f"m{k}"),
            "--listen-client-urls": self.urls[k],
            "--advertise-client-urls": self.urls[k],
            "--listen-peer-urls": peers[k],
            "--initial-advertise-peer-urls": peers[k],
            "--initial-cluster": cluster,
            "--logger": "zap",
            "--log-level": "error",
        }
        with (self._folder / f"m{k}.log").open("ab") as log:
            return subprocess.Popen(
                ["etcd", *(part for pair in arguments.items() for part in pair)],
                stdout=log,
                stderr=log,
            )


def _wait_for_port(port: int) -> None:
    """Wait a moment for a port to accept; a refused connection returns at once and says nothing."""
    import time

    with socket.socket() as probe:
        probe.settimeout(0.2)
        if probe.connect_ex(("127.0.0.1", port)) != 0:
            time.sleep(0.05)  # there is no event to wait for before the port is open
