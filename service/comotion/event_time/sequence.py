"""Sequence numbers per session: gaps are loss, repeats are duplicates, an old session is over."""

from collections import OrderedDict, deque
from dataclasses import dataclass, field

from .stats import Stats

# Bounds on what a hostile or broken publisher can make us remember.
_MAX_SESSIONS = 4096
_MAX_MISSING = 4096
_MAX_LEFT = 64


@dataclass
class _Log:
    first: int
    newest: int
    missing: OrderedDict[int, None] = field(default_factory=OrderedDict)

    def note_missing(self, start: int, stop: int) -> None:
        for seq in range(max(start, stop - _MAX_MISSING), stop):
            self.missing[seq] = None
        while len(self.missing) > _MAX_MISSING:
            self.missing.popitem(last=False)


class SequenceLog:
    """Judges the sequence number of every batch."""

    def __init__(self, stats: Stats) -> None:
        self._stats = stats
        self._logs: OrderedDict[tuple[str, str], _Log] = OrderedDict()
        self._left: dict[str, deque[str]] = {}
        self._current: dict[str, str] = {}

    def accept(self, source: str, session: str, seq: int) -> bool:
        """Count a gap as loss; False (and counted) for a batch that was seen before."""
        log = self._logs.get((source, session))
        if log is None:
            # A service that joins late has lost nothing.
            self._logs[source, session] = _Log(seq, seq)
            if len(self._logs) > _MAX_SESSIONS:
                self._logs.popitem(last=False)
            return True
        self._logs.move_to_end((source, session))
        if seq > log.newest:
            self._stats.lost += seq - log.newest - 1
            log.note_missing(log.newest + 1, seq)
            log.newest = seq
            return True
        return self._is_first_sight(log, seq)

    def _is_first_sight(self, log: _Log, seq: int) -> bool:
        if seq < log.first:
            log.note_missing(seq + 1, log.first)
            log.first = seq
            return True
        if seq in log.missing:
            del log.missing[seq]
            return True
        self._stats.duplicates += 1
        return False

    def enter(self, source: str, session: str) -> None:
        """A source has started a new session; the one before is over."""
        before = self._current.get(source)
        if before is not None:
            self._left.setdefault(source, deque(maxlen=_MAX_LEFT)).append(before)
            self._logs.pop((source, before), None)
        self._current[source] = session

    def has_left(self, source: str, session: str) -> bool:
        """Whether a session of a source is over."""
        return session in self._left.get(source, ())
