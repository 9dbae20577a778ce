"""Everything that a scene publishes, as it arrives: exact payloads, bounded memory.

A thread per kind takes the samples from a ring inside Zenoh at once, so that the time of receipt is
right and the ring does not overflow while the disk is slow. What then waits is bounded in bytes:
beyond that the newest payloads are dropped, and counted.
"""

import threading
import time
from collections import deque
from typing import Any, Self

import zenoh
from zenoh.handlers import RingChannel

from comotion_schemas import QOS, Keys
from comotion_schemas.qos import Kind
from comotion_schemas.recording import key_of
from comotion_schemas.transport import declare_subscriber

from .series import Arrival

MAX_WAITING_BYTES = 256 * 1024 * 1024
# Truth comes as a burst of all that publishers keep for late joiners; previews are large.
_RINGS: dict[Kind, int] = {"truth": 65536, "preview": 64}
_RING = 8192


class Waiting:
    """Payloads between the threads that receive and the one that writes.

    Parameters
    ----------
    limit
        Bytes kept; what comes when it is full is dropped and counted by key in :attr:`dropped`.
    """

    def __init__(self, limit: int = MAX_WAITING_BYTES) -> None:
        self.dropped: dict[str, int] = {}
        self._limit = limit
        self._bytes = 0
        self._items: deque[Arrival] = deque()
        self._changed = threading.Condition()

    def put(self, arrival: Arrival) -> None:
        """Add a payload from any thread."""
        with self._changed:
            if self._bytes + len(arrival.payload) > self._limit:
                self.dropped[arrival.key] = self.dropped.get(arrival.key, 0) + 1
                return
            self._bytes += len(arrival.payload)
            self._items.append(arrival)
            self._changed.notify()

    def take(self, timeout: float) -> list[Arrival]:
        """Take what is there; waits up to `timeout` seconds for the first."""
        with self._changed:
            self._changed.wait_for(lambda: self._items, timeout)
            items = list(self._items)
            self._items.clear()
            self._bytes = 0
            return items


class Intake:
    """Subscribes to every kind of message of a scene; a context manager."""

    def __init__(self, session: zenoh.Session, keys: Keys, waiting: Waiting) -> None:
        self._waiting = waiting
        self._subscribers: list[Any] = []
        self._threads: list[threading.Thread] = []
        for kind in QOS:
            ring: RingChannel[zenoh.Sample] = RingChannel(_RINGS.get(kind, _RING))
            subscriber = declare_subscriber(session, key_of(keys, kind), kind, ring)
            # The handler, not the subscriber: one that waits in its own recv cannot be undeclared.
            thread = threading.Thread(
                target=self._receive, args=(kind, subscriber.handler), name=f"record-{kind}", daemon=True
            )
            thread.start()
            self._subscribers.append(subscriber)
            self._threads.append(thread)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        for subscriber in self._subscribers:
            subscriber.undeclare()
        for thread in self._threads:
            thread.join()

    def _receive(self, kind: Kind, samples: Any) -> None:
        while True:
            try:
                sample = samples.recv()
            except zenoh.ZError:  # undeclared, or the session is closed
                return
            self._waiting.put(Arrival(kind, str(sample.key_expr), time.time_ns(), sample.payload.to_bytes()))
