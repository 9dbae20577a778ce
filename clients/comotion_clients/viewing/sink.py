"""Shows what is drawn in a window, on a web page or in a file, by Rerun. Needs the extra `view`."""

import contextlib
import math
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.parse
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
import rerun as rr
import rerun_cli

from comotion_schemas.transport import LOOPBACK, free_port

from .blueprint import TIMELINE, blueprint, prepare
from .drawing import Layout, Moment

_STOP_S = 2.0


class Program:
    """Runs the program of the package with arguments until :meth:`close`."""

    def __init__(self, *arguments: str) -> None:
        program = Path(rerun_cli.__file__).with_name("rerun.exe" if sys.platform == "win32" else "rerun")
        # As rerun.spawn does: no dialogue at the first start.
        environment = {"RUST_LOG": "error", **os.environ, "RERUN_APP_ONLY": "true"}
        self._output = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115
        self._process = subprocess.Popen(  # noqa: S603 - the viewer of the package
            [str(program), *arguments],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=self._output,
        )

    @property
    def ended(self) -> bool:
        """Whether it has ended.

        Raises
        ------
        OSError
            If it has failed; one line that says why.
        """
        status = self._process.poll()
        if status:
            self._output.seek(0)
            lines = [line.strip() for line in self._output if line.strip()]
            message = next((line for line in lines if "panicked" in line or "rror" in line), "")
            raise OSError(f"the viewer has failed (status {status}): {message or ' '.join(lines)[-200:]}")
        return status is not None

    def close(self) -> None:
        """Stop it."""
        if self._process.poll() is None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_STOP_S)
            self._process.kill()
            self._process.wait()
        self._output.close()


_FLUSH_S = 1.0  # longest wait for delivery
_FILE_TICK_S = 1.0  # rows of this time form a chunk of a file
_PAGE_S = 30.0  # longest wait until the page is served
_POLL_S = 0.05
_CHECK_S = 0.2  # between two checks whether the window is closed


@dataclass(kw_only=True, eq=False)
class RerunSink:
    """Shows moments by Rerun; a context manager. Several outputs may be combined.

    Raises
    ------
    OSError
        If a port is in use, the file exists or cannot be written, or the window does not open.
    """

    window: bool = False  # a window on this machine
    web_port: int | None = None  # port of a web page, and `data_port` of its data; both on this machine
    data_port: int = 9876
    open_browser: bool = False  # open the page in the browser
    file: Path | None = None  # path of a new ``.rrd`` file
    memory: str = "1GiB"  # memory for the history in the data server, and memory limit of the window
    url: str | None = field(default=None, init=False)  # address of the page

    def __post_init__(self) -> None:
        self._layout: Layout | None = None
        self._styled: set[str] = set()
        self._program: Program | None = None
        self._live = self.window or self.web_port is not None
        # Large chunks make a file smaller; a live view needs low latency instead.
        live, slow = rr.ChunkBatcherConfig.LOW_LATENCY(), rr.ChunkBatcherConfig(flush_tick=_FILE_TICK_S)
        self._recording = rr.RecordingStream(
            "comotion", batcher_config=live if self._live else slow, send_properties=False
        )

    def __enter__(self) -> Self:
        sinks: list[Any] = []
        if self.file is not None:
            self.file.open("xb").close()  # Rerun would overwrite one that exists
            sinks.append(rr.FileSink(str(self.file)))
        if self._live:
            port = self.data_port if self.web_port is not None else free_port()
            require_free(port)
            server = rr.GrpcServerSink(LOOPBACK, port, server_memory_limit=self.memory)
            sinks.append(server)
        self._recording.set_sinks(*sinks)
        self.arrange(Layout())
        if self.web_port is not None:
            self._serve_page(self.web_port, server.uri)
        if self.window:
            window = ("--connect", server.uri, "--memory-limit", self.memory, "--hide-welcome-screen")
            self._program = Program(*window, "--bind", LOOPBACK)
        return self

    def __exit__(self, *exception: object) -> None:
        if self._program is not None:
            self._program.close()
        with contextlib.suppress(Exception):  # the viewer may have gone
            self._recording.flush(timeout_sec=_FLUSH_S)
        self._recording.disconnect()

    @property
    def closed(self) -> bool:
        """Whether the window was closed.

        Raises
        ------
        OSError
            If the window could not be opened, or it or the server of the page has crashed.
        """
        return self._program is not None and self._program.ended

    def wait(self, stop: threading.Event, duration: float | None = None) -> None:
        """Wait until `stop` is set, `duration` (s) is over, or the window is closed."""
        end = math.inf if duration is None else time.monotonic() + duration
        while not self.closed and time.monotonic() < end and not stop.wait(_CHECK_S):
            pass

    def arrange(self, layout: Layout) -> None:
        """Arrange the views if the layout has changed; else the user's arrangement remains."""
        if layout == self._layout:
            return
        self._layout = layout
        prepare(self._recording, layout)
        self._recording.send_blueprint(blueprint(layout), make_active=True, make_default=True)

    def show(self, moments: Iterable[Moment]) -> None:
        """Send moments, and wait until they are delivered."""
        for moment in moments:
            self._recording.set_time(TIMELINE, timestamp=np.datetime64(moment.stamp_ns, "ns"))
            for shape in moment.shapes:
                if shape.style is not None and shape.path not in self._styled:
                    self._styled.add(shape.path)
                    self._recording.log(shape.path, shape.style, static=True)
                self._recording.log(shape.path, *shape.drawn)
        if self._live:
            self._recording.flush(timeout_sec=_FLUSH_S)

    def _serve_page(self, port: int, data_uri: str) -> None:
        require_free(port)
        # A process of its own: the server inside the SDK listens on every interface.
        self._program = Program("--serve-web", data_uri, "--bind", LOOPBACK, "--web-viewer-port", str(port))
        try:
            self._wait_for_page(port)
        except OSError:
            self.__exit__()
            raise
        data = urllib.parse.quote(data_uri, safe="")
        self.url = f"http://{LOOPBACK}:{port}/?url={data}&theme=dark&hide_welcome_screen"
        if self.open_browser:
            import webbrowser

            webbrowser.open(self.url)

    def _wait_for_page(self, port: int) -> None:
        deadline = time.monotonic() + _PAGE_S
        while not self.closed:
            with contextlib.suppress(ConnectionRefusedError), socket.create_connection((LOOPBACK, port), 1.0):
                return
            if time.monotonic() > deadline:
                raise OSError(f"the page does not answer at port {port}")
            time.sleep(_POLL_S)


def require_free(port: int) -> None:
    """Check that a port is free: Rerun's data server reports no error if it is not.

    Raises
    ------
    OSError
        If the port is in use.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise OSError(
                f"port {port} cannot be used: {error.strerror}; --port and --data-port choose others"
            ) from None
