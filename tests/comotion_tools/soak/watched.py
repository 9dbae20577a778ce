"""Processes that meet at a router, and a client of theirs that watches: for the soak and the attacks."""

import json
import threading
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import ExitStack
from typing import Any, Self

from comotion_clients.subscription import Subscription
from comotion_deploy.errors import UserError
from comotion_schemas import HypothesisUpdate, Keys, Status
from comotion_schemas.transport import SessionSettings, connect

from ..processes import Managed
from .monitor import Moment, Monitor, moment

_OPEN_S = 60.0
_UP_S = 300.0
_KEPT = 8192
_TURN_S = 0.1
_PAUSED_S = 15.0
_SETTLE_S = 1.2


class Watched:
    """Processes of a scene, of which the router is started at once; a context manager that stops them all.

    A monitor watches from the start on; `started_s` is on the monotonic clock. `stop` ends every wait.
    """

    def __init__(
        self, processes: Mapping[str, Managed], scene: str, endpoint: str, stop: threading.Event | None = None
    ) -> None:
        self.processes, self.keys, self.endpoint = dict(processes), Keys(scene), endpoint
        self.stop = stop or threading.Event()
        self._exit = ExitStack()

    def __enter__(self) -> Self:
        with self._exit:
            for process in self.processes.values():
                self._exit.callback(process.end)
            self.processes["router"].start()
            settings = SessionSettings(connect=(self.endpoint,))
            opened = connect(settings, timeout=_OPEN_S, given_up=self.stop)
            self.session = self._exit.enter_context(opened)
            self.started_s = time.monotonic()
            scene = self.keys.scene
            updates = Subscription(self.session, HypothesisUpdate, scene, capacity=_KEPT)
            statuses = Subscription(self.session, Status, scene, capacity=_KEPT)
            self.monitor = Monitor(
                self._exit.enter_context(updates), self._exit.enter_context(statuses), self.started_s
            )
            self._exit = self._exit.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._exit.close()

    def start(self, *names: str) -> None:
        """Start processes."""
        for name in names:
            self.processes[name].start()

    def turn(self) -> None:
        """Wait for a moment, and take in what has arrived."""
        self.stop.wait(_TURN_S)
        self.monitor.poll()

    def wait(self, seconds: float) -> None:
        """Watch for some time."""
        self.is_so(lambda: False, seconds)

    def is_so(self, condition: Callable[[], object], seconds: float) -> bool:
        """Watch until something is so; False where it is not after some time, or `stop` is set."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not self.stop.is_set():
            if condition():
                return True
            self.turn()
        return False

    def until(self, condition: Callable[[], object], seconds: float = _UP_S) -> None:
        """Watch until something is so; UserError with the last lines of the logs if it never is."""
        if self.is_so(condition, seconds) or self.stop.is_set():
            return
        logs = [log for process in self.processes.values() if (log := process.log) and log.exists()]
        texts = {log.stem: log.read_text(encoding="utf-8", errors="replace") for log in logs}
        last = [f"{name}: {line}" for name, text in texts.items() for line in text.splitlines()[-3:]]
        raise UserError(f"it does not come up within {seconds:.0f} s: {' | '.join(last)}")

    def counted(self, names: Collection[str], *, opens: bool = False) -> Moment | None:
        """Let sources pause until the service has counted what they have sent; None where that takes long.

        What `opens` a stretch waits until the service knows of all: what a service learns only now of the
        time before its start is none of the stretch.
        """
        sources, last_moment = [self.processes[name] for name in names], None
        end = time.monotonic() + _PAUSED_S
        for source in sources:
            source.send({"do": "pause"})
        try:
            while self.is_so(lambda: all(s.account.get("paused") for s in sources), end - time.monotonic()):
                last, reply = self.monitor.last, self._accounts()
                now = None if last is None or reply is None else moment(last.session, reply, sources)
                if now is not None and now == last_moment and not now.waiting and not (opens and now.unheard):
                    return now
                last_moment = now
                self.wait(_SETTLE_S)
            return None
        finally:
            for source in sources:
                source.send({"do": "resume"})

    def _accounts(self) -> dict[str, Any] | None:
        """What the service says became of the batches of every session; None where it does not answer."""
        for reply in self.session.get(self.keys.query("accounts"), timeout=_SETTLE_S):
            if reply.ok is not None:
                return dict(json.loads(reply.ok.payload.to_bytes()))
        return None
