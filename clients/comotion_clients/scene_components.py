"""The components of a scene, of their tokens, Statuses and messages. Pure.

The base of what `comotion watch`, `view` and `status` know of a scene. The caller passes the time: `now` and
`arrived` are seconds of one clock.

Clocks are compared by the stamps of Statuses and the round trips of queries: those that a service answers
with its clock, and those that the cache of every component's publisher answers.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from comotion_schemas import Event, HypothesisUpdate, Message, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.keys import TOKEN_NAME_CHARACTERS, token_name
from comotion_schemas.sequence import SequenceCounter
from comotion_schemas.text import shown

from .scene_problems import ComponentRow, RouterRow, SceneStatus, find_problems, overall

RATE_SPAN_S = 3.0
"""A rate is the mean over this time."""
RATE_MIN_SPAN_S = 0.5
"""Without arrivals over this time the rate is unknown: the first messages may come in a burst."""
STALL_S = 1.0
"""A stream is stalled after this time or :data:`STALL_PERIODS` periods, whichever is longer."""
STALL_PERIODS = 3
LOSS_SHOWN_S = 10.0
"""How long a loss is highlighted."""
MOST_CHARACTERS, MOST_TEXT = 80, 500
"""Bounds on what texts of one component or router may take of a screen: of a cell, and of a line."""
SILENT_S = 3.5
"""A component whose newest Status is older is silent: it sends one a second."""
_MOST_LOCATORS = 8
MOST = 4096
"""Components and routers that are remembered; a scene has hundreds at most."""


@dataclass
class Stream:
    """Arrivals of one publisher: rate, age and number of lost messages."""

    lost: int = 0
    lost_at: float = float("-inf")
    arrivals: deque[float] = field(default_factory=deque)

    def arrive(self, lost: int, now: float) -> None:
        """Take note of a message with which `lost` more are missing than before, or -1 for one less."""
        self.lost += lost
        if lost > 0:
            self.lost_at = now
        self.arrivals.append(now)
        while now - self.arrivals[0] > RATE_SPAN_S and len(self.arrivals) > 2:
            self.arrivals.popleft()

    def age(self, now: float) -> float:
        """Seconds since the last arrival."""
        return max(now - self.arrivals[-1], 0.0) if self.arrivals else float("inf")

    def period(self) -> float:
        """Mean seconds between the recent arrivals; 0 until there are two."""
        if len(self.arrivals) < 2:
            return 0.0
        return (self.arrivals[-1] - self.arrivals[0]) / (len(self.arrivals) - 1)

    def stalled(self, now: float) -> bool:
        """Whether the last arrival is too long ago for the period of the stream."""
        return self.age(now) > max(STALL_S, STALL_PERIODS * self.period())

    def rate(self, now: float) -> float:
        """Messages per second; 0 while stalled or unknown."""
        known = len(self.arrivals) > 1 and self.arrivals[-1] - self.arrivals[0] >= RATE_MIN_SPAN_S
        return 1.0 / self.period() if known and not self.stalled(now) else 0.0

    def losing(self, now: float) -> bool:
        """Whether a message was lost in the last 10 s."""
        return now - self.lost_at < LOSS_SHOWN_S


@dataclass
class ComponentRecord:
    """What is known of one component.

    `tokens`: roles of its tokens, of which it holds one while `present`; `gone_at`: when it left;
    `stream`, `space`, `lag`: of the batches of a source.
    """

    status: Status | None = None
    arrived: float = float("-inf")
    tokens: set[str] = field(default_factory=set)
    present: bool = False
    gone_at: float | None = None
    clock: ClockBounds = field(default_factory=ClockBounds)
    stream: Stream = field(default_factory=Stream)
    space: str = ""
    lag: float = float("nan")

    @property
    def role(self) -> str:
        """The role of its token; what its Status says counts only without one, or among several."""
        said = "" if self.status is None else self.status.role
        return said if not self.tokens or said in self.tokens else min(self.tokens)


class ComponentsModel:
    """Accumulates what is heard of a scene.

    Parameters
    ----------
    scene
        Name of the scene.
    """

    def __init__(self, scene: str) -> None:
        self.scene = scene
        self._components: dict[str, ComponentRecord] = {}
        self._sequences = SequenceCounter()
        self._updates = Stream()
        self._routers: dict[str, RouterRow] = {}
        self._update: HypothesisUpdate | None = None

    @property
    def update(self) -> HypothesisUpdate | None:
        """The newest update."""
        return self._update

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Event]:
        """Add a message of any kind; returns the events that no earlier update had."""
        if isinstance(message, Status):
            self.on_status(message, arrived, wall_ns / 1e9)
        elif isinstance(message, HypothesisUpdate):
            return self.on_update(message, arrived)
        return []

    def on_status(self, status: Status, arrived: float = 0.0, wall_s: float = math.nan) -> None:
        """Add a Status; one from a publisher's cache is older than its arrival tells.

        `wall_s` is its arrival by this machine's clock.
        """
        record = self._record(status.component)
        record.status, record.arrived = status, arrived
        if math.isfinite(wall_s):
            record.clock.on_stamp(status.stamp_ns / 1e9 - wall_s)

    def on_presence(self, role: str, token: str, *, alive: bool, now: float = 0.0) -> None:
        """Add a change of a liveliness token; `token` is its last chunk."""
        name = self._full_name(token_name(token)) if role == "service" else token
        if alive:
            record = self._record(name)
            record.tokens.add(role)
            record.present, record.gone_at = True, None
        elif name in self._components:
            self._components[name].present, self._components[name].gone_at = False, now

    def on_update(self, update: HypothesisUpdate, arrived: float) -> list[Event]:
        """Add an update; returns the events that no earlier update had, where these are known."""
        self._updates.arrive(self._sequences.sight("", update.session, update.seq).lost, arrived)
        self._update = update
        return []

    @property
    def publishers(self) -> list[str]:
        """Names of the components whose Status has arrived."""
        return [name for name, record in self._components.items() if record.status is not None]

    def on_answer(self, status: Status, sent_s: float, received_s: float) -> None:
        """Add the answer of a service to a query for its Status."""
        clock = self._record(status.component).clock
        clock.on_answer(status.stamp_ns / 1e9, sent_s, received_s)

    def on_cache_answer(self, name: str, trip_s: float) -> None:
        """Add the time until a publisher's cache has answered."""
        self._record(name).clock.on_trip(trip_s)

    def on_router(self, described: Mapping[str, Any]) -> None:
        """Add what a router says of itself; what is malformed is left out."""
        if len(self._routers) >= MOST:
            return
        metadata = described.get("metadata")
        metadata = metadata if isinstance(metadata, dict) else {}
        sessions = described.get("sessions")
        sessions = [s for s in sessions if isinstance(s, dict)] if isinstance(sessions, list) else []
        locators = described.get("locators")
        locators = locators[:_MOST_LOCATORS] if isinstance(locators, list) else []
        zid = in_cell(described.get("zid", ""))
        self._routers[zid] = RouterRow(
            name=in_cell(metadata.get("name", "")),
            host=in_cell(metadata.get("host", "")),
            zid=zid,
            version=in_cell(described.get("version", "")).partition("-")[0],
            locators=[in_cell(locator) for locator in locators],
            sessions=sum(s.get("whatami") != "router" for s in sessions),
            routers=sum(s.get("whatami") == "router" for s in sessions),
            dials=dials if isinstance(dials := metadata.get("dials"), int) else 0,
        )

    def status(self, now_s: float) -> SceneStatus:
        """Return what is known now."""
        rows = [self._row(name, record, now_s) for name, record in sorted(self._components.items())]
        rows = [row for row in rows if row.present or row.age_s <= SILENT_S]
        rows.sort(key=lambda row: (_ORDER.get(row.role, len(_ORDER)), row.name))
        routers = sorted(self._routers.values(), key=lambda row: (row.name, row.zid))
        problems = find_problems(rows, routers) + _reported(self.service)
        update = self._update
        return SceneStatus(
            scene=self.scene,
            overall=overall(rows, problems),
            updates_hz=self._updates_hz(),
            update_lag_s=None if update is None else (update.published_ns - update.stamp_ns) / 1e9,
            components=rows,
            routers=routers,
            problems=problems,
        )

    def _updates_hz(self) -> float | None:
        # The first may come from the publisher's cache.
        arrivals = list(self._updates.arrivals)[1:]
        if len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return None
        return (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])

    def _row(self, name: str, record: ComponentRecord, now_s: float) -> ComponentRow:
        status, service = record.status, self.service
        clock, error = self._clock(name, record, service)
        lag = None
        if service is not None and record.role == "source":
            lag = service.ages.get(name)
        return ComponentRow(
            role=record.role,
            name=name,
            state="silent" if status is None or now_s - record.arrived > SILENT_S else status.state,
            host="" if status is None else in_cell(status.host),
            version="" if status is None else in_cell(status.version),
            # A process that is killed loses its token at once; its last Status stays in this model.
            present=record.present,
            age_s=now_s - record.arrived,
            rate_hz=_rate(name, record, service, self._updates_hz()),
            lag_s=lag,
            lost=0 if status is None else status.counters.get("lost", 0),
            clock_s=clock,
            clock_error_s=error,
            replica="" if status is None else status.replica,
            epoch=0 if status is None else status.epoch,
            message="" if status is None else in_line(status.message),
        )

    def _clock(
        self, name: str, record: ComponentRecord, service: Status | None
    ) -> tuple[float | None, float | None]:
        own = record.clock.estimate()
        if own is None:
            return None, None
        reference = None if service is None else self._components[service.component].clock.estimate()
        if reference is None:
            return own
        if service is not None and service.component == name:
            return 0.0, 0.0
        return own[0] - reference[0], own[1] + reference[1]

    @property
    def service(self) -> Status | None:
        """Status of the service that speaks: of the highest epoch, and the newest."""
        services = [
            record for record in self._components.values() if record.status and record.role == "service"
        ]
        # Where services have tokens, who has none is no service.
        holding = [record for record in services if record.tokens] or services
        speaking = [
            record.status for record in holding if record.status and record.status.replica != "standby"
        ]
        return max(speaking, key=lambda status: (status.epoch, status.stamp_ns), default=None)

    def _record(self, name: str) -> ComponentRecord:
        """What is known of a component; one too many is not remembered."""
        if len(self._components) >= MOST and name not in self._components:
            return ComponentRecord()
        return self._components.setdefault(name, ComponentRecord())

    def _full_name(self, short: str) -> str:
        known = (name for name, record in self._components.items() if record.role == "service")
        return next((name for name in known if name[:TOKEN_NAME_CHARACTERS] == short), short)


def in_cell(value: object) -> str:
    """Text of a component for a cell of a table."""
    return shown(str(value), MOST_CHARACTERS)


def in_line(text: str) -> str:
    """Text of a component for a line."""
    return shown(text, MOST_TEXT)


_ORDER = {"service": 0, "source": 1, "recorder": 2, "viewer": 3}


def _rate(
    name: str, record: ComponentRecord, service: Status | None, updates_hz: float | None
) -> float | None:
    if record.role == "service":
        return updates_hz if service is not None and service.component == name else None
    if record.role != "source":
        return None
    received = None if service is None else service.rates.get(name)
    own = None if record.status is None else record.status.rates.get("obs")
    return own if received is None else received


def _reported(service: Status | None) -> list[str]:
    """What the service itself says that a person should change."""
    return [] if service is None else [in_line(problem.text) for problem in service.problems]
