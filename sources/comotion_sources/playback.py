"""Streams played live: frames are published when they are due, pass after pass."""

import itertools
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from comotion_schemas import DEFAULT_SCENE
from comotion_schemas.transport import SessionSettings

from .frames import NANOSECONDS, Batcher, in_time_order
from .runtime import SourcePublisher
from .streams import Stream

LATE_S = 0.2
"""A live instant later than this is left out: fresh ones are worth more than a burst of old ones."""

Progress = Callable[[int, float], None]
"""Called with the number of the pass and the time within it at every frame."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """When frames are published, and with which stamps.

    Attributes
    ----------
    start_at
        When t = 0 of the first pass is: Unix time in seconds, ``now``, or ``aligned``: when the
        wall clock is a multiple of the length, which puts processes that loop the same scene in phase.
    loop
        Start again at the end, each pass as a new session.
    pace
        Seconds of the frames' time per second.
    live_stamps
        Stamp with the wall clock when a frame is due; False: with the frames' own time, so that
        passes follow each other from 0 on and nothing is left out.
    duration
        Seconds after which to stop; None: at the end.
    """

    start_at: float | str = "now"
    loop: bool = False
    pace: float = 1.0
    live_stamps: bool = True
    duration: float | None = None


def parse_start(text: str) -> float | str:
    """Read a start time: ``now``, ``aligned`` or Unix time in seconds.

    Raises
    ------
    ValueError
        If it is none of these.
    """
    if text in {"now", "aligned"}:
        return text
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    # Beyond this the nanoseconds leave int64.
    if not 0 <= value < 9e9:
        raise ValueError(f"start {text!r} is neither 'now', 'aligned' nor a Unix time in seconds")
    return value


def publish(
    streams: Sequence[Stream],
    schedule: Schedule,
    *,
    scene: str = DEFAULT_SCENE,
    settings: SessionSettings | None = None,
    ready_file: Path | None = None,
    publish_sigma: bool = False,
    message: str = "",
    progress: Progress | None = None,
) -> None:
    """Publish streams as sources of a scene until they end, or a signal or the schedule stops them.

    Raises
    ------
    ValueError
        If a scene's or source's name is no valid chunk of a key.
    """
    with ExitStack() as stack:
        publishers = []
        for number, stream in enumerate(streams, 1):
            publisher = SourcePublisher(
                stream.name,
                space=stream.space,
                unit=stream.unit,
                dim=stream.dim,
                scene=scene,
                settings=settings,
                ready_file=ready_file if number == len(streams) else None,
                rate=stream.rate * schedule.pace,
                message=message,
            )
            publishers.append(stack.enter_context(publisher))
        # The component entered last is the one that signals reach.
        player = _Player(streams, publishers, schedule, publishers[-1].stop, publish_sigma, progress)
        publishers[-1].ready()
        player.run()


class _Player:
    def __init__(
        self,
        streams: Sequence[Stream],
        publishers: Sequence[SourcePublisher],
        schedule: Schedule,
        stop: threading.Event,
        publish_sigma: bool,
        progress: Progress | None,
    ) -> None:
        self._streams, self._publishers, self._schedule = streams, publishers, schedule
        self._stop = stop
        self._publish_sigma = publish_sigma
        self._progress = progress or (lambda number, t: None)  # noqa: ARG005 - nobody looks
        self._length = max(stream.length for stream in streams)
        self._period = self._length / schedule.pace
        limit = math.inf if schedule.duration is None else schedule.duration
        self._end = time.monotonic() + limit

    def run(self) -> None:
        start, first = self._first_pass()
        for number in itertools.count(first):
            if number > first:
                for publisher in self._publishers:
                    publisher.new_session()
            self._play_pass(number, start + number * self._period)
            if self._stop.is_set() or not self._schedule.loop:
                return

    def _first_pass(self) -> tuple[float, int]:
        """Wall clock of pass 0, and the pass that is going on now."""
        now, start = time.time(), self._schedule.start_at
        if start == "now":
            return now, 0
        if start == "aligned":
            passes = now / self._period
            whole = math.floor(passes) if self._schedule.loop else math.ceil(passes)
            return whole * self._period, 0
        going_on = math.floor((now - float(start)) / self._period) if self._schedule.loop else 0
        return float(start), max(0, going_on)

    def _play_pass(self, number: int, start: float) -> None:
        # The clocks are compared once a pass: a step of the wall clock must not stop the pacing.
        begin = start - time.time() + time.monotonic()
        joined = time.monotonic()
        batchers = self._batchers(number, start)
        for index, frame in in_time_order([stream.frames for stream in self._streams]):
            if self._schedule.loop and frame.t >= self._length - 1e-9:
                break
            due = begin + frame.t / self._schedule.pace
            if due < joined - LATE_S:  # the pass was going on before this process
                continue
            if self._wait(due):
                return
            if self._schedule.live_stamps and time.monotonic() > due + LATE_S:
                batchers[index].skip(frame)
                self._publishers[index].overrun()
                continue
            for message in batchers[index].messages(frame):
                self._publishers[index].put(message)
            self._progress(number, frame.t)
        if self._schedule.loop:
            self._wait(begin + self._period)

    def _wait(self, due: float) -> bool:
        """Wait for an instant of the monotonic clock; True if asked to stop."""
        if self._stop.wait(max(0.0, min(due, self._end) - time.monotonic())):
            return True
        if due >= self._end:
            self._stop.set()
        return self._stop.is_set()

    def _batchers(self, number: int, start: float) -> list[Batcher]:
        origin = start if self._schedule.live_stamps else number * self._length
        return [
            Batcher(
                publisher.builder,
                objects=stream.objects,
                epoch_ns=round(origin * NANOSECONDS),
                publish_sigma=self._publish_sigma,
            )
            for stream, publisher in zip(self._streams, self._publishers, strict=True)
        ]
