"""Processes that are started with their parent, killed, stopped and continued; what they hold on to."""

import json
import os
import signal
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from comotion_deploy.processes import PYTHON

_PAGE = os.sysconf("SC_PAGE_SIZE")
_STOP_S = 10.0
COMOTION = (*PYTHON, "comotion_deploy")
"""Words before a command of ours."""
STARTS = "%starts%"
"""Stands in a command for how often it has been started."""


@dataclass(frozen=True)
class Usage:
    """What a process holds: memory in MB, descriptors, threads, and the size of its log in bytes."""

    memory_mb: float
    descriptors: int
    threads: int
    log_bytes: int


class Managed:
    """One process of the system; its standard error goes to a file, its standard output is read.

    Attributes
    ----------
    account
        What it has said last, if it says JSON.
    starts, ended
        How often it has been started, and the exit statuses.
    """

    def __init__(self, name: str, command: tuple[str, ...], folder: Path) -> None:
        self.name = name
        self.command = command
        self.log = folder / f"{name}.log"
        self.account: dict[str, Any] = {}
        self.starts = 0
        self.ended: list[int] = []
        self._popen: subprocess.Popen[str] | None = None
        self._log: IO[bytes] | None = None
        self._reader: threading.Thread | None = None

    @property
    def pid(self) -> int | None:
        """Process id; None while it does not run."""
        return None if self._popen is None else self._popen.pid

    def start(self) -> None:
        """Start it; it ends with this process."""
        command = [word.replace(STARTS, str(self.starts)) for word in self.command]
        self._log = self.log.open("ab")
        self._popen = subprocess.Popen(
            [sys.executable, "-m", "comotion_deploy.parent_watch", str(os.getpid()), *command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},  # of the sources of the soak
            start_new_session=True,
        )
        self.starts += 1
        self._reader = threading.Thread(target=self._read, args=(self._popen,), daemon=True)
        self._reader.start()

    def _read(self, popen: "subprocess.Popen[str]") -> None:
        assert popen.stdout is not None
        for line in popen.stdout:
            if line.startswith("{"):
                self.account = json.loads(line)

    def send(self, command: dict[str, Any]) -> None:
        """Send the process a command, a line of JSON."""
        if self._popen is not None and self._popen.stdin is not None and self._popen.poll() is None:
            with suppress(OSError):  # it has just been killed
                self._popen.stdin.write(json.dumps(command) + "\n")
                self._popen.stdin.flush()

    def has_ended(self) -> bool:
        """Whether it has ended since the last call; what it held is released."""
        if self._popen is None or (status := self._popen.poll()) is None:
            return False
        self.ended.append(status)
        self._release()
        return True

    def signal(self, number: signal.Signals) -> None:
        """Send a signal to it."""
        if self._popen is not None and self._popen.poll() is None:
            self._popen.send_signal(number)

    def end(self) -> None:
        """Ask it to stop, and kill it if it does not."""
        if self._popen is None:
            return
        self.signal(signal.SIGCONT)
        self.signal(signal.SIGTERM)
        try:
            self._popen.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            self._popen.kill()
            self._popen.wait()
        self.ended.append(self._popen.returncode)
        self._release()

    def usage(self) -> Usage | None:
        """What it holds now; None while it does not run."""
        folder = Path(f"/proc/{self.pid}")
        try:
            pages = int((folder / "statm").read_text().split()[1])
            descriptors = len(list((folder / "fd").iterdir()))
            threads = len(list((folder / "task").iterdir()))
        except (OSError, IndexError):
            return None
        log_bytes = self.log.stat().st_size if self.log.exists() else 0
        return Usage(pages * _PAGE / 1e6, descriptors, threads, log_bytes)

    def processor_s(self) -> float:
        """Processor time so far, s; that of its threads included."""
        fields = Path(f"/proc/{self.pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def most_mb(self) -> float:
        """The most memory that it has held, MB."""
        status = Path(f"/proc/{self.pid}/status").read_text(encoding="utf-8")
        return int(status.partition("VmHWM:")[2].split()[0]) * 1024 / 1e6

    def _release(self) -> None:
        if self._popen is None:
            return
        if self._reader is not None:
            self._reader.join(1.0)
        for stream in (self._popen.stdin, self._popen.stdout, self._log):
            if stream is not None:
                with suppress(OSError):  # a command that it has never read
                    stream.close()
        self._popen = None
