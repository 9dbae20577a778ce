"""Knows which sources are present, by their liveliness tokens, queried once a second or less often.

The service does not subscribe to them: it would receive each one that comes and goes, and nothing limits how
many a source declares. A query ends with the router's reply.
"""

import logging
import threading

import zenoh
from zenoh.handlers import Callback

from comotion_schemas import Keys
from comotion_schemas.keys import last_chunk
from comotion_schemas.types import is_name

from .log_limit import LogLimit

# Between two queries, at least; and for each token that the last one has found, so that many cost no more.
_AGAIN_NS, _EACH_NS = 1_000_000_000, 2_000_000
# After more tokens than there may be sources: for so many replies a router keeps all others waiting.
_MANY_NS = 60_000_000_000
_TIMEOUT_S = 5.0
_log = logging.getLogger(__name__)


class _Answer:
    """Collects the replies to one query. A ring would vanish with the last reply, and its content with it."""

    def __init__(self, most: int) -> None:
        self._most = most
        self.names: set[str] = set()
        self.replies = 0
        # Whether it has all names; and whether all replies have come.
        self.whole, self.complete = True, threading.Event()

    def add(self, reply: zenoh.Reply) -> None:
        self.replies += 1
        if reply.ok is None or len(self.names) >= self._most:
            self.whole = False
        elif is_name(name := last_chunk(str(reply.ok.key_expr))):
            self.names.add(name)


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

    Attributes
    ----------
    present
        Names whose token is there, and since when in monotonic ns.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, most: int) -> None:
        self._session, self._key, self._most = session, keys.all_live("source"), most
        self._limit = LogLimit(20, 10.0)
        self._answer: _Answer | None = None
        self._due_ns = 0
        self.present: dict[str, int] = {}

    def look(self, monotonic_ns: int) -> None:
        """Take in a complete answer, and query again when it is due."""
        answer = self._answer
        if answer is not None and answer.complete.is_set():
            self._answer = None
            wait_ns = _EACH_NS * answer.replies if answer.replies <= self._most else _MANY_NS
            self._due_ns = monotonic_ns + max(_AGAIN_NS, wait_ns)
            self._take_in(answer, monotonic_ns)
        if self._answer is None and monotonic_ns >= self._due_ns:
            self._answer = query = _Answer(self._most)
            replies = Callback(query.add, query.complete.set)
            self._session.liveliness().get(self._key, replies, timeout=_TIMEOUT_S)

    def _take_in(self, answer: _Answer, monotonic_ns: int) -> None:
        # Of more tokens than are remembered nobody knows which are gone.
        for name in self.present.keys() - answer.names if answer.whole else ():
            del self.present[name]
            self._limit.log(_log, logging.INFO, "source %s has left", name)
        for name in sorted(answer.names - self.present.keys())[: self._most - len(self.present)]:
            self.present[name] = monotonic_ns
            self._limit.log(_log, logging.INFO, "source %s is here", name)
