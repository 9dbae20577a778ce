"""The process that plays a recording or a simulation live, as one source or several."""

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Unpack, cast

from comotion_schemas.component import Where, new_session_id
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import StreamKind
from comotion_schemas.terminal import keyboard, reporting
from comotion_schemas.text import counted

from .player import KINDS, Log, Player, Progress
from .recordings import Recording
from .runtime import Source
from .schedule import Schedule
from .streams import Stream, StreamLog

if TYPE_CHECKING:
    from comotion_schemas.message_log import MessageLog

_TERMINAL_LINE_S, _PLAIN_LINE_S = 0.2, 5.0  # between two lines of progress
_BAR = 40  # characters of the bar on a terminal
_log = logging.getLogger(__name__)


def play(
    log: Log,
    sources: Sequence[Source],
    schedule: Schedule,
    *,
    progress: Progress | None = None,
    keys: AbstractContextManager[Callable[[], str]] | None = None,
) -> None:
    """Publish a log until it ends, a signal arrives or the schedule ends.

    Parameters
    ----------
    log
        The messages.
    sources
        Those of the log; they are entered, and the last one says that all are ready.
    schedule
        When messages are due, and their stamps.
    progress
        Called at every message.
    keys
        Gives the keys by which playback is paused; None: it cannot be.

    Raises
    ------
    ValueError
        If the log is shorter than the start of the schedule.
    """
    with ExitStack() as stack:
        for source in sources:
            stack.enter_context(source)
        read_key = stack.enter_context(keys or nullcontext(lambda: ""))
        outputs = {source.name: source for source in sources}
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
    publish_sigma: bool = False,
    progress: Progress | None = None,
    keys: AbstractContextManager[Callable[[], str]] | None = None,
    **where: Unpack[Where],
) -> None:
    """:func:`play` the streams of simulations or recordings, each as a source.

    Parameters
    ----------
    streams
        One per source, with different names.
    schedule, progress, keys
        As in :func:`play`.
    message
        One line for Status.
    publish_sigma
        Publish the noise if a frame has it.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    ValueError
        If the name of the scene or a source is not valid.
    """
    session = new_session_id()
    sources = [
        Source(stream.name, rate=stream.rate * schedule.speed, message=message, session_id=session, **where)
        for stream in streams
    ]
    play(
        StreamLog(streams, session, publish_sigma=publish_sigma),
        sources,
        schedule,
        progress=progress,
        keys=keys,
    )


def replay_recording(
    recording: Recording, streams: Sequence[Stream], schedule: Schedule, **where: Unpack[Where]
) -> None:
    """Play the streams of a recording of features, with a line of progress and a key for pauses.

    The parameters and errors are those of :func:`play_streams`.
    """
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
    with shown_progress(recording.name, recording.length) as progress:
        play_streams(
            streams,
            schedule,
            publish_sigma=True,
            message=f"replays {recording.name}",
            progress=progress,
            keys=replay_keys(),
            **where,
        )


def replay_scene(path: Path, schedule: Schedule, **where: Unpack[Where]) -> None:
    """Play a recorded scene: observations, truth, joint states and previews, on the keys of their sources.

    Hypotheses and Statuses are not published: the running service publishes its own.

    Parameters
    ----------
    path
        An MCAP recording.
    schedule
        Range, speed and stamps.
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Raises
    ------
    RecordingError
        If the file is missing or damaged.
    ImportError
        If the extra `record` is not installed.
    ValueError
        If the scene name is not valid, or the recording has no message of a source or is shorter than
        the start.
    """
    from comotion_schemas.message_log import MessageLog

    with MessageLog(path) as log:
        sources = _recorded_sources(log, f"replays {path.stem}", where)
        _log.info("%s: %.1f s; as %s", path.name, log.seconds, ", ".join(source.name for source in sources))
        with shown_progress(path.stem, log.seconds) as progress:

            def advance(number: int, t: float) -> None:
                progress(number, schedule.start + t)

            play(log, sources, schedule, progress=advance, keys=replay_keys())
    if left_out := sum(source.overruns for source in sources):
        _log.warning("%s left out: late, or invalid and so without a stamp", counted(left_out, "message"))


def _recorded_sources(log: "MessageLog", message: str, where: Where) -> list[Source]:
    """Sources of a recorded scene, each with the session of its first message."""
    kinds: dict[str, set[StreamKind]] = {}
    sessions: dict[str, str | None] = {}
    for logged in log.messages(KINDS):
        if logged.name not in sessions:
            first = logged.decode()
            sessions[logged.name] = None if first is None else first.session
        kinds.setdefault(logged.name, set()).add(cast("StreamKind", logged.kind))
    if not kinds:
        raise KnownError(f"{log.path}: it holds no message of a source")
    return [
        Source(name, kinds=kinds[name], message=message, session_id=sessions[name], **where)
        for name in sorted(kinds)
    ]


@contextmanager
def shown_progress(what: str, length: float) -> Iterator[Progress]:
    """Show the progress of a replay on standard error; yields the function to call at every message.

    Parameters
    ----------
    what
        Name of the recording.
    length
        Seconds of one pass.
    """
    with reporting(terminal_s=_TERMINAL_LINE_S, plain_s=_PLAIN_LINE_S) as report:

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
