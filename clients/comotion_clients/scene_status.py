"""Models what an operator wants to know of a scene. Pure.

Clocks are compared by the stamps of Statuses and the round trips of queries: those that a service answers
with its clock, and those that the cache of every component's publisher answers.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from comotion_schemas import HypothesisUpdate, Status
from comotion_schemas.clock_bounds import ClockBounds
from comotion_schemas.keys import TOKEN_NAME_CHARACTERS, token_name
from comotion_schemas.text import shown

from .scene_problems import ComponentRow, RouterRow, find_problems

Overall = Literal["ok", "degraded", "stalled"]
SILENT_S = 3.5
"""A component whose newest Status is older is silent: it sends one a second."""
# Bounds on what one component or router may take of a screen: of a cell, and of a line.
_MOST_CHARACTERS, _MOST_TEXT = 80, 500
_MOST_LOCATORS = 8
# Components and routers that are remembered; a scene has hundreds at most.
_MOST = 4096


@dataclass(frozen=True)
class SceneStatus:
    """What `comotion status` shows; `problems` are lines for a person."""

    scene: str
    overall: Overall
    updates_hz: float | None
    update_lag_s: float | None
    components: list[ComponentRow]
    routers: list[RouterRow]
    problems: list[str]

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


@dataclass
class _Seen:
    status: Status | None = None
    arrived_s: float = float("-inf")
    present: bool = False
    tokens: set[str] = field(default_factory=set)
    clock: ClockBounds = field(default_factory=ClockBounds)

    @property
    def role(self) -> str:
        """The role of its token; what its Status says counts only without one, or among several."""
        said = "" if self.status is None else self.status.role
        return said if not self.tokens or said in self.tokens else min(self.tokens)


class StatusModel:
    """Accumulates what is heard of a scene. Times are seconds of this machine's wall clock."""

    def __init__(self, scene: str) -> None:
        self.scene = scene
        self._seen: dict[str, _Seen] = {}
        self._routers: dict[str, RouterRow] = {}
        self._arrivals: list[float] = []
        self._update: HypothesisUpdate | None = None

    @property
    def names(self) -> list[str]:
        """Names of the components whose Status has arrived."""
        return [name for name, seen in self._seen.items() if seen.status is not None]

    def on_status(self, status: Status, arrived_s: float) -> None:
        """Add a Status; one from a publisher's cache is older than its arrival tells."""
        seen = self._of(status.component)
        seen.status, seen.arrived_s = status, arrived_s
        seen.clock.on_stamp(status.stamp_ns / 1e9 - arrived_s)

    def on_presence(self, role: str, token: str, *, alive: bool) -> None:
        """Add a change of a liveliness token; `token` is its last chunk."""
        name = self._full_name(token_name(token)) if role == "service" else token
        if alive:
            seen = self._of(name)
            seen.tokens.add(role)
            seen.present = True
        elif name in self._seen:
            self._seen[name].present = False

    def on_update(self, update: HypothesisUpdate, arrived_s: float) -> None:
        """Add an update."""
        self._update = update
        self._arrivals.append(arrived_s)

    def on_answer(self, status: Status, sent_s: float, received_s: float) -> None:
        """Add the answer of a service to a query for its Status."""
        clock = self._of(status.component).clock
        clock.on_answer(status.stamp_ns / 1e9, sent_s, received_s)

    def on_cache_answer(self, name: str, trip_s: float) -> None:
        """Add the time until a publisher's cache has answered."""
        self._of(name).clock.on_trip(trip_s)

    def on_router(self, described: Mapping[str, Any]) -> None:
        """Add what a router says of itself; what is malformed is left out."""
        if len(self._routers) >= _MOST:
            return
        metadata = described.get("metadata")
        metadata = metadata if isinstance(metadata, dict) else {}
        sessions = described.get("sessions")
        sessions = [s for s in sessions if isinstance(s, dict)] if isinstance(sessions, list) else []
        zid, locators = _short(described.get("zid", "")), described.get("locators")
        self._routers[zid] = RouterRow(
            name=_short(metadata.get("name", "")),
            host=_short(metadata.get("host", "")),
            zid=zid,
            version=_short(described.get("version", "")).partition("-")[0],
            locators=[_short(one) for one in locators[:_MOST_LOCATORS]] if isinstance(locators, list) else [],
            sessions=sum(s.get("whatami") != "router" for s in sessions),
            routers=sum(s.get("whatami") == "router" for s in sessions),
            dials=dials if isinstance(dials := metadata.get("dials"), int) else 0,
        )

    def snapshot(self, now_s: float) -> SceneStatus:
        """Return what is known now."""
        rows = [self._row(name, seen, now_s) for name, seen in sorted(self._seen.items())]
        rows = [row for row in rows if row.present or row.age_s <= SILENT_S]
        rows.sort(key=lambda row: (_ORDER.get(row.role, len(_ORDER)), row.name))
        routers = sorted(self._routers.values(), key=lambda row: (row.name, row.zid))
        problems = find_problems(rows, routers) + _reported(self._newest_service())
        update = self._update
        return SceneStatus(
            scene=self.scene,
            overall=_overall(rows, problems),
            updates_hz=self._updates_hz(),
            update_lag_s=None if update is None else (update.published_ns - update.stamp_ns) / 1e9,
            components=rows,
            routers=routers,
            problems=problems,
        )

    def _of(self, name: str) -> _Seen:
        """What is known of a component; one too many is not remembered."""
        if len(self._seen) >= _MOST and name not in self._seen:
            return _Seen()
        return self._seen.setdefault(name, _Seen())

    def _full_name(self, short: str) -> str:
        known = (name for name, seen in self._seen.items() if seen.role == "service")
        return next((name for name in known if name[:TOKEN_NAME_CHARACTERS] == short), short)

    def _newest_service(self) -> Status | None:
        """Status of the service that speaks: of the highest epoch, and the newest."""
        found = [seen for seen in self._seen.values() if seen.status and seen.role == "service"]
        # Where services have tokens, who has none is no service.
        holding = [seen for seen in found if seen.tokens] or found
        speaking = [seen.status for seen in holding if seen.status and seen.status.replica != "standby"]
        return max(speaking, key=lambda status: (status.epoch, status.stamp_ns), default=None)

    def _updates_hz(self) -> float | None:
        # The first may come from the publisher's cache.
        arrivals = self._arrivals[1:]
        if len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return None
        return (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])

    def _row(self, name: str, seen: _Seen, now_s: float) -> ComponentRow:
        status, service = seen.status, self._newest_service()
        clock, error = self._clock(name, seen, service)
        lag = None
        if service is not None and seen.role == "source":
            lag = service.ages.get(name)
        return ComponentRow(
            role=seen.role,
            name=name,
            state="silent" if status is None or now_s - seen.arrived_s > SILENT_S else status.state,
            host="" if status is None else _short(status.host),
            version="" if status is None else _short(status.version),
            # A process that is killed loses its token at once; its last Status stays in this model.
            present=seen.present,
            age_s=now_s - seen.arrived_s,
            rate_hz=_rate(name, seen, service, self._updates_hz()),
            lag_s=lag,
            lost=0 if status is None else status.counters.get("lost", 0),
            clock_s=clock,
            clock_error_s=error,
            replica="" if status is None else status.replica,
            epoch=0 if status is None else status.epoch,
            message="" if status is None else shown(status.message, _MOST_TEXT),
        )

    def _clock(self, name: str, seen: _Seen, service: Status | None) -> tuple[float | None, float | None]:
        own = seen.clock.estimate()
        if own is None:
            return None, None
        reference = None if service is None else self._seen[service.component].clock.estimate()
        if reference is None:
            return own
        if service is not None and service.component == name:
            return 0.0, 0.0
        return own[0] - reference[0], own[1] + reference[1]


_ORDER = {"service": 0, "source": 1, "recorder": 2, "viewer": 3}


def _rate(name: str, seen: _Seen, service: Status | None, updates_hz: float | None) -> float | None:
    if seen.role == "service":
        return updates_hz if service is not None and service.component == name else None
    if seen.role != "source":
        return None
    received = None if service is None else service.rates.get(name)
    own = None if seen.status is None else seen.status.rates.get("obs")
    return own if received is None else received


def _reported(service: Status | None) -> list[str]:
    """What the service itself says that a person should change."""
    return [] if service is None else [shown(problem.text, _MOST_TEXT) for problem in service.problems]


def _short(value: object) -> str:
    return shown(str(value), _MOST_CHARACTERS)


def _overall(rows: list[ComponentRow], problems: list[str]) -> Overall:
    speaking = [row for row in rows if row.role == "service" and row.replica != "standby"]
    if not speaking or all(row.state in {"stalled", "silent"} for row in speaking):
        return "stalled"
    return "degraded" if problems else "ok"
