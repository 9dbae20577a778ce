"""Processes that meet at a router, and a client of theirs: for the soak, the attacks and the benchmark."""

import json
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Self

from comotion_clients.subscription import M, Subscription
from comotion_deploy.errors import UserError
from comotion_deploy.pki.authority import Authority
from comotion_deploy.pki.certificates import CertificateRole, Grant
from comotion_schemas import Keys
from comotion_schemas.transport import SessionSettings, connect

from .processes import Managed

OPEN_S = 60.0
UP_S = 300.0
_KEPT = 8192


class System:
    """Processes of a scene, of which the router is started at once; a context manager that stops them all.

    `settings` are those of the client in this process; `stop` ends every wait when set.
    """

    turn_s = 0.1
    """s between two looks."""

    def __init__(
        self,
        processes: Mapping[str, Managed],
        scene: str,
        settings: SessionSettings,
        stop: threading.Event | None = None,
    ) -> None:
        self.processes = dict(processes)
        self.keys = Keys(scene)
        self.stop = stop or threading.Event()
        self._settings = settings
        self._exit = ExitStack()

    def __enter__(self) -> Self:
        with self._exit:
            for process in self.processes.values():
                self._exit.callback(process.end)
            self.processes["router"].start()
            opened = connect(self._settings, timeout=OPEN_S, given_up=self.stop)
            self.session = self._exit.enter_context(opened)
            self._begin()
            self._exit = self._exit.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._exit.close()

    def _begin(self) -> None:
        """Do what is to be done once the session is open."""

    def subscribe(self, message: type[M]) -> Subscription[M]:
        """Subscribe for as long as the system runs."""
        return self._exit.enter_context(
            Subscription(self.session, message, self.keys.scene, capacity=_KEPT, timeout=OPEN_S)
        )

    def start(self, *names: str) -> None:
        """Start processes."""
        for name in names:
            self.processes[name].start()

    def turn(self) -> None:
        """Wait for a moment, and look once at everything."""
        self.stop.wait(self.turn_s)

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

    def until(self, condition: Callable[[], object], seconds: float = UP_S) -> None:
        """Watch until something is so; UserError with the last lines of the logs if it never is."""
        if self.is_so(condition, seconds) or self.stop.is_set():
            return
        logs = [log for process in self.processes.values() if (log := process.log) and log.exists()]
        last = [f"{log.stem}: {line}" for log in logs for line in _last_lines(log)]
        raise UserError(f"it does not come up within {seconds:.0f} s: {' | '.join(last)}")

    @contextmanager
    def paused(self, sources: Iterable[Managed]) -> Iterator[None]:
        """Let sources pause; that they do is to be awaited."""
        for source in sources:
            source.send({"do": "pause"})
        try:
            yield
        finally:
            for source in sources:
                source.send({"do": "resume"})

    def accounts(self, seconds: float) -> dict[str, Any] | None:
        """What the service says became of the batches of every session; None where it does not answer."""
        for reply in self.session.get(self.keys.query("accounts"), timeout=seconds):
            if reply.ok is not None:
                return dict(json.loads(reply.ok.payload.to_bytes()))
        return None


def certificates(folder: Path, roles: Mapping[str, CertificateRole], **grant: Any) -> Authority:
    """Issue a certificate for each name; routers are on this machine."""
    authority = Authority.create(folder)
    for name, role in roles.items():
        issue(authority, role, name, **grant)
    return authority


def issue(authority: Authority, role: CertificateRole, name: str, days: float = 90.0, **grant: Any) -> Path:
    """Issue a certificate of a component of this machine; returns its folder."""
    fields = {"common_name": "new", "sources": (name,) if role == "source" else ()} | grant
    hosts = ("localhost", "127.0.0.1") if role == "router" else ()
    return authority.issue(Grant(role=role, name=name, **fields), days=days, hosts=hosts)


def _last_lines(log: Path) -> list[str]:
    return log.read_text(encoding="utf-8", errors="replace").splitlines()[-3:]
