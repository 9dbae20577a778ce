"""What a source receives: from Zenoh's thread to its own, when it asks."""

import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Any

import zenoh

from comotion_schemas import DecodeError, Message, decode_on
from comotion_schemas.keys import Kind
from comotion_schemas.transport import declare_subscriber

Arrival = tuple[str, bytes, int]
"""Key, payload, and time of receipt in ns since the Unix epoch."""


class Inbox:
    """Keeps the samples of a key expression until they are taken; Zenoh's thread never waits.

    Parameters
    ----------
    session
        The session to receive in.
    key, kind
        The key expression, and the kind of a stream of comotion; None: it is of another protocol.
    capacity
        Samples that wait; of more the oldest are dropped. By default 4 s of a robot that reports at 500 Hz.

    Attributes
    ----------
    lost
        Number of samples that were dropped.
    """

    def __init__(
        self, session: zenoh.Session, key: str, kind: Kind | None = None, capacity: int = 2000
    ) -> None:
        self.lost = 0
        self._waiting: deque[Arrival] = deque(maxlen=capacity)
        self._arrived = threading.Event()
        subscriber: Any = (
            session.declare_subscriber(key, self._receive)
            if kind is None
            else declare_subscriber(session, key, kind, self._receive)
        )
        self.close = subscriber.undeclare

    def wait(self, seconds: float) -> bool:
        """Wait until a sample has arrived since the last :meth:`take`; False after a number of seconds."""
        return self._arrived.wait(seconds)

    def take(self) -> Iterator[Arrival]:
        """Yield what has arrived."""
        self._arrived.clear()
        while self._waiting:
            yield self._waiting.popleft()

    def messages(self) -> Iterator[Message]:
        """Yield the messages that have arrived; one that is invalid or not of its key is left out."""
        for key, payload, _ in self.take():
            try:
                message = decode_on(key, payload)
            except DecodeError:
                continue
            yield message

    def until(self, stop: threading.Event, idle_s: float = 0.1) -> Iterator[Arrival | None]:
        """Yield what arrives until an event is set, and None after each `idle_s` without anything."""
        while not stop.is_set():
            if not self.wait(idle_s):
                yield None
            for arrival in self.take():
                yield arrival
                # What waits may take long.
                if stop.is_set():
                    return

    def _receive(self, sample: zenoh.Sample) -> None:
        self.lost += len(self._waiting) == self._waiting.maxlen
        self._waiting.append((str(sample.key_expr), sample.payload.to_bytes(), time.time_ns()))
        self._arrived.set()
