"""Keeps the payloads of each source in a queue of its own, bounded in batches and in bytes.

A thread takes payloads from Zenoh as they come, while an update is computed too. A source that floods
displaces its own data. Payloads without a valid name, or of one source too many, share one queue.
"""

import threading
import time
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field
from itertools import islice

import zenoh

from comotion_schemas import Keys
from comotion_schemas.keys import last_chunk
from comotion_schemas.transport import Receiver
from comotion_schemas.types import is_name

# A source that has left is forgotten after this time without data; one too many displaces one that is silent.
IDLE_NS, _SILENT_NS = 10_000_000_000, 1_000_000_000
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
    """The payloads of one source that wait to be read.

    Attributes
    ----------
    used_ns
        When something came last, on the monotonic clock.
    received
        Valid batches that were read.
    waiting, size
        The payloads, and their bytes.
    displaced
        Payloads that gave way to later ones since the last one was read.
    """

    used_ns: int = 0
    received: int = 0
    waiting: deque[Payload] = field(default_factory=deque)
    size: int = 0
    displaced: int = 0

    def take(self) -> Payload:
        """Take the oldest payload."""
        name, content = self.waiting.popleft()
        self.size -= len(content)
        return name, content

    def bound(self, most_bytes: int) -> None:
        """Drop the oldest payloads beyond a bound; the newest stays."""
        while len(self.waiting) > _MOST_BATCHES or (self.size > most_bytes and len(self.waiting) > 1):
            self.take()
            self.displaced += 1


class Queues:
    """The subscription to the observations of a scene, and a queue for each of so many sources.

    `of` are the queues by name, the one heard last at the end.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, most: int) -> None:
        self._most = most
        self._lock = threading.Lock()
        self._size = 0
        self.of = {OTHERS: Queue()}
        self._receiver = Receiver(session, keys.streams("obs"), "obs", _RING, self._add)

    def active(self) -> dict[str, Queue]:
        """Queues in which payloads wait; of those of which nothing valid was read, the first ones.

        The shared queue is always read, however many names a sender takes: what is refused there shows it.
        """
        with self._lock:
            waiting = {name: queue for name, queue in self.of.items() if queue.waiting}
        read_before = {name: queue for name, queue in waiting.items() if queue.received or name == OTHERS}
        new = (item for item in waiting.items() if item[0] not in read_before)
        return read_before | dict(islice(new, _NEW_AT_ONCE))

    def take(self, queue: Queue) -> tuple[Payload, int]:
        """Take the oldest payload of a queue, and how many were displaced before it."""
        with self._lock:
            displaced, queue.displaced = queue.displaced, 0
            name, content = queue.take()
            self._size -= len(content)
            return (name, content), displaced

    def received(self) -> dict[str, int]:
        """Valid batches of every source."""
        with self._lock:
            return {name: queue.received for name, queue in self.of.items() if name != OTHERS}

    def heard_ns(self) -> int:
        """When something of any source came last, on the monotonic clock; 0: never."""
        with self._lock:
            return max(queue.used_ns for queue in self.of.values())

    def drop_idle(self, monotonic_ns: int, present: Collection[str]) -> None:
        """Forget sources that have sent nothing for some seconds, but those that are present."""
        with self._lock:
            for name, queue in list(self.of.items()):
                idle = monotonic_ns - queue.used_ns > IDLE_NS and not queue.waiting
                if idle and name not in {OTHERS, *present}:
                    del self.of[name]

    def close(self) -> None:
        """Stop receiving."""
        self._receiver.close()

    def _add(self, key: str, content: bytes) -> None:
        """Let a payload wait; called in the thread."""
        name, now_ns = last_chunk(key), time.monotonic_ns()
        with self._lock:
            queue = self._queue_of(name, now_ns)
            size = queue.size
            queue.waiting.append((name, content))
            queue.size += len(content)
            share = _ALL_BYTES // len(self.of) if self._size + len(content) > _ALL_BYTES else _MOST_BYTES
            queue.bound(min(share, _MOST_BYTES))
            self._size += queue.size - size

    def _queue_of(self, name: str, now_ns: int) -> Queue:
        """The queue of a source; of one too many, it takes the place of the one silent for longest."""
        queue = self.of.pop(name, None)
        if queue is None and not self._admits(name, now_ns):
            name, queue = OTHERS, self.of.pop(OTHERS)
        self.of[name] = queue = queue or Queue()
        queue.used_ns = now_ns
        return queue

    def _admits(self, name: str, now_ns: int) -> bool:
        """Whether a name may have a queue."""
        if not is_name(name) or len(self.of) <= self._most:
            return is_name(name)
        oldest = next(source for source in self.of if source != OTHERS)
        if self.of[oldest].waiting or now_ns - self.of[oldest].used_ns <= _SILENT_NS:
            return False
        del self.of[oldest]
        return True
