"""Recorded messages in real time: each when it is due, pass after pass, with pauses.

The clock, the keyboard and the wire are injected.
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
from comotion_schemas.qos import Kind

from .player import LATE_S, Clock
from .recordings.messages import Logged

Stamps = Literal["now", "original"]
KINDS: frozenset[Kind] = frozenset({"obs", "truth", "joints", "preview"})
_TICK_S = 0.1
_CLOCKS_AGREE_NS = 10_000_000_000


class Log(Protocol):
    """What is played: see :class:`comotion_sources.recordings.messages.MessageLog`."""

    start_ns: int
    end_ns: int

    def messages(
        self, kinds: frozenset[Kind] | None = None, *, start_ns: int | None = None, end_ns: int | None = None
    ) -> Iterator[Logged]:
        """Yield payloads in the order of receipt."""


@dataclass(frozen=True, kw_only=True)
class MessageSchedule:
    """What is played and when.

    Attributes
    ----------
    speed
        Recorded seconds per second.
    loop
        Start again at the end, each pass as a new session.
    start, end
        Seconds from the beginning of the recording; None: its end.
    stamps
        ``original``: the first pass goes out byte for byte, later ones follow in time as new
        sessions. ``now``: stamps are moved to the wall clock, sessions are new; what is over 0.2 s
        late is left out.
    duration
        Seconds after which to stop; None: at the end.
    start_at
        Unix time of the beginning; None: at once.
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
            raise ValueError(f"speed {self.speed:g} is not within 0 to 1000")
        if self.start < 0 or (self.end is not None and self.end <= self.start):
            raise ValueError("the end of what is played is not after its start")


class Wire(Protocol):
    """Where payloads go."""

    def put(self, kind: Kind, name: str, payload: bytes) -> None:
        """Publish a payload of a source."""

    def skipped(self, name: str) -> None:
        """Count a message that was left out: late, or not valid and so without a stamp to move."""


class Restamp:
    """Moves messages in time and into new sessions.

    Parameters
    ----------
    reference_ns, target_ns
        A stamp of the recording, and what it becomes.
    speed
        Recorded time per time.
    """

    def __init__(self, reference_ns: int, target_ns: int, speed: float) -> None:
        self.target_ns = target_ns
        self._reference_ns, self._speed = reference_ns, speed
        self._sessions: dict[tuple[str, str], str] = {}

    def __call__(self, message: Message) -> Message:
        """Build the moved message."""
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
        past = stamps - self._reference_ns
        if self._speed != 1.0:
            past = np.rint(past / self._speed).astype(np.int64)
        return past + self.target_ns

    def _session(self, source: str, old: str) -> str:
        return self._sessions.setdefault((source, old), new_session_id())


class MessagePlayer:
    """Plays a recording onto the wire.

    Parameters
    ----------
    log, wire
        From where and to where.
    schedule
        When.
    stop
        Ends the playing when set.
    read_key
        Answers with a key that was pressed, or ""; the space bar pauses and goes on.
    progress
        Told of the pass and the seconds within the recording.
    clock
        Tells the time.
    """

    def __init__(
        self,
        log: Log,
        wire: Wire,
        schedule: MessageSchedule,
        stop: threading.Event,
        *,
        read_key: Callable[[], str] = lambda: "",
        progress: Callable[[int, float], None] = lambda number, t: None,  # noqa: ARG005
        clock: Clock | None = None,
    ) -> None:
        self._log, self._wire, self._schedule, self._stop = log, wire, schedule, stop
        self._read_key, self._progress = read_key, progress
        self._clock = clock or Clock()
        self._start_ns = log.start_ns + round(schedule.start * 1e9)
        end_ns = log.end_ns if schedule.end is None else log.start_ns + round(schedule.end * 1e9)
        self._end_ns = min(end_ns, log.end_ns)
        if self._start_ns > self._end_ns:
            raise ValueError(f"the recording is {(log.end_ns - log.start_ns) / 1e9:.1f} s long only")
        self._limit = math.inf
        self._begin = 0.0
        self._restamp: Restamp | None = None
        self.paused = False

    def run(self) -> None:
        """Play until the recording ends, the schedule says so or `stop` is set."""
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
            # The pause between passes is that between two messages, nearly.
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
        """What is played: the truth told before the start, then everything up to the end."""
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
        """The stamp that belongs to the start: the same instant, where the recorder's clock was theirs.

        Stamps of an older recording, played to a service with an event clock, are far from it.
        """
        for logged in self._log.messages(frozenset({"obs"}), start_ns=self._start_ns):
            batch = logged.decode()
            if isinstance(batch, ObservationBatch):
                offset = batch.stamp_ns - logged.log_ns
                return self._start_ns + (offset if abs(offset) > _CLOCKS_AGREE_NS else 0)
        return self._start_ns

    def _publish(self, logged: Logged, restamp: Restamp | None) -> None:
        if restamp is None:
            self._wire.put(logged.kind, logged.name, logged.payload)
            return
        late = self._clock.monotonic() - self._due(logged.log_ns) > LATE_S
        message = logged.decode()
        if message is None or (late and self._schedule.stamps == "now" and logged.kind != "truth"):
            self._wire.skipped(logged.name)
            return
        self._wire.put(logged.kind, logged.name, encode(restamp(message)))

    def _wait_until(self, due: Callable[[], float]) -> bool:
        """Wait for an instant that pauses put off; True if it is time to stop."""
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
        """Stand still from one space bar to the next."""
        if self._read_key() != " ":
            return
        self.paused, began = True, self._clock.monotonic()
        while self.paused and not self._clock.wait(self._stop, _TICK_S):
            self.paused = self._read_key() != " "
        seconds = self._clock.monotonic() - began
        self._begin += seconds
        if self._restamp is not None and self._schedule.stamps == "now":
            self._restamp.target_ns += round(seconds * 1e9)
