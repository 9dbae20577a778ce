"""A real etcd server on a free loopback port, for tests."""

import shutil
import signal
import subprocess

import pytest

from comotion.runtime.standby import Etcd, EtcdUnavailableError

from .network import free_endpoints
from .tracker import until

NEEDS_ETCD = pytest.mark.skipif(shutil.which("etcd") is None, reason="etcd-server is not installed")


class EtcdServer:
    """A cluster of one as a process, which can be paused; a context manager."""

    def __init__(self, folder):
        url, peer = (endpoint.replace("tcp/", "http://") for endpoint in free_endpoints(2))
        self.urls = [url]
        command = (
            f"etcd --name m --listen-client-urls {url} --advertise-client-urls {url} --logger zap"
            f" --listen-peer-urls {peer} --initial-advertise-peer-urls {peer} --initial-cluster m={peer}"
        ).split()
        with (folder / "etcd.log").open("ab") as log:
            command += ["--log-level", "error", "--data-dir", str(folder / "etcd")]
            self._process = subprocess.Popen(command, stdout=log, stderr=log)

    def __enter__(self):
        try:
            until(self._answers)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *exception):
        self._process.kill()
        self._process.wait()

    def _answers(self):
        try:
            Etcd(self.urls).put("ready", b"")
        except EtcdUnavailableError:
            return False
        return True

    def pause(self):
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self):
        self._process.send_signal(signal.SIGCONT)
