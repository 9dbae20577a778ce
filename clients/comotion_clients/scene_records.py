"""Records of a scene: its components, by their tokens, Statuses and batches, updates and events. Pure.

The caller passes the time: `now` and `arrived` are seconds of one clock, `wall_ns` and `wall_s` the wall
clock. Clocks are compared by the stamps of Statuses and the round trips of queries: those that a service
answers with its clock, and those that the cache of every component's publisher answers.
"""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

from comotion_schemas import Event, HypothesisUpdate, Message, ObservationBatch, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.colours import Palette
from comotion_schemas.hypotheses import OF_BODIES, EventKind
from comotion_schemas.keys import TOKEN_NAME_CHARACTERS, token_name
from comotion_schemas.naming import Names
from comotion_schemas.sequence import SequenceCounter
from comotion_schemas.text import shown

from .bodies import HypothesisNames
from .scene_rows import RouterRow

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
EVENTS_KEPT = 4096
"""Events that are known again when a later update repeats them."""
MOST = 4096
"""Components and routers that are remembered; a scene has hundreds at most."""
_MOST_LOCATORS = 8


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
        measured = len(self.arrivals) > 1 and self.arrivals[-1] - self.arrivals[0] >= RATE_MIN_SPAN_S
        return 1.0 / self.period() if measured and not self.stalled(now) else 0.0

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
        role = "" if self.status is None else self.status.role
        return role if not self.tokens or role in self.tokens else min(self.tokens)


