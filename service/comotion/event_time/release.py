"""Holds batches until the watermark has passed, and releases their instants in time order.

These are rules 9 to 11 of :mod:`comotion.event_time`. The batches that wait are bounded for each source here.
"""

import heapq
from collections.abc import Callable

from comotion_schemas import RejectionReason

from . import Event
from .budget import Budget
from .entries import Entry, Instants
from .sources import Source, Sources
from .stats import Key
from .troubles import Troubles

# ns for which a source may be behind the watermark because of its cost; then what it has there is dropped.
_PATIENCE_NS = 1_000_000_000
Move = Callable[[Entry, Event], None]
"""Moves a batch to its next stage."""
Store = Callable[[Instants], RejectionReason | None]
"""Fuses instants that come out, or says why they are refused."""
End = Callable[[int], None]
"""Ends the trajectories of a session, by its number."""


class Load:
    """Counts the batches and bytes that wait, of each source and of all, against their bounds."""

    def __init__(self, batches: int, size: int, size_of_all: int) -> None:
        self._batches, self._bytes, self._bytes_of_all = batches, size, size_of_all
        self._held: dict[str, tuple[int, int]] = {}
        self._total = 0

    def admits(self, source: str, size: int) -> bool:
        """Whether one more batch of a source, of so many bytes, may wait."""
        batches, held = self._held.get(source, (0, 0))
        share = self._bytes
        if self._total + size > self._bytes_of_all:
            share = min(share, self._bytes_of_all // max(len(self._held), 1))
        return batches < self._batches and held + size <= share

    def add(self, source: str, size: int, count: int = 1) -> None:
        """Take a batch in; with a `count` of -1 it waits no more."""
        batches, held = self._held.get(source, (0, 0))
        self._held[source] = batches + count, held + count * size
        self._total += count * size
        if not self._held[source][0]:
            del self._held[source]

    def holds(self, source: str) -> bool:
        """Whether anything of a source waits."""
        return source in self._held


class Release:
    """The batches that wait, and the numbers of the sessions whose instants have come out.

    `move` is called with what has become of a batch once all its instants have come out. The budget says
    which sources may have instants released, and is charged with what they cost. `sessions` are (source,
    session) by number, of every session that is current or has trajectories; the next one gets `next_number`.
    """

    def __init__(self, sources: Sources, move: Move, budget: Budget, troubles: Troubles) -> None:
        self._sources = sources
        self._move = move
        self._budget = budget
        self._troubles = troubles
        self._behind_ns: dict[str, int] = {}
        self._order = 0
        self.next_number = 0
        self.sessions: dict[int, Key] = {}

    def add(self, entry: Entry) -> None:
        """Let the rows of a batch wait."""
        self._order += 1
        entry.order = self._order
        heapq.heappush(self._sources[entry.batch.source].waiting, entry)

    def until(self, watermark_ns: int, at_ns: int, store: Store, end: End) -> None:
        """Release what is stamped at or before the watermark, by rule 9, as far as the budget goes."""
        due = {name for name, source in self._sources.items() if source.is_due(watermark_ns)}
        new = {name for name, source in self._sources.items() if source.is_new}
        for _ in self._budget.rounds(at_ns, lambda: due, new):
            self._turn(due, watermark_ns, store, end)
        # Sources that have long been behind because of their costs lose what is due.
        self._behind_ns = {name: self._behind_ns.get(name, at_ns) for name in sorted(due)}
        for name in [name for name, since_ns in self._behind_ns.items() if at_ns - since_ns > _PATIENCE_NS]:
            while self._sources[name].is_due(watermark_ns):
                self._move(heapq.heappop(self._sources[name].waiting), "over-budget")
            del self._behind_ns[name]
            self._troubles.note("over-budget", name)

    def _turn(self, due: set[str], watermark_ns: int, store: Store, end: End) -> None:
        """Release due instants until their source has spent its share; `due` keeps sources with some left."""
        heads = [self._sources[name].waiting[0].rank for name in due if self._budget.allows(name)]
        heapq.heapify(heads)
        while heads:
            _, name, _ = heapq.heappop(heads)
            if not self._budget.allows(name):
                continue
            source = self._sources[name]
            entry = heapq.heappop(source.waiting)
            if self._begins(entry, source, end):
                others = [*heads[:1], *(other.rank for other in source.waiting[:1])]
                instants = entry.take(watermark_ns, others, source.number)
                if not instants.last:
                    heapq.heappush(source.waiting, entry)
                with self._budget.charge({name: 1.0}):
                    self._book(entry, instants, store(instants))
            if source.is_due(watermark_ns):
                heapq.heappush(heads, source.waiting[0].rank)
            else:
                due.discard(name)

    def _begins(self, entry: Entry, source: Source, end: End) -> bool:
        """Whether a batch comes out: its session is not over. The first of a session ends the one before."""
        if entry.generation < source.released:
            self._move(entry, "partly_late" if entry.outcome == "fused" else entry.outcome)
            return False
        if entry.generation > source.released:
            if source.released >= 0:
                end(source.number)
            source.released, source.number = entry.generation, self.next_number
            self.sessions[self.next_number] = entry.key
            self.next_number += 1
        return True

    def _book(self, entry: Entry, instants: Instants, refused: RejectionReason | None) -> None:
        # Of a batch that is late as a whole, only its ended trajectories have come out.
        if refused is None and (len(instants.rows) or not entry.late):
            entry.outcome = "partly_late" if entry.late else "fused"
        elif refused is not None and entry.outcome not in ("partly_late", "fused"):
            entry.outcome = refused
        if instants.last:
            self._move(entry, entry.outcome)
