"""Typed subscriptions: valid messages, the last one at once, and never in the way of the session.

    with subscribe(scene="default") as updates:
        for update in updates:
            print(update.stamp_ns, len(update.hypotheses))

In asyncio the same object serves ``async with`` and ``async for``.
"""

import asyncio
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from types import TracebackType
from typing import Any, Generic, TypeAlias, overload

import zenoh

from comotion_schemas import DEFAULT_SCENE, HypothesisUpdate, Keys
from comotion_schemas.transport import DEFAULT_ENDPOINT, SessionSettings, TlsFiles, open_session

from .inbox import Closed
from .subscription import Counters, M, Subscription

__all__ = ["Closed", "Counters", "Subscribing", "Subscription", "connected", "subscribe"]

Endpoints: TypeAlias = str | Sequence[str]

_CONNECT_TRY_MS = 500


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
