"""Plays a tape in real time. The clock and the keyboard are injected."""

import itertools
import math
import threading
import time
from collections.abc import Callable

from .tape import Schedule, Tape

LATE_S = 0.2
"""A live entry that is later than this, s, is left out: it would arrive after the allowed lateness."""
_TICK_S = 0.1  # longest wait between two looks at the keyboard

Progress = Callable[[int, float], None]
"""Called with the number of the pass and the time within it at every entry."""


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


class Player:
    """Plays a tape.

    Parameters
    ----------
    tape
        The entries and their output.
    schedule
        When they are due.
    stop
        Ends playback when set.
    read_key
        Returns a key that was pressed, or ""; the space bar pauses and resumes.
    progress
        Called at every entry.
    clock
        Clocks of the machine, or of a test.
    """

    def __init__(
        self,
        tape: Tape,
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
        self._period = tape.length / schedule.speed
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
        live = self._schedule.stamps == "now"
        for t, entry in self._tape.begin(number, first, start):
            if self._schedule.loop and t >= self._tape.length - 1e-9:
                break
            due = begin + t / self._schedule.speed
            if due + self._paused_s < joined - LATE_S:  # the pass started before this process
                self._tape.skip(entry, counted=False)
                continue
            if self._wait(due):
                return
            if live and self._clock.monotonic() > due + self._paused_s + LATE_S:
                self._tape.skip(entry, counted=True)
                continue
            self._tape.put(entry)
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
