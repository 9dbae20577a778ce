"""Keeps the samples of each source in a bounded queue of its own.

With a ring per source, a source that floods cannot displace the others' data. What its ring displaces shows
as a gap in `seq`, and is counted as overflow. Rings count samples: a thread empties them all the time, while
an update is computed too, into queues that are bounded in bytes. A source is discovered by its first batch.
"""

import threading
import time
from collections import Counter, deque
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import zenoh
from zenoh.handlers import RingChannel

from comotion_schemas import Keys
from comotion_schemas.keys import last_chunk
from comotion_schemas.transport import declare_subscriber
from comotion_schemas.types import is_name

from .tokens import Tokens

# The ring of a source that has left is closed after this time without data.
IDLE_NS = 10_000_000_000
# A source that has sent nothing for this long gives way to another.
_SILENT_NS = 1_000_000_000
# Batches: a source of 1 kHz may wait a quarter of a second, more than two default periods.
_MOST_BATCHES = 256
# Between two times at which the rings are emptied.
_PULL_S = 0.02
# What of a source is kept to be read in its share of the time; also of all that have no ring yet.
_PENDING = 1024
_PENDING_BYTES = 32 * 1024 * 1024
# Time for opening rings in one turn of the loop; one is opened in any case.
_OPENING_NS = 2_000_000
# The first batches of all sources that start at once.
_DISCOVERY_RING = 1024
# What waits so long for its ring to be opened comes too late to be fused.
_EARLY_NS = 1_000_000_000


class _Early(NamedTuple):
    """A sample of a source that has no ring yet, and since when there was no time to open it; 0: not yet."""

    name: str
    sample: zenoh.Sample
    since_ns: int = 0


class Item(NamedTuple):
    """A sample; how many of its source were displaced right before it, None for nobody knows; its bytes."""

    sample: zenoh.Sample
    displaced: int | None
    size: int


@dataclass
class Ring:
    """What has come of one source and waits to be read.

    Attributes
    ----------
    used_ns, spent_ns
        When something of it was read, on the monotonic clock, and the time spent in this turn.
    after
        Samples up to this time stamp have been found by discovery.
    pending, size
        What waits, and its bytes.
    displaced
        Samples that gave way to later ones and are not accounted yet.
    """

    subscriber: Any
    used_ns: int
    after: zenoh.Timestamp | None = None
    pending: deque[Item] = field(default_factory=deque)
    size: int = 0
    spent_ns: int = 0
    displaced: int = 0

    def pull(self) -> None:
        """Take what has come in, without what discovery has returned; what is too much is displaced."""
        fresh: list[zenoh.Sample] = []
        while len(fresh) < _MOST_BATCHES and (sample := self.subscriber.try_recv()) is not None:
            if self.after is None or sample.timestamp is None or sample.timestamp > self.after:
                fresh.append(sample)
        # A full ring has displaced nobody knows how many.
        unknown = len(fresh) == _MOST_BATCHES
        for sample in fresh:
            self.add(sample, None if unknown else 0)
            unknown = False
        displaced = 0
        while len(self.pending) > _PENDING or (self.size > _PENDING_BYTES and len(self.pending) > 1):
            self.size -= self.pending.popleft().size
            displaced += 1
        if displaced:
            self.displaced += displaced
            first = self.pending.popleft()
            known = None if first.displaced is None else first.displaced + displaced
            self.pending.appendleft(first._replace(displaced=known))

    def add(self, sample: zenoh.Sample, displaced: int | None = 0) -> None:
        """Let a sample wait."""
        size = len(sample.payload)
        self.pending.append(Item(sample, displaced, size))
        self.size += size

    def take(self) -> Item:
        """Take the oldest of what waits."""
        item = self.pending.popleft()
        self.size -= item.size
        return item


