"""Runs a scene under faults, and collects what goes wrong.

The loop looks at everything ten times a second: it starts what has ended, carries out what is due, and
measures. One fault is carried out at a time.
"""

import json
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Self

from comotion_clients.subscription import Subscription
from comotion_deploy.errors import UserError
from comotion_deploy.processes import PYTHON
from comotion_schemas import HypothesisUpdate, Keys, Status
from comotion_schemas.transport import SessionSettings, connect

from .accounts import Audit, Moment, audit, moment
from .monitor import Findings, Monitor
from .processes import Managed, Usage, system
from .schedule import HOSTILE, SOURCES, Fault

SCENE = "soak"
READY_S = 180.0
_TURN_S = 0.1
_SAMPLE_S = 2.0
_PAUSED_S = 15.0
_WINDOW_S = 60.0
_SETTLE_S = 1.2
_HOSTILE_S = 4.0
_RECORDINGS = 3
_PRUNE_S = 30.0


@dataclass
class Soak:
    """What a soak has found so far.

    Attributes
    ----------
    faults
        Those carried out: at how many s, and what.
    findings
        Of the updates.
    audits
        Accounts of stretches in which they must be exact.
    usage
        By process: at how many s, in its how many-th life, and what it held.
    ended
        Exit statuses of processes that nobody has ended, by name.
    """

    seconds: float = 0.0
    faults: list[tuple[float, Fault]] = field(default_factory=list)
    findings: Findings = field(default_factory=Findings)
    audits: list[tuple[float, Audit]] = field(default_factory=list)
    usage: dict[str, list[tuple[float, int, Usage]]] = field(default_factory=dict)
    ended: dict[str, list[int]] = field(default_factory=dict)
    recovery: list[tuple[str, float]] = field(default_factory=list)


