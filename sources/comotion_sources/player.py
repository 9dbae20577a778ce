"""Plays streams in real time: frames -> messages at the times they are due. The clock is injected."""

import itertools
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.errors import KnownError

from .frames import NANOSECONDS, Batcher, MessageBuilder, in_time_order
from .streams import Stream

LATE_S = 0.2
"""A live frame that is later than this, s, is left out: it would arrive after the allowed lateness."""

Progress = Callable[[int, float], None]
"""Called with the number of the pass and the time within it at every frame."""


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """When frames are due, and which stamps they get.

    Attributes
    ----------
    start_at
        Time of t = 0 of the first pass: Unix time in seconds, ``now``, or ``aligned``: when the
        wall clock is a multiple of the length, so that processes that loop the same scene are in phase.
    loop
        Repeat the streams; each pass is a new session.
    pace
        Seconds of frame time per second.
    live_stamps
        Stamp a frame with the wall clock time at which it is due; False: with its own time, continued
        over the passes, and leave no frame out.
    duration
        Seconds after which playback stops; None: at the end of the streams.
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


class Sink(Protocol):
    """Output of the messages of one source."""

    builder: MessageBuilder

    def put(self, message: ObservationBatch | TruthBatch) -> None:
        """Publish a message that :attr:`builder` has built."""

    def overrun(self) -> None:
        """Count a frame that is left out."""

    def new_session(self) -> None:
        """Start a new session with a new builder."""


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
    """Plays streams into sinks.

    Parameters
    ----------
    streams, sinks
        One sink for each stream.
    schedule
        When frames are due.
    stop
        Ends playback when set.
    publish_sigma
        Publish the noise if a frame has it.
    progress
        Called at every frame.
    clock
        Clocks of the machine, or of a test.
    """

    def __init__(
        self,
        streams: Sequence[Stream],
        sinks: Sequence[Sink],
        schedule: Schedule,
        stop: threading.Event,
        *,
        publish_sigma: bool = False,
        progress: Progress | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._streams, self._sinks, self._schedule = streams, sinks, schedule
        self._stop = stop
        self._publish_sigma = publish_sigma
        self._progress = progress or (lambda number, t: None)  # noqa: ARG005 - no progress
        self._clock = clock or Clock()
        self._length = max(stream.length for stream in streams)
        self._period = self._length / schedule.pace
        limit = math.inf if schedule.duration is None else schedule.duration
        self._end = self._clock.monotonic() + limit

    def run(self) -> None:
        """Play until the streams or the duration of the schedule end, or `stop` is set."""
        start, first = self._first_pass()
        for number in itertools.count(first):
            if number > first:
                for sink in self._sinks:
                    sink.new_session()
            self._play_pass(number, start + number * self._period)
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

    def _play_pass(self, number: int, start: float) -> None:
        # Compare the clocks once per pass, so that a step of the wall clock does not change the pacing.
        joined = self._clock.monotonic()
        begin = start - self._clock.wall() + joined
        batchers = self._batchers(number, start)
        for index, frame in in_time_order([stream.frames for stream in self._streams]):
            if self._schedule.loop and frame.t >= self._length - 1e-9:
                break
            due = begin + frame.t / self._schedule.pace
            if due < joined - LATE_S:  # the pass started before this process
                continue
            if self._wait(due):
                return
            if self._schedule.live_stamps and self._clock.monotonic() > due + LATE_S:
                batchers[index].skip(frame)
                self._sinks[index].overrun()
                continue
            for message in batchers[index].messages(frame):
                self._sinks[index].put(message)
            self._progress(number, frame.t)
        if self._schedule.loop:
            self._wait(begin + self._period)

    def _wait(self, due: float) -> bool:
        """Wait for an instant of the monotonic clock; True if playback is to stop."""
        if self._clock.wait(self._stop, max(0.0, min(due, self._end) - self._clock.monotonic())):
            return True
        if due >= self._end:
            self._stop.set()
        return self._stop.is_set()

    def _batchers(self, number: int, start: float) -> list[Batcher]:
        origin = start if self._schedule.live_stamps else number * self._length
        return [
            Batcher(
                sink.builder,
                objects=stream.objects,
                epoch_ns=round(origin * NANOSECONDS),
                publish_sigma=self._publish_sigma,
            )
            for stream, sink in zip(self._streams, self._sinks, strict=True)
        ]
