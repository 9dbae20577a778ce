"""Runs the processes of a system, which start and stop together; each may be restarted, with back-off."""

import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from itertools import cycle
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeAlias

from rich.console import Console
from rich.text import Text

from comotion_schemas.component import stop_on_signals

from .errors import UserError
from .processes import ENDS_WITH_PARENT, ProcessSpec

_COLOURS = (
    "bold",
    "cyan",
    "green",
    "yellow",
    "magenta",
    "blue",
    "bright_cyan",
    "bright_green",
    "bright_magenta",
)


WriteLine: TypeAlias = Callable[[str, str], None]
"""Takes the name of a process and a line of it."""


@contextmanager
def log_lines(names: list[str], path: Path | None = None) -> Iterator[WriteLine]:
    """Yield a function that prints prefixed lines, coloured on a terminal, or writes them to a file.

    `names` of processes give width and colour of the prefix; others may write too. The lines go to the file
    `path`, None: to standard output; a file is needed while another process owns the terminal.
    """
    width, lock = max(map(len, names), default=0), threading.Lock()
    styles = dict(zip(names, cycle(_COLOURS), strict=False))
    with nullcontext() if path is None else path.open("w", encoding="utf-8") as file:
        console = Console(file=file, soft_wrap=True, highlight=False)

        def write(name: str, line: str) -> None:
            prefix = Text(f"{name:>{width}} | ", style=styles.get(name, ""))
            with lock:
                console.print(prefix + Text.from_ansi(line))

        yield write


FIRST_DELAY_S = 0.2
"""Delay of the first restart; it doubles with each further one."""
LONGEST_DELAY_S = 10.0
STABLE_S = 10.0
"""A process that ran for this long restarts after the first delay again."""
READY_VARIABLE = "COMOTION_READY_FILE"
RESUME = {"COMOTION_RESUME": "1"}
"""A service that is restarted goes on with the scene that it has left."""


class Child(threading.Thread):
    """A thread that runs a :class:`ProcessSpec`, again where it says so; the process ends with the thread.

    Its ready file is in `folder`; `write` takes what it prints, `log` lines about its starts and ends.
    """

    def __init__(self, spec: ProcessSpec, folder: Path, write: WriteLine, log: Callable[[str], None]) -> None:
        super().__init__(name=spec.name, daemon=True)
        self.spec = spec
        self.last_line = ""
        self.cannot_start = False
        self._write, self._log = write, log
        self._ready_file = folder / f"{spec.name}.ready"
        self._was_ready = not spec.says_ready
        self._stopping, self._lock = threading.Event(), threading.Lock()
        self._popen: subprocess.Popen[str] | None = None

    @property
    def was_ready(self) -> bool:
        """Whether it has signalled readiness, now or before a restart."""
        self._was_ready |= self._ready_file.exists()
        return self._was_ready

    def run(self) -> None:
        """Run the process, and again as its specification says, until it is to stop."""
        delay_s = FIRST_DELAY_S
        while (popen := self._open()) is not None:
            began_s = time.monotonic()
            self._log(f"started {self.name}, pid {popen.pid}")
            status = self._follow(popen)
            if self._stopping.is_set():
                return
            self.cannot_start = status == 2 and not self.was_ready
            reason = f"killed by {signal.Signals(-status).name}" if status < 0 else f"status {status}"
            if self.spec.restart == "never" or (self.spec.restart == "on-failure" and status == 0):
                self._log(f"{self.name} has ended ({reason})")
                return
            if time.monotonic() - began_s >= STABLE_S:
                delay_s = FIRST_DELAY_S
            self._log(f"{self.name} has ended ({reason}); starting it again in {delay_s:.1f} s")
            self._stopping.wait(delay_s)
            delay_s = min(2 * delay_s, LONGEST_DELAY_S)

    def terminate(self) -> None:
        """Send SIGTERM; the process is not restarted."""
        with self._lock:
            self._stopping.set()
        self._signal(signal.SIGTERM)

    def wait(self, since_s: float) -> bool:
        """Wait until it ends; if that exceeds `stop_s` since `since_s`, kill it and return False."""
        if self.ident is None:
            return True
        self.join(max(0.0, since_s + self.spec.stop_s - time.monotonic()))
        in_time = not self.is_alive()
        self._signal(signal.SIGKILL)
        self.join()
        return in_time

    def _open(self) -> subprocess.Popen[str] | None:
        """Start the process, unless it is to stop."""
        spec, ready = self.spec, {READY_VARIABLE: str(self._ready_file)}
        self._ready_file.unlink(missing_ok=True)
        with self._lock:
            if self._stopping.is_set():
                return None
            self._popen = subprocess.Popen(
                [*ENDS_WITH_PARENT, *spec.command],
                stdin=None if spec.foreground else subprocess.DEVNULL,
                stdout=None if spec.foreground else subprocess.PIPE,
                stderr=None if spec.foreground else subprocess.STDOUT,
                text=True,
                errors="replace",
                env={**RESUME, **os.environ, "PYTHONUNBUFFERED": "1", **ready, **spec.env},
                # In a separate session, Ctrl-C reaches only the launcher, which stops all in order.
                start_new_session=not spec.foreground,
            )
        return self._popen

    def _follow(self, popen: subprocess.Popen[str]) -> int:
        """Write the lines of the process until it ends; returns its exit status."""
        with popen:
            # What it has started itself may hold its output open.
            reader = threading.Thread(target=self._read, args=(popen,), daemon=True)
            reader.start()
            status = popen.wait()
            self._signal(signal.SIGKILL)
            self._popen = None
            reader.join()
        return status

    def _read(self, popen: subprocess.Popen[str]) -> None:
        for line in popen.stdout or ():
            self.last_line = line.rstrip("\n")
            self._write(self.name, self.last_line)

    def _signal(self, number: signal.Signals) -> None:
        """Send a signal to the process and to all that it has started."""
        if (popen := self._popen) is None:
            return
        with suppress(ProcessLookupError):
            if self.spec.foreground:
                popen.send_signal(number)
            else:
                os.killpg(popen.pid, number)


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
