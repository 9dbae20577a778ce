"""Knows which sources are present, by their liveliness tokens."""

import logging
from typing import Any

import zenoh
from zenoh.handlers import RingChannel

from comotion_schemas import Keys
from comotion_schemas.keys import last_chunk
from comotion_schemas.types import is_name

from .guard import LogLimit

# Tokens that come and go between two turns of the loop; more are read with the next full list.
_MOST_CHANGES = 1024
# Tokens that are read at a time: a storm of them must not delay an update.
_AT_ONCE = 256
_log = logging.getLogger(__name__)


class Tokens:
    """Presence of sources.

    Parameters
    ----------
    session
        Open Zenoh session.
    keys
        Keys of the scene.
    most
        Names that are remembered.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, most: int) -> None:
        self._session, self._key, self._most = session, keys.all_live("source"), most
        self._changes = session.liveliness().declare_subscriber(
            self._key, RingChannel(_MOST_CHANGES), history=True
        )
        self._limit = LogLimit(20, 10.0)
        self._query: Any = None
        self._since_query: set[str] = set()
        self.present: dict[str, int] = {}

    def follow(self, monotonic_ns: int) -> list[str]:
        """Take in tokens that came and went; returns the names of those that came."""
        came = []
        for _ in range(_AT_ONCE):
            sample = self._changes.try_recv()
            if sample is None:
                break
            name = last_chunk(str(sample.key_expr))
            if sample.kind == zenoh.SampleKind.DELETE:
                if self.present.pop(name, None) is not None:
                    self._limit.log(_log, logging.INFO, "source %s has left", name)
            elif is_name(name) and len(self.present) < self._most:
                came.append(name)
                self._since_query.add(name)
                if name not in self.present:
                    self.present[name] = monotonic_ns
                    self._limit.log(_log, logging.INFO, "source %s is here", name)
        return came

    def reconcile(self) -> None:
        """Forget tokens whose end was not heard, by what the last call queried; and query again."""
        if self._query is not None:
            there, replies = set(), 0
            while replies < 4 * self._most and (reply := _next(self._query)) is not None:
                replies += 1
                if reply.ok is not None:
                    there.add(last_chunk(str(reply.ok.key_expr)))
            # Without any answer there may be no router.
            if there and replies < 4 * self._most:
                lost = self.present.keys() - there - self._since_query
                for name in lost:
                    del self.present[name]
        self._since_query.clear()
        self._query = self._session.liveliness().get(self._key, RingChannel(4 * self._most), timeout=5.0)


def _next(replies: Any) -> zenoh.Reply | None:
    """The next reply; None where there is none, or where the last one has been read."""
    try:
        found: zenoh.Reply | None = replies.try_recv()
    except zenoh.ZError:
        return None
    return found
