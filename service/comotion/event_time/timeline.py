"""Event time: many sources of different rates become one ordered stream up to a watermark.

The rules are those of PROTOCOL.md, "Time":

- newest(s) is the largest accepted stamp of source s; s is live while now - newest(s) <= source_timeout.
- W = max(previous W, now - max_lag, min newest(s) over live sources), never beyond now.
  Without a live source W stands still.
- What is stamped <= W is released, in stamp order, ties by source name; newer data waits.
- Behind W by at most allowed_lateness: released as reordered. Older: dropped as late.
- More than 1 s ahead of now: rejected as future; it moves nothing.

Nothing here reads a clock: `now_ns` comes from the caller.
"""

import heapq
from collections import deque
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import ObservationBatch

from ..config import FusionConfig, to_ns
from .sequence import SequenceLog
from .stats import Stats

FUTURE_NS = 1_000_000_000
MAX_PENDING_ROWS = 4_000_000
MAX_SOURCES = 1024
_GAPS = 15


@dataclass(frozen=True)
class Instant:
    """Rows of one batch that share one acquisition time.

    `rows` indexes the batch's rows; `in_order` is False when the watermark has passed the stamp;
    `last` marks the newest instant of the batch.
    """

    stamp_ns: int
    batch: ObservationBatch
    rows: NDArray[np.intp]
    in_order: bool
    last: bool


@dataclass
class SourceClock:
    """What event time knows of one source."""

    session: str
    newest_ns: int
    gaps_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_GAPS))

    @property
    def period_ns(self) -> int:
        """Median spacing of its recent instants; 0 until there are two."""
        return int(median(self.gaps_ns)) if self.gaps_ns else 0

    def observe(self, stamp_ns: int) -> None:
        """Advance to a stamp."""
        if stamp_ns > self.newest_ns:
            self.gaps_ns.append(stamp_ns - self.newest_ns)
            self.newest_ns = stamp_ns


class Timeline:
    """Merges batches of all sources into released instants."""

    def __init__(self, config: FusionConfig, stats: Stats) -> None:
        self._config = config
        self._stats = stats
        self._inbox: list[ObservationBatch] = []
        self._pending: list[tuple[int, str, int, Instant]] = []
        self._pending_rows = 0
        self._order = 0
        self._sequences = SequenceLog(stats)
        self.sources: dict[str, SourceClock] = {}
        self.watermark_ns: int | None = None

    def is_new(self, batch: ObservationBatch) -> bool:
        """Follow the sequence numbers; False for a batch that was seen before."""
        return self._sequences.accept(batch.source, batch.session, batch.seq)

    def add(self, batch: ObservationBatch) -> None:
        """Take a batch in; it is judged against the clock at the next :meth:`advance`."""
        if self._pending_rows + len(batch.ids) > MAX_PENDING_ROWS or self._is_one_source_too_many(batch):
            self._stats.reject("limit")
            return
        self._inbox.append(batch)
        self._pending_rows += len(batch.ids)

    def _is_one_source_too_many(self, batch: ObservationBatch) -> bool:
        return batch.source not in self.sources and len(self.sources) >= MAX_SOURCES

    def advance(self, now_ns: int) -> list[Instant]:
        """Move the watermark and release what it has passed, in event-time order.

        Late rows are judged against the watermark as it was when they came in.
        """
        for batch in self._inbox:
            self._judge(batch, now_ns)
        self._inbox.clear()
        self._move_watermark(now_ns)
        return self._release()

    def is_live(self, source: str, now_ns: int) -> bool:
        """Whether a source still holds the watermark."""
        return now_ns - self.sources[source].newest_ns <= to_ns(self._config.source_timeout)

    def track_timeout_ns(self, source: str) -> int:
        """Time without observation after which a trajectory of this source is outdated."""
        clock = self.sources.get(source)
        return max(to_ns(self._config.track_timeout), 3 * clock.period_ns if clock else 0)

    def _judge(self, batch: ObservationBatch, now_ns: int) -> None:
        if batch.stamp_ns > now_ns + FUTURE_NS:
            self._refuse(batch, "future")
            return
        if self.watermark_ns is None and batch.stamp_ns < now_ns - to_ns(self._config.window):
            # Nothing live has set a watermark yet that could call this late.
            self._refuse(batch, "past")
            return
        if not self._enter_session(batch):
            self._stats.late += 1
            self._pending_rows -= len(batch.ids)
            return
        self._enqueue(batch)

    def _refuse(self, batch: ObservationBatch, reason: str) -> None:
        self._stats.reject(reason)  # type: ignore[arg-type]
        self._pending_rows -= len(batch.ids)

    def _enter_session(self, batch: ObservationBatch) -> bool:
        """Follow a source into its newest session; False for a batch of one it has left."""
        clock = self.sources.get(batch.source)
        if clock is None or clock.session != batch.session:
            if self._sequences.has_left(batch.source, batch.session):
                return False
            self._sequences.enter(batch.source, batch.session)
            self.sources[batch.source] = SourceClock(batch.session, batch.stamp_ns)
            return True
        clock.observe(batch.stamp_ns)
        return True

    def _enqueue(self, batch: ObservationBatch) -> None:
        stamps = batch.stamps_ns
        rows = np.arange(len(batch.ids))
        if stamps is None or not len(stamps):
            groups = [(batch.stamp_ns, rows)]
        else:
            groups = [(int(stamp), rows[stamps == stamp]) for stamp in np.unique(stamps)]
        behind = [stamp for stamp, _ in groups if self._lag(stamp) > 0]
        dropped = [stamp for stamp in behind if self._lag(stamp) > to_ns(self._config.allowed_lateness)]
        self._stats.late += bool(dropped)
        self._stats.reordered += len(behind) > len(dropped)
        for stamp, members in groups:
            if stamp in dropped:
                self._pending_rows -= len(members)
                continue
            instant = Instant(stamp, batch, members, stamp not in behind, stamp == batch.stamp_ns)
            heapq.heappush(self._pending, (stamp, batch.source, self._order, instant))
            self._order += 1

    def _lag(self, stamp_ns: int) -> int:
        return 0 if self.watermark_ns is None else self.watermark_ns - stamp_ns

    def _move_watermark(self, now_ns: int) -> None:
        live = [clock.newest_ns for name, clock in self.sources.items() if self.is_live(name, now_ns)]
        if not live:
            return
        held = max(now_ns - to_ns(self._config.max_lag), min(live))
        if self.watermark_ns is not None:
            held = max(held, self.watermark_ns)
        # The previous watermark wins over a clock that was set back: time never runs backwards.
        self.watermark_ns = max(min(held, now_ns), self.watermark_ns or min(held, now_ns))

    def _release(self) -> list[Instant]:
        released: list[Instant] = []
        while self._pending and self.watermark_ns is not None and self._pending[0][0] <= self.watermark_ns:
            instant = heapq.heappop(self._pending)[-1]
            self._pending_rows -= len(instant.rows)
            released.append(instant)
        return released

    def state(self) -> dict[str, Any]:
        """Watermark and clocks, as plain values."""
        return {
            "watermark": self.watermark_ns,
            "sources": [
                [name, clock.session, clock.newest_ns, list(clock.gaps_ns)]
                for name, clock in self.sources.items()
            ],
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        self.watermark_ns = state["watermark"]
        for name, session, newest_ns, gaps_ns in state["sources"]:
            self.sources[name] = SourceClock(session, newest_ns, deque(gaps_ns, maxlen=_GAPS))
            self._sequences.enter(name, session)
