"""The sources of a scene: which are live, send and agree."""

from collections import deque
from dataclasses import dataclass, field
from statistics import median

from ..saving import NOT_KEPT
from .entries import Entry
from .stats import Key

# A median over so many gaps follows a new rate within a second at 15 Hz and ignores single outliers.
_GAPS = 15
# Past sessions that are remembered of a source, however often it restarts.
_PAST_SESSIONS = 64
# A source is silent, and hands its name over, after so many of its periods.
PERIODS = 3
MAX_SOURCES = 1024
"""Names at a time."""
_NEVER_NS = 2**62
# ns over which a source must have sent to have a share of its own; until then all such have one together.
_NEW_NS = 1_000_000_000


@dataclass
class Source:
    """State of one source."""

    session: str
    """The newest session it has started."""
    newest_ns: int
    """Largest stamp of that session, on the time scale of the scene."""
    started_ns: int = 0
    """First stamp of that session."""
    gaps_ns: deque[int] = field(default_factory=deque)
    arrivals_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_GAPS), metadata=NOT_KEPT)
    """Time between its newest stamps, and between their arrivals."""
    heard_ns: int | None = field(default=None, metadata=NOT_KEPT)
    agreed_ns: int | None = field(default=None, metadata=NOT_KEPT)
    """When its session was last heard, and last heard with a clock that agrees with the scene's, on the clock
    of arrivals; None: not since the start."""
    since_ns: int | None = field(default=None, metadata=NOT_KEPT)
    """When the source was heard first, on the clock of arrivals; None: in an earlier run of the service."""
    generation: int = 0
    """How many sessions it had started before."""
    released: int = -1
    number: int = -1
    """Generation of the session whose instants are being released, and its number; -1 before the first."""
    past: deque[str] = field(default_factory=deque)
    """Sessions that are over."""
    rivals: list[Entry] = field(default_factory=list, metadata=NOT_KEPT)
    """Batches of other sessions, which get the name should this one fall silent."""
    waiting: list[Entry] = field(default_factory=list, metadata=NOT_KEPT)
    """Batches that wait for the watermark, a heap."""

    def __post_init__(self) -> None:
        # A snapshot gives queues without bounds.
        self.gaps_ns = deque(self.gaps_ns, maxlen=_GAPS)
        self.past = deque(self.past, maxlen=_PAST_SESSIONS)

    @property
    def period_ns(self) -> int:
        """Median time between its recent stamps; 0 until there are two."""
        return int(median(self.gaps_ns or [0]))

    @property
    def silence_ns(self) -> int:
        """Three median times between its recent arrivals; 0 until there are two."""
        return PERIODS * int(median(self.arrivals_ns or [0]))

    @property
    def is_new(self) -> bool:
        """Whether its batches have come for a short time only; not one that an earlier run has known."""
        since_ns, heard_ns = self.since_ns, self.heard_ns
        return since_ns is not None and heard_ns is not None and heard_ns - since_ns < _NEW_NS

    def start(self, session: str, stamp_ns: int, at_ns: int) -> None:
        """Start a new session; its clock starts anew."""
        if session != self.session:
            self.past.append(self.session)
        self.session, self.newest_ns, self.started_ns = session, stamp_ns, stamp_ns
        self.gaps_ns.clear()
        self.arrivals_ns.clear()
        self.heard_ns, self.agreed_ns = at_ns, None
        self.generation += 1

    def observe(self, stamp_ns: int, at_ns: int) -> None:
        """Advance to a stamp; an older one changes no clock."""
        if stamp_ns > self.newest_ns:
            self.gaps_ns.append(stamp_ns - self.newest_ns)
            self.newest_ns = stamp_ns
        self.hear(at_ns)

    def hear(self, at_ns: int) -> None:
        """Take note that its session still sends."""
        if self.heard_ns is not None and at_ns > self.heard_ns:
            self.arrivals_ns.append(at_ns - self.heard_ns)
        self.heard_ns = at_ns

    def is_due(self, watermark_ns: int) -> bool:
        """Whether a batch of it waits that the watermark has passed."""
        return bool(self.waiting) and self.waiting[0].rank[0] <= watermark_ns

    def idle_ns(self, at_ns: int) -> int:
        """How long it has not been heard."""
        return _NEVER_NS if self.heard_ns is None else at_ns - self.heard_ns


class Sources(dict[str, Source]):
    """Sources by name, which hold the watermark for so long without data."""

    def __init__(self, timeout_ns: int) -> None:
        super().__init__()
        self.timeout_ns = timeout_ns

    def sender(self, key: Key) -> Source | None:
        """The source of a (source, session), where it is of that session now."""
        source = self.get(key[0])
        return source if source is not None and source.session == key[1] else None

    def agreed_ns(self) -> int | None:
        """When a source has agreed with the time of the scene last, on the clock of arrivals."""
        return max((s.agreed_ns for s in self.values() if s.agreed_ns is not None), default=None)

    def sending(self, at_ns: int) -> dict[str, Source]:
        """Sources that were heard within the timeout, or three of their periods if longer."""
        return {n: s for n, s in self.items() if s.idle_ns(at_ns) <= max(self.timeout_ns, s.silence_ns)}
