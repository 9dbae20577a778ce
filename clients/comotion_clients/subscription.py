"""Subscribes in an open session: validated messages in a bounded inbox."""

import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from typing import Generic, Self, cast

import zenoh
from typing_extensions import TypeVar

from comotion_schemas import (
    DEFAULT_SCENE,
    QOS,
    DecodeError,
    HypothesisUpdate,
    Keys,
    ObservationBatch,
    Preview,
    Status,
    TruthBatch,
    decode_on,
)
from comotion_schemas.inbox import Closed, Inbox
from comotion_schemas.sequence import Epochs, SequenceCounter
from comotion_schemas.transport import Receiver

_SILENT_S = 1.0
_SILENT_PERIODS = 3
_REMEMBERED = 64


class ActiveSession:
    """Follows one session of the services of a scene."""

    def __init__(self) -> None:
        self._epochs = Epochs()
        self._session = ""
        self._accepted_s = 0.0
        self._left: deque[str] = deque(maxlen=_REMEMBERED)

    def accepts(self, update: HypothesisUpdate, now_s: float) -> bool:
        """Whether an update is of the service to follow.

        Updates are given in the order of arrival, at `now_s` on a monotonic clock.
        """
        if not self._epochs.allows(update.epoch, now_s):
            return False
        if update.session != self._session:
            silent_s = max(_SILENT_S, _SILENT_PERIODS * update.period_ns * 1e-9)
            replaced = update.session in self._left and now_s - self._accepted_s <= silent_s
            if replaced and update.epoch == self._epochs.newest:
                return False
            self._left.append(self._session)
            self._session = update.session
        self._epochs.follow(update.epoch, now_s)
        self._accepted_s = now_s
        return True


M = TypeVar("M", HypothesisUpdate, ObservationBatch, TruthBatch, Status, Preview, default=HypothesisUpdate)

_KINDS = {qos.message: kind for kind, qos in QOS.items()}
# Messages kept for the reader, and samples in Zenoh's ring. Truth arrives as a burst, since publishers cache
# it for late joiners: none of it may be dropped. Images are large.
_CAPACITIES: dict[type, tuple[int, int]] = {
    HypothesisUpdate: (64, 1024),
    ObservationBatch: (1024, 1024),
    TruthBatch: (65536, 65536),
    Status: (256, 1024),
    Preview: (16, 32),
}
# Statuses come once a second; of a storm of them so many of one component displace no others.
_STATUS_S = 0.1
_MOST_KEYS = 4096


@dataclass
class Counters:
    """Counters of a subscription.

    `received`: valid messages; `lost`: missing sequence numbers; `stale`: skipped updates that were
    repeated, out of order, or of an epoch that is not followed, and Statuses less than 0.1 s after the one
    before; `invalid`: payloads by rejection reason of the protocol.
    """

    received: int = 0
    lost: int = 0
    stale: int = 0
    invalid: Counter[str] = field(default_factory=Counter)


class Subscription(Generic[M]):
    """The messages of one type in one scene, in an open session.

    A thread takes samples from a ring in Zenoh, validates them and puts them into a bounded inbox. A slow
    reader loses the oldest messages (:attr:`dropped`) and delays no other subscriber. Invalid payloads are
    counted and skipped.

    Parameters
    ----------
    session
        An open Zenoh session.
    message
        Message type: HypothesisUpdate, ObservationBatch, TruthBatch, Status or Preview. Cameras encode
        previews only while there is a subscription to them.
    scene
        Name of the scene.
    capacity
        Messages kept for the reader; 1: only the newest. None: a default for the type.
    timeout
        Seconds that iteration waits for the next message before it raises TimeoutError; None: no limit.

    Raises
    ------
    ValueError
        If the scene name is not valid.
    """

    def __init__(
        self,
        session: zenoh.Session,
        message: type[M],
        scene: str = DEFAULT_SCENE,
        *,
        capacity: int | None = None,
        timeout: float | None = None,
    ) -> None:
        kind, keys = _KINDS[message.__name__], Keys(scene)
        self.counters = Counters()
        self.timeout = timeout
        self._message: type[M] = message
        self._sequences = SequenceCounter()
        self._read: dict[str, float] = {}
        self._active = ActiveSession()
        kept, ring = _CAPACITIES[message]
        self._inbox: Inbox[tuple[float, M]] = Inbox(kept if capacity is None else capacity)
        self._receiver = Receiver(session, keys.messages(kind), kind, ring, self._take, self._inbox.close)

    @property
    def dropped(self) -> int:
        """Number of messages that were dropped because the reader was too slow."""
        return self._inbox.dropped

    def get(self, timeout: float | None = None) -> M:
        """Wait for the next message.

        Raises
        ------
        TimeoutError
            If no message arrives within `timeout` seconds (None: no limit).
        Closed
            If the subscription was closed.
        """
        return self._inbox.get(timeout)[1]

    def wait(self, timeout: float) -> bool:
        """Wait until a message has arrived or the subscription is closed; False after `timeout` seconds."""
        return self._inbox.wait(timeout)

    def drain(self) -> list[tuple[float, M]]:
        """Return all received messages at once: (time of arrival by ``time.monotonic()``, message)."""
        return self._inbox.drain()

    def __iter__(self) -> Iterator[M]:
        return self

    def __next__(self) -> M:
        try:
            return self._inbox.get(self.timeout)[1]
        except Closed:
            raise StopIteration from None

    def __aiter__(self) -> AsyncIterator[M]:
        return self

    async def __anext__(self) -> M:
        try:
            return (await self._inbox.aget(self.timeout))[1]
        except Closed:
            raise StopAsyncIteration from None

    def close(self) -> None:
        """Stop receiving; iteration ends after the messages received so far."""
        self._receiver.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _take(self, key: str, payload: bytes) -> None:
        if self._message is Status and self._is_storm(key):
            self.counters.stale += 1
            return
        try:
            message = cast("M", decode_on(key, payload))
        except DecodeError as error:
            self.counters.invalid[error.reason] += 1
            return
        if self._is_new(key, message):
            self.counters.received += 1
            self._inbox.put((time.monotonic(), message))

    def _is_storm(self, key: str) -> bool:
        """Whether a Status follows another one of its component too soon to be worth reading."""
        now = time.monotonic()
        if now - self._read.get(key, -_STATUS_S) < _STATUS_S:
            return True
        if len(self._read) >= _MOST_KEYS:
            self._read.clear()
        self._read[key] = now
        return False

    def _is_new(self, key: str, message: M) -> bool:
        """Count missing sequence numbers; False for an update that is repeated or out of order."""
        if not isinstance(message, HypothesisUpdate | ObservationBatch):
            return True
        # A service that was cut off and returns is not followed: another has published since.
        if isinstance(message, HypothesisUpdate) and not self._active.accepts(message, time.monotonic()):
            self.counters.stale += 1
            return False
        lost, order = self._sequences.sight(key, message.session, message.seq)
        self.counters.lost += lost
        if order == "newest" or isinstance(message, ObservationBatch):
            return True
        self.counters.stale += 1
        return False
