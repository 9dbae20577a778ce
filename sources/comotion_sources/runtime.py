"""One source of a scene: its messages on their keys, with its presence and Status."""

import logging
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Self, Unpack

import numpy as np
from numpy.typing import ArrayLike

from comotion_schemas import DEFAULT_SCENE, Message, ObservationBatch, TruthBatch, encode, metrics
from comotion_schemas.component import Component, Rates, StatusFields, Where, new_session_id
from comotion_schemas.doubts import coarse
from comotion_schemas.errors import KnownError, one_line_errors
from comotion_schemas.keys import StreamKind
from comotion_schemas.messages import RejectionReason
from comotion_schemas.rows import check_space, usable_rows
from comotion_schemas.text import shown
from comotion_schemas.transport import (
    Publisher,
    SessionSettings,
    client_settings,
    open_session,
    stream_publisher,
)
from comotion_schemas.types import Unit

from .received import Arrival, Inbox
from .streams import MessageBuilder

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
        Names of features by id.
    session_id
        16 hexadecimal digits; None: random.
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
        session_id: str | None = None,
        **where: Unpack[Where],
    ) -> None:
        self.name = name
        self.component = Component(
            role="source", name=name, status=self._status, session_id=session_id, **where
        )
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


class SourcePublisher(Source):
    """Publishes one source until its :attr:`stop` is set, by a signal or otherwise.

    ::

        with SourcePublisher("my-tracker", space="world", unit="m", dim=3) as source:
            source.ready()
            while not source.stop.is_set():
                ids, positions = my_tracker.next_frame()
                source.observe(ids=ids, positions=positions)

    Parameters
    ----------
    name
        Name of the source, one chunk of ``[a-z0-9_-]{1,64}``.
    space, unit, dim
        The coordinate space of the positions.
    scene
        Name of the scene.
    connect
        Endpoint of the router, or several, as in ``comotion_clients.subscribe``; None: that of this machine.
    settings
        Where to connect, and with what certificate, instead of `connect` and `tls`.
    tls
        Without `settings`: the folder that ``comotion pki issue`` has written; None: the folder named by
        ``COMOTION_TLS`` in the environment, if there is one.
    drop_invalid
        Leave out rows with an infinite position (``non-finite``) or a negative id (``range``) and
        count them in :attr:`dropped` and in Status. Otherwise such a row is an error.
    ready_file
        Written by :meth:`ready` instead of the line ``ready`` on standard output.
    rate
        Nominal rate in Hz, for detecting a stall; 0: unknown.
    message
        One line for Status that describes the source.
    feature_names
        Names of features by id, as of the links of a robot; what they move with is called by them.

    Raises
    ------
    ValueError
        If the name of the scene or source is not valid, or the unit does not go with `dim`.
    """

    def __init__(
        self,
        name: str,
        *,
        space: str,
        unit: Unit,
        dim: int,
        scene: str = DEFAULT_SCENE,
        connect: str | Sequence[str] | None = None,
        settings: SessionSettings | None = None,
        tls: Path | str | None = None,
        drop_invalid: bool = False,
        ready_file: Path | None = None,
        rate: float = 0.0,
        message: str = "",
        feature_names: Mapping[int, str] | None = None,
        moving: bool = False,
    ) -> None:
        if connect is not None and settings is not None:
            raise KnownError("give connect or settings, not both")
        check_space(unit, dim)
        endpoints = (connect,) if isinstance(connect, str) else connect
        super().__init__(
            name,
            rate=rate,
            message=message,
            feature_names=feature_names,
            scene=scene,
            settings=settings or client_settings(endpoints, tls),
            ready_file=ready_file,
        )
        self._drop_invalid = drop_invalid
        # Whether the first positions were looked at.
        self._judged = False
        session = self.component.session_id
        self.builder = MessageBuilder(
            source=name, session=session, space=space, unit=unit, dim=dim, moving=moving
        )

    @property
    def dropped(self) -> dict[RejectionReason, int]:
        """Rows that were left out, by reason."""
        return dict(self._rejected)

    def new_session(self) -> None:
        """Start a new session: all trajectories end, and ids and sequence numbers start again."""
        self._begin_session(new_session_id())
        self.builder = replace(self.builder, session=self.component.session_id)

    def observe(
        self,
        *,
        ids: ArrayLike,
        positions: ArrayLike,
        stamp_ns: int | None = None,
        sigma: float | ArrayLike | None = None,
        covariance: ArrayLike | None = None,
        quaternions: ArrayLike | None = None,
        ended: ArrayLike | None = None,
        stamps_ns: ArrayLike | None = None,
    ) -> None:
        """Publish the observations of one instant, or of several with `stamps_ns`.

        Parameters
        ----------
        ids
            Integers [N] at or above 0; an id must never be reused for another feature.
        positions
            float [N, dim], in the unit of the source; a row with NaN: not seen. Infinite: see `drop_invalid`.
        stamp_ns
            Acquisition time, nanoseconds since the Unix epoch; None: now.
        sigma
            One-sigma noise of a position in the unit of the source, a number or float [N]; None: unknown.
        covariance
            Float [N, 6] (xx, xy, xz, yy, yz, zz), in 2-D [N, 3] (xx, xy, yy), m²: covariance of the noise of
            a position in the axes of the space, as of a depth camera that knows its rays; it counts before
            `sigma`.
        quaternions
            float [N, 4] (x, y, z, w) of 6-DoF features, rows of NaN for points; None: only points.
        ended
            Ids [M] that the source has lost for good.
        stamps_ns
            Acquisition time of each row, int64 [N], if they differ; the largest equals `stamp_ns`.

        Raises
        ------
        comotion.Error
            A ValueError. If the arrays are malformed; nothing is published then.
        """
        with one_line_errors():
            columns = {"sigma": sigma, "covariance": covariance, "quaternions": quaternions}
            columns["stamps_ns"] = stamps_ns
            instants = stamps_ns is not None
            rows = usable_rows(ids, positions, columns, drop=self._drop_invalid, instants=instants)
            if not self._judged and len(rows.ids):
                self._judged = True
                if text := coarse(rows.positions):
                    _log.warning("%s", text)
            for reason, count in rows.dropped.items():
                self.reject(reason, count=count)
            stamp = time.time_ns() if stamp_ns is None else stamp_ns
            if instants and 0 < len(rows.ids) < np.size(ids):
                stamp = int(rows.columns["stamps_ns"].max())
            positions = rows.positions if len(rows.ids) else np.zeros((0, self.builder.dim))
            batch = self.builder.observation(
                stamp_ns=stamp, ids=rows.ids, positions=positions, ended=ended, **rows.columns
            )
            self.put(batch)

    def tell_truth(self, *, ids: ArrayLike, objects: ArrayLike, names: Mapping[int, str]) -> None:
        """Publish the true objects of features.

        Parameters
        ----------
        ids
            Unsigned integers [N].
        objects
            Integers [N], object numbers, -1 for ambiguous.
        names
            Object number -> name.

        Raises
        ------
        pydantic.ValidationError
            If the arrays are malformed.
        """
        self.put(self.builder.truth(ids=ids, objects=objects, names=names))

    def put(self, message: ObservationBatch | TruthBatch) -> None:
        """Publish a message that :attr:`builder` has built."""
        self.send("truth" if isinstance(message, TruthBatch) else "obs", encode(message), message)
