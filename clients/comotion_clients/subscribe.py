"""Subscribes to validated messages of a scene, in a session of its own.

Example::

    with subscribe(scene="default") as updates:
        for update in updates:
            print(update.stamp_ns, len(update.hypotheses))

In asyncio the same object supports ``async with`` and ``async for``.
"""

import asyncio
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Generic, TypeAlias

import zenoh

from comotion_schemas import DEFAULT_SCENE, HypothesisUpdate, Keys, transport
from comotion_schemas.inbox import Closed
from comotion_schemas.tls import TlsFiles
from comotion_schemas.transport import client_settings

from .subscription import Counters, M, Subscription

__all__ = ["Closed", "Counters", "Subscribing", "Subscription", "subscribe"]

Endpoints: TypeAlias = str | Sequence[str]


class Subscribing(Generic[M]):
    """Opens a session and a subscription; a context manager, also for ``async with``."""

    def __init__(
        self,
        open_session: Callable[..., zenoh.Session],
        subscription: Callable[[zenoh.Session], Subscription[M]],
    ) -> None:
        self._open = open_session
        self._subscription: Callable[[zenoh.Session], Subscription[M]] = subscription
        self._given_up = threading.Event()
        self._exit = ExitStack()

    def __enter__(self) -> Subscription[M]:
        with ExitStack() as stack:
            session = stack.enter_context(self._open(given_up=self._given_up))
            subscription = stack.enter_context(self._subscription(session))
            self._exit = stack.pop_all()
        return subscription

    def __exit__(self, *exception: object) -> None:
        self._exit.close()

    async def __aenter__(self) -> Subscription[M]:
        try:
            return await asyncio.to_thread(self.__enter__)
        except asyncio.CancelledError:
            self._given_up.set()
            raise

    async def __aexit__(self, *exception: object) -> None:
        await asyncio.to_thread(self._exit.close)


def subscribe(
    scene: str = DEFAULT_SCENE,
    connect: Endpoints | None = None,
    *,
    message: type[M] = HypothesisUpdate,  # type: ignore[assignment]
    timeout: float | None = None,
    capacity: int | None = None,
    tls: TlsFiles | Path | str | None = None,
) -> Subscribing[M]:
    """Subscribe to the hypotheses of a scene, or to another of its messages.

    Parameters
    ----------
    scene
        Name of the scene.
    connect
        Endpoint of the router, or several; None: the router of this machine.
    message
        Message type. HypothesisUpdate: the last update comes at once, and none comes twice or out of
        order. TruthBatch and Status: cached messages come first. ObservationBatch: only new ones.
    timeout
        Seconds to wait for the router, and for each message; None: no limit.
    capacity
        Messages kept for a slow reader; 1: only the newest. None: 64 updates, or more of other types.
    tls
        Certificates of a mutual TLS link, or the folder that ``comotion pki issue`` has written. None: the
        folder named by ``COMOTION_TLS`` in the environment, if there is one.

    Raises
    ------
    TimeoutError
        On entry if no router answers; from the iterator if no message arrives.
    ValueError
        If the scene name or an endpoint is not valid, or the folder of the certificate is not.
    """
    settings = client_settings(connect, tls)
    scene = Keys(scene).scene
    return Subscribing(
        partial(transport.connect, settings, timeout=timeout),
        partial(Subscription, message=message, scene=scene, capacity=capacity, timeout=timeout),
    )
