"""Batches whose stamps are far from now in; whether to wait, to follow their clock or to judge them out.

One wrong clock must not move the time of a scene. But when a clock is set that all sources share, all of
them are wrong at once, and the scene follows them:

1. A batch is off when its stamp is more than 1 s after now, or late and more than `source_timeout` before.
2. While any source agrees with the scene's time, an off batch is judged like any other: rejected, or late.
3. A batch off waits where its session has agreed before, where its clock is off by less than the window, or
   by as much as the clock of the service was set. Any other is judged.
4. When a source has agreed after the first that waits came, all that wait are judged. When none has for half
   a second, the time scale moves by their median offset, and they are on time.

With ``follow_all`` (event clock), any batch off waits. Where it is behind, a recording is played again: the
time scale moves so that the earliest one follows what was fused. Where it is ahead, time has passed.
"""

from dataclasses import dataclass, field
from statistics import median_low
from typing import Literal

from comotion_schemas import ObservationBatch

from .instants import Entry

# "More than 1 s ahead" of docs/protocol.md.
FUTURE_NS = 1_000_000_000
# Silence of all that agree after which the scene follows those that do not. Within `max_lag`, so that the
# watermark has not passed by then what waits.
_SILENCE_NS = 500_000_000
# A source that agrees so long after the first that waits is not on its way since before the step.
_MARGIN_NS = 250_000_000
# What a recording that is played again leaves to the end of the last one.
_GAP_NS = 100_000_000
# A clock counts as having been set as the service's was when it differs by less.
_SAME_STEP_NS = 1_000_000_000
# Stamps before 2001 count from a start, or are no nanoseconds.
_ZERO_NS = 10**18
# Troubles are remembered so long after the last batch that shows them, and so many before one is told.
_TROUBLE_NS = 3_000_000_000
_TELLING = 3
_MAX_TROUBLES = 256

ClockKind = Literal["clock-ahead", "clock-behind", "clock-zero"]


@dataclass
class ClockTrouble:
    """A source whose clock is off: kind, offset to the scene, last stamp, and when it was seen.

    `pace` is how far the stamp has gone up by, in the time that has passed; 1 for nanoseconds.
    """

    kind: ClockKind
    offset_ns: int
    stamp_ns: int
    seen_ns: int
    count: int = 0
    pace: float = 0.0


@dataclass
class Steps:
    """What waits for a decision about clocks, and which clocks are wrong.

    Attributes
    ----------
    window_ns, timeout_ns
        `window` and `source_timeout` in ns.
    shift_ns
        Stamps minus the time scale of the scene.
    clock_set_ns
        By how much the clock of the service was set since its start, as the caller says.
    follow_all
        Follow any clock, as with recordings.
    held
        Batches that wait.
    followed
        How often the time scale has moved.
    """

    window_ns: int
    timeout_ns: int
    shift_ns: int = 0
    clock_set_ns: int = 0
    follow_all: bool = False
    held: list[Entry] = field(default_factory=list)
    followed: int = 0
    _troubles: dict[str, ClockTrouble] = field(default_factory=dict)

    def scene_time(self, batch: ObservationBatch) -> int:
        """Stamp of a batch on the time scale of the scene."""
        return batch.stamp_ns - self.shift_ns

    def is_off(self, entry: Entry, reference_ns: int, floor_ns: int | None) -> bool:
        """Whether a batch is far from a time, and of no use there; takes note of its offset."""
        stamp_ns = self.scene_time(entry.batch)
        entry.offset_ns = stamp_ns - reference_ns
        late = floor_ns is not None and stamp_ns < floor_ns
        return entry.offset_ns > FUTURE_NS or (late and entry.offset_ns < -self.timeout_ns)

    def may_wait(self, entry: Entry, *, agreed: bool, alone: bool) -> bool:
        """Whether a batch that is off waits.

        `agreed`: its session has agreed before; `alone`: no source agrees now.
        """
        if self.follow_all or agreed:
            return True
        if not alone:
            return False
        step = entry.offset_ns - self.clock_set_ns
        near = abs(entry.offset_ns) <= self.window_ns
        return near or (self.clock_set_ns != 0 and abs(step) <= _SAME_STEP_NS)

    def decide(self, agreed_ns: int | None, at_ns: int) -> Literal["wait", "judge", "follow"]:
        """What to do with those that wait; `agreed_ns` is when any source has agreed last."""
        if not self.held:
            return "wait"
        first = self.held[0].at_ns
        if agreed_ns is not None and agreed_ns >= first + _MARGIN_NS:
            return "judge"
        return "follow" if at_ns - first >= _SILENCE_NS else "wait"

    def follow(self, reference_ns: int) -> None:
        """Move the time scale to the clock of those that wait."""
        if self.follow_all:
            earliest = min(self.scene_time(one.batch) for one in self.held) - reference_ns
            # A gap in a recording has lasted as long as it says.
            shift = earliest - _GAP_NS if earliest < 0 else 0
        else:
            by_source: dict[str, list[int]] = {}
            for one in self.held:
                by_source.setdefault(one.batch.source, []).append(one.offset_ns)
            shift = median_low(median_low(offsets) for offsets in by_source.values())
        self.shift_ns += shift
        self.followed += 1

    def note(self, batch: ObservationBatch, offset_ns: int, at_ns: int) -> None:
        """Take note of a batch whose clock is wrong, or which is late for its clock."""
        zero = batch.stamp_ns < _ZERO_NS and not self.follow_all
        kind: ClockKind = "clock-zero" if zero else "clock-ahead" if offset_ns > 0 else "clock-behind"
        trouble = self._troubles.get(batch.source)
        if trouble is None or trouble.kind != kind or at_ns - trouble.seen_ns > _TROUBLE_NS:
            self._troubles.pop(batch.source, None)
            while len(self._troubles) >= _MAX_TROUBLES:
                del self._troubles[next(iter(self._troubles))]
            trouble = self._troubles[batch.source] = ClockTrouble(kind, 0, 0, at_ns)
        if trouble.count and at_ns > trouble.seen_ns:
            trouble.pace = (batch.stamp_ns - trouble.stamp_ns) / (at_ns - trouble.seen_ns)
        trouble.offset_ns, trouble.stamp_ns, trouble.seen_ns = offset_ns, batch.stamp_ns, at_ns
        trouble.count += 1

    def clear(self, source: str) -> None:
        """Take note that the clock of a source is right."""
        self._troubles.pop(source, None)

    def troubles(self, at_ns: int) -> dict[str, ClockTrouble]:
        """Wrong clocks by source, as far as they have lately been seen often enough."""
        return {
            name: one
            for name, one in self._troubles.items()
            if one.count >= _TELLING and at_ns - one.seen_ns <= _TROUBLE_NS
        }