class SceneRecords:
    """Accumulates the messages and liveliness tokens of one scene.

    Parameters
    ----------
    scene
        Name of the scene.
    names
        Names of hypotheses by id, as people give them; :attr:`names` holds those of sources too.
    all_events
        Whether events of joints are listed beside those of bodies.
    """

    def __init__(self, scene: str, names: Names | None = None, *, all_events: bool = False) -> None:
        self.scene = scene
        self.names = HypothesisNames(names)
        self.palette = Palette()
        self.update: HypothesisUpdate | None = None
        """The newest update."""
        self.components: dict[str, ComponentRecord] = {}
        self.updates = Stream()
        self.routers: dict[str, RouterRow] = {}
        self.units: dict[str, str] = {}
        self.events: dict[tuple[int, EventKind, int], Event] = {}
        self.service_gone = False
        self._kinds = frozenset(get_args(EventKind)) if all_events else OF_BODIES
        self._sequences = SequenceCounter()

    @property
    def seen(self) -> bool:
        """Whether any message of the scene was received."""
        return self.update is not None or self.service is not None or bool(self.sources())

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Event]:
        """Add a message of any kind; returns the events that no earlier update had."""
        match message:
            case Status():
                self.on_status(message, arrived, wall_ns / 1e9)
            case ObservationBatch():
                self.on_batch(message, arrived, wall_ns)
            case HypothesisUpdate():
                return self.on_update(message, arrived)
        return []

    def on_status(self, status: Status, arrived: float = 0.0, wall_s: float = math.nan) -> None:
        """Add a Status, which may name features; one from a cache is older than its arrival tells."""
        record = self.record(status.component)
        record.status, record.arrived = status, arrived
        self.names.on_status(status)
        if math.isfinite(wall_s):
            record.clock.on_stamp(status.stamp_ns / 1e9 - wall_s)

    def on_batch(self, batch: ObservationBatch, arrived: float, wall_ns: int) -> None:
        """Add a batch of a source."""
        source = self.record(batch.source)
        source.stream.arrive(self._sequences.sight(batch.source, batch.session, batch.seq).lost, arrived)
        source.space, source.gone_at = in_cell(batch.space), None
        source.lag = (wall_ns - batch.stamp_ns) / 1e9
        self.units[batch.space] = batch.unit

    def on_update(self, update: HypothesisUpdate, arrived: float) -> list[Event]:
        """Add an update; returns the events that no earlier update had."""
        self.updates.arrive(self._sequences.sight("", update.session, update.seq).lost, arrived)
        self.update, self.service_gone = update, False
        self.names.on_update(update)
        self.palette.see(update.hypotheses)
        listed = {(e.stamp_ns, e.kind, e.hypothesis): e for e in update.events if e.kind in self._kinds}
        new = {key: event for key, event in listed.items() if key not in self.events}
        self.events.update(new)
        for key in list(self.events)[:-EVENTS_KEPT]:
            del self.events[key]
        return list(new.values())

    def on_presence(self, role: str, token: str, *, alive: bool, now: float = 0.0) -> None:
        """Add a change of a liveliness token; `token` is its last chunk."""
        name = token
        if role == "service":
            short = token_name(token)
            full = (name for name, record in self.components.items() if record.role == "service")
            name = next((name for name in full if name[:TOKEN_NAME_CHARACTERS] == short), short)
        if alive:
            record = self.record(name)
            record.tokens.add(role)
            record.present, record.gone_at = True, None
        elif name in self.components:
            self.components[name].present, self.components[name].gone_at = False, now
        if role == "service":
            services = [record for record in self.components.values() if "service" in record.tokens]
            self.service_gone = not any(record.present for record in services)

    def on_answer(self, status: Status, sent_s: float, received_s: float) -> None:
        """Add the answer of a service to a query for its Status."""
        self.record(status.component).clock.on_answer(status.stamp_ns / 1e9, sent_s, received_s)

    def on_cache_answer(self, name: str, trip_s: float) -> None:
        """Add the time until a publisher's cache has answered."""
        self.record(name).clock.on_trip(trip_s)

    def on_router(self, described: Mapping[str, Any]) -> None:
        """Add what a router says of itself; what is malformed is left out."""
        if len(self.routers) >= MOST:
            return
        metadata = described.get("metadata")
        metadata = metadata if isinstance(metadata, dict) else {}
        sessions = described.get("sessions")
        sessions = [s for s in sessions if isinstance(s, dict)] if isinstance(sessions, list) else []
        locators = described.get("locators")
        locators = locators[:_MOST_LOCATORS] if isinstance(locators, list) else []
        zid = in_cell(described.get("zid", ""))
        self.routers[zid] = RouterRow(
            name=in_cell(metadata.get("name", "")),
            host=in_cell(metadata.get("host", "")),
            zid=zid,
            version=in_cell(described.get("version", "")).partition("-")[0],
            locators=[in_cell(locator) for locator in locators],
            sessions=sum(s.get("whatami") != "router" for s in sessions),
            routers=sum(s.get("whatami") == "router" for s in sessions),
            dials=dials if isinstance(dials := metadata.get("dials"), int) else 0,
        )

    @property
    def service(self) -> Status | None:
        """Status of the service that speaks: of the highest epoch, and the newest."""
        services = [
            record for record in self.components.values() if record.status and record.role == "service"
        ]
        # Where services have tokens, who has none is no service.
        holding = [record for record in services if record.tokens] or services
        speaking = [r.status for r in holding if r.status and r.status.replica != "standby"]
        return max(speaking, key=lambda status: (status.epoch, status.stamp_ns), default=None)

    def sources(self) -> dict[str, ComponentRecord]:
        """Sources that have a token or have sent something, and those in the Status of the service."""
        of_service = {} if self.service is None else self.service.ages
        own = {n: s for n, s in self.components.items() if "source" in s.tokens or s.stream.arrivals}
        return {name: self.components.get(name) or ComponentRecord() for name in sorted({*own, *of_service})}

    def record(self, name: str) -> ComponentRecord:
        """What is known of a component; one too many is not remembered."""
        if len(self.components) >= MOST and name not in self.components:
            return ComponentRecord()
        return self.components.setdefault(name, ComponentRecord())


def in_cell(value: object) -> str:
    """Text of a component for a cell of a table."""
    return shown(str(value), MOST_CHARACTERS)


def in_line(text: str) -> str:
    """Text of a component for a line."""
    return shown(text, MOST_TEXT)
