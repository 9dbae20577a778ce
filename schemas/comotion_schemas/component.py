"""Component: the session, liveliness token, Status, signals and readiness of one process in a scene.

Sources, the service and clients run in a :class:`Component`::

    with Component(scene="default", role="source", name="my-tracker") as component:
        publisher = stream_publisher(component.session, component.keys, "obs", component.name)
        component.ready()
        while not component.stop.is_set():
            ...
"""

import _thread
import logging
import secrets
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any, Literal, Self, TypedDict

import zenoh

from . import metrics
from .codec import encode
from .keys import DEFAULT_SCENE, Keys
from .messages import Problem, RejectionReason, Role, Status, StatusState
from .readiness import announce_ready, beat
from .text import shown
from .transport import Publisher, SessionSettings, client_settings, connect, declare_publisher

STATUS_PERIOD_S = 1.0
_log = logging.getLogger(__name__)


@cache
def _version() -> str:
    """Version of comotion; empty when it runs from a folder that is not installed."""
    try:
        return metadata.version("comotion")
    except metadata.PackageNotFoundError:
        return ""


def new_session_id() -> str:
    """Draw a random session id of 16 hexadecimal digits."""
    return secrets.token_hex(8)


@dataclass(frozen=True, kw_only=True)
class StatusFields:
    """The fields of Status that a component provides; :class:`Component` adds the others.

    `hangs` is not sent: while it is true, supervisors hear that the process is not alive.
    """

    state: StatusState = "ok"
    rates: dict[str, float] = field(default_factory=dict)
    ages: dict[str, float] = field(default_factory=dict)
    counters: dict[str, int] = field(default_factory=dict)
    rejected: dict[RejectionReason, int] = field(default_factory=dict)
    message: str = ""
    replica: Literal["", "active", "standby"] = ""
    epoch: int = 0
    clock_offsets: dict[str, float] = field(default_factory=dict)
    feature_names: dict[str, str] = field(default_factory=dict)
    hangs: bool = False
    problems: list[Problem] = field(default_factory=list)


class Rates:
    """Rates of counters between two Statuses."""

    def __init__(self) -> None:
        self._at, self._counts = time.monotonic(), dict[str, int]()

    def of(self, counts: Mapping[str, int]) -> dict[str, float]:
        """Increments per second since the last call; a new name begins at 0."""
        now, earlier = time.monotonic(), self._counts
        seconds = max(now - self._at, 1e-3)
        self._at, self._counts = now, dict(counts)
        return {name: (count - earlier.get(name, 0)) / seconds for name, count in counts.items()}


class Where(TypedDict, total=False):
    """Last parameters of all that runs a :class:`Component`, which raises what that does; as there."""

    scene: str
    settings: SessionSettings | None
    ready_file: Path | None


