"""Zenoh samples in, checked observation batches out; one bounded ring per source, and a share of the time.

With a ring per source, a source that floods cannot displace the others' data. What its ring displaces shows
as a gap in `seq`, and is counted as overflow. A source is discovered by its liveliness token or by its first
batch, whichever comes first.
"""

import logging
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import zenoh
from zenoh.handlers import RingChannel

from comotion_schemas import DecodeError, Keys, ObservationBatch, decode_as
from comotion_schemas.keys import last_chunk
from comotion_schemas.transport import declare_subscriber
from comotion_schemas.types import is_name

from ..event_time.stats import Ledger
from .guard import LogLimit
from .statuses import Statuses
from .tokens import Tokens

# The ring of a source that has left is closed after this time without data.
IDLE_NS = 60_000_000_000
# A source that has sent nothing for this long makes room for another.
_SILENT_NS = 1_000_000_000
# Batches: a source of 1 kHz may wait a quarter of a second, more than two default periods.
_MOST_BATCHES = 256
# What of a source is kept to be read in its share of the time.
_PENDING = 1024
_PENDING_BYTES = 32 * 1024 * 1024
# The first batches of all sources that start at once.
_DISCOVERY_RING = 1024
_log = logging.getLogger(__name__)


class _Item(NamedTuple):
    """A sample; how many of its source were displaced right before it, None for nobody knows; its bytes."""

    sample: zenoh.Sample
    displaced: int | None
    size: int


@dataclass
class _Ring:
    subscriber: Any
    used_ns: int
    after: zenoh.Timestamp | None = None
    pending: deque[_Item] = field(default_factory=deque)
    size: int = 0
    spent_ns: int = 0

    def pull(self) -> int:
        """Take what has come in, without what discovery has returned; returns how many were displaced."""
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
            first = self.pending.popleft()
            known = None if first.displaced is None else first.displaced + displaced
            self.pending.appendleft(first._replace(displaced=known))
        return displaced

    def add(self, sample: zenoh.Sample, displaced: int | None = 0) -> None:
        size = len(sample.payload)
        self.pending.append(_Item(sample, displaced, size))
        self.size += size

    def take(self) -> _Item:
        item = self.pending.popleft()
        self.size -= item.size
        return item


@dataclass(frozen=True)
class Rejection:
    """The newest payload that was refused: when (monotonic ns), on whose key, and why."""

    at_ns: int
    source: str
    error: DecodeError


