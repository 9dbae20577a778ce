"""Reads the Statuses of a scene's components.

A Status is believed about the component of its own key alone. Of a storm of them each component's newest is
read, twice a second at most, and some in a turn of the loop: what one component sends costs nobody else.
"""

import logging
import threading
import time

import zenoh

from comotion_schemas import DecodeError, Keys, Status, decode_as
from comotion_schemas.keys import last_chunk
from comotion_schemas.transport import Receiver
from comotion_schemas.types import is_name

from .log_limit import LogLimit

_RING = 1024
# Between two Statuses of one component that are read.
_AGAIN_NS = 500_000_000
# Read in one turn of the loop: a millisecond of work.
_AT_ONCE = 16
# That of a service with a thousand sources is as large.
_MOST_BYTES = 256 * 1024
_log = logging.getLogger(__name__)


class Statuses:
    """The subscription; a thread keeps the newest of each of so many components, with its time of arrival.

    `refused` counts those of another component than that of the key, those that are no Status, and those of
    more components than are remembered.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, most: int) -> None:
        self.refused = 0
        self._most = most
        self._lock = threading.Lock()
        self._unread: dict[str, tuple[bytes, float]] = {}
        self._read_ns: dict[str, int] = {}
        self._sources: set[str] = set()
        self._limit = LogLimit(5, 60.0)
        self._receiver = Receiver(session, keys.streams("status"), "status", _RING, self._add)

    def close(self) -> None:
        """Stop receiving."""
        self._receiver.close()

    def read(self) -> list[tuple[Status, float]]:
        """Statuses that are due, each with the time of its arrival by this machine's wall clock, s."""
        now = time.monotonic_ns()
        self._read_ns = {name: at for name, at in self._read_ns.items() if now - at < _AGAIN_NS}
        with self._lock:
            names = [name for name in self._unread if name not in self._read_ns][:_AT_ONCE]
            due = [(name, *self._unread.pop(name)) for name in names]
        self._read_ns |= dict.fromkeys(names, now)
        decoded = ((self._decode(name, content), arrived_s) for name, content, arrived_s in due)
        found = [(status, arrived_s) for status, arrived_s in decoded if status is not None]
        self._sources.update(status.component for status, _ in found if status.role == "source")
        return found

    def take_sources(self) -> set[str]:
        """Names of the sources of which a Status was read since the last call."""
        sources, self._sources = self._sources, set()
        return sources

    def _add(self, key: str, content: bytes) -> None:
        """Keep the newest of a component; called in the thread."""
        name = last_chunk(key)
        with self._lock:
            if name in self._unread or (len(self._unread) < self._most and is_name(name)):
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
            self._limit.log(_log, logging.WARNING, "refused a Status on status/%s: %s", name, error)
            return None
        return status
