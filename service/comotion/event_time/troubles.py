"""Remembers what sources do wrong, for as long as their data shows it."""

from dataclasses import dataclass
from typing import Any

from comotion_schemas.messages import ProblemKind

# ns after which a trouble is not reported any more, and the sources of a kind that are remembered.
_LASTS_NS, _MOST = 3_000_000_000, 256
CLOCKS: tuple[ProblemKind, ...] = ("clock-ahead", "clock-behind", "clock-zero")
"""Of one source at most one of these."""
# A single batch may seem late for its clock: a trouble is reported after so many in a row.
_REPORTED_AFTER = dict.fromkeys(CLOCKS, 3)


@dataclass(frozen=True)
class ClockTrouble:
    """A clock that is off: offset to the scene and last stamp.

    `pace` is how far the stamp has gone up by, in the time that has passed; 1 for nanoseconds.
    """

    offset_ns: int
    stamp_ns: int
    pace: float = 0.0

    @property
    def off_s(self) -> float:
        """How far it is off, s."""
        return abs(self.offset_ns) / 1e9


@dataclass(frozen=True)
class _Seen:
    """When a trouble was seen last, how often in a row, and its evidence."""

    at_ns: int
    count: int
    evidence: Any


class Troubles:
    """Troubles by kind and source, with their evidence and when they were seen last.

    `at_ns` is now, on the clock of arrivals.
    """

    def __init__(self) -> None:
        self.at_ns = 0
        self._seen: dict[ProblemKind, dict[str, _Seen]] = {}

    def note(self, kind: ProblemKind, source: str, evidence: Any = None) -> None:
        """Take note of a trouble; of too many sources, the one seen longest ago is forgotten."""
        seen = self._seen.setdefault(kind, {})
        previous = seen.pop(source, None)
        if len(seen) >= _MOST:
            del seen[next(iter(seen))]
        count = previous.count if previous is not None and self._lasts(previous) else 0
        seen[source] = _Seen(self.at_ns, count + 1, evidence)

    def note_clock(self, source: str, stamp_ns: int, offset_ns: int, kind: ProblemKind | None) -> None:
        """Take note of how a stamp is off the time of the scene; None: the clock of its source is right."""
        for other in CLOCKS:
            if other != kind:
                self._seen.get(other, {}).pop(source, None)
        if kind is None:
            return
        previous, pace = self._seen.get(kind, {}).get(source), 0.0
        if previous is not None and self._lasts(previous):
            pace = previous.evidence.pace
            if self.at_ns > previous.at_ns:
                pace = (stamp_ns - previous.evidence.stamp_ns) / (self.at_ns - previous.at_ns)
        self.note(kind, source, ClockTrouble(offset_ns, stamp_ns, pace))

    def sources(self, *kinds: ProblemKind) -> set[str]:
        """Sources of which one of some kinds has been seen lately."""
        return {name for kind in kinds for name in self._of(kind)}

    def lately(self) -> dict[ProblemKind, dict[str, Any]]:
        """Evidence of the troubles seen within 3 s, by kind and source."""
        return {kind: sources for kind in self._seen if (sources := self._of(kind))}

    def _of(self, kind: ProblemKind) -> dict[str, Any]:
        seen, least = self._seen.get(kind, {}), _REPORTED_AFTER.get(kind, 1)
        return {n: s.evidence for n, s in sorted(seen.items()) if s.count >= least and self._lasts(s)}

    def _lasts(self, sighting: _Seen) -> bool:
        return self.at_ns - sighting.at_ns <= _LASTS_NS
