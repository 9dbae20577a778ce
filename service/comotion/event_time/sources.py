"""Stamps and sessions of one source in; its clock, its liveness and its health out."""

from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Any, Self

# A median over so many gaps follows a new rate within a second at 15 Hz and ignores single outliers.
_GAPS = 15
# Bound on what a source that restarts all the time can make us remember.
_PAST_SESSIONS = 64


@dataclass(frozen=True)
class SourceHealth:
    """One source: `age_ns` since its newest stamp, `period_ns` between its instants (0: unknown).

    `live` tells whether the watermark waits for it.
    """

    name: str
    session: str
    age_ns: int
    period_ns: int
    live: bool


@dataclass
class Source:
    """State of one source.

    Attributes
    ----------
    session
        The newest session it has started.
    newest_ns
        Largest stamp of that session.
    gaps_ns
        Time between its newest stamps.
    generation
        How many sessions it had started before.
    released, number
        Generation of the session whose instants are being released, and its number; -1 before the first.
    past
        Sessions that are over.
    """

    session: str
    newest_ns: int
    gaps_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_GAPS))
    generation: int = 0
    released: int = -1
    number: int = -1
    past: deque[str] = field(default_factory=lambda: deque(maxlen=_PAST_SESSIONS))

    @property
    def period_ns(self) -> int:
        """Median time between its recent stamps; 0 until there are two."""
        return int(median(self.gaps_ns)) if self.gaps_ns else 0

    def start(self, session: str, stamp_ns: int) -> None:
        """Start a new session; its clock starts anew."""
        self.past.append(self.session)
        self.session, self.newest_ns = session, stamp_ns
        self.gaps_ns.clear()
        self.generation += 1

    def observe(self, stamp_ns: int) -> None:
        """Advance to a stamp; an older one changes nothing."""
        if stamp_ns > self.newest_ns:
            self.gaps_ns.append(stamp_ns - self.newest_ns)
            self.newest_ns = stamp_ns

    def is_live(self, now_ns: int, timeout_ns: int) -> bool:
        """Whether its newest stamp is at most `timeout_ns` old."""
        return now_ns - self.newest_ns <= timeout_ns

    def state(self) -> dict[str, Any]:
        """As plain values."""
        return vars(self) | {"gaps_ns": list(self.gaps_ns), "past": list(self.past)}

    @classmethod
    def from_state(cls, state: dict[str, Any]) -> Self:
        """Build a source from :meth:`state`."""
        gaps_ns, past = deque(state["gaps_ns"], maxlen=_GAPS), deque(state["past"], maxlen=_PAST_SESSIONS)
        return cls(**(state | {"gaps_ns": gaps_ns, "past": past}))
