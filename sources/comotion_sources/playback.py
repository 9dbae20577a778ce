"""Publishes streams live to a scene: one source per stream."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from typing import Protocol, Unpack

from comotion_schemas import ObservationBatch, TruthBatch
from comotion_schemas.component import Where
from comotion_schemas.terminal import keyboard, reporting

from .frames import NANOSECONDS, Batcher, Frame, MessageBuilder, in_time_order
from .player import Player, Progress, Schedule
from .runtime import SourcePublisher
from .streams import Stream

_TERMINAL_LINE_S, _PLAIN_LINE_S = 0.2, 5.0  # between two lines of progress
_BAR = 40  # characters of the bar on a terminal


class Sink(Protocol):
    """Output of the messages of one source."""

    builder: MessageBuilder

    def put(self, message: ObservationBatch | TruthBatch) -> None:
        """Publish a message that :attr:`builder` has built."""

    def overrun(self) -> None:
        """Count a frame that is left out."""

    def new_session(self) -> None:
        """Start a new session with a new builder."""


class StreamTape:
    """Streams as a tape: its items are (number of the stream, frame).

    Parameters
    ----------
    streams, sinks
        One sink for each stream.
    live_stamps
        As in :class:`Schedule`.
    publish_sigma
        Publish the noise if a frame has it.
    """

    def __init__(
        self,
        streams: Sequence[Stream],
        sinks: Sequence[Sink],
        *,
        live_stamps: bool = True,
        publish_sigma: bool = False,
    ) -> None:
        self._streams, self._sinks = streams, sinks
        self._live_stamps, self._publish_sigma = live_stamps, publish_sigma
        self._batchers: list[Batcher] = []
        self.length = max(stream.length for stream in streams)

    def begin(self, number: int, first: bool, start: float) -> Iterator[tuple[float, tuple[int, Frame]]]:
        """Begin a pass: a new session of every source, but for the first."""
        origin = start if self._live_stamps else number * self.length
        if not first:
            for sink in self._sinks:
                sink.new_session()
        self._batchers = [
            Batcher(
                sink.builder,
                objects=stream.objects,
                epoch_ns=round(origin * NANOSECONDS),
                publish_sigma=self._publish_sigma,
            )
            for stream, sink in zip(self._streams, self._sinks, strict=True)
        ]
        for index, frame in in_time_order([stream.frames for stream in self._streams]):
            yield frame.t, (index, frame)

    def put(self, item: tuple[int, Frame]) -> None:
        """Publish the messages of a frame."""
        index, frame = item
        for message in self._batchers[index].messages(frame):
            self._sinks[index].put(message)

    def skip(self, item: tuple[int, Frame]) -> None:
        """Leave a frame out and count it."""
        index, frame = item
        self._batchers[index].skip(frame)
        self._sinks[index].overrun()

    def delay(self, seconds: float) -> None:
        """Stamp further frames later, if they are stamped with the wall clock."""
        if self._live_stamps:
            for batcher in self._batchers:
                batcher.epoch_ns += round(seconds * NANOSECONDS)


def publish(
    streams: Sequence[Stream],
    schedule: Schedule,
    *,
    publish_sigma: bool = False,
    message: str = "",
    progress: Progress | None = None,
    keys: AbstractContextManager[Callable[[], str]] | None = None,
    **where: Unpack[Where],
) -> None:
    """Publish streams as sources of a scene until they end, a signal arrives or the schedule ends.

    Parameters
    ----------
    streams
        One per source.
    schedule
        When frames are due, and their stamps.
    publish_sigma
        Publish the noise if a frame has it.
    message
        One line for Status.
    progress
        Called at every frame.
    keys
        Gives the keys by which playback is paused; None: it cannot be.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If the name of the scene or a source is not valid.
    """
    with ExitStack() as stack:
        publishers = []
        for number, stream in enumerate(streams, 1):
            publisher = SourcePublisher(
                stream.name,
                space=stream.space,
                unit=stream.unit,
                dim=stream.dim,
                rate=stream.rate * schedule.pace,
                message=message,
                # The last one says that all are ready.
                **(where if number == len(streams) else {**where, "ready_file": None}),
            )
            publishers.append(stack.enter_context(publisher))
        tape = StreamTape(streams, publishers, live_stamps=schedule.live_stamps, publish_sigma=publish_sigma)
        read_key = stack.enter_context(keys or nullcontext(lambda: ""))
        # Signals reach the component that was entered last.
        player = Player(tape, schedule, publishers[-1].stop, read_key=read_key, progress=progress)
        publishers[-1].ready()
        player.run()


@contextmanager
def shown_progress(what: str, length: float) -> Iterator[Progress]:
    """Show the progress of a replay on standard error; yields the function to call at every item.

    Parameters
    ----------
    what
        Name of the recording.
    length
        Seconds of one pass.
    """
    with reporting(quiet=False, terminal_s=_TERMINAL_LINE_S, plain_s=_PLAIN_LINE_S) as report:

        def advance(number: int, t: float) -> None:
            count = f", pass {number + 1}" if number else ""
            done = round(_BAR * min(t / length, 1.0)) if sys.stderr.isatty() else 0
            line = f"{what}{count}: {t:.1f} of {length:.1f} s"
            report(lambda: f"{line} {'━' * done}" if done else line)

        yield advance


@contextmanager
def replay_keys() -> Iterator[Callable[[], str]]:
    """Yield a function that returns a pressed key, or "" without a key press or terminal."""
    if not sys.stderr.isatty():
        yield lambda: ""
        return
    with keyboard() as read_key:
        yield lambda: read_key(0.0)
