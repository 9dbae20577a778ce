"""The replay process for recorded scenes: MCAP file -> messages of all its sources on their own keys."""

import logging
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Unpack

from comotion_schemas.component import Component, Rates, StatusFields, Where
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import Kind, StreamKind
from comotion_schemas.message_log import Logged, MessageLog
from comotion_schemas.transport import Publisher, stream_publisher

from .message_tape import KINDS, MessageSchedule, MessageTape
from .playback import replay_keys, shown_progress
from .player import Player

_log = logging.getLogger(__name__)


class _Source:
    """One recorded source: its component and the publishers of its streams."""

    def __init__(self, first: Logged, message: str, where: Where) -> None:
        self.counters = {"batches": 0, "skipped": 0}
        self._message = message
        self._rates = Rates()
        self._publishers: dict[Kind, Publisher] = {}
        decoded = first.decode()
        self.component = Component(
            role="source",
            name=first.name,
            status=self._status,
            session_id=None if decoded is None else decoded.session,
            **where,
        )

    def open(self, stack: ExitStack, kinds: set[StreamKind]) -> None:
        """Enter the scene and declare the publishers."""
        component = stack.enter_context(self.component)
        for kind in sorted(kinds):
            publisher = stream_publisher(component.session, component.keys, kind, component.name)
            stack.callback(publisher.undeclare)
            self._publishers[kind] = publisher

    def put(self, kind: Kind, payload: bytes) -> None:
        self._publishers[kind].put(payload)
        self.counters["batches"] += kind == "obs"

    def _status(self) -> StatusFields:
        rates = self._rates.of({"obs": self.counters["batches"]})
        return StatusFields(rates=rates, counters=dict(self.counters), message=self._message)


class _Scene:
    """All sources of the recording, as the output of a player."""

    def __init__(self, sources: dict[str, _Source]) -> None:
        self._sources = sources

    def put(self, kind: Kind, name: str, payload: bytes) -> None:
        self._sources[name].put(kind, payload)

    def skipped(self, name: str) -> None:
        self._sources[name].counters["skipped"] += 1


def run(
    path: Path,
    schedule: MessageSchedule,
    **where: Unpack[Where],
) -> None:
    """Publish a recorded scene until it ends, a signal arrives or the schedule ends.

    Observations, truth, joint states and previews are published. Hypotheses and Statuses are not:
    the running service publishes its own.

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
    ValueError
        If the scene name is not valid, or the recording has no message of a source or is shorter than
        the start.
    """
    with MessageLog(path) as log, ExitStack() as stack:
        sources, streams = _sources(log, where)
        for name, source in sources.items():
            source.open(stack, streams[name])
        last = next(reversed(sources.values()))
        read_key = stack.enter_context(replay_keys())
        _log.info("%s: %.1f s; as %s", path.name, log.seconds, ", ".join(sources))
        with shown_progress(path.stem, log.seconds) as progress:
            player = Player(
                MessageTape(log, _Scene(sources), schedule),
                schedule.at(time.time()),
                # Signals reach the component that was entered last.
                last.component.stop,
                read_key=read_key,
                progress=lambda number, t: progress(number, schedule.start + t),
            )
            last.component.ready()
            player.run()
        skipped = sum(source.counters["skipped"] for source in sources.values())
        if skipped:
            _log.warning("%d messages were left out: late, or invalid and so without a stamp", skipped)


def _sources(log: MessageLog, where: Where) -> tuple[dict[str, _Source], dict[str, set[StreamKind]]]:
    first: dict[str, Logged] = {}
    streams: dict[str, set[StreamKind]] = {}
    for logged in log.messages(KINDS):
        first.setdefault(logged.name, logged)
        if logged.kind != "hypotheses":
            streams.setdefault(logged.name, set()).add(logged.kind)
    if not first:
        raise KnownError(f"{log.path}: it holds no message of a source")
    message, names = f"replays {log.path.stem}", sorted(first)
    return {
        # The last one says that all are ready.
        name: _Source(first[name], message, where if name == names[-1] else {**where, "ready_file": None})
        for name in names
    }, streams
