"""A real etcd server, and links that a test can cut: nothing passes and neither side is told."""

import shutil
import signal
import socket
import socketserver
import threading
from contextlib import suppress
from urllib.parse import urlsplit

import pytest

from comotion.runtime.standby.etcd import Etcd, EtcdUnavailableError
from comotion_deploy.demo import free_endpoint

from .waiting import until

NEEDS_ETCD = pytest.mark.skipif(shutil.which("etcd") is None, reason="etcd-server is not installed")


class EtcdServer:
    """A cluster of one as a process, which can be paused."""

    def __init__(self, start, folder):
        url, peer = (free_endpoint().replace("tcp/", "http://") for _ in range(2))
        self.urls = [url]
        self._process = start.any(
            *(
                f"etcd --name m --listen-client-urls {url} --advertise-client-urls {url} --logger zap"
                f" --listen-peer-urls {peer} --initial-advertise-peer-urls {peer} --initial-cluster m={peer}"
                f" --log-level error --data-dir {folder / 'etcd'}"
            ).split()
        )
        until(self._answers)

    def _answers(self):
        try:
            Etcd(self.urls).put("ready", b"")
        except EtcdUnavailableError:
            return False
        return True

    def pause(self):
        self._process.signal(signal.SIGSTOP)

    def go_on(self):
        self._process.signal(signal.SIGCONT)


_HERE = "127.0.0.1"


class Wire(socketserver.ThreadingTCPServer):
    """Carries TCP while it is whole; what was sent before or during a cut arrives after it.

    Parameters
    ----------
    target
        ``tcp/127.0.0.1:PORT`` or ``http://127.0.0.1:PORT``; :attr:`endpoint` has the same form.
    """

    daemon_threads = True

    def __init__(self, target):
        super().__init__((_HERE, 0), None)
        self._whole = threading.Event()
        self.mend, self.cut = self._whole.set, self._whole.clear
        self._port = urlsplit(target.replace("tcp/", "tcp://")).port
        self.endpoint = target.replace(str(self._port), str(self.server_address[1]))
        self.mend()
        threading.Thread(target=self.serve_forever, daemon=True).start()

    def __exit__(self, *exception):
        self.mend()
        self.shutdown()
        self.server_close()

    def finish_request(self, request, client_address):
        """Carry one connection, both ways."""
        self._whole.wait()
        with suppress(OSError), socket.create_connection((_HERE, self._port)) as other:
            back = threading.Thread(target=self._pass, args=(other, request), daemon=True)
            back.start()
            self._pass(request, other)
            back.join()

    def _pass(self, source, sink):
        with suppress(OSError):
            while data := source.recv(65536):
                self._whole.wait()
                sink.sendall(data)
        with suppress(OSError):
            sink.shutdown(socket.SHUT_RDWR)
