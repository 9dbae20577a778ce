"""Launcher: process specifications -> running processes, which start, restart and stop together."""

import signal
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from comotion_schemas.component import stop_on_signals

from .child import Child, WriteLine, log_lines
from .errors import UserError
from .processes import ProcessSpec

OWN_NAME = "launcher"
READY_S = 180.0
"""Longest wait until all processes are ready: the first start of the service compiles its kernels."""
_POLL_S = 0.05


def launch(specs: Sequence[ProcessSpec], *, log: Path | None = None, duration_s: float | None = None) -> None:
    """Run the processes until SIGINT, SIGTERM, the end of the foreground process or of `duration_s`.

    Parameters
    ----------
    log
        File for the lines of the processes; None: standard output.

    Raises
    ------
    UserError
        If a process cannot start (exit status 2 before it was ready).
    """
    stop = threading.Event()
    with (
        TemporaryDirectory(prefix="comotion-") as folder,
        log_lines([OWN_NAME, *(spec.name for spec in specs)], log) as write,
        stop_on_signals(stop),
    ):
        Launcher(specs, Path(folder), write, stop).run(duration_s)


class Launcher:
    """The processes of one system, watched from one thread."""

    def __init__(
        self, specs: Sequence[ProcessSpec], folder: Path, write: WriteLine, stop: threading.Event
    ) -> None:
        self._write = write
        self._stop = stop
        self.children = [Child(spec, folder, write) for spec in specs]

        # The router last to stop, and first to start.
        self._stages = [[c for c in self.children if c.spec.is_router is last] for last in (False, True)]

    def run(self, duration_s: float | None = None) -> None:
        """Start all processes, restart failed ones until the end, and stop all."""
        try:
            self._start_all()
            self._watch(None if duration_s is None else time.monotonic() + duration_s)
        finally:
            self._stop_all()

    def _start_all(self) -> None:
        # Start the router first, so that the others need not wait for it.
        for members in reversed(self._stages):
            for child in members:
                self._start(child)
            self._wait_ready(members)
        if not self._stop.is_set():
            self._log("all processes are ready; Ctrl-C stops them")

    def _wait_ready(self, children: list[Child]) -> None:
        deadline = time.monotonic() + READY_S
        while not self._stop.is_set() and not all(child.was_ready for child in children):
            self._check_children()
            if time.monotonic() > deadline:
                late = ", ".join(child.spec.name for child in children if not child.was_ready)
                self._log(f"not ready after {READY_S:.0f} s: {late}")
                return
            self._stop.wait(_POLL_S)

    def _watch(self, end_s: float | None) -> None:
        while not self._stop.is_set() and (end_s is None or time.monotonic() < end_s):
            self._check_children()
            if all(child.pid is None and child.due_s is None for child in self.children):
                self._log("all processes have ended")
                return
            self._stop.wait(_POLL_S)

    def _check_children(self) -> None:
        """Handle ended processes and start those whose restart is due."""
        for child in self.children:
            status = child.poll()
            if status is not None:
                self._on_end(child, status)
            if child.is_due and not self._stop.is_set():
                self._start(child)

    def _start(self, child: Child) -> None:
        child.start()
        self._log(f"started {child.spec.name}, pid {child.pid}")

    def _on_end(self, child: Child, status: int) -> None:
        name = child.spec.name
        if status == 2 and not child.was_ready:
            raise UserError(f"{name} cannot start: {child.last_line.removeprefix('error: ')}")
        if child.due_s is not None:
            delay = child.due_s - time.monotonic()
            self._log(f"{name} has ended ({_reason(status)}); starting it again in {delay:.1f} s")
            return
        child.was_ready = True  # it ended as intended
        self._log(f"{name} has ended ({_reason(status)})")
        if child.spec.foreground:
            self._stop.set()

    def _stop_all(self) -> None:
        for members in self._stages:
            for child in members:
                child.terminate()
            since = time.monotonic()
            for child in members:
                if not child.wait(since):
                    self._log(f"{child.spec.name} did not stop in time and was killed")

    def _log(self, text: str) -> None:
        self._write(OWN_NAME, text)


def _reason(status: int) -> str:
    return f"killed by {signal.Signals(-status).name}" if status < 0 else f"status {status}"
