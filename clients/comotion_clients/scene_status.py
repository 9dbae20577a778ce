"""Models what an operator wants to know of a scene. Pure.

Clocks are compared by the stamps of Statuses and the round trips of queries: those that a service answers
with its clock, and those that the cache of every component's publisher answers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from comotion_schemas import Status

from .scene_components import MOST, ComponentRecord, ComponentsModel, in_cell, in_line
from .scene_problems import ComponentRow, RouterRow, find_problems

Overall = Literal["ok", "degraded", "stalled"]
SILENT_S = 3.5
"""A component whose newest Status is older is silent: it sends one a second."""
_MOST_LOCATORS = 8


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


class StatusModel(ComponentsModel):
    """Accumulates what is heard of a scene. Times are seconds of this machine's wall clock."""

    def __init__(self, scene: str) -> None:
        super().__init__(scene)
        self._routers: dict[str, RouterRow] = {}

    @property
    def names(self) -> list[str]:
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

    def snapshot(self, now_s: float) -> SceneStatus:
        """Return what is known now."""
        rows = [self._row(name, record, now_s) for name, record in sorted(self._components.items())]
        rows = [row for row in rows if row.present or row.age_s <= SILENT_S]
        rows.sort(key=lambda row: (_ORDER.get(row.role, len(_ORDER)), row.name))
        routers = sorted(self._routers.values(), key=lambda row: (row.name, row.zid))
        problems = find_problems(rows, routers) + _reported(self.service)
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


def _overall(rows: list[ComponentRow], problems: list[str]) -> Overall:
    speaking = [row for row in rows if row.role == "service" and row.replica != "standby"]
    if not speaking or all(row.state in {"stalled", "silent"} for row in speaking):
        return "stalled"
    return "degraded" if problems else "ok"
