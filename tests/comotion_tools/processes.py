"""Processes that are started with their parent, killed, stopped and continued; what they hold on to."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comotion_deploy.processes import ENDS_WITH_PARENT, PYTHON

_PAGE = os.sysconf("SC_PAGE_SIZE")
_STOP_S = 10.0
DEADLINE = 120.0
"""s after which what is awaited counts as missing; long, for a loaded machine takes its time."""
COMOTION = (*PYTHON, "comotion_deploy")
"""Words before a command of ours."""
STARTS = "%starts%"
"""Stands in a command for how often it has been started."""


@dataclass(frozen=True)
class Usage:
    """What a process holds: memory in MB, descriptors, threads, and the size of its log in bytes.

    Beside it stands its processor time in s, that of its threads included.
    """

    memory_mb: float
    descriptors: int
    threads: int
    log_bytes: int
    processor_s: float = 0.0


class Managed:
    """A process that ends with this one, and can be started again.

    :data:`STARTS` in the words of its command is how often it has been started before. Its standard error
    goes to its standard output or, where there is a folder, to :attr:`log`; `env` is beside that of this
    process. :attr:`lines` are what it has printed, :attr:`account` is the last line that is JSON, and
    :attr:`ended` are the exit statuses.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        folder: Path | None = None,
        *,
        env: Mapping[str, str] | None = None,
        cwd: Path | None = None,
    ) -> None:
        self.name, self.command = name, tuple(command)
        self.log = None if folder is None else folder / f"{name}.log"
        self.lines: list[str] = []
        self.account: dict[str, Any] = {}
        self.starts = 0
        self.ended: list[int] = []
        # Lines are read as they come, and modules are found where this process finds them.
        own = {"PYTHONPATH": os.pathsep.join(sys.path), "PYTHONUNBUFFERED": "1"}
        self._env, self._cwd = os.environ | own | dict(env or {}), cwd
        self._popen: subprocess.Popen[str] | None = None
        self._news = threading.Condition()
        self._reader = threading.Thread()

    @property
    def pid(self) -> int | None:
        """Process id; None while it does not run."""
        return None if self._popen is None else self._popen.pid

    @property
    def output(self) -> str:
        """What it has printed."""
        return "\n".join(self.lines)

    def start(self) -> None:
        """Start it, in a group of its own: Ctrl-C is sent to all of it, as a terminal would."""
        command = [word.replace(STARTS, str(self.starts)) for word in self.command]
        with nullcontext(subprocess.STDOUT) if self.log is None else self.log.open("ab") as errors:
            self._popen = subprocess.Popen(
                [*ENDS_WITH_PARENT, *command],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                start_new_session=True,
                env=self._env,
                cwd=self._cwd,
            )
        self.starts += 1
        self._reader = threading.Thread(target=self._read, args=(self._popen,), daemon=True)
        self._reader.start()

    def _read(self, popen: "subprocess.Popen[str]") -> None:
        assert popen.stdout is not None
        for line in popen.stdout:
            with self._news:
                self.lines.append(line.rstrip("\n"))
                if line.startswith("{"):
                    with suppress(ValueError):  # the first of several lines of JSON
                        self.account = json.loads(line)
                self._news.notify_all()
        with self._news:
            self._news.notify_all()

    def wait_line(self, wanted: Callable[[str], object], start: int = 0) -> str:
        """The first line from number `start` on that is wanted; AssertionError where it ends before."""

        def matches() -> list[str]:
            return [line for line in self.lines[start:] if wanted(line)]

        end = time.monotonic() + DEADLINE
        with self._news:
            while not matches() and self.is_running and time.monotonic() < end:
                self._news.wait(0.5)
        self._reader.join(0.0 if self.is_running else DEADLINE)
        assert matches(), f"{self.name} did not say so:\n{self.output}"
        return matches()[0]

    def wait_ready(self) -> None:
        """Wait until it says that it is ready."""
        self.wait_line(lambda line: line == "ready")

    def wait(self) -> int:
        """Wait for its end; the exit status, with all output read."""
        assert self._popen is not None
        status = self._popen.wait(DEADLINE)
        self._reader.join(DEADLINE)
        return status

    def send(self, command: dict[str, Any]) -> None:
        """Send the process a command, a line of JSON."""
        if self._popen is not None and self._popen.stdin is not None and self._popen.poll() is None:
            with suppress(OSError):  # it has just been killed
                self._popen.stdin.write(json.dumps(command) + "\n")
                self._popen.stdin.flush()

    @property
    def is_running(self) -> bool:
        """Whether it has been started and has not ended."""
        return self._popen is not None and self._popen.poll() is None

    def has_ended(self) -> bool:
        """Whether it has ended since the last call; what it held is released."""
        if self._popen is None or self.is_running:
            return False
        self._release(self._popen)
        return True

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to it."""
        if self._popen is not None and self._popen.poll() is None:
            self._popen.send_signal(number)

    def interrupt(self) -> int:
        """The exit status after Ctrl-C at the terminal: the signal goes to the whole foreground group."""
        assert self._popen is not None
        os.killpg(self._popen.pid, signal.SIGINT)
        return self.wait()

    def kill(self) -> int:
        """Kill it; the exit status."""
        self.signal(signal.SIGKILL)
        return self.wait()

    def end(self, stop_s: float = _STOP_S) -> bool:
        """Ask it to stop, and kill it if it does not in time; whether it did."""
        if self._popen is None:
            return True
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        stops = True
        try:
            self._popen.wait(stop_s)
        except subprocess.TimeoutExpired:
            stops = False
            self._popen.kill()
            self._popen.wait()
        self._release(self._popen)
        return stops

    def usage(self) -> Usage | None:
        """What it holds now; None while it does not run."""
        folder = Path(f"/proc/{self.pid}")
        try:
            pages = int((folder / "statm").read_text().split()[1])
            descriptors = len(list((folder / "fd").iterdir()))
            threads = len(list((folder / "task").iterdir()))
            fields = (folder / "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        except (OSError, IndexError):
            return None
        log_bytes = self.log.stat().st_size if self.log is not None and self.log.exists() else 0
        processor_s = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        return Usage(pages * _PAGE / 1e6, descriptors, threads, log_bytes, processor_s)

    def _release(self, popen: "subprocess.Popen[str]") -> None:
        self.ended.append(popen.wait())
        self._reader.join(1.0)
        for stream in (popen.stdin, popen.stdout):
            if stream is not None:
                with suppress(OSError):  # a command that it has never read
                    stream.close()
        self._popen = None
