"""Knows of which sources the process is there: of each known one, its liveliness token is asked for.

The service has no wildcard for tokens, neither a subscription nor a query. Nothing limits how many a source
declares, and when it leaves, a router goes through all matches of a wildcard for each one of them.
"""

import logging
from collections import deque
from collections.abc import Callable, Collection
from typing import Any

import zenoh
from zenoh.handlers import Callback

from comotion_schemas import Keys

from .log_limit import LogLimit

# Between two queries of one token, at least; and queries without an answer.
_AGAIN_NS, _AT_ONCE = 1_000_000_000, 4
_TIMEOUT_S = 5.0
_log = logging.getLogger(__name__)


class Tokens:
    """Presence of sources, of so many names at most.

    `present` are the names whose token is there, and since when in monotonic ns.
    """

    def __init__(self, session: zenoh.Session, keys: Keys, most: int) -> None:
        self._session, self._keys, self._most = session, keys, most
        self._limit = LogLimit(20, 10.0)
        self._due_ns = self._asked = 0
        self._turn: list[str] = []
        # Names, and whether their token is there; None: no router has said. Zenoh's threads add to it.
        self._answers: deque[tuple[str, bool | None]] = deque()
        self.present: dict[str, int] = {}

    def look(self, monotonic_ns: int, known: Callable[[], Collection[str]]) -> None:
        """Take in answers, and query some tokens: each second those of all names that are known by then."""
        while self._answers:
            self._asked -= 1
            self._take_in(*self._answers.popleft(), monotonic_ns)
        if not self._turn and monotonic_ns >= self._due_ns:
            self._due_ns = monotonic_ns + _AGAIN_NS
            self._turn = sorted(self.present.keys() | known(), reverse=True)
        while self._turn and self._asked < _AT_ONCE:
            self._asked += 1
            self._ask(self._turn.pop())

    def _ask(self, name: str) -> None:
        replies: list[bool] = []

        def answered() -> None:
            self._answers.append((name, None if False in replies else bool(replies)))

        query: Any = Callback(lambda reply: replies.append(reply.ok is not None), answered)
        self._session.liveliness().get(self._keys.live("source", name), query, timeout=_TIMEOUT_S)

    def _take_in(self, name: str, there: bool | None, monotonic_ns: int) -> None:
        if there and name not in self.present and len(self.present) < self._most:
            self.present[name] = monotonic_ns
            self._limit.log(_log, logging.INFO, "source %s is here", name)
        elif there is False and name in self.present:
            del self.present[name]
            self._limit.log(_log, logging.INFO, "source %s has left", name)
