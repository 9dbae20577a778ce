"""Plays a log of messages in real time. The clock and the keyboard are injected."""

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from comotion_schemas import ObservationBatch, encode
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import Kind, StreamKind

from .schedule import Restamp, Schedule
from .streams import StreamLog, StreamMessage

if TYPE_CHECKING:
    from comotion_schemas.message_log import Logged, MessageLog

    from .source import Source

LATE_S = 0.2
"""A live entry that is later than this, s, is left out: it would arrive after the allowed lateness."""
_SLIP_S = 1.0  # what is later than this is put off with all that follows, unless its time is given
KINDS: frozenset[Kind] = frozenset({"obs", "truth", "joints", "preview"})
_CLOCKS_AGREE_NS = 10_000_000_000  # a larger offset between stamp and receipt means different clocks
_TICK_S = 0.1  # longest wait between two looks at the keyboard

Progress = Callable[[int, float], None]
"""Called with the number of the pass and the time within it at every entry."""
Log: TypeAlias = "MessageLog | StreamLog"
Entry: TypeAlias = "Logged | StreamMessage"


class Player:
    """Plays a log pass after pass.

    Parameters
    ----------
    log, outputs
        The messages, and where those of each source go.
    schedule
        Range, speed and stamps, and when entries are due.
    stop
        Ends playback when set.
    read_key
        Returns a key that was pressed, or ""; the space bar pauses and resumes.
    progress
        Called at every entry.
    clock
        Has ``time()`` and ``monotonic()`` as the module :mod:`time`; a test has one of its own.

    Raises
    ------
    ValueError
        If the log is shorter than the start of the schedule.
    """

    def __init__(
        self,
        log: Log,
        outputs: Mapping[str, "Source"],
        schedule: Schedule,
        stop: threading.Event,
        *,
        read_key: Callable[[], str] = lambda: "",
        progress: Progress | None = None,
        clock: Any = time,
    ) -> None:
        self._log, self._outputs, self._schedule, self._stop = log, outputs, schedule, stop
        self._start_ns = log.start_ns + round(schedule.start * 1e9)
        end_ns = log.end_ns if schedule.end is None else log.start_ns + round(schedule.end * 1e9)
        self._end_ns = min(end_ns, log.end_ns)
        if self._start_ns > self._end_ns:
            raise KnownError(f"the recording is only {(log.end_ns - log.start_ns) / 1e9:.1f} s long")
        # Seconds after which a pass is repeated; then entries at or after this time are left out.
        self._length = (self._end_ns - self._start_ns) / 1e9 + log.gap_s
        self._restamp: Restamp | None = None
        self._read_key = read_key
        self._progress = progress or (lambda number, t: None)  # noqa: ARG005 - no progress
        self._clock = clock
        self._period = self._length / schedule.speed
        self._paused_s = 0.0
        self._ahead = self._clock.monotonic() - self._clock.time()
        limit = math.inf if schedule.duration is None else schedule.duration
        self._end = self._clock.monotonic() + limit

    def run(self) -> None:
        """Play until the log or the duration of the schedule ends, or `stop` is set."""
        start, first = self._first_pass()
        number = first
        while True:
            self._play_pass(number, number == first, start + number * self._period + self._paused_s)
            if self._stop.is_set() or not self._schedule.loop:
                return
            number += 1
            if self._schedule.stamps == "now":
                # Passes that a process has slept through, or had no time for, are over.
                elapsed = self._clock.monotonic() - self._ahead - start - self._paused_s
                number = max(number, math.floor(elapsed / self._period))

    def _first_pass(self) -> tuple[float, int]:
        """Wall clock time of pass 0, and number of the current pass."""
        now, start = self._clock.time(), self._schedule.start_at
        if start == "now":
            return now, 0
        if start == "aligned":
            passes = now / self._period
            whole = math.floor(passes) if self._schedule.loop else math.ceil(passes)
            return whole * self._period, 0
        current = math.floor((now - float(start)) / self._period) if self._schedule.loop else 0
        return float(start), max(0, current)

    def _play_pass(self, number: int, first: bool, start: float) -> None:
        joined = self._clock.monotonic()
        if self._schedule.start_at != "now":
            # Compare the clocks once per pass, so that a step of the wall clock does not change the pacing.
            self._ahead = joined - self._clock.time()
        begin = start + self._ahead - self._paused_s
        live = self._schedule.stamps == "now"
        self._restamp = self._restamp_of(number, first, start)
        for t, entry in self._entries():
            if self._schedule.loop and t >= self._length - 1e-9:
                break
            due = begin + t / self._schedule.speed
            if due + self._paused_s < joined - LATE_S:  # the pass started before this process
                self._skip(entry, counted=False)
                continue
            if self._wait(due):
                return
            late = self._clock.monotonic() - due - self._paused_s
            if live and late > _SLIP_S and self._schedule.start_at == "now":
                self._put_off(late)
                self._outputs[entry.name].count("slips")
            elif live and late > LATE_S:
                self._skip(entry, counted=True)
                continue
            self._put(entry)
            self._progress(number, t)
        if self._schedule.loop:
            self._wait(begin + self._period)

    def _restamp_of(self, number: int, first: bool, start: float) -> Restamp | None:
        """How messages of a pass, which the wall clock sees at `start`, move in time; None: they do not."""
        if self._schedule.stamps == "now":
            return Restamp(self._reference_ns(), round(start * 1e9), self._schedule.speed)
        if first:
            return None
        reference = self._reference_ns()
        return Restamp(reference, reference + round(number * self._length * 1e9), 1.0)

    def _entries(self) -> Iterator[tuple[float, Entry]]:
        """Yield (seconds within the pass, entry) in order; the truth from before its start comes first."""
        if self._start_ns > self._log.start_ns:
            for entry in self._log.messages(frozenset({"truth"}), end_ns=self._start_ns - 1):
                yield 0.0, entry
        for entry in self._log.messages(KINDS, start_ns=self._start_ns, end_ns=self._end_ns):
            yield (entry.log_ns - self._start_ns) / 1e9, entry

    def _put(self, entry: Entry) -> None:
        """Publish an entry; where its stamp is to move and it has none, it is left out."""
        message, output = entry.decode(), self._outputs[entry.name]
        if self._restamp is None:
            output.send(cast("StreamKind", entry.kind), entry.payload, message)
        elif message is not None:
            moved = self._restamp(message)
            output.send(cast("StreamKind", entry.kind), encode(moved), moved)
        else:
            output.count("overruns")

    def _skip(self, entry: Entry, *, counted: bool) -> None:
        """Leave an entry out, but for truth, which holds whenever it comes; where `counted`, count it."""
        if entry.kind == "truth":
            self._put(entry)
            return
        if self._restamp is not None and (message := entry.decode()) is not None:
            self._restamp.leave_out(message)
        if counted:
            self._outputs[entry.name].count("overruns")

    def _reference_ns(self) -> int:
        """Stamp of the start of the range on the clock of the sources.

        It equals the time in the log unless the first stamp is more than 10 s from it, as in a recording of
        replayed data with original stamps.
        """
        for entry in self._log.messages(frozenset({"obs"}), start_ns=self._start_ns):
            batch = entry.decode()
            if isinstance(batch, ObservationBatch):
                offset = batch.stamp_ns - entry.log_ns
                return self._start_ns + (offset if abs(offset) > _CLOCKS_AGREE_NS else 0)
        return self._start_ns

    def _wait(self, due: float) -> bool:
        """Wait for an instant of the monotonic clock, which pauses delay; True if playback is to stop."""
        while True:
            self._pause()
            now = self._clock.monotonic()
            if now >= self._end:
                self._stop.set()
            left = min(due + self._paused_s, self._end) - now
            if self._stop.wait(min(max(0.0, left), _TICK_S)):
                return True
            if left <= 0:
                return self._stop.is_set()

    def _pause(self) -> None:
        """Pause from one press of the space bar to the next."""
        if self._read_key() != " ":
            return
        began = self._clock.monotonic()
        while not self._stop.wait(_TICK_S) and self._read_key() != " ":
            pass
        self._put_off(self._clock.monotonic() - began)

    def _put_off(self, seconds: float) -> None:
        """Let all that follows be due later."""
        self._paused_s += seconds
        if self._restamp is not None and self._schedule.stamps == "now":
            self._restamp.target_ns += round(seconds * 1e9)
