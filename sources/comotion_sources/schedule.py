"""Which part of a log is played, when, and with which stamps; messages moved in time. Pure."""

import math
from bisect import bisect_left, insort
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import JointStates, Message, ObservationBatch, Preview, TruthBatch
from comotion_schemas.component import new_session_id
from comotion_schemas.errors import KnownError

Stamps = Literal["now", "original"]


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Which part of a log is played, when, and with which stamps.

    Raises
    ------
    ValueError
        If `speed` or the range is not valid.
    """

    # When the first pass starts: Unix time in seconds, ``now``, or ``aligned``: when the wall clock is a
    # multiple of the length, so that processes that loop the same scene are in phase.
    start_at: float | str = "now"
    loop: bool = False  # repeat the log; each pass is a new session
    speed: float = 1.0  # seconds of the log per second of playback, above 0 and at most 1000
    # ``now``: stamps are moved to the wall clock and sessions are new; a message that is more than 0.2 s late
    # is left out. ``original``: the first pass is published byte for byte; later passes continue in time, as
    # new sessions.
    stamps: Stamps = "now"
    duration: float | None = None  # seconds after which playback stops; None: at the end of the log
    # Seconds from the beginning of the log; None: its end.
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


class Restamp:
    """Changes the stamps and sessions of messages, and closes the gaps that messages left out leave.

    `reference_ns` is a stamp of the log and `target_ns` what it becomes; `speed` is in seconds of the log per
    second.
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
        changes: dict[str, Any] = {"session": session}
        if not isinstance(message, TruthBatch):
            changes["stamp_ns"] = int(self._moved(np.array([message.stamp_ns]))[0])
        if isinstance(message, ObservationBatch | JointStates):
            left_out = self._left_out.get((type(message), session), ())
            changes["seq"] = message.seq - bisect_left(left_out, message.seq)
        if isinstance(message, ObservationBatch):
            changes["ended"] = self._with_ended(message, session)
            if message.stamps_ns is not None:
                changes["stamps_ns"] = self._moved(message.stamps_ns)
        return replace(message, **changes)

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
