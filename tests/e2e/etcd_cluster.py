"""Real etcd servers on free loopback ports, for tests."""

import shutil
import signal
import subprocess
from urllib.parse import urlsplit

import pytest

from comotion.runtime.standby import Etcd, EtcdUnavailableError

from .network import free_endpoints
from .tracker import until

NEEDS_ETCD = pytest.mark.skipif(shutil.which("etcd") is None, reason="etcd-server is not installed")


class EtcdCluster:
    """Members of a cluster as processes; `kill`, `pause` and `go_on` take the number of one."""

    def __init__(self, folder, members=1):
        self._folder = folder
        urls = [endpoint.replace("tcp/", "http://") for endpoint in free_endpoints(2 * members)]
        self.urls, self._peers = urls[:members], urls[members:]
        self.processes = [self._start(k) for k in range(members)]

    def __enter__(self):
        try:
            self.wait()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *exception):
        self.close()

    def wait(self):
        """Wait until the cluster has a leader: it answers a write."""
        until(self._answers)

    def _answers(self):
        try:
            Etcd(self.urls).put("ready", b"")
        except EtcdUnavailableError:
            return False
        return True

    def leader(self):
        """The number of the member that leads."""
        from etcd3gw import client  # the extra `cluster`

        for k, url in enumerate(self.urls):
            status = client(host="127.0.0.1", port=urlsplit(url).port).status()
            if status["leader"] == status["header"]["member_id"]:
                return k
        raise AssertionError("no member leads")

    def kill(self, member):
        self.processes[member].kill()
        self.processes[member].wait()

    def pause(self):
        for process in self.processes:
            process.send_signal(signal.SIGSTOP)

    def go_on(self):
        for process in self.processes:
            process.send_signal(signal.SIGCONT)

    def close(self):
        for process in self.processes:
            process.kill()
            process.wait()

    def _start(self, k):
        cluster = ",".join(f"m{i}={peer}" for i, peer in enumerate(self._peers))
        arguments = {
            "--name": f"m{k}",
            "--data-dir": str(self._folder / f"m{k}"),
            "--listen-client-urls": self.urls[k],
            "--advertise-client-urls": self.urls[k],
            "--listen-peer-urls": self._peers[k],
            "--initial-advertise-peer-urls": self._peers[k],
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
