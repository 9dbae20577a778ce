"""Runs the processes of a system, which start, restart and stop together."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
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
    """The processes of one system."""

    def __init__(
        self, specs: Sequence[ProcessSpec], folder: Path, write: WriteLine, stop: threading.Event
    ) -> None:
        self._log = partial(write, OWN_NAME)
        self._stop = stop
        self._children = [Child(spec, folder, write, self._log) for spec in specs]

    def run(self, duration_s: float | None = None) -> None:
        """Start all processes, the router first, run them until the end, and stop all, the router last."""
        routers, others = (
            [c for c in self._children if c.spec.is_router is first] for first in (True, False)
        )
        try:
            self._begin(routers)
            self._begin(others)
            if not self._stop.is_set():
                self._log("all processes are ready; Ctrl-C stops them")
            if self._wait(lambda: not any(child.is_alive() for child in self._children), duration_s):
                self._log("all processes have ended")
        finally:
            self._end(others)
            self._end(routers)

    def _begin(self, children: Sequence[Child]) -> None:
        """Start processes, and wait until each is ready, or has ended as intended."""

        def late() -> list[str]:
            return [child.name for child in children if child.is_alive() and not child.was_ready]

        for child in children:
            child.start()
        if not self._wait(lambda: not late(), READY_S) and not self._stop.is_set():
            self._log(f"not ready after {READY_S:.0f} s: {', '.join(late())}")

    def _wait(self, over: Callable[[], bool], timeout_s: float | None) -> bool:
        """Wait until something is over; False if the end of the launcher, or of the time, is first."""
        end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
        while not self._stop.is_set() and time.monotonic() < end_s:
            if (wrong := next((child for child in self._children if child.cannot_start), None)) is not None:
                raise UserError(f"{wrong.name} cannot start: {wrong.last_line.removeprefix('error: ')}")
            if over():
                return True
            if any(
                child.spec.foreground and child.ident and not child.is_alive() for child in self._children
            ):
                self._stop.set()
            self._stop.wait(_POLL_S)
        return False

    def _end(self, children: Sequence[Child]) -> None:
        for child in children:
            child.terminate()
        since_s = time.monotonic()
        for child in children:
            if not child.wait(since_s):
                self._log(f"{child.name} did not stop in time and was killed")