class Intake:
    """All observation subscriptions of the service.

    `present` holds the names whose liveliness token is there, since when; `received` counts the valid batches
    of every source; `rejection` is the newest payload that was refused.

    Parameters
    ----------
    session
        Open Zenoh session.
    keys
        Keys of the scene.
    ledger
        Where refusals and overflow are accounted.
    most
        Sources at a time.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, ledger: Ledger, most: int = 1024) -> None:
        self._session = session
        self._keys = keys
        self._ledger = ledger
        self._most = most
        self._rings: dict[str, _Ring] = {}
        self._limit = LogLimit(10, 10.0)
        self.received: dict[str, int] = {}
        self.rejection: Rejection | None = None
        self._discovery = declare_subscriber(
            session, keys.streams("obs"), "obs", RingChannel(_DISCOVERY_RING)
        )
        self.tokens = Tokens(session, keys, 4 * most)
        self.statuses = Statuses(session, keys, most)

    @property
    def present(self) -> dict[str, int]:
        """Names whose liveliness token is there, and since when in monotonic ns."""
        return self.tokens.present

    def silent_ns(self, monotonic_ns: int) -> float:
        """Time since a payload of any source arrived; infinite if none has."""
        return min((monotonic_ns - ring.used_ns for ring in self._rings.values()), default=float("inf"))

    def receive(self, monotonic_ns: int, budget_ns: int = 2**62) -> Iterator[ObservationBatch]:
        """Yield valid batches that have arrived: of each source in the order of arrival, in turns.

        Parameters
        ----------
        monotonic_ns
            Now, on the monotonic clock.
        budget_ns
            For reading and whatever the caller does with a batch. Beyond it, a source that has had its share
            waits for the next call; any source may have one batch read.
        """
        for name, sample in self._discover(monotonic_ns):
            if name in self._rings:
                self._rings[name].add(sample)
            else:
                yield from self._check(name, sample, monotonic_ns)
        active = {}
        for name, ring in list(self._rings.items()):
            displaced = ring.pull()
            if displaced:
                self._ledger.overflow((name, ""), displaced)
            if ring.pending:
                ring.used_ns, ring.spent_ns, active[name] = monotonic_ns, 0, ring
        yield from self._in_turns(active, monotonic_ns, budget_ns)

    def _in_turns(
        self, active: dict[str, _Ring], monotonic_ns: int, budget_ns: int
    ) -> Iterator[ObservationBatch]:
        share_ns, spent_ns = budget_ns // max(len(active), 1), 0
        while active:
            for name, ring in list(active.items()):
                began = time.monotonic_ns()
                item = ring.take()
                if item.displaced != 0:
                    self._ledger.overlooked(name, item.displaced)
                yield from self._check(name, item.sample, monotonic_ns)
                took = time.monotonic_ns() - began
                ring.spent_ns += took
                spent_ns += took
                if not ring.pending or (spent_ns > budget_ns and ring.spent_ns >= share_ns):
                    del active[name]

    def drop_idle(self, monotonic_ns: int) -> None:
        """Close the rings of sources that have left and sent nothing for a minute."""
        for name, ring in list(self._rings.items()):
            if name not in self.present and monotonic_ns - ring.used_ns > IDLE_NS:
                self._close(name)
        self.tokens.reconcile()

    def close(self) -> None:
        """Stop receiving Statuses; the other subscriptions end with the session."""
        self.statuses.close()

    def _close(self, name: str) -> None:
        self._rings.pop(name).subscriber.undeclare()
        self.received.pop(name, None)

    def _discover(self, monotonic_ns: int) -> list[tuple[str, zenoh.Sample]]:
        """Open rings for new sources; returns their samples from before the ring was there."""
        opened = {name for name in self.tokens.follow(monotonic_ns) if self._open(name, monotonic_ns)}
        samples: list[tuple[str, zenoh.Sample]] = []
        while True:
            fresh = self._drain_discovery()
            found = [name for name, _ in fresh if self._open(name, monotonic_ns)]
            samples += fresh
            opened.update(found)
            if not found:
                break
            # What came before the new ring was open is in the discovery ring alone: look again.
            # What comes later is in both rings: time stamps tell which was already returned.
        early = [(n, s) for n, s in samples if n in opened or n not in self._rings]
        for name, sample in early:
            if name in opened:
                self._rings[name].after = sample.timestamp
        return early

    def _drain_discovery(self) -> list[tuple[str, zenoh.Sample]]:
        samples = []
        for _ in range(_DISCOVERY_RING):
            sample = self._discovery.try_recv()
            if sample is None:
                break
            samples.append((last_chunk(str(sample.key_expr)), sample))
        return samples

    def _open(self, name: str, monotonic_ns: int) -> bool:
        """Declare the ring of a source unless it has one, is no valid name, or is one too many."""
        if name in self._rings or not is_name(name):
            return False
        if len(self._rings) >= self._most:
            idle = min(self._rings, key=lambda one: self._rings[one].used_ns)
            if monotonic_ns - self._rings[idle].used_ns <= _SILENT_NS:
                return False
            self._close(idle)
        key = self._keys.stream("obs", name)
        self._rings[name] = _Ring(
            declare_subscriber(self._session, key, "obs", RingChannel(_MOST_BATCHES)), monotonic_ns
        )
        self.received[name] = 0
        return True

    def _check(self, name: str, sample: zenoh.Sample, monotonic_ns: int) -> Iterator[ObservationBatch]:
        try:
            if name not in self._rings and is_name(name):
                raise DecodeError("limit", f"more than {self._most} sources")
            batch = decode_as(ObservationBatch, sample.payload.to_bytes())
            if batch.source != name:
                raise DecodeError("source-mismatch", f"source {batch.source!r} on the key of {name!r}")
        except DecodeError as error:
            self._reject(name, error, monotonic_ns)
            return
        except Exception as error:  # a defect of the codec costs one payload
            self._reject(name, DecodeError("defect", f"{type(error).__name__}: {error}"[:500]), monotonic_ns)
            _log.debug("decoding failed", exc_info=True)
            return
        self.received[name] += 1
        yield batch

    def _reject(self, name: str, error: DecodeError, monotonic_ns: int) -> None:
        known = name if is_name(name) else ""
        self._ledger.refuse((known, ""), error.reason)
        if known:
            self._ledger.overlooked(known, 1)
        self.rejection = Rejection(monotonic_ns, name, error)
        self._limit.log(_log, logging.WARNING, "rejected a batch on obs/%s: %s", name[:64], error)
