"""Keeps the payloads of each source in a queue of its own, bounded in batches and in bytes.

A thread takes payloads from Zenoh as they come, while an update is computed too. A source that floods
displaces its own data. Payloads without a valid name, or of one source too many, share one queue.
"""

import threading
import time
from collections import deque
from dataclasses import dataclass, field
from itertools import islice

import zenoh

from comotion_schemas import Keys
from comotion_schemas.keys import publisher_of
from comotion_schemas.transport import Receiver
from comotion_schemas.types import is_name

from ..event_time.release import Load
from ..event_time.sources import MAX_SOURCES

# Without data for so long a source is silent, and gives way to one too many.
_SILENT_NS = 1_000_000_000
# Payloads of all sources between Zenoh and the thread, which takes some 300,000 a second.
_RING = 16_384
# Bounds of the queue of a source, in batches and bytes; and bytes of all, of which each then has its share.
_MOST_BATCHES = 1024
_MOST_BYTES, _ALL_BYTES = 32 * 1024 * 1024, 256 * 1024 * 1024
# Sources of which nothing was read before, in one turn of the loop: two milliseconds of work.
_NEW_AT_ONCE = 16
OTHERS = ""
"""Name of the queue of sources without one of their own."""


Payload = tuple[str, bytes]
"""The name in a key, and the bytes that have come on it."""


@dataclass
class Queue:
    """The payloads of one source that wait to be read."""

    used_ns: int = 0
    """When something came last, on the monotonic clock."""
    received: int = 0
    """Valid batches that were read."""
    waiting: deque[Payload] = field(default_factory=deque)
    """The payloads."""
    displaced: int = 0
    """Payloads that gave way to later ones since the last one was read."""


class Queues:
    """The subscription to the observations of a scene, and a queue for each of :data:`MAX_SOURCES`.

    `of` are the queues by name, the one heard last at the end.
    """

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self._lock = threading.Lock()
        self._load = Load(_MOST_BATCHES, _MOST_BYTES, _ALL_BYTES)
        self.of = {OTHERS: Queue()}
        Receiver(session, keys.streams("obs"), "obs", _RING, self._add)  # until the session is closed

    def active(self) -> dict[str, Queue]:
        """Queues in which payloads wait; of those of which nothing valid was read, the first ones.

        The shared queue is always read, however many names a sender takes: what is refused there shows it.
        """
        with self._lock:
            waiting = {name: queue for name, queue in self.of.items() if queue.waiting}
        valid = {name: queue for name, queue in waiting.items() if queue.received or name == OTHERS}
        new = (item for item in waiting.items() if item[0] not in valid)
        return valid | dict(islice(new, _NEW_AT_ONCE))

    def take(self, name: str) -> tuple[Payload, int]:
        """Take the oldest payload of a queue, and how many were displaced before it."""
        with self._lock:
            queue = self.of[name]
            displaced, queue.displaced = queue.displaced, 0
            return self._pop(name, queue), displaced

    def received(self) -> dict[str, int]:
        """Valid batches of every source."""
        with self._lock:
            return {name: queue.received for name, queue in self.of.items() if name != OTHERS}

    def heard_ns(self) -> int:
        """When something of any source came last, on the monotonic clock; 0: never."""
        with self._lock:
            return max(queue.used_ns for queue in self.of.values())

    def _add(self, key: str, content: bytes) -> None:
        """Let a payload wait; called in the thread."""
        name, now_ns = publisher_of(key), time.monotonic_ns()
        with self._lock:
            owner = name if name in self.of or self._admits(name, now_ns) else OTHERS
            self.of[owner] = queue = self.of.pop(owner, None) or Queue()
            queue.used_ns = now_ns
            # The newest has a place in any case.
            while queue.waiting and not self._load.admits(owner, len(content)):
                self._pop(owner, queue)
                queue.displaced += 1
            queue.waiting.append((name, content))
            self._load.add(owner, len(content))

    def _pop(self, owner: str, queue: Queue) -> Payload:
        payload = queue.waiting.popleft()
        self._load.add(owner, len(payload[1]), -1)
        return payload

    def _admits(self, name: str, now_ns: int) -> bool:
        if not is_name(name) or len(self.of) <= MAX_SOURCES:
            return is_name(name)
        oldest = next(source for source in self.of if source != OTHERS)
        if self.of[oldest].waiting or now_ns - self.of[oldest].used_ns <= _SILENT_NS:
            return False
        del self.of[oldest]
        return True
