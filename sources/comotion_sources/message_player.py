"""Plays recorded messages in real time: message log -> payloads at the times they are due.

The clock, the keyboard and the output are injected.
"""

import math
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import JointStates, Message, ObservationBatch, Preview, TruthBatch, encode
from comotion_schemas.component import new_session_id
from comotion_schemas.errors import KnownError
from comotion_schemas.qos import Kind

from .player import LATE_S, Clock
from .recordings.messages import Logged

Stamps = Literal["now", "original"]
KINDS: frozenset[Kind] = frozenset({"obs", "truth", "joints", "preview"})
_TICK_S = 0.1  # longest wait between two looks at the keyboard
_CLOCKS_AGREE_NS = 10_000_000_000  # a larger offset between stamp and receipt means different clocks


class Log(Protocol):
    """A recorded scene; see :class:`comotion_sources.recordings.messages.MessageLog`."""

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

        es
        --
        eError
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


class PayloadSink(Protocol):
    """Output of a player."""

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


class MessagePlayer:
    """Plays a recording into an output.

    Parameters
    ----------
    log, sink
        The recording and the output.
    schedule
        Range, speed and stamps.
    stop
        Ends playback when set.
    read_key
        Returns a key that was pressed, or ""; the space bar pauses and resumes.
    progress
        Called with the number of the pass and the seconds within the recording.
    clock
        Clocks of the machine, or of a test.

        es
        --
        eError
        If the recording is shorter than the start of the schedule.
    """

    def __init__(
        self,
        log: Log,
        sink: PayloadSink,
        schedule: MessageSchedule,
        stop: threading.Event,
        *,
        read_key: Callable[[], str] = lambda: "",
        progress: Callable[[int, float], None] = lambda number, t: None,  # noqa: ARG005
        clock: Clock | None = None,
    ) -> None:
        self._log, self._sink, self._schedule, self._stop = log, sink, schedule, stop
        self._read_key, self._progress = read_key, progress
        self._clock = clock or Clock()
        self._start_ns = log.start_ns + round(schedule.start * 1e9)
        end_ns = log.end_ns if schedule.end is None else log.start_ns + round(schedule.end * 1e9)
        self._end_ns = min(end_ns, log.end_ns)
        if self._start_ns > self._end_ns:
            raise KnownError(f"the recording is only {(log.end_ns - log.start_ns) / 1e9:.1f} s long")
        self._limit = math.inf
        self._begin = 0.0
        self._restamp: Restamp | None = None
        self.paused = False

    def run(self) -> None:
        """Play until the recording or the duration of the schedule ends, or `stop` is set."""
        wanted = self._schedule.start_at
        delay = 0.0 if wanted is None else max(0.0, wanted - self._clock.wall())
        self._begin = self._clock.monotonic() + delay
        self._limit = self._begin + (math.inf if self._schedule.duration is None else self._schedule.duration)
        number = 0
        while True:
            self._play_pass(number)
            number += 1
            if self._stop.is_set() or not self._schedule.loop:
                return
            # Leave about the time between two messages between passes.
            self._begin += self._length_s / self._schedule.speed
            if self._wait_until(lambda: self._begin):
                return

    @property
    def _length_s(self) -> float:
        return (self._end_ns - self._start_ns) / 1e9 + _TICK_S

    def _play_pass(self, number: int) -> None:
        self._restamp = self._restamping(number)
        for logged in self._selected():
            if self._wait_until(lambda t=logged.log_ns: self._due(t)):  # type: ignore[misc]
                return
            self._publish(logged, self._restamp)
            self._progress(number, max(0.0, (logged.log_ns - self._log.start_ns) / 1e9))

    def _selected(self) -> Iterable[Logged]:
        """Yield the truth from before the start, then all messages of the range."""
        if self._start_ns > self._log.start_ns:
            yield from self._log.messages(frozenset({"truth"}), end_ns=self._start_ns - 1)
        yield from self._log.messages(KINDS, start_ns=self._start_ns, end_ns=self._end_ns)

    def _due(self, log_ns: int) -> float:
        return self._begin + max(0, log_ns - self._start_ns) / 1e9 / self._schedule.speed

    def _restamping(self, number: int) -> Restamp | None:
        if self._schedule.stamps == "original" and number == 0:
            return None
        reference = self._reference_ns()
        if self._schedule.stamps == "original":
            return Restamp(reference, reference + round(number * self._length_s * 1e9), 1.0)
        origin_ns = round((self._clock.wall() - self._clock.monotonic() + self._begin) * 1e9)
        return Restamp(reference, origin_ns, self._schedule.speed)

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

    def _publish(self, logged: Logged, restamp: Restamp | None) -> None:
        if restamp is None:
            self._sink.put(logged.kind, logged.name, logged.payload)
            return
        late = self._clock.monotonic() - self._due(logged.log_ns) > LATE_S
        message = logged.decode()
        if message is None or (late and self._schedule.stamps == "now" and logged.kind != "truth"):
            self._sink.skipped(logged.name)
            return
        self._sink.put(logged.kind, logged.name, encode(restamp(message)))

    def _wait_until(self, due: Callable[[], float]) -> bool:
        """Wait for an instant, which pauses delay; True if playback is to stop."""
        while True:
            self._pause()
            now = self._clock.monotonic()
            if now >= self._limit:
                self._stop.set()
            left = min(due(), self._limit) - now
            if self._clock.wait(self._stop, min(max(0.0, left), _TICK_S)):
                return True
            if left <= 0:
                return self._stop.is_set()

    def _pause(self) -> None:
        """Pause from one press of the space bar to the next."""
        if self._read_key() != " ":
            return
        self.paused, began = True, self._clock.monotonic()
        while self.paused and not self._clock.wait(self._stop, _TICK_S):
            self.paused = self._read_key() != " "
        seconds = self._clock.monotonic() - began
        self._begin += seconds
        if self._restamp is not None and self._schedule.stamps == "now":
            self._restamp.target_ns += round(seconds * 1e9)
