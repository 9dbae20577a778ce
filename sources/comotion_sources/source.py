"""One source of a scene: its messages on their keys, with its presence and Status."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from itertools import islice
from typing import Self, Unpack

from comotion_schemas import Message, ObservationBatch, TruthBatch, metrics
from comotion_schemas.component import Component, Rates, StatusFields, Where
from comotion_schemas.keys import StreamKind
from comotion_schemas.messages import RejectionReason
from comotion_schemas.text import shown
from comotion_schemas.transport import (
    Publisher,
    SessionSettings,
    open_session,
    stream_publisher,
)

from .received import Arrival, Inbox

_MOST_LOGGED = 20  # different texts of rejected input in the log
_MOST_NAMES, _NAME_LENGTH = 256, 80
_log = logging.getLogger(__name__)

STALLED_S = 1.0
"""A source without a batch for this time, or 3 periods if longer, reports the state ``stalled``."""


class Source:
    """One source of a scene: its presence, the publishers of its streams, its counters and its Status.

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
    where
        Scene, router and ready file, as in :class:`comotion_schemas.component.Component`.

    Attributes
    ----------
    fault
        One line while something is wrong, for Status, which is then ``degraded``.
    more_counters
        Called for further counters of Status.

    Raises
    ------
    ValueError
        If the name of the scene or source is not valid.
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
        self.name = name
        self.component = Component(role="source", name=name, status=self._status, **where)
        self._kinds = sorted(kinds)
        self._publishers: dict[StreamKind, Publisher] = {}
        self._stalled_after_s = max(STALLED_S, 3.0 / rate if rate else 0.0)
        self._message = message
        self.fault = ""
        self.more_counters: Callable[[], Mapping[str, int]] = dict
        self._feature_names: dict[str, str] = {}
        self.name_features(feature_names or {})
        self._exit = ExitStack()
        # `sent` counts the batches of the present session: the service learns what of its end never came.
        self._counters = {"batches": 0, "sent": 0, "observations": 0, "tracks": 0, "overruns": 0}
        self._rejected: dict[RejectionReason, int] = {}
        self._logged: set[str] = set()
        self._rates = Rates()
        self._last_put: float | None = None
        scene = self.component.scene
        self._lag = metrics.histogram("publish_lag_seconds", scene=scene, component=name, role="source")

    @property
    def stop(self) -> threading.Event:
        """Set when the process is to stop."""
        return self.component.stop

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            component = stack.enter_context(self.component)
            for kind in self._kinds:
                publisher = stream_publisher(component.session, component.keys, kind, self.name)
                stack.callback(publisher.undeclare)
                self._publishers[kind] = publisher
            self._exit = stack.pop_all()
        return self

    def __exit__(self, *exception: object) -> None:
        self._exit.close()

    def ready(self) -> None:
        """Signal that the source is ready, by the ready file or the line ``ready``."""
        self.component.ready()

    def send(self, kind: StreamKind, payload: bytes, message: Message | None = None) -> None:
        """Publish a payload on the stream of a kind; `message` is what it holds, where that is known."""
        self._publishers[kind].put(payload)
        if isinstance(message, TruthBatch):
            self._counters["tracks"] += len(message.ids)
        if kind != "obs":
            return
        self._counters["batches"] += 1
        self._last_put = time.monotonic()
        if isinstance(message, ObservationBatch):
            self._begin_session(message.session)
            self._counters["sent"] += 1
            self._counters["observations"] += len(message.ids)
            if self._lag is not metrics.off:
                self._lag((time.time_ns() - message.stamp_ns) / 1e9)

    def receive(self, key: str, settings: SessionSettings | None = None) -> Iterator[Arrival | None]:
        """Receive what others publish, as :meth:`Inbox.until` the source stops.

        Parameters
        ----------
        key
            The key expression.
        settings
            How to connect to the router of another network; None: in the session of the source.
        """
        session = self.component.session
        if settings is not None:
            session = self._exit.enter_context(open_session(settings))
        inbox = Inbox(session, key)
        self._exit.callback(inbox.close)
        self.more_counters = lambda: {"lost": inbox.lost}
        return inbox.until(self.stop)

    def name_features(self, names: Mapping[int, str]) -> None:
        """Say the names of further features by id, 256 at most; what they move with is called by them."""
        new = {str(number): shown(name, _NAME_LENGTH) for number, name in names.items()}
        if not new.keys() <= self._feature_names.keys():
            # Another thread may read the names that were.
            self._feature_names = dict(islice((self._feature_names | new).items(), _MOST_NAMES))

    def count(self, name: str, amount: int = 1) -> None:
        """Add to a counter that appears in Status."""
        self._counters[name] = self._counters.get(name, 0) + amount

    def reject(self, reason: RejectionReason, text: str = "", count: int = 1) -> None:
        """Count rejected input by its reason for Status; a `text` that says more is logged once."""
        self._rejected[reason] = self._rejected.get(reason, 0) + count
        if text and text not in self._logged and len(self._logged) < _MOST_LOGGED:
            self._logged.add(text)
            _log.warning("%s: such messages are left out", text)

    @property
    def overruns(self) -> int:
        """How many were due and are left out."""
        return self._counters["overruns"]

    def _begin_session(self, session: str) -> None:
        if session != self.component.session_id:
            self._counters["sent"] = 0
            self.component.session_id = session

    def _status(self) -> StatusFields:
        age = None if self._last_put is None else time.monotonic() - self._last_put
        stalled = age is not None and age > self._stalled_after_s
        return StatusFields(
            state="degraded" if self.fault else "stalled" if stalled else "ok",
            rates=self._rates.of({"obs": self._counters["batches"]}),
            ages={} if age is None else {"obs": age},
            counters=self._counters | dict(self.more_counters()),
            rejected=dict(self._rejected),
            message=self.fault or self._message,
            feature_names=self._feature_names,
        )
