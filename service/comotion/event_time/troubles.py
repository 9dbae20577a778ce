"""Remembers what sources do wrong, for as long as their data shows it."""

from dataclasses import dataclass
from typing import Any

from comotion_schemas.messages import ProblemKind

# ns after which what was seen last is not reported any more, and the sources of a kind that are remembered.
_LASTS_NS, _MOST = 3_000_000_000, 256
CLOCKS: tuple[ProblemKind, ...] = ("clock-ahead", "clock-behind", "clock-zero")
"""Of one source at most one of these."""
# A single batch may be late for its clock: so many are told.
_TELLING = dict.fromkeys(CLOCKS, 3)


@dataclass(frozen=True)
class ClockTrouble:
    """A clock that is off: offset to the scene and last stamp.

    `pace` is how far the stamp has gone up by, in the time that has passed; 1 for nanoseconds.
    """

    offset_ns: int
    stamp_ns: int
    pace: float = 0.0


@dataclass(frozen=True)
class _Seen:
    """When something was seen last, how often in a row, and what shows it."""

    at_ns: int
    count: int
    evidence: Any


class Troubles:
    """By kind, the sources, what shows it, and when it was seen last.

    `at_ns` is now, on the clock of arrivals.
    """

    def __init__(self) -> None:
        self.at_ns = 0
        self._seen: dict[ProblemKind, dict[str, _Seen]] = {}

    def note(self, kind: ProblemKind, source: str, evidence: Any = None) -> None:
        """Take note of one; of too many sources, the one seen longest ago is forgotten."""
        seen = self._seen.setdefault(kind, {})
        before = seen.pop(source, None)
        if len(seen) >= _MOST:
            del seen[next(iter(seen))]
        count = before.count if before is not None and self._lasts(before) else 0
        seen[source] = _Seen(self.at_ns, count + 1, evidence)

    def note_clock(self, source: str, stamp_ns: int, offset_ns: int, kind: ProblemKind) -> None:
        """Take note of a stamp that is off the time of the scene."""
        before = self._seen.get(kind, {}).get(source)
        pace = 0.0
        if before is not None and self._lasts(before):
            pace = before.evidence.pace
            if self.at_ns > before.at_ns:
                pace = (stamp_ns - before.evidence.stamp_ns) / (self.at_ns - before.at_ns)
        self.clear_clock(source, but=kind)
        self.note(kind, source, ClockTrouble(offset_ns, stamp_ns, pace))

    def clear_clock(self, source: str, but: ProblemKind | None = None) -> None:
        """Take note that the clock of a source is right, or off in one way only."""
        for kind in CLOCKS:
            if kind != but:
                self._seen.get(kind, {}).pop(source, None)

    def sources(self, *kinds: ProblemKind) -> set[str]:
        """Sources of which one of some kinds has been seen lately."""
        return {name for kind in kinds for name in self._of(kind)}

    def lately(self) -> dict[ProblemKind, dict[str, Any]]:
        """What has been seen within 3 s: by kind and source, the evidence."""
        found = {kind: self._of(kind) for kind in self._seen}
        return {kind: sources for kind, sources in found.items() if sources}

    def _of(self, kind: ProblemKind) -> dict[str, Any]:
        seen, least = self._seen.get(kind, {}), _TELLING.get(kind, 1)
        told = {name: one for name, one in sorted(seen.items()) if one.count >= least and self._lasts(one)}
        return {name: one.evidence for name, one in told.items()}

    def _lasts(self, one: _Seen) -> bool:
        return self.at_ns - one.at_ns <= _LASTS_NS
