"""Receives the batches and Statuses of the sources, and follows whether their processes are there.

Batches are decoded and checked in turns; each source has a share of the time.

A Status is believed about the component of its own key alone. Of a storm of them each component's newest is
read, twice a second at most, and some in a turn of the loop: what one component sends costs no other.

The liveliness token of each known source is queried by itself: the service has no wildcard for tokens,
neither a subscription nor a query. Nothing limits how many a source declares, and when it leaves, a router
goes through all matches of a wildcard for each of them.
"""

import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import Any

import zenoh
from zenoh.handlers import Callback

from comotion_schemas import DecodeError, Keys, ObservationBatch, Status, decode_as
from comotion_schemas.keys import publisher_of
from comotion_schemas.transport import Receiver
from comotion_schemas.types import is_name

from ..event_time.sources import MAX_SOURCES
from ..event_time.timeline import Timeline
from .log_limit import limited
from .queues import OTHERS, Payload, Queues

# Between two queries of one token, at least; and queries without an answer.
_QUERY_AGAIN_NS, _MOST_PENDING = 1_000_000_000, 4
_TIMEOUT_S = 5.0
# Statuses between Zenoh and the thread; and the time between two of one component that are read.
_RING, _READ_AGAIN_NS = 1024, 500_000_000
# Statuses read in one turn of the loop: a millisecond of work.
_READ_AT_ONCE = 16
# That of a service with a thousand sources is as large.
_MOST_BYTES = 256 * 1024
_log = limited(__name__)


class Intake(Queues):
    """All subscriptions of the service; refusals and overflow go to the time line's ledger.

    `rejection` is the key and reason of the newest payload that was refused; empty before any.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, timeline: Timeline) -> None:
        self._ledger, self._faults = timeline.ledger, timeline.faults
        self.rejection = ""
        self.tokens = Tokens(session, keys)
        self.statuses = Statuses(session, keys)
        super().__init__(session, keys)

    def receive(self, monotonic_ns: int, budget_ns: int = 2**62) -> Iterator[ObservationBatch]:
        """Yield valid batches that have arrived: of each source in the order of arrival, in turns.

        The budget is for reading and whatever the caller does with a batch. Beyond it, a source that has had
        its share waits for the next call; any source may have one batch read.
        """
        self.tokens.look(monotonic_ns)
        active = self.active()
        self.tokens.heard.update(active.keys() - {OTHERS})
        share_ns, total_ns, spent = budget_ns // max(len(active), 1), 0, dict.fromkeys(active, 0)
        while active:
            for name, queue in list(active.items()):
                began = time.monotonic_ns()
                payload, displaced = self.take(name)
                if displaced:
                    self._ledger.unread(name, "overflow", displaced)
                batch = self._batch(name, payload)
                if batch is not None:
                    queue.received += 1
                    yield batch
                took_ns = time.monotonic_ns() - began
                total_ns += took_ns
                spent[name] += took_ns
                if not queue.waiting or (total_ns > budget_ns and spent[name] >= share_ns):
                    del active[name]

    def _batch(self, queue: str, payload: Payload) -> ObservationBatch | None:
        """The batch in a payload of a queue; None where it is refused."""
        name, content = payload
        with self._faults.guard("decoding a batch") as failed:
            try:
                if queue == OTHERS and is_name(name):
                    raise DecodeError("limit", f"more than {MAX_SOURCES} sources")
                batch = decode_as(ObservationBatch, content)
                if batch.source != name:
                    raise DecodeError("source-mismatch", f"source {batch.source!r} on the key of {name!r}")
            except DecodeError as error:
                self._reject(name, error)
            else:
                return batch
        if failed:
            self._reject(name, DecodeError("defect", f"{type(failed[0]).__name__}: {failed[0]}"[:500]))
        return None

    def _reject(self, name: str, error: DecodeError) -> None:
        self._ledger.unread(name if is_name(name) else "", error.reason)
        self.rejection = f"obs/{name}: {error}"
        _log.warning("rejected a batch on obs/%s: %s", name[:64], error)


class Statuses:
    """The subscription; a thread keeps the newest of each component, with its time of arrival.

    `refused` counts those of another component than that of the key, those that are no Status, and those of
    more components than are remembered.
    """

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self.refused = 0
        self._lock = threading.Lock()
        self._unread: dict[str, tuple[bytes, float]] = {}
        self._read_ns: dict[str, int] = {}
        Receiver(session, keys.streams("status"), "status", _RING, self._add)

    def read(self) -> list[tuple[Status, float]]:
        """Statuses that are due, each with the time of its arrival by this machine's wall clock, s."""
        now = time.monotonic_ns()
        self._read_ns = {name: at for name, at in self._read_ns.items() if now - at < _READ_AGAIN_NS}
        with self._lock:
            names = [name for name in self._unread if name not in self._read_ns][:_READ_AT_ONCE]
            due = [(name, *self._unread.pop(name)) for name in names]
        self._read_ns |= dict.fromkeys(names, now)
        decoded = ((self._decode(name, content), arrived_s) for name, content, arrived_s in due)
        return [(status, arrived_s) for status, arrived_s in decoded if status is not None]

    def _add(self, key: str, content: bytes) -> None:
        """Keep the newest of a component; called in the thread."""
        name = publisher_of(key)
        with self._lock:
            if name in self._unread or (len(self._unread) < MAX_SOURCES and is_name(name)):
                self._unread[name] = content, time.time()
            else:
                self.refused += 1

    def _decode(self, name: str, content: bytes) -> Status | None:
        try:
            if len(content) > _MOST_BYTES:
                raise DecodeError("too-large", f"{len(content)} bytes")
            status = decode_as(Status, content)
            if status.component != name:
                raise DecodeError("source-mismatch", f"it is about {status.component!r}")
        except DecodeError as error:
            self.refused += 1
            _log.warning("refused a Status on status/%s: %s", name, error)
            return None
        return status


class Tokens:
    """Presence of sources, of :data:`MAX_SOURCES` names at most.

    `present` are the names whose token is there, and since when in monotonic ns; `heard` those of which
    something has come since the last queries.
    """

    def __init__(self, session: zenoh.Session, keys: Keys) -> None:
        self._session, self._keys = session, keys
        self._due_ns = self._pending = 0
        self._turn: list[str] = []
        # Names, and whether their token is there; None: no router has answered. Zenoh's threads add to it.
        self._answers: deque[tuple[str, bool | None]] = deque()
        self.present: dict[str, int] = {}
        self.heard: set[str] = set()

    def look(self, monotonic_ns: int) -> None:
        """Take in answers, and query some tokens: each second of all names heard and present."""
        while self._answers:
            self._pending -= 1
            name, alive = self._answers.popleft()
            if alive and name not in self.present and len(self.present) < MAX_SOURCES:
                self.present[name] = monotonic_ns
                _log.info("source %s is here", name)
            elif alive is False and self.present.pop(name, None) is not None:
                _log.info("source %s has left", name)
        if not self._turn and monotonic_ns >= self._due_ns:
            self._due_ns = monotonic_ns + _QUERY_AGAIN_NS
            self._turn = sorted(self.present.keys() | self.heard, reverse=True)
            self.heard.clear()
        while self._turn and self._pending < _MOST_PENDING:
            self._pending += 1
            self._query(self._turn.pop())

    def _query(self, name: str) -> None:
        replies: list[bool] = []

        def answered() -> None:
            self._answers.append((name, None if False in replies else bool(replies)))

        query: Any = Callback(lambda reply: replies.append(reply.ok is not None), answered)
        self._session.liveliness().get(self._keys.live("source", name), query, timeout=_TIMEOUT_S)