@contextmanager
def stop_on_signals(stop: threading.Event) -> Iterator[None]:
    """Set an event on SIGINT or SIGTERM; a second signal has its usual effect.

    Does nothing outside the main thread, since Python handles signals only there.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for number, handler in previous.items():
            signal.signal(number, handler)

    def handle(*_: object) -> None:
        restore()
        # The main thread, which runs this, may hold the lock that Event.set needs, and those of threading.
        _thread.start_new_thread(stop.set, ())

    for number in previous:
        signal.signal(number, handle)
    try:
        yield
    finally:
        restore()


def viewer(
    program: str, scene: str = DEFAULT_SCENE, settings: SessionSettings | None = None, **options: Any
) -> "Component":
    """The component of a client; `options` are further arguments of :class:`Component`.

    Its name is that of its certificate, or without one that of the program with random digits.
    """
    tls = (settings or client_settings()).tls
    certified = tls is not None and tls.identity
    name = certified.name if certified else f"{program}-{new_session_id()[:8]}"
    return Component(role="viewer", name=name, scene=scene, settings=settings, **options)


class Component:
    """Context manager that connects a process to a scene.

    While open it holds the liveliness token ``live/<role>/<name>``, publishes a Status at once and then
    every second from a thread, and sets :attr:`stop` on SIGINT and SIGTERM. Entry waits until a router
    is available; the session reconnects by itself to a router that restarts.

    Parameters
    ----------
    scene, role, name
        Names of scene and component, each ``[a-z0-9_-]{1,64}``, and the role of the component.
    settings
        How to connect.
    status
        Called once a second from the Status thread; must not block. An exception is logged and
        reported as ``degraded``.
    ready_file
        Written by :meth:`ready` instead of the line ``ready`` on standard output.
    session_id
        16 hexadecimal digits; None: random.
    has_token
        Whether it declares its liveliness token; False: the caller does.
    connect_timeout
        s to wait for a router on entry; None: no limit.

    Raises
    ------
    ValueError
        If the name of the scene or component is not valid, or the certificate is for another component.
    TimeoutError
        On entry, if no router answers in time.
    SystemExit
        On entry, with status 0, if a signal arrives before a router is available.
    """

    def __init__(
        self,
        *,
        role: Role,
        name: str,
        scene: str = DEFAULT_SCENE,
        settings: SessionSettings | None = None,
        status: Callable[[], StatusFields] = StatusFields,
        ready_file: Path | None = None,
        session_id: str | None = None,
        has_token: bool = True,
        connect_timeout: float | None = None,
    ) -> None:
        self.keys = Keys(scene)
        self.role: Role = role
        self.name = name
        self.session_id = session_id or new_session_id()
        self.stop = threading.Event()
        self.last_status: Status | None = None
        self._live_key = self.keys.live(role, name)
        self._has_token = has_token
        self._connect_timeout = connect_timeout
        self._settings = settings or client_settings()
        identity = None if self._settings.tls is None else self._settings.tls.identity
        if identity is not None:
            identity.check(role, name, scene)
        self._status = status
        self._ready_file = ready_file
        self._hangs = False
        self._exit = ExitStack()
        self._session: zenoh.Session | None = None

    @property
    def scene(self) -> str:
        """Name of the scene."""
        return self.keys.scene

    @property
    def listens(self) -> bool:
        """Whether it is itself a router."""
        return self._settings.mode == "router"

    @property
    def session(self) -> zenoh.Session:
        """The open Zenoh session."""
        if self._session is None:
            raise RuntimeError("the component is not open")
        return self._session

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(stop_on_signals(self.stop))
            try:
                session = connect(self._settings, timeout=self._connect_timeout, given_up=self.stop)
            except TimeoutError:
                if not self.stop.is_set():
                    raise
                raise SystemExit(0) from None  # a signal arrived
            self._session = stack.enter_context(session)
            stack.callback(self.stop.set)
            if self._has_token:
                # The callback keeps a reference: garbage collection would undeclare the token.
                token = self.session.liveliness().declare_token(self._live_key)
                stack.callback(token.undeclare)
            publisher = declare_publisher(self.session, self.keys.stream("status", self.name), "status")
            closing = threading.Event()
            thread = threading.Thread(
                target=self._publish_status, args=(publisher, closing), name="status", daemon=True
            )
            thread.start()
            stack.callback(publisher.undeclare)
            stack.callback(thread.join, 2 * STATUS_PERIOD_S)
            stack.callback(closing.set)
            metrics.components.append(self)
            stack.callback(metrics.components.remove, self)
            self._exit = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._exit.close()

    def ready(self) -> None:
        """Signal that the process is ready, by the ready file or the line ``ready``."""
        self._exit.enter_context(announce_ready(self._ready_file))

    def status(self) -> Status:
        """Build the current Status; one that says why where the fields are no valid Status."""
        try:
            return self._compose(self._status())
        except Exception as error:  # an error in the callback must not end the Status thread
            _log.exception("the status of %s could not be determined", self.name)
            return self._compose(
                StatusFields(state="degraded", message=f"status unavailable: {error!r}"[:500])
            )

    def _compose(self, fields: StatusFields) -> Status:
        sent = vars(fields) | {"message": shown(fields.message)}
        self._hangs = sent.pop("hangs")
        sent["feature_names"] = fields.feature_names or None
        return Status(
            component=self.name,
            role=self.role,
            session=self.session_id,
            stamp_ns=time.time_ns(),
            version=_version(),
            host=socket.gethostname(),
            **sent,
        )

    def _publish_status(self, publisher: Publisher, closing: threading.Event) -> None:
        due = time.monotonic()
        while True:
            try:
                self.last_status = self.status()
                publisher.put(encode(self.last_status))
            except Exception:  # one Status less, but not the end of all
                if closing.is_set():  # the machine is so busy that the publisher has gone meanwhile
                    return
                _log.exception("no status of %s", self.name)
            if not self._hangs:
                beat(self._ready_file)
            if closing.is_set():
                return
            due = max(due + STATUS_PERIOD_S, time.monotonic())
            # A source says at its end how much it has sent; others have nothing to add.
            if closing.wait(due - time.monotonic()) and self.role != "source":
                return
