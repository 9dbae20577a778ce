"""What the messages of one scene say of its state now, for `comotion watch`, `view` and `status`. Pure.

Times are as in :mod:`.scene_records`.
"""

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from comotion_schemas import UNDETERMINED, Hypothesis, HypothesisUpdate, Status
from comotion_schemas.naming import event_words, named
from comotion_schemas.rigid import rotation

from .bodies import joint_row
from .scene_records import ComponentRecord, SceneRecords, in_cell, in_line
from .scene_rows import (
    ComponentRow,
    EventRow,
    HypothesisRow,
    SceneStatus,
    ServiceRow,
    ServiceState,
    Snapshot,
    SourceRow,
    SourceState,
    find_problems,
    overall,
)

GONE_SHOWN_S = 60.0
"""How long a source that has left remains in the list."""
EVENTS_SHOWN = 100
"""Newest events of a snapshot."""
SILENT_S = 3.5
"""A component whose newest Status is older is silent: it sends one a second."""
_ORDER = {"service": 0, "source": 1, "recorder": 2, "viewer": 3}


class SceneModel(SceneRecords):
    """Accumulates the messages of one scene, and summarises its state."""

    def snapshot(self, now: float) -> Snapshot:
        """Build the snapshot at the time `now`."""
        update = self.update
        labels = np.zeros(0, np.uint32) if update is None else update.track_hypothesis
        return Snapshot(
            scene=self.scene,
            stamp_ns=0 if update is None else update.stamp_ns,
            service=self._service_row(now),
            tracks=len(labels),
            undetermined=int(np.count_nonzero(labels == UNDETERMINED)),
            sources=self._source_rows(now),
            hypotheses=[] if update is None else [self._hypothesis_row(update, h) for h in update.hypotheses],
            events=[] if update is None else self._event_rows(update),
            joints=[] if update is None else [joint_row(joint, self.names) for joint in update.joints],
        )

    def status(self, now_s: float) -> SceneStatus:
        """Return who is there now, and what a person should look at."""
        service = self.service
        rows = [self._component_row(name, now_s, service) for name in sorted(self.components)]
        rows = [row for row in rows if row.present or row.age_s <= SILENT_S]
        rows.sort(key=lambda row: (_ORDER.get(row.role, len(_ORDER)), row.name))
        routers = sorted(self.routers.values(), key=lambda row: (row.name, row.zid))
        reported = [] if service is None else [in_line(problem.text) for problem in service.problems]
        problems = find_problems(rows, routers) + reported
        update = self.update
        return SceneStatus(
            scene=self.scene,
            overall=overall(rows, problems),
            updates_hz=self._updates_hz(),
            update_lag_s=None if update is None else _lag(update),
            components=rows,
            routers=routers,
            problems=problems,
        )

    def _service_row(self, now: float) -> ServiceRow:
        status, update, updates = self.service, self.update, self.updates
        problems = [] if status is None else status.problems
        return ServiceRow(
            state=self._service_state(now),
            rate=updates.rate(now),
            age=updates.age(now),
            lag=math.nan if update is None else _lag(update),
            lost=updates.lost,
            losing=updates.losing(now),
            seq=-1 if update is None else update.seq,
            message="" if status is None else in_line(status.message),
            counters={} if status is None else dict(status.counters),
            rejected={} if status is None else {str(k): v for k, v in status.rejected.items()},
            problems=[replace(problem, text=in_line(problem.text)) for problem in problems],
        )

    def _service_state(self, now: float) -> ServiceState:
        service = self.service
        if self.service_gone or (self.update is None and service is None):
            return "absent"
        if self.update is None or self.updates.stalled(now):
            return "silent"
        return "ok" if service is None else service.state

    def _source_rows(self, now: float) -> list[SourceRow]:
        update, service = self.update, self.service
        listed = [] if update is None else [update.sources[k].name for k in update.track_source.tolist()]
        tracks = Counter(listed)
        reported = {} if service is None else service.ages
        clocks = {} if service is None else service.clock_offsets
        rows = []
        for name, source in self.sources().items():
            stream = source.stream
            age = stream.age(now) if stream.arrivals else reported.get(name, math.inf)
            if source.gone_at is not None and now - source.gone_at > GONE_SHOWN_S:
                del self.components[name]
                continue
            rows.append(
                SourceRow(
                    name=name,
                    state=_source_state(source, age, now),
                    rate=0.0 if source.gone_at is not None else stream.rate(now),
                    age=age,
                    lag=source.lag,
                    lost=stream.lost,
                    losing=stream.losing(now),
                    tracks=tracks[name],
                    space=source.space,
                    clock=clocks.get(name),
                )
            )
        return rows

    def _hypothesis_row(self, update: HypothesisUpdate, h: Hypothesis) -> HypothesisRow:
        twist, pose, box = h.twist, h.pose, h.box
        members = update.track_confidence[update.track_hypothesis == h.id]
        return HypothesisRow(
            id=h.id,
            space=in_cell(h.space),
            # Of a space of which no batch has been received: px in 2-D.
            unit=self.units.get(h.space) or ("px" if len(h.centroid) == 2 else "m"),
            state=h.state,
            size=h.size,
            age=(update.stamp_ns - h.born_ns) / 1e9,
            confidence=float(members.mean()) if len(members) else math.nan,
            speed=None if twist is None else float(np.linalg.norm(twist.linear)),
            linked=list(h.linked or ()),
            confirmed=h.confirmed,
            absent=bool(h.absent),
            colour=self.palette.colour(h.id),
            turning=None if twist is None else float(np.linalg.norm(twist.angular)),
            translation=None if pose is None else list(pose.translation),
            rotation=None if pose is None else _rotation_vector(pose.rotation),
            name=named(h.id, self.names),
            extent=None if box is None else [2 * half for half in box.half],
        )

    def _event_rows(self, update: HypothesisUpdate) -> list[EventRow]:
        newest_first = sorted(self.events.values(), key=lambda e: e.stamp_ns, reverse=True)[:EVENTS_SHOWN]
        return [
            EventRow(
                **vars(e),
                ago=(update.stamp_ns - e.stamp_ns) / 1e9,
                names={k: self.names[k] for k in (e.hypothesis, *e.others) if k in self.names},
                words=event_words(e, self.names),
            )
            for e in newest_first
        ]

    def _component_row(self, name: str, now_s: float, service: Status | None) -> ComponentRow:
        record = self.components[name]
        status, source = record.status, record.role == "source"
        clock, error = self._clock(name, service)
        return ComponentRow(
            role=record.role,
            name=name,
            state="silent" if status is None or now_s - record.arrived > SILENT_S else status.state,
            host="" if status is None else in_cell(status.host),
            version="" if status is None else in_cell(status.version),
            # A process that is killed loses its token at once; its last Status stays in this model.
            present=record.present,
            age_s=now_s - record.arrived,
            rate_hz=self._rate(name, service),
            lag_s=service.ages.get(name) if service is not None and source else None,
            lost=0 if status is None else status.counters.get("lost", 0),
            clock_s=clock,
            clock_error_s=error,
            replica="" if status is None else status.replica,
            epoch=0 if status is None else status.epoch,
            message="" if status is None else in_line(status.message),
        )

    def _rate(self, name: str, service: Status | None) -> float | None:
        """Rate of the service's updates, or of a source: as the service receives it, or as it says itself."""
        record = self.components[name]
        if record.role == "service":
            return self._updates_hz() if service is not None and service.component == name else None
        if record.role != "source":
            return None
        received = None if service is None else service.rates.get(name)
        own = None if record.status is None else record.status.rates.get("obs")
        return own if received is None else received

    def _updates_hz(self) -> float | None:
        # The first may come from the publisher's cache.
        arrivals = list(self.updates.arrivals)[1:]
        if len(arrivals) < 2 or arrivals[-1] <= arrivals[0]:
            return None
        return (len(arrivals) - 1) / (arrivals[-1] - arrivals[0])

    def _clock(self, name: str, service: Status | None) -> tuple[float | None, float | None]:
        """How far a clock is ahead of the service's, or of ours without one, and the bound of the error."""
        own = self.components[name].clock.estimate()
        if own is None:
            return None, None
        reference = None if service is None else self.components[service.component].clock.estimate()
        if service is None or reference is None:
            return own
        if service.component == name:
            return 0.0, 0.0
        return own[0] - reference[0], own[1] + reference[1]


def _lag(update: HypothesisUpdate) -> float:
    return (update.published_ns - update.stamp_ns) / 1e9


def _rotation_vector(turn: list[float] | float) -> list[float]:
    """Rotation vector [3] in rad of a quaternion (x, y, z, w); an angle is [1]."""
    return rotation(turn).as_rotvec().tolist() if isinstance(turn, list) else [turn]


def _source_state(source: ComponentRecord, age: float, now: float) -> SourceState:
    if source.gone_at is not None:
        return "gone"
    if not source.stream.arrivals:
        if not math.isfinite(age):
            return "silent"
        return "stalled" if source.present else "gone"  # before this client came
    return "stalled" if source.stream.stalled(now) else "ok"
