"""Sequence numbers of messages in; out comes how many were lost before each, and whether it is a repeat.

Every message with a `seq` counts 0, 1, 2 ... per publisher and session. A number that is skipped is a
lost message, a number that comes twice is a repeated one. Whoever joins late has lost nothing.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

# Bounds on what a hostile or broken publisher can make the counter remember.
MAX_SESSIONS = 4096
MAX_MISSING = 4096

Order = Literal["newest", "overtaken", "repeated"]


class Sighting(NamedTuple):
    """What follows from one sequence number.

    `lost` is how many numbers were skipped right before it. `order` is ``newest`` for a number beyond
    all before, ``overtaken`` for the first sight of an older one, and ``repeated`` for one seen before.
    A lost message that comes after all stays counted as lost.
    """

    lost: int
    order: Order


@dataclass
class _Session:
    oldest: int
    newest: int
    missing: dict[int, None] = field(default_factory=dict)

    def sight(self, seq: int) -> Sighting:
        if seq > self.newest:
            lost = seq - self.newest - 1
            self._miss(self.newest + 1, seq)
            self.newest = seq
            return Sighting(lost, "newest")
        if seq < self.oldest:
            self._miss(seq + 1, self.oldest)
            self.oldest = seq
            return Sighting(0, "overtaken")
        if seq in self.missing:
            del self.missing[seq]
            return Sighting(0, "overtaken")
        return Sighting(0, "repeated")

    def _miss(self, start: int, stop: int) -> None:
        self.missing.update(dict.fromkeys(range(max(start, stop - MAX_MISSING), stop)))
        while len(self.missing) > MAX_MISSING:
            del self.missing[next(iter(self.missing))]


class SequenceCounter:
    """Follows the sequence numbers of any number of publishers.

    It remembers the 4096 sessions seen last, and of each the 4096 missing numbers noted last: an older
    number counts as repeated.
    """

    def __init__(self) -> None:
        self._sessions: dict[tuple[str, str], _Session] = {}

    def sight(self, publisher: str, session: str, seq: int) -> Sighting:
        """Take note of a number.

        Parameters
        ----------
        publisher
            Whatever tells the streams apart: the name of a source, or a key.
        session
            Session of the publisher; each counts from its own first number on.
        seq
            Sequence number, 0 or more.
        """
        key = publisher, session
        known = self._sessions.pop(key, None)
        if known is None:
            self._sessions[key] = _Session(seq, seq)
            if len(self._sessions) > MAX_SESSIONS:
                del self._sessions[next(iter(self._sessions))]
            return Sighting(0, "newest")
        # The last in the dictionary is the one seen last.
        self._sessions[key] = known
        return known.sight(seq)

    def state(self) -> list[list[Any]]:
        """Publisher, session, oldest, newest and missing numbers of every session, as plain values."""
        return [[*key, s.oldest, s.newest, list(s.missing)] for key, s in self._sessions.items()]

    def load(self, state: Iterable[Sequence[Any]]) -> None:
        """Take up :meth:`state`."""
        self._sessions = {
            (str(publisher), str(session)): _Session(int(oldest), int(newest), dict.fromkeys(missing))
            for publisher, session, oldest, newest, missing in state
        }

    def forget(self, publisher: str, session: str) -> None:
        """Forget a session that is over; nothing happens where it is not known."""
        self._sessions.pop((publisher, session), None)
