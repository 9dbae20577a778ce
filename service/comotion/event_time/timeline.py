"""Batches of many sources in, in any order; instants in time order and ended sessions out.

Event time is one state machine. It reads no clock: `now_ns` comes from the caller. Its rules are those of
docs/protocol.md, "Time"; the counters are those of Status.

A batch comes in (`receive`):

1. Sequence numbers are followed per session. A skipped number is `lost`, a repeated batch is dropped.
2. What the caller refuses is rejected, and so is what finds more rows waiting than memory allows.

The clock is known (`advance`). Each batch that has come in since is judged, in the order of arrival:

3. Rejected, and moves nothing: a stamp more than 1 s ahead of now (`future`); one older than the window
   while there is no watermark yet (`past`); one source too many (`limit`).
4. A session that its source has not had before starts anew: it is the source's session from now on, with
   a new clock. Batches of a session that is over are dropped as `late`.
5. newest(s) is the largest stamp of source s.
6. Rows behind the watermark by at most `allowed_lateness` are `reordered`; older ones are dropped as `late`.

Then the watermark moves and releases:

7. W = max(previous W, now - `max_lag`, smallest newest(s) over live sources), never beyond now. A source is
   live while now - newest(s) <= `source_timeout`. Without a live source W stands still.
8. What is stamped <= W comes out in stamp order, ties by source name and then by arrival; newer data waits.
9. Right before the first instant of a new session, :class:`SessionEnded` comes out for the one before.
   Nothing of an ended session comes out any more: what still waits is dropped as `late`.

What is forgotten:

10. A trajectory is outdated after `track_timeout` without observation, or 3 periods of its source if longer.
11. A session is forgotten when it is not its source's and has no trajectory left (`forget_idle`).
"""

import heapq
from collections.abc import Collection, Iterator
from typing import Any, NamedTuple

from comotion_schemas import ObservationBatch, RejectionReason
from comotion_schemas.sequence import SequenceCounter

from ..config import FusionConfig, to_ns
from .instants import Indices, Instant, SessionEnded, split
from .sources import Source, SourceHealth
from .stats import Stats

# "More than 1 s ahead" of docs/protocol.md.
FUTURE_NS = 1_000_000_000
MAX_SOURCES = 1024
# Some 220 MB of poses with noise and stamps.
MAX_WAITING_ROWS = 4_000_000
# "3 periods of its source" of docs/protocol.md.
_PERIODS = 3


class _Waiting(NamedTuple):
    """An instant behind the watermark; compared by the first three, of which `order` is unique."""

    stamp_ns: int
    source: str
    order: int
    generation: int
    batch: ObservationBatch
    rows: Indices
    in_order: bool


