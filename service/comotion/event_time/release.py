"""Instants that wait for the watermark in; in time order, with the ends of sessions, out (rules 9 and 10)."""

import heapq
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from comotion_schemas import RejectionReason

from .directory import Sources
from .instants import Entry, Instant, SessionEnded
from .sources import Source
from .stats import Key


class Settle(Protocol):
    """Books what became of a batch."""

    def __call__(self, entry: Entry, fate: Any, *, rejected: bool = False) -> None:
        """`fate` is a name of :class:`.stats.Ledger`, or the reason of a rejection."""


class _Waiting(NamedTuple):
    """An instant that waits; compared by the first three, of which `order` is unique."""

    stamp_ns: int
    source: str
    order: int
    generation: int
    instant: Instant


class Release:
    """The instants that wait, and the numbers of the sessions whose instants have come out.

    Parameters
    ----------
    sources
        The sources; whose session is over is read there.
    settle
        Is told what became of a batch once all its instants have come out.

    Attributes
    ----------
    sessions
        (source, session) by number, of every session that is current or has trajectories.
    """

    def __init__(self, sources: Sources, settle: Settle) -> None:
        self._sources = sources
        self._settle = settle
        self._waiting: list[_Waiting] = []
        self._over: list[int] = []
        self._order = 0
        self._next_number = 0
        self.sessions: dict[int, Key] = {}

    def add(self, instant: Instant, generation: int) -> None:
        """Let an instant wait; `generation` counts the session among those of its source."""
        self._order += 1
        key = instant.stamp_ns, instant.batch.source, self._order
        heapq.heappush(self._waiting, _Waiting(*key, generation, instant))

    def end(self, number: int) -> None:
        """Let the end of a session come out with the next release."""
        self._over.append(number)

    def until(self, watermark_ns: int | None) -> Iterator[Instant | SessionEnded]:
        """What is stamped at or before the watermark, in the order of rule 9."""
        over, self._over = self._over, []
        yield from (SessionEnded(number) for number in over if number >= 0)
        if watermark_ns is None:
            return
        while self._waiting and self._waiting[0].stamp_ns <= watermark_ns:
            found = heapq.heappop(self._waiting)
            source = self._sources.get(found.source)
            if source is None or found.generation < source.released:
                self._drop(found.instant.entry)
                continue
            if found.generation > source.released:
                if source.released >= 0:
                    yield SessionEnded(source.number)
                self._number(source, found)
            yield replace(found.instant, session=source.number)

    def _drop(self, entry: Entry | None) -> None:
        """An instant of a session that is over is late."""
        if entry is not None:
            entry.late = True
            self._finish(entry)

    def _number(self, source: Source, first: _Waiting) -> None:
        """Give a session its number, with its first instant."""
        source.released, source.number = first.generation, self._next_number
        self.sessions[self._next_number] = (first.source, first.instant.batch.session)
        self._next_number += 1

    def done(self, instant: Instant, refused: RejectionReason | None) -> None:
        """Book an instant that came out: it was fused, or refused for a reason."""
        entry = instant.entry
        if entry is None:
            return
        if refused is None:
            entry.kept = True
        else:
            entry.refused = refused
        self._finish(entry)

    def _finish(self, entry: Entry) -> None:
        """One instant of a batch is booked; with the last one, the batch is."""
        entry.left -= 1
        if entry.left > 0:
            return
        if entry.kept:
            self._settle(entry, "partly_late" if entry.late else "fused")
        elif entry.refused is not None:
            self._settle(entry, entry.refused, rejected=True)
        else:
            self._settle(entry, "late")

    def state(self) -> dict[str, Any]:
        """The sessions as plain values; what waits is not kept."""
        return {
            "next_number": self._next_number,
            "sessions": [[number, *key] for number, key in self.sessions.items()],
        }

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        self._next_number = int(state["next_number"])
        self.sessions = {int(number): (source, session) for number, source, session in state["sessions"]}
