"""Plays what was recorded or is simulated in real time. The clock and the keyboard are injected."""

import itertools
import math
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from comotion_schemas.errors import KnownError

LATE_S = 0.2
"""A live item that is later than this, s, is left out: it would arrive after the allowed lateness."""
_TICK_S = 0.1  # longest wait between two looks at the keyboard

Item = TypeVar("Item")
Progress = Callable[[int, float], None]
"""Called with the number of the pass and the time within it at every item."""


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """When items are due, and which stamps they get.

    Attributes
    ----------
    start_at
        Time of t = 0 of the first pass: Unix time in seconds, ``now``, or ``aligned``: when the
        wall clock is a multiple of the length, so that processes that loop the same scene are in phase.
    loop
        Repeat the tape; each pass is a new session.
    pace
        Seconds of the tape per second.
    live_stamps
        Stamp an item with the wall clock time at which it is due; False: with its own time, continued
        over the passes, and leave nothing out.
    duration
        Seconds after which playback stops; None: at the end of the tape.
    """

    start_at: float | str = "now"
    loop: bool = False
    pace: float = 1.0
    live_stamps: bool = True
    duration: float | None = None


def parse_start(text: str) -> float | str:
    """Parse a start time: ``now``, ``aligned`` or Unix time in seconds.

    Raises
    ------
    ValueError
        If the text is none of these.
    """
    if text in {"now", "aligned"}:
        return text
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # Later times in nanoseconds do not fit in int64.
    if not 0 <= value < 9e9:
        raise KnownError(f"start {text!r} is neither 'now', 'aligned' nor a Unix time in seconds")
    return value


class Tape(Protocol[Item]):
    """What is played, and where it goes."""

    @property
    def length(self) -> float:
        """Seconds after which a pass may be repeated; then items at or after this time are left out."""

    def begin(self, number: int, first: bool, start: float) -> Iterator[tuple[float, Item]]:
        """Begin a pass, which the wall clock sees at `start`; yield (seconds within it, item) in order."""

    def put(self, item: Item) -> None:
        """Publish an item."""

    def skip(self, item: Item) -> None:
        """Leave an item out because it is late."""

    def delay(self, seconds: float) -> None:
        """Stamp all further items of the pass later, after a pause."""


class Clock:
    """The clocks of the machine; tests replace them."""

    def wall(self) -> float:
        """Unix time in seconds."""
        return time.time()

    def monotonic(self) -> float:
        """Seconds of a clock that is never set."""
        return time.monotonic()

    def wait(self, stop: threading.Event, seconds: float) -> bool:
        """Wait for an event or a number of seconds; True if the event is set."""
        return stop.wait(seconds)


class Player(Generic[Item]):
    """Plays a tape.

    Parameters
    ----------
    tape
        The items and their output.
    schedule
        When they are due.
    stop
        Ends playback when set.
    read_key
        Returns a key that was pressed, or ""; the space bar pauses and resumes.
    progress
        Called at every item.
    clock
        Clocks of the machine, or of a test.
    """

    def __init__(
        self,
        tape: Tape[Item],
        schedule: Schedule,
        stop: threading.Event,
        *,
        read_key: Callable[[], str] = lambda: "",
        progress: Progress | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._tape, self._schedule, self._stop = tape, schedule, stop
        self._read_key = read_key
        self._progress = progress or (lambda number, t: None)  # noqa: ARG005 - no progress
        self._clock = clock or Clock()
        self._period = tape.length / schedule.pace
        self._paused_s = 0.0
        self._ahead = self._clock.monotonic() - self._clock.wall()
        limit = math.inf if schedule.duration is None else schedule.duration
        self._end = self._clock.monotonic() + limit

    def run(self) -> None:
        """Play until the tape or the duration of the schedule ends, or `stop` is set."""
        start, first = self._first_pass()
        for number in itertools.count(first):
            self._play_pass(number, number == first, start + number * self._period + self._paused_s)
            if self._stop.is_set() or not self._schedule.loop:
                return

    def _first_pass(self) -> tuple[float, int]:
        """Wall clock time of pass 0, and number of the current pass."""
        now, start = self._clock.wall(), self._schedule.start_at
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
            self._ahead = joined - self._clock.wall()
        begin = start + self._ahead - self._paused_s
        for t, item in self._tape.begin(number, first, start):
            if self._schedule.loop and t >= self._tape.length - 1e-9:
                break
            due = begin + t / self._schedule.pace
            if due + self._paused_s < joined - LATE_S:  # the pass started before this process
                continue
            if self._wait(due):
                return
            if self._schedule.live_stamps and self._clock.monotonic() > due + self._paused_s + LATE_S:
                self._tape.skip(item)
                continue
            self._tape.put(item)
            self._progress(number, t)
        if self._schedule.loop:
            self._wait(begin + self._period)

    def _wait(self, due: float) -> bool:
        """Wait for an instant of the monotonic clock, which pauses delay; True if playback is to stop."""
        while True:
            self._pause()
            now = self._clock.monotonic()
            if now >= self._end:
                self._stop.set()
            left = min(due + self._paused_s, self._end) - now
            if self._clock.wait(self._stop, min(max(0.0, left), _TICK_S)):
                return True
            if left <= 0:
                return self._stop.is_set()

    def _pause(self) -> None:
        """Pause from one press of the space bar to the next."""
        if self._read_key() != " ":
            return
        began = self._clock.monotonic()
        while not self._clock.wait(self._stop, _TICK_S) and self._read_key() != " ":
            pass
        seconds = self._clock.monotonic() - began
        self._paused_s += seconds
        self._tape.delay(seconds)