class Timeline:
    """Event time of one scene, as the rules above say.

    Parameters
    ----------
    config
        `window`, `allowed_lateness`, `max_lag`, `source_timeout` and `track_timeout` are used.
    stats
        Where batches are counted.

    Attributes
    ----------
    watermark_ns
        W, nanoseconds since the Unix epoch; None until a source has set it.
    sessions
        (source, session) by number, of every session that is current or has trajectories.
    """

    def __init__(self, config: FusionConfig, stats: Stats) -> None:
        self._window_ns = to_ns(config.window)
        self._lateness_ns = to_ns(config.allowed_lateness)
        self._max_lag_ns = to_ns(config.max_lag)
        self._source_timeout_ns = to_ns(config.source_timeout)
        self._track_timeout_ns = to_ns(config.track_timeout)
        self._stats = stats
        self._sequences = SequenceCounter()
        self._sources: dict[str, Source] = {}
        self._inbox: list[ObservationBatch] = []
        self._waiting: list[_Waiting] = []
        self._rows = 0
        self._order = 0
        self._next_number = 0
        self.sessions: dict[int, tuple[str, str]] = {}
        self.watermark_ns: int | None = None

    def receive(self, batch: ObservationBatch, refusal: RejectionReason | None = None) -> None:
        """Take a batch in; the next :meth:`advance` judges it against the clock.

        Parameters
        ----------
        batch
            Any batch.
        refusal
            Why the caller cannot use it, if so: its sequence number counts, but nothing else.
        """
        self._stats.batches += 1
        lost, order = self._sequences.sight(batch.source, batch.session, batch.seq)
        self._stats.lost += lost
        if order == "repeated":
            self._stats.duplicates += 1
        elif refusal is not None:
            self._stats.reject(refusal)
        elif self._rows + _size(len(batch.ids)) > MAX_WAITING_ROWS:
            self._stats.reject("limit")
        else:
            self._inbox.append(batch)
            self._rows += _size(len(batch.ids))

    def advance(self, now_ns: int) -> list[Instant | SessionEnded]:
        """Judge what has come in, move the watermark, and release what it has passed.

        Parameters
        ----------
        now_ns
            The caller's clock, nanoseconds since the Unix epoch.

        Returns
        -------
        list[Instant | SessionEnded]
            In event-time order.
        """
        for batch in self._inbox:
            self._rows -= _size(len(batch.ids))
            self._judge(batch, now_ns)
        self._inbox.clear()
        self._move_watermark(now_ns)
        return list(self._release())

    def track_timeout_ns(self, session: int) -> int:
        """Time without observation after which a trajectory of this session number is outdated."""
        source, _ = self.sessions[session]
        return max(self._track_timeout_ns, _PERIODS * self._sources[source].period_ns)

    def live(self, now_ns: int) -> bool:
        """Whether any source is live."""
        return any(s.is_live(now_ns, self._source_timeout_ns) for s in self._sources.values())

    def health(self, now_ns: int) -> list[SourceHealth]:
        """Health of every source seen so far, by name."""
        return [
            SourceHealth(
                name,
                source.session,
                now_ns - source.newest_ns,
                source.period_ns,
                source.is_live(now_ns, self._source_timeout_ns),
            )
            for name, source in sorted(self._sources.items())
        ]

    def forget_idle(self, used: Collection[int]) -> None:
        """Forget the sessions that are over, except for the numbers in `used`, which have trajectories."""
        current = {source.number for source in self._sources.values()}
        self.sessions = {n: key for n, key in self.sessions.items() if n in used or n in current}

    def _judge(self, batch: ObservationBatch, now_ns: int) -> None:
        """Reject a batch, drop it as late, or let its instants wait for the watermark."""
        source = self._sources.get(batch.source)
        if source is None and len(self._sources) >= MAX_SOURCES:
            self._stats.reject("limit")
        elif batch.stamp_ns > now_ns + FUTURE_NS:
            self._stats.reject("future")
        elif self.watermark_ns is None and batch.stamp_ns < now_ns - self._window_ns:
            self._stats.reject("past")
        elif source is not None and batch.session in source.past:
            self._stats.late += 1
        else:
            self._wait(batch, self._observe(batch, source).generation)

    def _observe(self, batch: ObservationBatch, source: Source | None) -> Source:
        """Bring a source's session and clock up to date; returns the source."""
        if source is None:
            source = self._sources[batch.source] = Source(batch.session, batch.stamp_ns)
        elif source.session != batch.session:
            self._sequences.forget(batch.source, source.session)
            source.start(batch.session, batch.stamp_ns)
        else:
            source.observe(batch.stamp_ns)
        return source

    def _wait(self, batch: ObservationBatch, generation: int) -> None:
        """Let the instants of a batch wait for the watermark, except for those that are too late."""
        reordered = late = False
        for stamp, rows in split(batch):
            lag_ns = 0 if self.watermark_ns is None else self.watermark_ns - stamp
            if lag_ns > self._lateness_ns:
                late = True
                continue
            reordered |= lag_ns > 0
            self._order += 1
            waiting = _Waiting(stamp, batch.source, self._order, generation, batch, rows, lag_ns <= 0)
            heapq.heappush(self._waiting, waiting)
            self._rows += _size(len(rows))
        self._stats.late += late
        self._stats.reordered += reordered

    def _move_watermark(self, now_ns: int) -> None:
        timeout_ns = self._source_timeout_ns
        live = [s.newest_ns for s in self._sources.values() if s.is_live(now_ns, timeout_ns)]
        if not live:
            return
        reached = min(max(now_ns - self._max_lag_ns, min(live)), now_ns)
        # The previous watermark wins over a clock that was set back: W never decreases.
        self.watermark_ns = reached if self.watermark_ns is None else max(reached, self.watermark_ns)

    def _release(self) -> Iterator[Instant | SessionEnded]:
        if self.watermark_ns is None:
            return
        while self._waiting and self._waiting[0].stamp_ns <= self.watermark_ns:
            found = heapq.heappop(self._waiting)
            self._rows -= _size(len(found.rows))
            source = self._sources[found.source]
            last = found.stamp_ns == found.batch.stamp_ns
            if found.generation < source.released:
                self._stats.late += last
                continue
            if found.generation > source.released:
                if source.released >= 0:
                    yield SessionEnded(source.number)
                self._number(source, found)
            yield Instant(found.stamp_ns, found.batch, found.rows, source.number, found.in_order, last)

    def _number(self, source: Source, first: _Waiting) -> None:
        """Give a session its number, with its first instant."""
        source.released, source.number = first.generation, self._next_number
        self.sessions[self._next_number] = (first.source, first.batch.session)
        self._next_number += 1

    def state(self) -> dict[str, Any]:
        """Watermark, sources, sessions and sequence numbers as plain values; what waits is not kept."""
        return {
            "watermark": self.watermark_ns,
            "next_number": self._next_number,
            "sources": [[name, source.state()] for name, source in self._sources.items()],
            "sessions": [[number, *key] for number, key in self.sessions.items()],
            "sequences": self._sequences.state(),
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`.

        Raises
        ------
        KeyError, TypeError, ValueError
            If it is none.
        """
        self.watermark_ns = state["watermark"]
        self._next_number = int(state["next_number"])
        self._sources = {name: Source.from_state(source) for name, source in state["sources"]}
        self.sessions = {int(number): (source, session) for number, source, session in state["sessions"]}
        self._sequences.load(state["sequences"])


def _size(rows: int) -> int:
    """Rows as counted against the limit: a batch without rows takes memory too."""
    return max(1, rows)
