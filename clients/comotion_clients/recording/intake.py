"""Receives all messages of a scene: Zenoh samples -> exact payloads with their time of receipt.

One thread per kind of message takes samples from a ring in Zenoh at once. The time of receipt is
therefore right, and a slow disk does not make the ring overflow. The pending payloads have a limit in
bytes; when it is reached, new payloads are dropped and counted.
"""

import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial

import zenoh

from comotion_schemas import QOS, Keys
from comotion_schemas.keys import Kind
from comotion_schemas.transport import Receiver

from .series import Arrival

MAX_PENDING_BYTES = 256 * 1024 * 1024
# Truth arrives as a burst, since publishers cache it for late joiners; previews are large.
_RING_SAMPLES: dict[Kind, int] = {"truth": 65536, "preview": 64}
_DEFAULT_RING_SAMPLES = 8192


class PendingPayloads:
    """Queue of payloads between the receiving threads and the writing thread.

    Parameters
    ----------
    limit
        Most bytes kept; further payloads are dropped and counted by key in :attr:`dropped`.
    """

    def __init__(self, limit: int = MAX_PENDING_BYTES) -> None:
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
        """Return all pending payloads; waits up to `timeout` seconds for the first."""
        with self._changed:
            self._changed.wait_for(lambda: self._items, timeout)
            items = list(self._items)
            self._items.clear()
            self._bytes = 0
            return items


@contextmanager
def receiving(session: zenoh.Session, keys: Keys, pending: PendingPayloads) -> Iterator[None]:
    """Put all kinds of messages of a scene into a queue, until the context ends."""
    with ExitStack() as stack:
        for kind in QOS:
            size = _RING_SAMPLES.get(kind, _DEFAULT_RING_SAMPLES)
            put = partial(_put, pending, kind)
            stack.callback(Receiver(session, keys.messages(kind), kind, size, put).close)
        yield


def _put(pending: PendingPayloads, kind: Kind, key: str, payload: bytes) -> None:
    pending.put(Arrival(kind, key, time.time_ns(), payload))
