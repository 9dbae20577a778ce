"""What a source receives: from Zenoh's thread to its own, or when it asks."""

import queue
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import zenoh

from comotion_schemas import DecodeError, Message, decode_on
from comotion_schemas.component import Component
from comotion_schemas.keys import Kind
from comotion_schemas.transport import SessionSettings, declare_subscriber, open_session

from .runtime import SourcePublisher

_CAPACITY = 2000
"""Samples: 4 s of a robot that reports at 500 Hz."""
_IDLE_S = 0.1
"""Interval between two None while nothing arrives, s."""


class Received:
    """Takes samples without blocking Zenoh's thread; drops new ones when full, counted as ``lost``.

    Iteration yields (key, payload, time of receipt in ns) until the source stops, and None every 0.1 s while
    nothing arrives, so that the caller can send what it holds back.
    """

    def __init__(self, source: SourcePublisher) -> None:
        self._source = source
        self._queue: queue.SimpleQueue[tuple[str, bytes, int]] = queue.SimpleQueue()

    def receive(self, sample: zenoh.Sample) -> None:
        """Take a sample; the handler of a subscriber."""
        if self._queue.qsize() >= _CAPACITY:
            self._source.count("lost")
            return
        self._queue.put((str(sample.key_expr), sample.payload.to_bytes(), time.time_ns()))

    def __iter__(self) -> Iterator[tuple[str, bytes, int] | None]:
        while not self._source.stop.is_set():
            try:
                yield self._queue.get(timeout=_IDLE_S)
            except queue.Empty:
                yield None


@contextmanager
def subscribed(
    source: SourcePublisher, key: str, settings: SessionSettings | None = None
) -> Iterator[Received]:
    """Subscribe to a key expression for a source that is entered; yields what is received.

    Parameters
    ----------
    source
        Counts what is lost.
    key
        The key expression.
    settings
        How to connect to the router of another network; None: in the session of the source.
    """
    received = Received(source)
    with ExitStack() as stack:
        session = source.component.session
        if settings is not None:
            session = stack.enter_context(open_session(settings))
        stack.callback(session.declare_subscriber(key, received.receive).undeclare)
        yield received


class Polled:
    """Messages of a key that are taken when they are asked for; of those that wait the oldest are dropped.

    Parameters
    ----------
    component
        Whose session is used.
    key, kind
        What is received; messages that are invalid or not of this key are left out.
    capacity
        Messages that wait.
    """

    def __init__(self, component: Component, key: str, kind: Kind, capacity: int) -> None:
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(capacity)
        self._subscriber: Any = declare_subscriber(component.session, key, kind, ring)

    def take(self) -> Iterator[Message]:
        """Yield what has arrived since the last call."""
        while (sample := self._subscriber.handler.try_recv()) is not None:
            try:
                message = decode_on(str(sample.key_expr), sample.payload.to_bytes())
            except DecodeError:
                continue
            yield message

    def close(self) -> None:
        """End the subscription."""
        self._subscriber.undeclare()
