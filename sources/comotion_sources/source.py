"""One source of a scene: its messages on their keys, with its Status, and what it receives of others."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from itertools import islice
from typing import Any, Self, Unpack

import zenoh

from comotion_schemas import DecodeError, Message, ObservationBatch, TruthBatch, decode_on, metrics
from comotion_schemas.component import Component, Rates, StatusFields, Where
from comotion_schemas.errors import KnownError
from comotion_schemas.inbox import Inbox
from comotion_schemas.keys import Kind, StreamKind
from comotion_schemas.messages import RejectionReason
from comotion_schemas.text import shown
from comotion_schemas.transport import (
    Publisher,
    SessionSettings,
    declare_subscriber,
    open_session,
    stream_publisher,
)

_MOST_LOGGED = 20  # different texts of rejected input in the log
_MOST_NAMES, _NAME_LENGTH = 256, 80
_log = logging.getLogger(__name__)

STALLED_S = 1.0
"""A source without a batch for this time, or 3 periods if longer, reports the state ``stalled``."""


Arrival = tuple[str, bytes, int]
"""Key, payload, and time of receipt in ns since the Unix epoch."""


class Received(Inbox[Arrival]):
    """Keeps the samples of a key expression until they are taken; Zenoh's thread never waits.

    Parameters
    ----------
    session
        The session to receive in.
    key, kind
        The key expression, and the kind of a stream of comotion; None: it is of another protocol.
    capacity
        Samples that wait; of more the oldest are dropped. By default 4 s of a robot that reports at 500 Hz.
    """

    def __init__(
        self, session: zenoh.Session, key: str, kind: Kind | None = None, capacity: int = 2000
    ) -> None:
        super().__init__(capacity)
        # The subscriber lasts as long as the session, or this reference to it.
        self._subscriber: Any = (
            session.declare_subscriber(key, self._receive)
            if kind is None
            else declare_subscriber(session, key, kind, self._receive)
        )

    def messages(self) -> Iterator[Message]:
        """Yield the messages that have arrived; one that is invalid or not of its key is left out."""
        for key, payload, _ in self.drain():
            try:
                message = decode_on(key, payload)
            except DecodeError:
                continue
            yield message

    def until(self, stop: threading.Event, idle_s: float = 0.1) -> Iterator[Arrival | None]:
        """Yield what arrives until an event is set, and None after each `idle_s` without anything."""
        while not stop.is_set():
            if not self.wait(idle_s):
                yield None
            for arrival in self.drain():
                yield arrival
                # What waits may take long.
                if stop.is_set():
                    return

    def _receive(self, sample: zenoh.Sample) -> None:
        self.put((str(sample.key_expr), sample.payload.to_bytes(), time.time_ns()))


class Source(Component):
    """One source of a scene: the publishers of its streams, its counters and its Status.

    Parameters
    ----------
    name
        Name of the source, one chunk of ``[a-z0-9_-]{1,64}``.
    kinds
        What it publishes.
    rate
        Nominal rate of its batches in Hz, for detecting a stall; 0: unknown.
    message
        One line for Status that describes the source.
    feature_names
        Names of features by id, as of the links of a robot; what they move with is called by them.

    Attributes
    ----------
    counters
        By name, for Status.
    fault
        One line while something is wrong, for Status, which is then ``degraded``.
    more_counters
        Called for further counters of Status.
    """

    def __init__(
        self,
        name: str,
        *,
        kinds: Collection[StreamKind] = ("obs", "truth"),
        rate: float = 0.0,
        message: str = "",
        feature_names: Mapping[int, str] | None = None,
        **where: Unpack[Where],
    ) -> None:
        super().__init__(role="source", name=name, status=self._fields, **where)
        self._kinds = sorted(kinds)
        self._publishers: dict[StreamKind, Publisher] = {}
        self._stalled_after_s = max(STALLED_S, 3.0 / rate if rate else 0.0)
        self._message = message
        self.fault = ""
        self.more_counters: Callable[[], Mapping[str, int]] = dict
        self._feature_names: dict[str, str] = {}
        self.name_features(feature_names or {})
        # `sent` counts the batches of the present session: the service learns what of its end never came.
        self.counters = {"batches": 0, "sent": 0, "observations": 0, "tracks": 0, "overruns": 0}
        self._rejected: dict[RejectionReason, int] = {}
        self._logged: set[str] = set()
        self._rates = Rates()
        self._last_put: float | None = None
        self._lag = metrics.histogram("publish_lag_seconds", scene=self.scene, component=name, role="source")

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.push(super().__enter__())
            for kind in self._kinds:
                publisher = stream_publisher(self.session, self.keys, kind, self.name)
                self._exit.callback(publisher.undeclare)
                self._publishers[kind] = publisher
            stack.pop_all()
        return self

    def send(self, kind: StreamKind, payload: bytes, message: Message | None = None) -> None:
        """Publish a payload on the stream of a kind; `message` is what it holds, where that is known."""
        self._publishers[kind].put(payload)
        if isinstance(message, TruthBatch):
            self.counters["tracks"] += len(message.ids)
        if kind != "obs":
            return
        self.counters["batches"] += 1
        self._last_put = time.monotonic()
        if isinstance(message, ObservationBatch):
            self._begin_session(message.session)
            self.counters["sent"] += 1
            self.counters["observations"] += len(message.ids)
            if self._lag is not metrics.off:
                self._lag((time.time_ns() - message.stamp_ns) / 1e9)

    def receive(self, key: str, settings: SessionSettings | None = None) -> Iterator[Arrival | None]:
        """Receive what others publish, as :meth:`Received.until` the source stops.

        `settings` say how to connect to the router of another network; None: in the session of the source.
        """
        other = None if settings is None else self._exit.enter_context(open_session(settings))
        inbox = Received(other or self.session, key)
        self.more_counters = lambda: {"lost": inbox.dropped}
        return inbox.until(self.stop)

    def name_features(self, names: Mapping[int, str]) -> None:
        """Say the names of further features by id, 256 at most; what they move with is called by them."""
        if not isinstance(names, Mapping) or not all(isinstance(name, str) for name in names.values()):
            raise KnownError(f"feature_names: {shown(repr(names), _NAME_LENGTH)} is not texts by ids")
        new = {str(number): shown(name, _NAME_LENGTH) for number, name in names.items()}
        if not new.keys() <= self._feature_names.keys():
            # Another thread may read the names that were.
            self._feature_names = dict(islice((self._feature_names | new).items(), _MOST_NAMES))

    def count(self, name: str, amount: int = 1) -> None:
        """Add to a counter that appears in Status."""
        self.counters[name] = self.counters.get(name, 0) + amount

    def reject(self, reason: RejectionReason, text: str = "", count: int = 1) -> None:
        """Count rejected input by its reason for Status; a `text` that says more is logged once."""
        self._rejected[reason] = self._rejected.get(reason, 0) + count
        if text and text not in self._logged and len(self._logged) < _MOST_LOGGED:
            self._logged.add(text)
            _log.warning("%s: such messages are left out", text)

    def _begin_session(self, session: str) -> None:
        if session != self.session_id:
            self.counters["sent"] = 0
            self.session_id = session

    def _fields(self) -> StatusFields:
        age = None if self._last_put is None else time.monotonic() - self._last_put
        stalled = age is not None and age > self._stalled_after_s
        return StatusFields(
            state="degraded" if self.fault else "stalled" if stalled else "ok",
            rates=self._rates.of({"obs": self.counters["batches"]}),
            ages={} if age is None else {"obs": age},
            counters=self.counters | dict(self.more_counters()),
            rejected=dict(self._rejected),
            message=self.fault or self._message,
            feature_names=self._feature_names,
        )
