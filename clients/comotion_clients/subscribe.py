"""Typed subscriptions: valid messages, the last one at once, and never in the way of the session.

    with subscribe(scene="default") as updates:
        for update in updates:
            print(update.stamp_ns, len(update.hypotheses))

In asyncio the same object serves ``async with`` and ``async for``.
"""

import asyncio
import threading
import time
from collections.abc import AsyncIterator, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Generic, Self, TypeAlias, TypeVar, overload

import zenoh

from comotion_schemas import (
    DEFAULT_SCENE,
    DecodeError,
    HypothesisUpdate,
    Keys,
    ObservationBatch,
    Status,
    TruthBatch,
    decode_as,
)
from comotion_schemas.keys import last_chunk
from comotion_schemas.qos import Kind
from comotion_schemas.transport import (
    DEFAULT_ENDPOINT,
    SessionSettings,
    TlsFiles,
    declare_subscriber,
    open_session,
)

from .inbox import Closed, Inbox

M = TypeVar("M", HypothesisUpdate, ObservationBatch, TruthBatch, Status)
Endpoints: TypeAlias = str | Sequence[str]

_KINDS: dict[type, Kind] = {
    HypothesisUpdate: "hypotheses",
    ObservationBatch: "obs",
    TruthBatch: "truth",
    Status: "status",
}
# Truth comes as a burst of everything that publishers keep for late joiners; none of it may drop.
_CAPACITIES: dict[type, int] = {HypothesisUpdate: 64, ObservationBatch: 1024, TruthBatch: 65536, Status: 256}
_RING = 1024
_CONNECT_TRY_MS = 500


@dataclass
class Counters:
    """What a subscription has seen.

    `received` valid messages; `lost` gaps in their sequence numbers; `stale` updates that were
    repeated or overtaken, and skipped; `invalid` payloads by the protocol's rejection reason.
    """

    received: int = 0
    lost: int = 0
    stale: int = 0
    invalid: dict[str, int] = field(default_factory=dict)


