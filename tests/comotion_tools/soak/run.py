"""Runs a scene under faults, and collects what goes wrong.

The loop looks at everything ten times a second: it starts what has ended, carries out what is due, and
measures. One fault is carried out at a time.
"""

import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path

from comotion_deploy.processes import PYTHON

from ..processes import COMOTION, STARTS, Managed, Usage
from . import load
from .monitor import Audit, Findings, Moment, audit
from .schedule import HOSTILE, SOURCES, Fault
from .watched import Watched

SCENE = "soak"
_ENDS = {"kill": signal.SIGKILL, "restart": signal.SIGTERM}
_SAMPLE_S = 2.0
_WINDOW_S = 60.0
_RECORDINGS = 3


@dataclass
class Soak:
    """What a soak has found so far; times are s from its start."""

    seconds: float = 0.0
    faults: list[tuple[float, Fault]] = field(default_factory=list)
    findings: Findings = field(default_factory=Findings)
    # Of stretches in which accounts must be exact.
    audits: list[tuple[float, Audit]] = field(default_factory=list)
    # From the stamp of the last batch in an update to its receipt: median, 99th percentile and largest.
    last_batch_ms: list[float] = field(default_factory=list)
    # By process: when, in its how many-th life, and what it held.
    usage: dict[str, list[tuple[float, int, Usage]]] = field(default_factory=dict)
    # Kind and source of the problems that the service has named.
    named: set[tuple[str, str]] = field(default_factory=set)
    # Exit statuses of processes that nobody has ended.
    ended: dict[str, list[int]] = field(default_factory=dict)


def _processes(
    endpoint: str, folder: Path, features: int | None, serve: tuple[str, ...]
) -> dict[str, Managed]:
    """Build the processes of a soak, by name, in the order in which they start."""
    at = ("--connect", endpoint, "--scene", SCENE)
    record = ("record", str(folder / f"take-{STARTS}.mcap"), "--max-size", "20")
    commands = {
        "router": (*COMOTION, "router", "--listen", endpoint),
        "service": (*serve, "--state", str(folder / "scene.state"), *at),
        **{name: load.command(endpoint, SCENE, name, features) for name in SOURCES},
        "recorder": (*COMOTION, *record, *at),
        "viewer": (*COMOTION, "watch", *at),
    }
    return {name: Managed(name, command, folder) for name, command in commands.items()}


class Runner(Watched):
    """A running system under faults; a context manager that stops it all, as `stop` does when set.

    Its router listens at the endpoint; logs, state and recording go to the folder; `say` is called with lines
    of progress. `features` are those of each body in each source, `serve` the command of the service.
    """

    def __init__(
        self,
        endpoint: str,
        folder: Path,
        stop: threading.Event,
        say: Callable[[str], None],
        *,
        features: int | None = None,
        serve: tuple[str, ...] = (*COMOTION, "serve"),
    ) -> None:
        super().__init__(_processes(endpoint, folder, features, serve), SCENE, endpoint, stop)
        self._folder, self.say = folder, say
        if find_spec("mcap") is None:
            del self.processes["recorder"]
            say("no recorder: mcap is not installed")
        self.result = Soak()
        self._expected: set[str] = set()
        self._sampled_s = self._window_s = 0.0
        self._window: Moment | None = None

    @property
    def now_s(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.started_s

    def __exit__(self, *exception: object) -> None:
        self.result.seconds, self.result.last_batch_ms = self.now_s, self.monitor.last_batch_ms
        super().__exit__(*exception)

    def settle(self) -> None:
        """Start all and wait until every body has a hypothesis of its own; the soak begins then.

        Raises
        ------
        UserError
            If that does not happen.
        """
        self.start(*(name for name in self.processes if name != "router"))
        self.result.findings = self.monitor.findings
        self.until(lambda: self.monitor.is_sorted_out)
        self.monitor.begin()

    def run(self, faults: list[Fault], until_s: float) -> None:
        """Carry out faults at their times; the clock of the schedule starts now."""
        offset_s = self.now_s
        for fault in faults:
            self.wait(offset_s + fault.at_s - self.now_s)
            if self.stop.is_set():
                return
            self._audit(fault)
            self.carry_out(fault)
        self.wait(offset_s + until_s - self.now_s)
        self._audit(None)

    def turn(self) -> None:
        """Look once at everything: start what has ended, and measure."""
        super().turn()
        problems = self.monitor.status.problems if self.monitor.status else []
        self.result.named |= {(problem.kind, problem.source or "") for problem in problems}
        for name, process in self.processes.items():
            if process.has_ended():
                if name not in self._expected:
                    self.result.ended.setdefault(name, []).append(process.ended[-1])
                    self.say(f"{name} has ended by itself, status {process.ended[-1]}")
                self._expected.discard(name)
                process.start()
        if self.now_s - self._sampled_s > _SAMPLE_S:
            self._sampled_s = self.now_s
            self._sample()

    def carry_out(self, fault: Fault) -> None:
        """Do what a fault says, and wait until it is over."""
        self.result.faults.append((round(self.now_s, 1), fault))
        self.say(f"{fault}")
        process = self.processes.get(fault.target)
        if fault.kind == HOSTILE:
            at_s = self.now_s
            words = (f"{fault.lasts_s:g}", str(len(self.result.faults)), fault.target)
            command = (*PYTHON, "comotion_tools.soak.hostile", self.endpoint, SCENE, *words)
            attacker = Managed(HOSTILE, command, self._folder)
            attacker.start()
            self.is_so(attacker.has_ended, 60 + 10 * fault.lasts_s)
            attacker.end()
            lasted_s = round(self.now_s - at_s, 1)
            self.result.faults[-1] = (round(at_s, 1), replace(fault, lasts_s=lasted_s))
        elif process is None:
            return
        elif fault.kind in _ENDS:
            self._expected.add(fault.target)
            process.signal(_ENDS[fault.kind])
        elif fault.kind == "stop":
            process.signal(signal.SIGSTOP)
            self.wait(fault.lasts_s)
            process.signal(signal.SIGCONT)
        else:
            process.send({"do": fault.kind, "lasts_s": fault.lasts_s, "size": fault.size})
            self.wait(fault.lasts_s)

    def _audit(self, fault: Fault | None) -> None:
        """Close the stretch of exact accounts before a fault that ends it; open one before another fault."""
        ends = fault is None or fault.blurs
        if self._window is not None and (ends or self.now_s - self._window_s > _WINDOW_S):
            self._close_window(self.counted(SOURCES))
        if not ends and self._window is None:
            self._window, self._window_s = self.counted(SOURCES, opens=True), self.now_s

    def _close_window(self, end: Moment | None) -> None:
        start, self._window = self._window, None
        audited = None if start is None or end is None else audit(start, end)
        if audited is not None:
            self.result.audits.append((round(self.now_s, 1), audited))
            if audited.missing or audited.unsettled:
                self.say(f"accounts: {audited.missing} of {audited.sent} batches are missing")

    def _sample(self) -> None:
        """Measure; recordings are there to be written, not to be kept."""
        for name, process in self.processes.items():
            usage = process.usage()
            if usage is not None:
                self.result.usage.setdefault(name, []).append((round(self.now_s, 1), process.starts, usage))
        takes = sorted(self._folder.glob("take*.mcap*"), key=lambda file: file.stat().st_mtime)
        for file in takes[:-_RECORDINGS]:
            file.unlink(missing_ok=True)


def clear(folder: Path) -> None:
    """Remove from a folder what an earlier soak has left there, and make it if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for pattern in ("*.log", "take-*.mcap", "scene.state*"):
        for file in folder.glob(pattern):
            file.unlink()
