"""Zenoh samples in, checked observation batches out; one bounded ring per source.

With a ring per source, a source that floods cannot displace the others' data. An overflow shows as a
gap in `seq`, which the core counts. A source is discovered by its liveliness token or by its first
batch, whichever comes first.
"""

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from comotion_schemas import DecodeError, Keys, ObservationBatch, decode_as
from comotion_schemas.keys import last_chunk
from comotion_schemas.transport import declare_subscriber
from comotion_schemas.types import is_name

from ..event_time.stats import Stats
from ..event_time.timeline import MAX_SOURCES

# The ring of a source that has left is closed after this time without data.
IDLE_NS = 60_000_000_000
# Batches: a source of 1 kHz may wait a quarter of a second, more than two default periods.
_RING = 256
# The first batches of all sources that start at once.
_DISCOVERY_RING = 1024
_LOG_EVERY_NS = 1_000_000_000
_log = logging.getLogger(__name__)


@dataclass
class _Ring:
    subscriber: Any
    used_ns: int
    after: zenoh.Timestamp | None = None

    def drain(self) -> Iterator[zenoh.Sample]:
        """What has come in, without what discovery has already returned."""
        for _ in range(_RING):
            sample = self.subscriber.try_recv()
            if sample is None:
                return
            if self.after is None or sample.timestamp is None or sample.timestamp > self.after:
                yield sample


@dataclass(frozen=True)
class Rejection:
    """The newest payload that was refused: when (monotonic ns), on whose key, and why."""

    at_ns: int
    source: str
    error: DecodeError


class Intake:
    """All observation subscriptions of the service.

    `present` holds the names whose liveliness token is there; `received` counts the valid batches of
    every source; `rejection` is the newest payload that was refused. Refusals are counted in `stats`.

    Parameters
    ----------
    session
        Open Zenoh session.
    keys
        Keys of the scene.
    stats
        Counters of the fusion.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, stats: Stats) -> None:
        self._session = session
        self._keys = keys
        self._stats = stats
        self._rings: dict[str, _Ring] = {}
        self._logged_ns = -_LOG_EVERY_NS
        self.present: set[str] = set()
        self.received: dict[str, int] = {}
        self.rejection: Rejection | None = None
        self._discovery = declare_subscriber(
            session, keys.streams("obs"), "obs", RingChannel(_DISCOVERY_RING)
        )
        self._tokens = session.liveliness().declare_subscriber(
            keys.all_live("source"), RingChannel(_DISCOVERY_RING), history=True
        )

    def receive(self, monotonic_ns: int) -> Iterator[ObservationBatch]:
        """Yield every valid batch that has arrived: source by source, in the order of arrival of each.

        `monotonic_ns` is now on the monotonic clock.
        """
        for name, sample in self._discover(monotonic_ns):
            yield from self._check(name, sample, monotonic_ns)
        for name, ring in self._rings.items():
            for sample in ring.drain():
                ring.used_ns = monotonic_ns
                yield from self._check(name, sample, monotonic_ns)

    def drop_idle(self, monotonic_ns: int) -> None:
        """Close the rings of sources that have left and sent nothing for a minute."""
        for name, ring in list(self._rings.items()):
            if name not in self.present and monotonic_ns - ring.used_ns > IDLE_NS:
                ring.subscriber.undeclare()
                del self._rings[name]
                self.received.pop(name, None)

    def _discover(self, monotonic_ns: int) -> list[tuple[str, zenoh.Sample]]:
        """Open rings for new sources; returns their samples from before the ring was there."""
        opened = self._follow_tokens(monotonic_ns)
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

    def _follow_tokens(self, monotonic_ns: int) -> set[str]:
        opened: set[str] = set()
        while (sample := self._tokens.try_recv()) is not None:
            name = last_chunk(str(sample.key_expr))
            if sample.kind == zenoh.SampleKind.DELETE:
                self.present.discard(name)
                _log.info("source %s has left", name)
            elif is_name(name):
                self.present.add(name)
                if self._open(name, monotonic_ns):
                    opened.add(name)
                _log.info("source %s is here", name)
        return opened

    def _open(self, name: str, monotonic_ns: int) -> bool:
        """Declare the ring of a source unless it has one, is no valid name, or is one too many."""
        if name in self._rings or not is_name(name) or len(self._rings) >= MAX_SOURCES:
            return False
        key = self._keys.stream("obs", name)
        self._rings[name] = _Ring(
            declare_subscriber(self._session, key, "obs", RingChannel(_RING)), monotonic_ns
        )
        self.received[name] = 0
        return True

    def _check(self, name: str, sample: zenoh.Sample, monotonic_ns: int) -> Iterator[ObservationBatch]:
        try:
            if name not in self._rings and is_name(name):
                raise DecodeError("limit", f"more than {MAX_SOURCES} sources")
            batch = decode_as(ObservationBatch, sample.payload.to_bytes())
            if batch.source != name:
                raise DecodeError("source-mismatch", f"source {batch.source!r} on the key of {name!r}")
        except DecodeError as error:
            self._reject(name, error, monotonic_ns)
            return
        self.received[name] += 1
        yield batch

    def _reject(self, name: str, error: DecodeError, monotonic_ns: int) -> None:
        self._stats.reject(error.reason)
        self.rejection = Rejection(monotonic_ns, name, error)
        if monotonic_ns - self._logged_ns >= _LOG_EVERY_NS:
            self._logged_ns = monotonic_ns
            _log.warning("rejected a batch on obs/%s: %s", name, error)
