"""Recorded messages as a tape: message log -> payloads, moved in time where that is asked for. Pure."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import JointStates, Message, ObservationBatch, Preview, TruthBatch, encode
from comotion_schemas.component import new_session_id
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import Kind
from comotion_schemas.message_log import Logged

from .player import Schedule

Stamps = Literal["now", "original"]
KINDS: frozenset[Kind] = frozenset({"obs", "truth", "joints", "preview"})
_GAP_S = 0.1  # about the time between two messages, between two passes
_CLOCKS_AGREE_NS = 10_000_000_000  # a larger offset between stamp and receipt means different clocks


class Log(Protocol):
    """A recorded scene; see :class:`comotion_schemas.message_log.MessageLog`."""

    start_ns: int
    end_ns: int

    def messages(
        self, kinds: frozenset[Kind] | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Logged]:
        """Yield payloads in the order of receipt."""


@dataclass(frozen=True, kw_only=True)
class MessageSchedule:
    """Which part of a recording is played, when, and with which stamps.

    Attributes
    ----------
    speed
        Recorded seconds per second of playback, above 0 and at most 1000.
    loop
        Repeat the recording; each pass is a new session.
    start, end
        Seconds from the beginning of the recording; None: its end.
    stamps
        ``original``: the first pass is published byte for byte; later passes continue in time, as
        new sessions. ``now``: stamps are moved to the wall clock and sessions are new; a message that
        is more than 0.2 s late is left out.
    duration
        Seconds after which playback stops; None: at the end of the recording.
    start_at
        Unix time in seconds at which playback starts; None: at once.

    Raises
    ------
    ValueError
        If `speed` or the range is not valid.
    """

    speed: float = 1.0
    loop: bool = False
    start: float = 0.0
    end: float | None = None
    stamps: Stamps = "now"
    duration: float | None = None
    start_at: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.speed <= 1000:
            raise KnownError(f"speed {self.speed:g} is not within 0 to 1000")
        if self.start < 0 or (self.end is not None and self.end <= self.start):
            raise KnownError("the end of what is played is not after its start")

    def at(self, now: float) -> Schedule:
        """The schedule of a player that begins at `now`, Unix time in s; it plays all from the start on."""
        return Schedule(
            start_at="now" if self.start_at is None or self.start_at <= now else self.start_at,
            loop=self.loop,
            pace=self.speed,
            live_stamps=self.stamps == "now",
            duration=self.duration,
        )


class PayloadSink(Protocol):
    """Output of the messages of all sources."""

    def put(self, kind: Kind, name: str, payload: bytes) -> None:
        """Publish a payload of a source."""

    def skipped(self, name: str) -> None:
        """Count a message that is left out: late, or invalid and so without a stamp to move."""


class Restamp:
    """Changes the stamps and sessions of messages.

    Parameters
    ----------
    reference_ns, target_ns
        A stamp of the recording, and the stamp it becomes, ns.
    speed
        Recorded seconds per second.
    """

    def __init__(self, reference_ns: int, target_ns: int, speed: float) -> None:
        self.target_ns = target_ns
        self._reference_ns, self._speed = reference_ns, speed
        self._sessions: dict[tuple[str, str], str] = {}

    def __call__(self, message: Message) -> Message:
        """Return a copy of a message with its new stamps and session."""
        if isinstance(message, TruthBatch):
            return replace(message, session=self._session(message.source, message.session))
        if not isinstance(message, ObservationBatch | JointStates | Preview):
            return message
        session = self._session(message.source, message.session)
        stamp = int(self._moved(np.array([message.stamp_ns]))[0])
        if isinstance(message, ObservationBatch) and message.stamps_ns is not None:
            stamps = self._moved(message.stamps_ns)
            return replace(message, session=session, stamp_ns=stamp, stamps_ns=stamps)
        return replace(message, session=session, stamp_ns=stamp)

    def _moved(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        elapsed = stamps - self._reference_ns
        if self._speed != 1.0:
            elapsed = np.rint(elapsed / self._speed).astype(np.int64)
        return elapsed + self.target_ns

    def _session(self, source: str, old: str) -> str:
        return self._sessions.setdefault((source, old), new_session_id())


class MessageTape:
    """A recording as a tape: its items are recorded payloads.

    Parameters
    ----------
    log, sink
        The recording and the output.
    schedule
        Range, speed and stamps.

    Raises
    ------
    ValueError
        If the recording is shorter than the start of the schedule.
    """

    def __init__(self, log: Log, sink: PayloadSink, schedule: MessageSchedule) -> None:
        self._log, self._sink, self._schedule = log, sink, schedule
        self._start_ns = log.start_ns + round(schedule.start * 1e9)
        end_ns = log.end_ns if schedule.end is None else log.start_ns + round(schedule.end * 1e9)
        self._end_ns = min(end_ns, log.end_ns)
        if self._start_ns > self._end_ns:
            raise KnownError(f"the recording is only {(log.end_ns - log.start_ns) / 1e9:.1f} s long")
        self.length = (self._end_ns - self._start_ns) / 1e9 + _GAP_S
        self._restamp: Restamp | None = None

    def begin(self, number: int, first: bool, start: float) -> Iterator[tuple[float, Logged]]:
        """Begin a pass: the truth from before the start, then all messages of the range."""
        self._restamp = None
        if self._schedule.stamps == "now":
            self._restamp = Restamp(self._reference_ns(), round(start * 1e9), self._schedule.speed)
        elif not first:
            reference = self._reference_ns()
            self._restamp = Restamp(reference, reference + round(number * self.length * 1e9), 1.0)
        if self._start_ns > self._log.start_ns:
            for logged in self._log.messages(frozenset({"truth"}), end_ns=self._start_ns - 1):
                yield 0.0, logged
        for logged in self._log.messages(KINDS, start_ns=self._start_ns, end_ns=self._end_ns):
            yield (logged.log_ns - self._start_ns) / 1e9, logged

    def put(self, item: Logged) -> None:
        """Publish a payload; where its stamp is to move and it has none, it is left out."""
        if self._restamp is None:
            self._sink.put(item.kind, item.name, item.payload)
        elif (message := item.decode()) is not None:
            self._sink.put(item.kind, item.name, encode(self._restamp(message)))
        else:
            self._sink.skipped(item.name)

    def skip(self, item: Logged) -> None:
        """Leave a payload out and count it, but for truth, which holds whenever it comes."""
        if item.kind == "truth":
            self.put(item)
        else:
            self._sink.skipped(item.name)

    def delay(self, seconds: float) -> None:
        """Stamp further messages later, if they are stamped with the wall clock."""
        if self._restamp is not None and self._schedule.stamps == "now":
            self._restamp.target_ns += round(seconds * 1e9)

    def _reference_ns(self) -> int:
        """Stamp of the start of the range on the clock of the sources.

        It equals the recorder's time unless the first stamp is more than 10 s from its receipt, as in a
        recording of replayed data with original stamps.
        """
        for logged in self._log.messages(frozenset({"obs"}), start_ns=self._start_ns):
            batch = logged.decode()
            if isinstance(batch, ObservationBatch):
                offset = batch.stamp_ns - logged.log_ns
                return self._start_ns + (offset if abs(offset) > _CLOCKS_AGREE_NS else 0)
        return self._start_ns
