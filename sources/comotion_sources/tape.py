"""A log of messages as a tape: payloads in time order, moved in time where that is asked for. Pure."""

import math
from bisect import bisect_left, insort
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import JointStates, Message, ObservationBatch, Preview, TruthBatch, encode
from comotion_schemas.component import new_session_id
from comotion_schemas.errors import KnownError
from comotion_schemas.keys import Kind

Stamps = Literal["now", "original"]
KINDS: frozenset[Kind] = frozenset({"obs", "truth", "joints", "preview"})
_CLOCKS_AGREE_NS = 10_000_000_000  # a larger offset between stamp and receipt means different clocks


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Which part of a log is played, when, and with which stamps.

    Attributes
    ----------
    start_at
        When the first pass starts: Unix time in seconds, ``now``, or ``aligned``: when the wall clock is a
        multiple of the length, so that processes that loop the same scene are in phase.
    loop
        Repeat the log; each pass is a new session.
    speed
        Seconds of the log per second of playback, above 0 and at most 1000.
    stamps
        ``now``: stamps are moved to the wall clock and sessions are new; a message that is more than 0.2 s
        late is left out. ``original``: the first pass is published byte for byte; later passes continue in
        time, as new sessions.
    duration
        Seconds after which playback stops; None: at the end of the log.
    start, end
        Seconds from the beginning of the log; None: its end.

    Raises
    ------
    ValueError
        If `speed` or the range is not valid.
    """

    start_at: float | str = "now"
    loop: bool = False
    speed: float = 1.0
    stamps: Stamps = "now"
    duration: float | None = None
    start: float = 0.0
    end: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.speed <= 1000:
            raise KnownError(f"speed {self.speed:g} is not within 0 to 1000")
        if self.start < 0 or (self.end is not None and self.end <= self.start):
            raise KnownError("the end of what is played is not after its start")


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


class Entry(Protocol):
    """A message in a log, with its source and the time at which it is due in the log, ns."""

    @property
    def kind(self) -> Kind:
        """Kind of the message."""

    @property
    def name(self) -> str:
        """Name of the source."""

    @property
    def log_ns(self) -> int:
        """Time in the log."""

    @property
    def payload(self) -> bytes:
        """The message as bytes."""

    def decode(self) -> Message | None:
        """The message; None if it is invalid."""


class Log(Protocol):
    """What is played: a :class:`~comotion_schemas.message_log.MessageLog`, or streams.

    `gap_s`: seconds between two passes, beyond the time of the last message.
    """

    start_ns: int
    end_ns: int
    gap_s: float

    def messages(
        self, kinds: Collection[Kind] | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Entry]:
        """Yield messages in the order of their times in the log."""


class Outputs(Protocol):
    """Output of the messages of all sources."""

    def put(self, kind: Kind, name: str, payload: bytes, message: Message | None) -> None:
        """Publish a payload of a source; `message` is what it holds, None if it is invalid."""

    def skipped(self, name: str) -> None:
        """Count a message that is left out: late, or invalid and so without a stamp to move."""


class Restamp:
    """Changes the stamps and sessions of messages, and closes the gaps that messages left out leave.

    Parameters
    ----------
    reference_ns, target_ns
        A stamp of the log, and the stamp it becomes, ns.
    speed
        Seconds of the log per second.
    """

    def __init__(self, reference_ns: int, target_ns: int, speed: float) -> None:
        self.target_ns = target_ns
        self._reference_ns, self._speed = reference_ns, speed
        self._sessions: dict[tuple[str, str], str] = {}
        # By kind and session: sequence numbers of what was left out, sorted, and features that ended in it.
        self._left_out: dict[tuple[type, str], list[int]] = {}
        self._ended: dict[str, list[NDArray[np.uint64]]] = {}

    def __call__(self, message: Message) -> Message:
        """Return a copy of a message with its new stamps, session and sequence number."""
        if not isinstance(message, TruthBatch | ObservationBatch | JointStates | Preview):
            return message
        session = self._sessions.setdefault((message.source, message.session), new_session_id())
        if isinstance(message, TruthBatch):
            return replace(message, session=session)
        stamp = int(self._moved(np.array([message.stamp_ns]))[0])
        if isinstance(message, Preview):
            return replace(message, session=session, stamp_ns=stamp)
        seq = message.seq - bisect_left(self._left_out.get((type(message), session), ()), message.seq)
        if isinstance(message, JointStates):
            return replace(message, session=session, seq=seq, stamp_ns=stamp)
        return replace(
            message,
            session=session,
            seq=seq,
            stamp_ns=stamp,
            stamps_ns=None if message.stamps_ns is None else self._moved(message.stamps_ns),
            ended=self._with_ended(message, session),
        )

    def leave_out(self, message: Message) -> None:
        """Take note of a message that is left out: the next batch says what has ended in it."""
        if not isinstance(message, ObservationBatch | JointStates):
            return
        session = self._sessions.setdefault((message.source, message.session), new_session_id())
        insort(self._left_out.setdefault((type(message), session), []), message.seq)
        if isinstance(message, ObservationBatch) and message.ended is not None:
            self._ended.setdefault(session, []).append(message.ended)

    def _with_ended(self, batch: ObservationBatch, session: str) -> NDArray[np.uint64] | None:
        missed = self._ended.pop(session, [])
        if not missed:
            return batch.ended
        return np.unique(np.concatenate(missed if batch.ended is None else [*missed, batch.ended]))

    def _moved(self, stamps: NDArray[np.int64]) -> NDArray[np.int64]:
        elapsed = stamps - self._reference_ns
        if self._speed != 1.0:
            elapsed = np.rint(elapsed / self._speed).astype(np.int64)
        return elapsed + self.target_ns


class Tape:
    """A log that is played pass after pass.

    Parameters
    ----------
    log, outputs
        The messages and where they go.
    schedule
        Range, speed and stamps.

    Attributes
    ----------
    length
        Seconds after which a pass may be repeated; then entries at or after this time are left out.

    Raises
    ------
    ValueError
        If the log is shorter than the start of the schedule.
    """

    def __init__(self, log: Log, outputs: Outputs, schedule: Schedule) -> None:
        self._log, self._outputs, self._schedule = log, outputs, schedule
        self._start_ns = log.start_ns + round(schedule.start * 1e9)
        end_ns = log.end_ns if schedule.end is None else log.start_ns + round(schedule.end * 1e9)
        self._end_ns = min(end_ns, log.end_ns)
        if self._start_ns > self._end_ns:
            raise KnownError(f"the recording is only {(log.end_ns - log.start_ns) / 1e9:.1f} s long")
        self.length = (self._end_ns - self._start_ns) / 1e9 + log.gap_s
        self._restamp: Restamp | None = None

    def begin(self, number: int, first: bool, start: float) -> Iterator[tuple[float, Entry]]:
        """Begin a pass, which the wall clock sees at `start`; yield (seconds within it, entry) in order.

        The truth from before the start of the range comes first.
        """
        self._restamp = None
        if self._schedule.stamps == "now":
            self._restamp = Restamp(self._reference_ns(), round(start * 1e9), self._schedule.speed)
        elif not first:
            reference = self._reference_ns()
            self._restamp = Restamp(reference, reference + round(number * self.length * 1e9), 1.0)
        if self._start_ns > self._log.start_ns:
            for entry in self._log.messages(frozenset({"truth"}), end_ns=self._start_ns - 1):
                yield 0.0, entry
        for entry in self._log.messages(KINDS, start_ns=self._start_ns, end_ns=self._end_ns):
            yield (entry.log_ns - self._start_ns) / 1e9, entry

    def put(self, entry: Entry) -> None:
        """Publish an entry; where its stamp is to move and it has none, it is left out."""
        message = entry.decode()
        if self._restamp is None:
            self._outputs.put(entry.kind, entry.name, entry.payload, message)
        elif message is not None:
            moved = self._restamp(message)
            self._outputs.put(entry.kind, entry.name, encode(moved), moved)
        else:
            self._outputs.skipped(entry.name)

    def skip(self, entry: Entry, *, counted: bool) -> None:
        """Leave an entry out, but for truth, which holds whenever it comes; where `counted`, count it."""
        if entry.kind == "truth":
            self.put(entry)
            return
        if self._restamp is not None and (message := entry.decode()) is not None:
            self._restamp.leave_out(message)
        if counted:
            self._outputs.skipped(entry.name)

    def delay(self, seconds: float) -> None:
        """Stamp further entries of the pass later, after a pause, if they have stamps of the wall clock."""
        if self._restamp is not None and self._schedule.stamps == "now":
            self._restamp.target_ns += round(seconds * 1e9)

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
