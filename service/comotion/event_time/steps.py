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

These are the rules for sources that stamp what happens now. Where they play recordings (`replays`), with the
stamps that these have, any batch off waits. Where it is behind, a recording is played again: the time scale
moves so that the earliest one follows what was fused. Where it is ahead, time has passed.
"""

from dataclasses import dataclass, field
from statistics import median_low
from typing import Literal

from comotion_schemas import ObservationBatch
from comotion_schemas.messages import ProblemKind

from .entries import Entry
from .troubles import Troubles

# "More than 1 s ahead" of docs/protocol.md.
FUTURE_NS = 1_000_000_000
# Silence of all that agree after which the scene follows those that do not. Within `max_lag`, so that the
# watermark has not yet passed the batches that wait.
_SILENCE_NS = 500_000_000
# Nothing is acquired in the future: clocks that are synchronised agree better than this.
AHEAD_NS = 250_000_000
# A batch that agrees and comes so long after the first that waits was sent after the step.
_MARGIN_NS = 250_000_000
# Gap between the end of a recording and its start when it is played again.
_GAP_NS = 100_000_000
# A clock counts as having been set as the service's was when it differs by less.
_SAME_STEP_NS = 1_000_000_000
# Stamps before 2001 count from a start, or are no nanoseconds.
_ZERO_NS = 10**18


@dataclass
class Steps:
    """Batches that wait for a decision about clocks, and the time scale."""

    timeout_ns: int
    window_ns: int
    """`source_timeout` and `window` in ns."""
    troubles: Troubles
    """Get to know what is wrong with clocks."""
    shift_ns: int = 0
    """Stamps minus the time scale of the scene."""
    clock_set_ns: int = 0
    """By how much the clock of the service was set since its start, as the caller says."""
    held: list[Entry] = field(default_factory=list)
    """Batches that wait."""
    followed: int = 0
    """How often the time scale has moved."""
    replays: bool = False
    """Whether sources play recordings: their stamps set the time, and a sequence number that was seen before
    may be new."""

    def scene_time(self, batch: ObservationBatch) -> int:
        """Stamp of a batch on the time scale of the scene."""
        return batch.stamp_ns - self.shift_ns

    def catch_up(self, batch: ObservationBatch, now_ns: int) -> None:
        """Let the time scale go back where a batch would be ahead of the scene alone (rule 5)."""
        # Where the service's clock was set, its sources may have been set with it.
        follows_late = self.shift_ns < 0 and abs(self.clock_set_ns) < _SAME_STEP_NS
        if not self.replays and follows_late and self.scene_time(batch) > now_ns + AHEAD_NS:
            self.shift_ns = min(batch.stamp_ns - now_ns, 0)

    def may_wait(self, entry: Entry, now_ns: int, floor_ns: int | None, *, agreed: bool, alone: bool) -> bool:
        """Whether a batch is far from now, of no use there, and waits (rule 3); takes note of its offset.

        `agreed`: its session has agreed before; `alone`: no source agrees now. Of a recording any waits: the
        end of one that is played again fast is near the end of the last one, so all of it does.
        """
        stamp_ns = self.scene_time(entry.batch)
        entry.offset_ns = stamp_ns - now_ns
        late = floor_ns is not None and stamp_ns < floor_ns
        far = entry.offset_ns > FUTURE_NS or (late and entry.offset_ns < -self.timeout_ns)
        if not far and not (self.replays and any(other.key == entry.key for other in self.held)):
            return False
        near = abs(entry.offset_ns) <= self.window_ns
        as_set = self.clock_set_ns != 0 and abs(entry.offset_ns - self.clock_set_ns) <= _SAME_STEP_NS
        return self.replays or agreed or (alone and (near or as_set))

    def decide(self, agreed_ns: int | None, at_ns: int) -> Literal["wait", "judge", "follow"]:
        """What to do with the batches that wait; `agreed_ns` is when any source has agreed last."""
        if not self.held:
            return "wait"
        first = self.held[0].at_ns
        if agreed_ns is not None and agreed_ns >= first + _MARGIN_NS:
            return "judge"
        return "follow" if at_ns - first >= _SILENCE_NS else "wait"

    def follow(self, now_ns: int) -> None:
        """Move the time scale to the clock of the batches that wait."""
        self.followed += 1
        if self.replays:
            # So that the earliest follows the fused ones; a gap in a recording lasts as its stamps say.
            earliest = min(self.scene_time(entry.batch) for entry in self.held) - now_ns
            self.shift_ns += earliest - _GAP_NS if earliest < 0 else 0
            return
        by_source: dict[str, list[int]] = {}
        for entry in self.held:
            by_source.setdefault(entry.batch.source, []).append(entry.offset_ns)
        self.shift_ns += median_low(map(median_low, by_source.values()))

    def note(self, batch: ObservationBatch, offset_ns: int, *, off: bool) -> None:
        """Take note of whether the clock of a source is right; `off` says that it cannot be."""
        kind: ProblemKind | None = "clock-ahead" if offset_ns > 0 else "clock-behind"
        if not off and -self.timeout_ns <= offset_ns <= AHEAD_NS:
            kind = None
        # The stamps of a recording may count from anything.
        elif batch.stamp_ns < _ZERO_NS and not self.replays:
            kind = "clock-zero"
        self.troubles.note_clock(batch.source, batch.stamp_ns, offset_ns, kind)
