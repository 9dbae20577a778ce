"""Zenoh sessions, publishers and subscribers with the settings of the protocol.

Only this module and :mod:`~comotion_schemas.component` import zenoh.
"""

import atexit
import json
import logging
import socket
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, get_args

import zenoh
import zenoh.ext

from .errors import KnownError
from .keys import HEARTBEAT_S, QOS, Keys, Kind, PriorityName, StreamKind
from .tls import ENCRYPTED, TlsFiles, find_tls, require_encryption, warn_of_expiry

LOOPBACK = "127.0.0.1"
DEFAULT_ENDPOINT = f"tcp/{LOOPBACK}:7447"
DEFAULT_TLS_ENDPOINT = "tls/localhost:7447"
TRANSPORT_LIMIT = 32 * 1024 * 1024
"""Above the limit of the codec, so that the receiver rejects an oversized message with a reason."""
LEASE_MS = 2000
"""Time after which Zenoh declares a silent link dead."""
OPEN_TIMEOUT_MS = 3000
"""Ends an attempt that began while a link was cut; with the 10 s of Zenoh a cut of 5 s lasted 12."""
WAIT_BEFORE_DROP_US = 50_000
"""With the 1 ms of Zenoh, batches are dropped whenever a loaded machine schedules the sender late; with 10 ms
one or two of 700 were, over TLS, beside a source that sends 8 MB/s."""
QUEUE_SIZE = 16
"""Packets of each priority that wait for a link, the most that Zenoh takes; an express message is one. With
the 2 of Zenoh a source of 100 Hz lost one in a hundred where processes wait for 10 ms now and then."""
_CONNECT_TRY_MS = 500  # a signal is handled between two tries
_RETRY = {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5}
_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class SessionSettings:
    """Endpoints that a process connects to or listens on.

    Clients connect to a router; only a router listens.

    Raises
    ------
    ValueError
        If there is a certificate and an endpoint without encryption, or the other way round.
    """

    mode: Literal["client", "router"] = "client"
    connect: Sequence[str] = (DEFAULT_ENDPOINT,)
    listen: Sequence[str] = ()
    tls: TlsFiles | None = None

    def __post_init__(self) -> None:
        require_encryption([*self.connect, *self.listen], wanted=self.tls is not None)


def client_settings(
    connect: str | Sequence[str] | None = None, tls: TlsFiles | Path | str | None = None
) -> SessionSettings:
    """Settings of a client.

    It connects to the endpoints of routers, None: the router of this machine. `tls` are certificates of a
    mutual TLS link, or the folder that ``comotion pki issue`` has written; None: the folder named by
    ``COMOTION_TLS`` in the environment, if there is one.

    Raises
    ------
    ValueError
        If the folder is not valid, the certificate has expired, or an endpoint does not fit.
    """
    files = find_tls(tls)
    default = DEFAULT_ENDPOINT if files is None else DEFAULT_TLS_ENDPOINT
    given: Any = connect or default
    several = isinstance(given, Sequence) and not isinstance(given, str)
    return SessionSettings(connect=tuple(given if several else (given,)), tls=files)