class Subscription(Generic[M]):
    """The messages of one kind in one scene, within an open session.

    A thread takes them from a ring inside Zenoh, checks them, and leaves them in a bounded inbox:
    a reader that is too slow loses the oldest (:attr:`dropped`) and delays nobody. Invalid payloads
    are counted and skipped.

    Parameters
    ----------
    session
        An open Zenoh session.
    message
        Which messages: HypothesisUpdate, ObservationBatch, TruthBatch or Status.
    scene
        Name of the scene.
    capacity
        Messages kept for the reader; 1: only the newest is of interest. None: by kind.
    timeout
        Seconds that iteration waits for the next message before it raises TimeoutError; None: for ever.

    Raises
    ------
    ValueError
        If the scene is no valid name.
    """

    def __init__(
        self,
        session: zenoh.Session,
        message: type[M],
        scene: str = DEFAULT_SCENE,
        *,
        capacity: int | None = None,
        timeout: float | None = None,
    ) -> None:
        kind, keys = _KINDS[message], Keys(scene)
        self.counters = Counters()
        self.timeout = timeout
        self._message: type[M] = message
        self._scene = scene
        self._newest: dict[str, tuple[str, int]] = {}
        self._inbox: Inbox[tuple[float, M]] = Inbox(_CAPACITIES[message] if capacity is None else capacity)
        key = keys.hypotheses if kind == "hypotheses" else keys.streams(kind)
        size = max(_RING, _CAPACITIES[message])
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(size)
        self._subscriber = declare_subscriber(session, key, kind, ring)
        self._thread = threading.Thread(target=self._receive, name=f"subscribe-{kind}", daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Messages that gave way to newer ones because the reader was too slow."""
        return self._inbox.dropped

    def get(self, timeout: float | None = None) -> M:
        """Wait for the next message.

        Raises
        ------
        TimeoutError
            If none came within `timeout` seconds (None: waits for ever).
        Closed
            If the subscription was closed.
        """
        return self._inbox.get(timeout)[1]

    def drain(self) -> list[tuple[float, M]]:
        """Take what is there, without waiting: (time of arrival by ``time.monotonic()``, message)."""
        found: list[tuple[float, M]] = []
        while True:
            try:
                found.append(self._inbox.get(0.0))
            except (TimeoutError, Closed):
                return found

    def __iter__(self) -> Iterator[M]:
        return self

    def __next__(self) -> M:
        try:
            return self._inbox.get(self.timeout)[1]
        except Closed:
            raise StopIteration from None

    def __aiter__(self) -> AsyncIterator[M]:
        return self

    async def __anext__(self) -> M:
        try:
            return (await self._inbox.aget(self.timeout))[1]
        except Closed:
            raise StopAsyncIteration from None

    def close(self) -> None:
        """Stop receiving; iteration ends after what was received."""
        if self._thread.is_alive():
            self._subscriber.undeclare()
            self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _receive(self) -> None:
        # The handler, not the subscriber: one that waits in its own recv cannot be undeclared.
        samples = self._subscriber.handler
        try:
            while True:
                try:
                    sample = samples.recv()
                except zenoh.ZError:  # undeclared, or the session is closed
                    return
                self._accept(str(sample.key_expr), sample.payload.to_bytes())
        finally:
            self._inbox.close()

    def _accept(self, key: str, payload: bytes) -> None:
        try:
            message = decode_as(self._message, payload)
            if _publisher(message) != (
                self._scene if isinstance(message, HypothesisUpdate) else last_chunk(key)
            ):
                raise DecodeError("source-mismatch", f"published on {key}")
        except DecodeError as error:
            self.counters.invalid[error.reason] = self.counters.invalid.get(error.reason, 0) + 1
            return
        if self._is_new(message):
            self.counters.received += 1
            self._inbox.put((time.monotonic(), message))

    def _is_new(self, message: M) -> bool:
        """Follow the sequence numbers; an update that is repeated or overtaken says nothing new."""
        if not isinstance(message, HypothesisUpdate | ObservationBatch):
            return True
        name = _publisher(message)
        session, newest = self._newest.get(name, ("", 0))
        if session == message.session:
            if message.seq <= newest:
                self.counters.stale += isinstance(message, HypothesisUpdate)
                return isinstance(message, ObservationBatch)
            self.counters.lost += message.seq - newest - 1
        self._newest[name] = (message.session, message.seq)
        return True


def _publisher(message: HypothesisUpdate | ObservationBatch | TruthBatch | Status) -> str:
    """Who says it published this, in the words of the key."""
    match message:
        case HypothesisUpdate():
            return message.scene
        case Status():
            return message.component
        case _:
            return message.source


class Subscribing(Generic[M]):
    """Opens a session and a subscription in it; a context manager, also for ``async with``."""

    def __init__(
        self,
        message: type[M],
        scene: str,
        connect: Endpoints,
        timeout: float | None,
        capacity: int | None,
        tls: TlsFiles | None,
    ) -> None:
        endpoints = (connect,) if isinstance(connect, str) else tuple(connect)
        self._settings = SessionSettings(connect=endpoints, tls=tls)
        self._scene = Keys(scene).scene
        self._message: type[M] = message
        self._timeout = timeout
        self._capacity = capacity
        self._given_up = threading.Event()
        self._exit = ExitStack()

    def __enter__(self) -> Subscription[M]:
        with ExitStack() as stack:
            session = stack.enter_context(connected(self._settings, self._timeout, self._given_up))
            subscription = Subscription(
                session, self._message, self._scene, capacity=self._capacity, timeout=self._timeout
            )
            stack.enter_context(subscription)
            self._exit = stack.pop_all()
        return subscription

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._exit.close()

    async def __aenter__(self) -> Subscription[M]:
        try:
            return await asyncio.to_thread(self.__enter__)
        except asyncio.CancelledError:
            self._given_up.set()
            raise

    async def __aexit__(self, *exception: object) -> None:
        await asyncio.to_thread(self._exit.close)


def connected(
    settings: SessionSettings, timeout: float | None = None, given_up: threading.Event | None = None
) -> zenoh.Session:
    """Open a session, waiting for a router that is not there yet; Ctrl-C ends the wait.

    Raises
    ------
    TimeoutError
        If no router answered within `timeout` seconds, or `given_up` was set.
    ValueError
        If an endpoint or certificate is wrong, so that waiting would not help.
    """
    deadline = None if timeout is None else time.monotonic() + timeout
    # Zenoh's own unlimited connect cannot be interrupted; short tries in a loop can. Once connected,
    # the session reconnects by itself for ever.
    once = {
        "endpoints": list(settings.connect),
        "timeout_ms": _CONNECT_TRY_MS,
        "exit_on_failure": True,
        "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 1.5},
    }
    given_up = given_up or threading.Event()
    while True:
        try:
            return open_session(settings, {"connect": once})
        except zenoh.ZError as error:
            reason = str(error).split(" at /")[0]
            if "Unable to connect" not in reason:
                raise ValueError(f"cannot connect to {', '.join(settings.connect)}: {reason}") from None
        if given_up.wait(0.1) or (deadline is not None and time.monotonic() > deadline):
            raise TimeoutError(f"no router answers at {', '.join(settings.connect)}")


@overload
def subscribe(
    scene: str = ...,
    connect: Endpoints = ...,
    *,
    timeout: float | None = ...,
    capacity: int | None = ...,
    tls: TlsFiles | None = ...,
) -> Subscribing[HypothesisUpdate]: ...


@overload
def subscribe(
    scene: str = ...,
    connect: Endpoints = ...,
    *,
    message: type[M],
    timeout: float | None = ...,
    capacity: int | None = ...,
    tls: TlsFiles | None = ...,
) -> Subscribing[M]: ...


def subscribe(
    scene: str = DEFAULT_SCENE,
    connect: Endpoints = DEFAULT_ENDPOINT,
    *,
    message: type[Any] = HypothesisUpdate,
    timeout: float | None = None,
    capacity: int | None = None,
    tls: TlsFiles | None = None,
) -> Subscribing[Any]:
    """Subscribe to the hypotheses of a scene, or to another of its messages.

    Parameters
    ----------
    scene
        Name of the scene.
    connect
        Endpoint of the router, or several.
    message
        HypothesisUpdate: the last one comes at once, and none comes twice or out of order.
        TruthBatch and Status: what was published before comes first. ObservationBatch: live only.
    timeout
        Seconds to wait for the router, and for each next message; None: for ever.
    capacity
        Messages kept for a slow reader; 1: only the newest. None: 64 updates, more of the others.
    tls
        Certificates of a mutual TLS link.

    Raises
    ------
    TimeoutError
        On entering when no router answers, from the iterator when no message comes.
    ValueError
        If the scene is no valid name, or an endpoint is wrong.
    """
    return Subscribing(message, scene, connect, timeout, capacity, tls)