class Rings:
    """The subscriptions to the observations of a scene.

    Parameters
    ----------
    session
        Open Zenoh session.
    keys
        Keys of the scene.
    tokens
        Of the sources: a ring is kept while its source is there.
    most
        Sources at a time.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, tokens: Tokens, most: int) -> None:
        self._session, self._keys, self._tokens, self._most = session, keys, tokens, most
        self.of: dict[str, Ring] = {}
        self._discovery = declare_subscriber(
            session, keys.streams("obs"), "obs", RingChannel(_DISCOVERY_RING)
        )
        # Samples of sources that have no ring yet, as discovery has found them.
        self._early: deque[_Early] = deque()
        self._early_bytes = 0
        # Samples of those that have waited in vain, by source.
        self._unopened: Counter[str] = Counter()
        self._lock = threading.Lock()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._pull, name="intake", daemon=True)
        self._thread.start()

    def gather(self, monotonic_ns: int) -> tuple[list[tuple[str, zenoh.Sample]], Counter[str]]:
        """Discover sources and take in what has come.

        Returns samples for whose source there is no ring, and how many of each were dropped before there was
        time to open it.
        """
        with self._lock:
            without = self._discover(monotonic_ns)
            for ring in self.of.values():
                ring.pull()
            dropped, self._unopened = self._unopened, Counter()
        return without, dropped

    def take(self, ring: Ring) -> Item:
        """Take the oldest of what waits of a source."""
        with self._lock:
            return ring.take()

    def drop_idle(self, monotonic_ns: int) -> None:
        """Close the rings of sources that have left and sent nothing for some seconds."""
        with self._lock:
            for name, ring in list(self.of.items()):
                if name not in self._tokens.present and monotonic_ns - ring.used_ns > IDLE_NS:
                    self._close(name)

    def close(self) -> None:
        """Stop emptying the rings; the subscriptions end with the session."""
        self._closing.set()
        self._thread.join()

    def _pull(self) -> None:
        """Empty the rings again and again, in a thread."""
        while not self._closing.wait(_PULL_S):
            with self._lock:
                try:
                    self._drain_discovery()
                    for ring in self.of.values():
                        ring.pull()
                except zenoh.ZError:  # the session is closed
                    return

    def _close(self, name: str) -> None:
        self.of.pop(name).subscriber.undeclare()

    def _discover(self, monotonic_ns: int) -> list[tuple[str, zenoh.Sample]]:
        """Open rings for new sources, with what came before the ring was there.

        Returns samples for whose source there is no ring. For some there is no time now: theirs wait.
        """
        opened: set[str] = set()
        until_ns, is_full, found = time.monotonic_ns() + _OPENING_NS, False, True
        while found:
            # What came before a new ring was open is in the discovery ring alone: look again.
            # What comes later is in both rings: time stamps show which was already returned.
            self._drain_discovery(opened)
            found = False
            for name in dict.fromkeys(one.name for one in self._early if one.name not in self.of):
                if is_full or (found and time.monotonic_ns() > until_ns):
                    break
                if self._open(name, monotonic_ns):
                    opened.add(name)
                    found = True
                else:
                    is_full = is_name(name)
            found = found and time.monotonic_ns() < until_ns
        self._drain_discovery(opened)
        return self._sort_early(is_full=is_full)

    def _sort_early(self, *, is_full: bool) -> list[tuple[str, zenoh.Sample]]:
        """Give early samples to their rings; returns those for which there will be none."""
        without, waiting, now_ns = [], [], time.monotonic_ns()
        for one in self._early:
            if one.name in self.of:
                self.of[one.name].add(one.sample)
                self.of[one.name].after = one.sample.timestamp
            elif is_full or not is_name(one.name):
                without.append((one.name, one.sample))
            elif one.since_ns and now_ns - one.since_ns > _EARLY_NS:
                self._unopened[one.name] += 1
            else:
                waiting.append(one._replace(since_ns=one.since_ns or now_ns))
        self._early = deque(waiting)
        self._early_bytes = sum(len(one.sample.payload) for one in waiting)
        return without

    def _drain_discovery(self, opened: Collection[str] = ()) -> None:
        """Keep what has come of sources without a ring, and of those whose ring has just been opened."""
        for _ in range(_DISCOVERY_RING):
            sample = self._discovery.try_recv()
            if sample is None:
                break
            name = last_chunk(str(sample.key_expr))
            if name not in self.of or name in opened:
                self._early.append(_Early(name, sample))
                self._early_bytes += len(sample.payload)
        while len(self._early) > _PENDING or (self._early_bytes > _PENDING_BYTES and len(self._early) > 1):
            one = self._early.popleft()
            self._early_bytes -= len(one.sample.payload)
            self._unopened[one.name] += 1

    def _open(self, name: str, monotonic_ns: int) -> bool:
        """Declare the ring of a source unless it has one, is no valid name, or is one too many."""
        if name in self.of or not is_name(name):
            return False
        if len(self.of) >= self._most:
            idle = min(self.of, key=lambda one: self.of[one].used_ns)
            if monotonic_ns - self.of[idle].used_ns <= _SILENT_NS:
                return False
            self._close(idle)
        key = self._keys.stream("obs", name)
        self.of[name] = Ring(
            declare_subscriber(self._session, key, "obs", RingChannel(_MOST_BATCHES)), monotonic_ns
        )
        return True