def free_port() -> int:
    """Return an unused TCP port of this machine."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class Publisher(Protocol):
    """Interface of plain and cached Zenoh publishers."""

    def put(self, payload: bytes) -> None:
        """Publish a payload; without a connection it is dropped silently."""

    def undeclare(self) -> None:
        """Undeclare the publisher."""


def zenoh_config(settings: SessionSettings) -> dict[str, Any]:
    """Build the Zenoh configuration as a tree of its JSON5 format."""
    config: dict[str, Any] = {
        "mode": settings.mode,
        "connect": {
            "endpoints": list(settings.connect),
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": 50, "period_max_ms": 1000, "period_increase_factor": 1.5},
        },
        "listen": {"endpoints": list(settings.listen)},
        # A router would wait for half a second for what scouting finds.
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}, "delay": 1},
        # Cached publishers require time stamps.
        "timestamping": {"enabled": True},
        "transport": {
            # Shared memory leaks across publisher restarts.
            "shared_memory": {"enabled": False},
            "unicast": {"open_timeout": OPEN_TIMEOUT_MS, "accept_timeout": OPEN_TIMEOUT_MS},
            "link": {
                "tx": {
                    "lease": LEASE_MS,
                    "queue": {
                        "size": {name.lower(): QUEUE_SIZE for name in get_args(PriorityName)},
                        "congestion_control": {"drop": {"wait_before_drop": WAIT_BEFORE_DROP_US}},
                    },
                },
                "rx": {"max_message_size": TRANSPORT_LIMIT},
            },
        },
    }
    if settings.mode == "router":
        config |= _described(settings)
    if settings.tls is not None:
        config["transport"]["link"]["tls"] = _tls(settings.tls, settings.mode)
        config["transport"]["link"]["protocols"] = list(ENCRYPTED)
    return config


def _described(settings: SessionSettings) -> dict[str, Any]:
    """`comotion status` asks routers to describe themselves; nobody may change them."""
    identity = None if settings.tls is None else settings.tls.identity
    return {
        "adminspace": {"enabled": True, "permissions": {"read": True, "write": False}},
        "metadata": {
            "name": "" if identity is None else identity.name,
            "host": socket.gethostname(),
            "dials": len(settings.connect),
        },
    }


def _tls(tls: TlsFiles, mode: str) -> dict[str, Any]:
    # A router that connects to another one needs a certificate in that direction too.
    directions = ("connect",) if mode == "client" else ("listen", "connect")
    return {
        "root_ca_certificate": str(tls.root_ca),
        **{f"{direction}_certificate": str(tls.certificate) for direction in directions},
        **{f"{direction}_private_key": str(tls.key) for direction in directions},
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


def open_session(settings: SessionSettings, overrides: dict[str, Any] | None = None) -> zenoh.Session:
    """Open a session; use it as a context manager, otherwise the process hangs at exit.

    `overrides` are top-level keys of the Zenoh configuration to add or replace, e.g. ``access_control``.
    """
    config = zenoh_config(settings) | (overrides or {})
    return zenoh.open(zenoh.Config.from_json5(json.dumps(config)))


def connect(
    settings: SessionSettings,
    *,
    timeout: float | None = None,
    given_up: threading.Event | None = None,
) -> zenoh.Session:
    """Open a session and wait until a router is available; Ctrl-C ends the wait.

    `timeout` is in s, None: no limit; `given_up` ends the wait when set, from another thread.

    Raises
    ------
    TimeoutError
        If no router answers in time, or `given_up` is set.
    ValueError
        If an endpoint or certificate is wrong.
    """
    if settings.tls is not None:
        warn_of_expiry(settings.tls)
    endpoints = ", ".join(settings.connect)
    deadline = None if timeout is None else time.monotonic() + timeout
    # An unlimited connect of Zenoh cannot be interrupted, so short tries run in a loop. Once connected,
    # the session reconnects by itself without a time limit.
    once = {"timeout_ms": _CONNECT_TRY_MS, "exit_on_failure": True, "retry": _RETRY}
    overrides = {"connect": {"endpoints": list(settings.connect), **once}}
    given_up = given_up or threading.Event()
    waiting = False
    while not given_up.is_set() and (deadline is None or time.monotonic() < deadline or not waiting):
        began = time.monotonic()
        try:
            return open_session(settings, overrides)
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]
            if "Unable to connect" not in reason:
                raise KnownError(f"cannot open a session at {endpoints}: {reason}") from None
        if not waiting and deadline is None:
            _log.warning("waiting for a router at %s; 'comotion router' starts one", endpoints)
        waiting = True
        given_up.wait(max(0.0, began + 0.2 - time.monotonic()))
    raise TimeoutError(f"no router answers at {endpoints}; 'comotion router' starts one")


def declare_publisher(session: zenoh.Session, key: str, kind: Kind) -> Publisher:
    """Declare a publisher with the quality of service of a kind of key."""
    qos = QOS[kind]
    options: dict[str, Any] = {
        "encoding": qos.encoding,
        "congestion_control": zenoh.CongestionControl.DROP,
        "priority": getattr(zenoh.Priority, qos.priority),
        "express": qos.express,
        "reliability": zenoh.Reliability.RELIABLE if qos.reliable else zenoh.Reliability.BEST_EFFORT,
    }
    if not qos.cache:
        return session.declare_publisher(key, **options)
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        cache=zenoh.ext.CacheConfig(max_samples=qos.cache),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=HEARTBEAT_S, sporadic_heartbeat=None),
        publisher_detection=True,
        **options,
    )


def declare_subscriber(session: zenoh.Session, key: str, kind: Kind, handler: Any) -> Any:
    """Declare a subscriber; for a cached kind it also gets the samples that publishers keep."""
    qos = QOS[kind]
    if not qos.cache:
        return session.declare_subscriber(key, handler)
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        handler,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=qos.cache),
        recovery=zenoh.ext.RecoveryConfig(heartbeat=True, periodic_queries=None),
        subscriber_detection=True,
    )


class Receiver:
    """Receives the samples of a kind of key in a thread, from a ring that drops the oldest when it is full.

    Parameters
    ----------
    session, key, kind
        As for :func:`declare_subscriber`.
    capacity
        Samples that the ring keeps.
    take
        Called in the thread with the key and the payload of each sample.
    ended
        Called in the thread when no more samples come.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        kind: Kind,
        capacity: int,
        take: Callable[[str, bytes], None],
        ended: Callable[[], None] = lambda: None,
    ) -> None:
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(capacity)
        self._subscriber = declare_subscriber(session, key, kind, ring)
        self._take, self._ended = take, ended
        self._thread = threading.Thread(target=self._receive, name=f"receive-{kind}", daemon=True)
        self._thread.start()
        # A thread that still waits in Zenoh when Python ends would be ended by force, and abort the process.
        atexit.register(self.close)

    def close(self) -> None:
        """Stop receiving; returns when all samples are taken."""
        if self._thread.is_alive():
            with suppress(zenoh.ZError):  # the session has been closed meanwhile
                self._subscriber.undeclare()
        self._thread.join()
        atexit.unregister(self.close)

    def _receive(self) -> None:
        # Receive from the handler: a subscriber that waits in recv cannot be undeclared.
        samples = self._subscriber.handler
        try:
            while True:
                try:
                    sample = samples.recv()
                except zenoh.ZError:  # undeclared, or the session is closed
                    return
                self._take(str(sample.key_expr), sample.payload.to_bytes())
        finally:
            self._ended()


def stream_publisher(session: zenoh.Session, keys: Keys, kind: StreamKind, name: str) -> Publisher:
    """Declare the publisher of a named stream in a scene."""
    return declare_publisher(session, keys.stream(kind, name), kind)
