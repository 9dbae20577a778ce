"""Judges batches whose stamps are far from now: wait, follow their clock, or refuse.

One wrong clock must not move the time of a scene. But when a clock is set that all sources share, all of
them are wrong at once, and the scene follows them:

1. A batch is off when its stamp is more than 1 s after now, or late and more than `source_timeout` before.
2. While any source agrees with the scene's time, an off batch is judged like any other: rejected, or late.
3. A batch off waits where its session has agreed before, where its clock is off by less than the window, or
   by as much as the clock of the service was set. Any other is judged.
4. When a source has agreed after the first that waits came, all that wait are judged. When none has for half
   a second, the time scale moves by their median offset, and they are on time.
5. What the clock of the service has passed is not ahead. Where the scene has followed sources that were late,
   the time scale goes back with the first one that is less late, as far as its stamp says.

These are the rules for sources that stamp what happens now. Where they play recordings, with the stamps that
these have, any batch off waits. Where it is behind, a recording is played again: the time scale moves so that
the earliest one follows what was fused. Where it is ahead, time has passed.
"""

from dataclasses import dataclass, field
from statistics import median_low
from typing import Literal

from comotion_schemas import ObservationBatch
from comotion_schemas.messages import ProblemKind

from .entries import Entry
from .sources import Sources
from .troubles import Troubles

# "More than 1 s ahead" of docs/protocol.md.
FUTURE_NS = 1_000_000_000
# Silence of all that agree after which the scene follows those that do not. Within `max_lag`, so that the
# watermark has not yet passed the batches that wait.
_SILENCE_NS = 500_000_000
# Nothing is acquired in the future: clocks that are synchronised agree better than this.
_AHEAD_NS = 250_000_000
# A batch that agrees and comes so long after the first that waits was sent after the step.
_MARGIN_NS = 250_000_000
# Gap between the end of a recording and its start when it is played again.
_GAP_NS = 100_000_000
# A clock counts as having been set as the service's was when it differs by less.
_SAME_STEP_NS = 1_000_000_000


@dataclass
class LiveClock:
    """Policy where sources stamp what happens now: batches that wait for a decision, and the time scale."""

    sources: Sources
    window_ns: int
    """`window` in ns."""
    troubles: Troubles
    """Get to know what is wrong with clocks."""
    shift_ns: int = 0
    """Stamps minus the time scale of the scene."""
    clock_set_ns: int = 0
    """By how much the clock of the service was set since its start, as the caller says."""
    held: list[Entry] = field(default_factory=list)
    """Batches that wait."""
    # Stamps before 2001 count from a start, or are no nanoseconds.
    _least_ns = 10**18

    def scene_time(self, batch: ObservationBatch) -> int:
        """Stamp of a batch on the time scale of the scene."""
        return batch.stamp_ns - self.shift_ns

    def is_copy(self, entry: Entry) -> bool:
        """Whether a batch cannot be new, as its sequence number was seen before."""
        return entry.repeated

    def may_wait(self, entry: Entry, now_ns: int, floor_ns: int | None) -> bool:
        """Whether a batch is far from now, of no use there, and waits (rule 3); takes note of its offset."""
        # Rule 5. Where the service's clock was set, its sources may have been set with it.
        follows_late = self.shift_ns < 0 and abs(self.clock_set_ns) < _SAME_STEP_NS
        if follows_late and self.scene_time(entry.batch) > now_ns + _AHEAD_NS:
            self.shift_ns = min(entry.batch.stamp_ns - now_ns, 0)
        if not self._is_off(entry, now_ns, floor_ns):
            return False
        source, agreed_ns = self.sources.sender(entry.key), self.sources.agreed_ns()
        near = abs(entry.offset_ns) <= self.window_ns
        as_set = self.clock_set_ns != 0 and abs(entry.offset_ns - self.clock_set_ns) <= _SAME_STEP_NS
        alone = agreed_ns is None or entry.at_ns - agreed_ns > self.sources.timeout_ns
        return (source is not None and source.agreed_ns is not None) or (alone and (near or as_set))

    def _is_off(self, entry: Entry, now_ns: int, floor_ns: int | None) -> bool:
        stamp_ns = self.scene_time(entry.batch)
        entry.offset_ns = stamp_ns - now_ns
        late = floor_ns is not None and stamp_ns < floor_ns
        return entry.offset_ns > FUTURE_NS or (late and entry.offset_ns < -self.sources.timeout_ns)

    def decide(self, now_ns: int, at_ns: int) -> Literal["wait", "judge", "follow"]:
        """What to do with the batches that wait (rule 4); moves the time scale where they are followed."""
        if not self.held:
            return "wait"
        first_ns, agreed_ns = self.held[0].at_ns, self.sources.agreed_ns()
        if agreed_ns is not None and agreed_ns >= first_ns + _MARGIN_NS:
            return "judge"
        if at_ns - first_ns < _SILENCE_NS:
            return "wait"
        self.shift_ns += self._step_ns(now_ns)
        return "follow"

    def _step_ns(self, _: int) -> int:
        by_source: dict[str, list[int]] = {}
        for entry in self.held:
            by_source.setdefault(entry.batch.source, []).append(entry.offset_ns)
        return median_low(map(median_low, by_source.values()))

    def pace_ns(self, at_ns: int) -> int | None:
        """What time it is where no source is live: the clocks of those that still send are behind."""
        return min((s.newest_ns for s in self.sources.sending(at_ns).values()), default=None)

    def offset_ns(self, batch: ObservationBatch, now_ns: int) -> int:
        """By how much the clock of a source is ahead, also where the scene has followed it."""
        return batch.stamp_ns - now_ns

    def note(self, batch: ObservationBatch, offset_ns: int, *, off: bool) -> None:
        """Take note of whether the clock of a source is right; `off` says that it cannot be."""
        kind: ProblemKind | None = "clock-ahead" if offset_ns > 0 else "clock-behind"
        if not off and -self.sources.timeout_ns <= offset_ns <= _AHEAD_NS:
            kind = None
        elif batch.stamp_ns < self._least_ns:
            kind = "clock-zero"
        self.troubles.note_clock(batch.source, batch.stamp_ns, offset_ns, kind)


class ReplayClock(LiveClock):
    """Policy where sources play recordings: their stamps set the time, and may count from anything."""

    _least_ns = -(2**63)

    def is_copy(self, _: Entry) -> bool:
        """It may be played again."""
        return False

    def may_wait(self, entry: Entry, now_ns: int, floor_ns: int | None) -> bool:
        """The end of one that is played again fast is near the end of the last one: all of it waits."""
        return self._is_off(entry, now_ns, floor_ns) or any(other.key == entry.key for other in self.held)

    def _step_ns(self, now_ns: int) -> int:
        # So that the earliest follows the fused ones; a gap in a recording lasts as its stamps say.
        earliest = min(self.scene_time(entry.batch) for entry in self.held) - now_ns
        return earliest - _GAP_NS if earliest < 0 else 0

    def pace_ns(self, _: int) -> int | None:
        """Without live sources time stands still."""
        return None

    def offset_ns(self, batch: ObservationBatch, now_ns: int) -> int:
        """By how much a source is ahead of what the scene plays."""
        return self.scene_time(batch) - now_ns
