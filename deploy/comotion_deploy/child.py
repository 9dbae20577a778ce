"""One child process of the launcher: started with parent watch, read by line, restarted with back-off."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from itertools import cycle
from pathlib import Path
from typing import TypeAlias

from rich.console import Console
from rich.text import Text

from .processes import ProcessSpec

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

    Parameters
    ----------
    names
        Names of processes, for width and colour of the prefix; others may write too.
    path
        File for the lines; None: standard output. Needed while another process owns the terminal.
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


class Child:
    """Runs a :class:`ProcessSpec`; start it from the main thread, since it ends with that thread.

    Its ready file is in `folder`, and what it prints goes to `write`.
    """

    def __init__(self, spec: ProcessSpec, folder: Path, write: WriteLine) -> None:
        self.spec = spec
        self.was_ready = False
        self.last_line = ""
        self.due_s: float | None = None
        self._ready_file = folder / f"{spec.name}.ready"
        self._write = write
        self._popen: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        self._delay_s = FIRST_DELAY_S
        self._started_s = 0.0

    @property
    def pid(self) -> int | None:
        """Process id; None while it does not run."""
        return None if self._popen is None else self._popen.pid

    def start(self) -> None:
        """Start the process."""
        spec, ready = self.spec, {READY_VARIABLE: str(self._ready_file)}
        self._ready_file.unlink(missing_ok=True)
        self._popen = subprocess.Popen(
            [sys.executable, "-m", "comotion_deploy.parent_watch", str(os.getpid()), *spec.command],
            stdin=None if spec.foreground else subprocess.DEVNULL,
            stdout=None if spec.foreground else subprocess.PIPE,
            stderr=None if spec.foreground else subprocess.STDOUT,
            text=True,
            errors="replace",
            env={**RESUME, **os.environ, "PYTHONUNBUFFERED": "1", **ready, **spec.env},
            # In a separate session, Ctrl-C reaches only the launcher, which stops all processes in order.
            start_new_session=not spec.foreground,
        )
        self._started_s = time.monotonic()
        self.due_s = None
        if not spec.foreground:
            self._reader = threading.Thread(target=self._read, args=(self._popen,), daemon=True)
            self._reader.start()

    @property
    def is_due(self) -> bool:
        """Whether it is time to start it again."""
        return self.due_s is not None and time.monotonic() >= self.due_s

    def poll(self) -> int | None:
        """Return the exit status if the process has just ended, else None; schedules a restart."""
        if self._popen is None:
            return None
        self.was_ready |= not self.spec.says_ready or self._ready_file.exists()
        status = self._popen.poll()
        if status is None:
            return None
        self._reap()
        self._schedule(status)
        return status

    def terminate(self) -> None:
        """Send SIGTERM; the process is not restarted."""
        self.due_s = None
        self._signal(signal.SIGTERM)

    def wait(self, since_s: float) -> bool:
        """Wait until it ends; if that exceeds `stop_s` since `since_s`, kill it and return False."""
        if self._popen is None:
            return True
        in_time = True
        try:
            self._popen.wait(max(0.0, since_s + self.spec.stop_s - time.monotonic()))
        except subprocess.TimeoutExpired:
            in_time = False
            self._signal(signal.SIGKILL)
            self._popen.wait()
        self._reap()
        return in_time

    def _reap(self) -> None:
        """Kill remaining processes of its group and release resources."""
        self._signal(signal.SIGKILL)
        if self._reader is not None:
            self._reader.join()
        if self._popen is not None and self._popen.stdout is not None:
            self._popen.stdout.close()
        self._popen, self._reader = None, None

    def _signal(self, number: signal.Signals) -> None:
        if self._popen is None:
            return
        with suppress(ProcessLookupError):
            if self.spec.foreground:
                self._popen.send_signal(number)
            else:
                os.killpg(self._popen.pid, number)

    def _schedule(self, status: int) -> None:
        now = time.monotonic()
        if self.spec.restart == "never" or (self.spec.restart == "on-failure" and status == 0):
            return
        if now - self._started_s >= STABLE_S:
            self._delay_s = FIRST_DELAY_S
        self.due_s = now + self._delay_s
        self._delay_s = min(2 * self._delay_s, LONGEST_DELAY_S)

    def _read(self, popen: subprocess.Popen[str]) -> None:
        assert popen.stdout is not None  # noqa: S101 - it was opened with a pipe
        for line in popen.stdout:
            self.last_line = line.rstrip("\n")
            self._write(self.spec.name, self.last_line)