class Runner:
    """A running system under faults; a context manager that stops it all.

    Parameters
    ----------
    endpoint
        Where its router listens.
    folder
        Where logs, state and recording go.
    stop
        Ends everything when set.
    say
        Called with lines of progress.
    """

    def __init__(
        self, endpoint: str, folder: Path, stop: threading.Event, say: Callable[[str], None]
    ) -> None:
        self._endpoint, self._folder, self._stop, self.say = endpoint, folder, stop, say
        self.processes = system(endpoint, SCENE, folder)
        if find_spec("mcap") is None:
            del self.processes["recorder"]
            say("no recorder: mcap is not installed")
        self.started_s = time.monotonic()
        self.result = Soak()
        self._expected: dict[str, int] = {}
        self._sampled_s = self._pruned_s = 0.0
        self._window: Moment | None = None
        self._window_s = 0.0

    @property
    def now_s(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self.started_s

    def __enter__(self) -> Self:
        self.processes["router"].start()
        self._session = connect(SessionSettings(connect=(self._endpoint,)), given_up=self._stop)
        self._updates = Subscription(self._session, HypothesisUpdate, SCENE)
        self._statuses = Subscription(self._session, Status, SCENE)
        for name, process in self.processes.items():
            if name != "router":
                process.start()
        self.monitor = Monitor(self._updates, self._statuses, self.started_s)
        self.result.findings = self.monitor.findings
        return self

    def __exit__(self, *_: object) -> None:
        self.result.seconds = self.now_s
        for process in reversed(self.processes.values()):
            process.end()
        self._updates.close()
        self._statuses.close()
        self._session.close()  # type: ignore[no-untyped-call]

    def settle(self) -> None:
        """Wait until every body has a hypothesis of its own; the soak begins then.

        Raises
        ------
        UserError
            If that does not happen.
        """
        deadline = time.monotonic() + READY_S
        while not self.monitor.is_sorted_out and not self._stop.is_set():
            self.turn()
            if time.monotonic() > deadline:
                raise UserError(f"the scene does not come up; see the logs in {self._folder}")
        self.monitor.begin()

    def run(self, faults: list[Fault], until_s: float) -> None:
        """Carry out faults at their times; the clock of the schedule starts now."""
        offset_s = self.now_s
        for fault in faults:
            self.wait(offset_s + fault.at_s - self.now_s)
            if self._stop.is_set():
                return
            self._audit(fault)
            self.carry_out(fault)
        self.wait(offset_s + until_s - self.now_s)
        self._audit(None)

    def wait(self, seconds: float) -> None:
        """Watch for some time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self._stop.is_set():
            self.turn()

    def turn(self) -> None:
        """Look once at everything."""
        self._stop.wait(_TURN_S)
        self.monitor.poll()
        for name, process in self.processes.items():
            if process.has_ended():
                if not self._expected.pop(name, 0):
                    self.result.ended.setdefault(name, []).append(process.ended[-1])
                    self.say(f"{name} has ended by itself, status {process.ended[-1]}")
                process.start()
        if self.now_s - self._sampled_s > _SAMPLE_S:
            self._sampled_s = self.now_s
            self._sample()
        if self.now_s - self._pruned_s > _PRUNE_S:
            self._pruned_s = self.now_s
            self._prune()

    def expect(self, name: str) -> None:
        """Note that a process is about to end, and is to be started again."""
        self._expected[name] = 1

    def carry_out(self, fault: Fault) -> None:
        """Do what a fault says, and wait until it is over."""
        self.result.faults.append((round(self.now_s, 1), fault))
        self.say(f"{fault}")
        if fault.kind == HOSTILE:
            at_s = self.now_s
            self._attack(len(self.result.faults))
            lasted_s = round(self.now_s - at_s, 1)
            self.result.faults[-1] = (round(at_s, 1), replace(fault, lasts_s=lasted_s))
            return
        process = self.processes.get(fault.target)
        if process is None:
            return
        if fault.kind == "kill":
            self.expect(fault.target)
            process.signal(signal.SIGKILL)
        elif fault.kind == "restart":
            self.expect(fault.target)
            process.signal(signal.SIGTERM)
        elif fault.kind == "stop":
            process.signal(signal.SIGSTOP)
            self.wait(fault.lasts_s)
            process.signal(signal.SIGCONT)
        else:
            process.send({"do": fault.kind, "lasts_s": fault.lasts_s, "size": fault.size})
            self.wait(fault.lasts_s)

    def _attack(self, seed: int) -> None:
        command = (*PYTHON, "comotion_tools.soak.hostile", self._endpoint, SCENE)
        attacker = Managed(HOSTILE, (*command, f"{_HOSTILE_S:g}", str(seed)), self._folder)
        attacker.start()
        deadline = time.monotonic() + 10 * _HOSTILE_S
        while not attacker.has_ended() and time.monotonic() < deadline and not self._stop.is_set():
            self.turn()
        attacker.end()

    def _audit(self, fault: Fault | None) -> None:
        """Close the stretch of exact accounts before a fault that ends it; open one before another fault."""
        ends = fault is None or _blurs(fault)
        if self._window is not None and (ends or self.now_s - self._window_s > _WINDOW_S):
            self._close_window(self._moment())
        if not ends and self._window is None:
            self._window, self._window_s = self._moment(opens=True), self.now_s

    def _close_window(self, after: Moment | None) -> None:
        before, self._window = self._window, None
        found = None if before is None or after is None else audit(before, after)
        if found is not None:
            self.result.audits.append((round(self.now_s, 1), found))
            if found.missing or found.unsettled:
                self.say(f"accounts: {found.missing} of {found.sent} batches are missing")

    def _moment(self, *, opens: bool = False) -> Moment | None:
        """Let all sources pause until the service has counted what they have sent.

        One that `opens` a stretch waits until the service knows of all: what a service learns only now of
        the time before its start is none of the stretch.
        """
        sources = [self.processes[name] for name in SOURCES]
        for source in sources:
            source.send({"do": "pause"})
        try:
            return self._settled(sources, time.monotonic() + _PAUSED_S, opens=opens)
        finally:
            for source in sources:
                source.send({"do": "resume"})

    def _settled(self, sources: list[Managed], deadline: float, *, opens: bool) -> Moment | None:
        """The accounts, once all sources pause and the service counts no more; None if that takes long."""
        before: Moment | None = None
        asked_s = 0.0
        while time.monotonic() < deadline and not self._stop.is_set():
            self.turn()
            paused = all(source.account.get("paused") for source in sources)
            if not paused or time.monotonic() - asked_s < _SETTLE_S:
                continue
            asked_s = time.monotonic()
            now = self._query_accounts(sources)
            if now is not None and now == before and not now.waiting and not (opens and now.unheard):
                return now
            before = now
        return None

    def _query_accounts(self, sources: list[Managed]) -> Moment | None:
        """What the service says of the accounts now."""
        if self.monitor.last is None:
            return None
        selector = f"{Keys(SCENE).prefix}/query/accounts"
        for reply in self._session.get(selector, timeout=_SETTLE_S):
            if reply.ok is not None:
                return moment(self.monitor.last.session, json.loads(reply.ok.payload.to_bytes()), sources)
        return None

    def _sample(self) -> None:
        for name, process in self.processes.items():
            usage = process.usage()
            if usage is not None:
                self.result.usage.setdefault(name, []).append((round(self.now_s, 1), process.starts, usage))

    def _prune(self) -> None:
        """Recordings are there to be written, not to be kept."""
        takes = sorted(self._folder.glob("take*.mcap*"), key=lambda file: file.stat().st_mtime)
        for file in takes[:-_RECORDINGS]:
            file.unlink(missing_ok=True)


def _blurs(fault: Fault) -> bool:
    """Whether accounts cannot be exact across a fault: a process takes with it what only it knew."""
    ends = fault.kind in ("kill", "restart") and fault.target in (*SOURCES, "service")
    return ends or fault.kind == HOSTILE


def clear(folder: Path) -> None:
    """Remove from a folder what an earlier soak has left there, and make it if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    for pattern in ("*.log", "take-*.mcap", "scene.state*"):
        for file in folder.glob(pattern):
            file.unlink()
