"""The process that plays a recording or a simulation live, as one source or several."""

import logging
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Unpack

from comotion_schemas.component import Where, new_session_id
from comotion_schemas.errors import KnownError
from comotion_schemas.terminal import keyboard, reporting
from comotion_schemas.text import counted

from .player import Log, Player, Progress
from .recordings import Recording
from .schedule import Schedule
from .source import Source
from .streams import Stream, StreamLog

_TERMINAL_LINE_S, _PLAIN_LINE_S = 0.2, 5.0  # between two lines of progress
_BAR = 40  # characters of the bar on a terminal
_log = logging.getLogger(__name__)


def play(log: Log, sources: Sequence[Source], schedule: Schedule, *, shown_as: str = "") -> None:
    """Publish a log until it ends, a signal arrives or the schedule ends.

    The `sources` are those of the log; they are entered, and the last one says that all are ready. `shown_as`
    is the name of the recording, for a line of progress and a key for pauses; empty: neither.

    Raises
    ------
    ValueError
        If the log is shorter than the start of the schedule.
    """
    outputs = {source.name: source for source in sources}
    progress: Progress | None = None
    read_key: Callable[[], str] = str
    with ExitStack() as stack:
        for source in sources:
            stack.enter_context(source)
        if shown_as:
            report = stack.enter_context(reporting(terminal_s=_TERMINAL_LINE_S, plain_s=_PLAIN_LINE_S))
            length = (log.end_ns - log.start_ns) / 1e9

            def progress(number: int, t: float) -> None:
                at, count = schedule.start + t, f", pass {number + 1}" if number else ""
                done = round(_BAR * min(at / length, 1.0)) if sys.stderr.isatty() else 0
                line = f"{shown_as}{count}: {at:.1f} of {length:.1f} s {'━' * done}".rstrip()
                report(lambda: line)

            if sys.stderr.isatty():
                read_key = partial(stack.enter_context(keyboard()), 0.0)
        # Signals reach the component that was entered last.
        player = Player(log, outputs, schedule, sources[-1].stop, read_key=read_key, progress=progress)
        sources[-1].ready()
        player.run()
        if not sources[-1].stop.is_set():
            _log.info("played to the end")


def play_streams(
    streams: Sequence[Stream],
    schedule: Schedule,
    *,
    message: str,
    shown_as: str = "",
    **where: Unpack[Where],
) -> None:
    """:func:`play` the streams of simulations or recordings, each as a source.

    The streams, one per source, have different names; `message` is one line for Status; the rest is as in
    :func:`play`.
    """
    sources = [Source(s.name, rate=s.rate * schedule.speed, message=message, **where) for s in streams]
    play(StreamLog(streams, new_session_id()), sources, schedule, shown_as=shown_as)


def replay_recording(
    recording: Recording, streams: Sequence[Stream], schedule: Schedule, **where: Unpack[Where]
) -> None:
    """:func:`play_streams` of a recording of features."""
    _log.info(
        "%s: %s at %.4g Hz, %d %s%s; as %s",
        recording.name,
        counted(len(recording), "instant"),
        recording.rate,
        recording.positions.shape[1],
        "markers in m" if recording.dim == 3 else "tracks in px",
        "" if recording.labels is None else " with truth",
        ", ".join(f"{stream.name} at {stream.rate * schedule.speed:.4g} Hz" for stream in streams),
    )
    message = f"replays {recording.name}"
    play_streams(streams, schedule, message=message, shown_as=recording.name, **where)


def replay_scene(path: Path, schedule: Schedule, **where: Unpack[Where]) -> None:
    """Play a recorded scene: observations, truth, joint states and previews, on the keys of their sources.

    Hypotheses and Statuses are not published: the running service publishes its own.

    `path` is that of an MCAP recording.

    Raises
    ------
    RecordingError
        If the file is missing or damaged.
    ImportError
        If the extra `record` is not installed.
    ValueError
        If the recording has no message of a source or is shorter than the start.
    """
    from comotion_schemas.message_log import MessageLog

    with MessageLog(path) as log:
        if not log.sources:
            raise KnownError(f"{path}: it holds no message of a source")
        message = f"replays {path.stem}"
        sources = [Source(name, kinds=kinds, message=message, **where) for name, kinds in log.sources.items()]
        _log.info("%s: %.1f s; as %s", path.name, log.seconds, ", ".join(source.name for source in sources))
        play(log, sources, schedule, shown_as=path.stem)
    if left_out := sum(source.counters["overruns"] for source in sources):
        _log.warning("%s left out: late, or invalid and so without a stamp", counted(left_out, "message"))
