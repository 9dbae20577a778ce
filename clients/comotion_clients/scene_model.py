"""Scene model: messages of one scene -> snapshot of its sources, service, hypotheses and events. Pure.

The caller passes the time: `now` and `arrived` are seconds of one monotonic clock, `wall_ns` is the wall
clock in nanoseconds.
"""

import math
from typing import get_args

import numpy as np

from comotion_schemas import (
    UNDETERMINED,
    Event,
    Hypothesis,
    HypothesisUpdate,
    Message,
    ObservationBatch,
    Status,
)
from comotion_schemas.colours import Palette
from comotion_schemas.hypotheses import OF_BODIES, EventKind
from comotion_schemas.naming import Names, event_words, named
from comotion_schemas.rigid import rotation

from .feature_names import HypothesisNames
from .joint_rows import joint_row
from .scene_components import ComponentRecord, ComponentsModel, in_cell, in_line
from .scene_rows import (
    EventRow,
    HypothesisRow,
    ProblemRow,
    ServiceRow,
    ServiceState,
    Snapshot,
    SourceRow,
    SourceState,
)

GONE_SHOWN_S = 60.0
"""How long a source that has left remains in the list."""
EVENTS_SHOWN, EVENTS_KEPT = 100, 4096
"""Newest events of a snapshot, and those that are known again when a later update repeats them."""


class SceneModel(ComponentsModel):
    """Accumulates the messages of one scene.

    Parameters
    ----------
    scene
        Name of the scene.
    names
        Names of hypotheses by id, as people give them; :attr:`names` holds those of sources too.
    all_events
        Whether events of joints are told beside those of bodies.
    """

    def __init__(self, scene: str, names: Names | None = None, *, all_events: bool = False) -> None:
        super().__init__(scene)
        self._kinds = frozenset(get_args(EventKind)) if all_events else OF_BODIES
        self.names = HypothesisNames(names)
        self.palette = Palette()
        self._units: dict[str, str] = {}
        self._service_gone = False
        self._events: dict[tuple[int, str, int], Event] = {}

    @property
    def seen(self) -> bool:
        """Whether any message of the scene was received."""
        return self._update is not None or self.service is not None or bool(self._sources())

    def on_message(self, message: Message, arrived: float, wall_ns: int) -> list[Event]:
        """Add a message of any kind; returns the events that no earlier update had."""
        if isinstance(message, ObservationBatch):
            self.on_batch(message, arrived, wall_ns)
        return super().on_message(message, arrived, wall_ns)

    def on_batch(self, batch: ObservationBatch, arrived: float, wall_ns: int) -> None:
        """Add a batch of a source."""
        source = self._record(batch.source)
        source.stream.arrive(self._sequences.sight(batch.source, batch.session, batch.seq).lost, arrived)
        source.space, source.gone_at = in_cell(batch.space), None
        source.lag = (wall_ns - batch.stamp_ns) / 1e9
        self._units[batch.space] = batch.unit

    def on_update(self, update: HypothesisUpdate, arrived: float) -> list[Event]:
        """Add an update; returns the events that no earlier update had."""
        super().on_update(update, arrived)
        self._service_gone = False
        self.names.on_update(update)
        self.palette.see(update.hypotheses)
        shown = [e for e in update.events if e.kind in self._kinds]
        new = [e for e in shown if (e.stamp_ns, e.kind, e.hypothesis) not in self._events]
        self._events.update({(e.stamp_ns, e.kind, e.hypothesis): e for e in new})
        for key in list(self._events)[:-EVENTS_KEPT]:
            del self._events[key]
        return new

    def on_status(self, status: Status, arrived: float = 0.0, wall_s: float = math.nan) -> None:
        """Add a Status, which may name the features of a source."""
        super().on_status(status, arrived, wall_s)
        self.names.on_status(status)

    def on_presence(self, role: str, token: str, *, alive: bool, now: float = 0.0) -> None:
        """Process that a component entered or left the scene."""
        super().on_presence(role, token, alive=alive, now=now)
        if role == "service":
            held = any(record.present for record in self._components.values() if "service" in record.tokens)
            self._service_gone = not held

    def _sources(self) -> dict[str, ComponentRecord]:
        """Sources that have a token or have sent something, and those that the service knows."""
        named = self.service.ages if self.service is not None else {}
        own = {n: s for n, s in self._components.items() if "source" in s.tokens or s.stream.arrivals}
        return {name: self._components.get(name) or ComponentRecord() for name in sorted({*own, *named})}

    def snapshot(self, now: float) -> Snapshot:
        """Build the snapshot at the time `now`."""
        update = self._update
        labels = np.zeros(0, np.uint32) if update is None else update.track_hypothesis
        return Snapshot(
            scene=self.scene,
            stamp_ns=0 if update is None else update.stamp_ns,
            service=self._service_row(now),
            tracks=len(labels),
            undetermined=int(np.count_nonzero(labels == UNDETERMINED)),
            sources=self._source_rows(now),
            hypotheses=[] if update is None else self._hypothesis_rows(update),
            events=[] if update is None else self._event_rows(update),
            joints=[] if update is None else [joint_row(joint, self.names) for joint in update.joints],
        )

    def _service_row(self, now: float) -> ServiceRow:
        status, update = self.service, self._update
        return ServiceRow(
            state=self._service_state(now),
            rate=self._updates.rate(now),
            age=self._updates.age(now),
            lag=float("nan") if update is None else (update.published_ns - update.stamp_ns) / 1e9,
            lost=self._updates.lost,
            losing=self._updates.losing(now),
            seq=-1 if update is None else update.seq,
            message="" if status is None else in_line(status.message),
            counters={} if status is None else dict(status.counters),
            rejected={} if status is None else {str(k): v for k, v in status.rejected.items()},
            problems=[]
            if status is None
            else [
                ProblemRow(problem.kind, problem.source, in_line(problem.text)) for problem in status.problems
            ],
        )

    def _service_state(self, now: float) -> ServiceState:
        service = self.service
        if self._service_gone or (self._update is None and service is None):
            return "absent"
        if self._update is None or self._updates.stalled(now):
            return "silent"
        return "ok" if service is None else service.state

    def _source_rows(self, now: float) -> list[SourceRow]:
        tracks = self._tracks_per_source()
        service = self.service
        reported = {} if service is None else service.ages
        clocks = {} if service is None else service.clock_offsets
        rows = []
        for name, source in self._sources().items():
            age = source.stream.age(now) if source.stream.arrivals else reported.get(name, math.inf)
            if source.gone_at is not None and now - source.gone_at > GONE_SHOWN_S:
                del self._components[name]
                continue
            rows.append(
                SourceRow(
                    name=name,
                    state=_source_state(source, age, now),
                    rate=0.0 if source.gone_at is not None else source.stream.rate(now),
                    age=age,
                    lag=source.lag,
                    lost=source.stream.lost,
                    losing=source.stream.losing(now),
                    tracks=tracks.get(name, 0),
                    space=source.space,
                    clock=clocks.get(name),
                )
            )
        return rows

    def _tracks_per_source(self) -> dict[str, int]:
        update = self._update
        if update is None:
            return {}
        counts = np.bincount(update.track_source, minlength=len(update.sources)).tolist()
        tracks: dict[str, int] = {}
        for source, count in zip(update.sources, counts, strict=True):
            tracks[source.name] = tracks.get(source.name, 0) + count
        return tracks

    def _hypothesis_rows(self, update: HypothesisUpdate) -> list[HypothesisRow]:
        rows = []
        for h in update.hypotheses:
            twist, pose, box = h.twist, h.pose, h.box
            members = update.track_confidence[update.track_hypothesis == h.id]
            rows.append(
                HypothesisRow(
                    id=h.id,
                    space=in_cell(h.space),
                    unit=self._units.get(h.space) or _usual_unit(h),
                    state=h.state,
                    size=h.size,
                    age=(update.stamp_ns - h.born_ns) / 1e9,
                    confidence=float(members.mean()) if len(members) else float("nan"),
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
            )
        return rows

    def _event_rows(self, update: HypothesisUpdate) -> list[EventRow]:
        newest_first = sorted(self._events.values(), key=lambda e: e.stamp_ns, reverse=True)[:EVENTS_SHOWN]
        return [
            EventRow(
                e.stamp_ns,
                (update.stamp_ns - e.stamp_ns) / 1e9,
                e.kind,
                e.hypothesis,
                list(e.others),
                {number: self.names[number] for number in (e.hypothesis, *e.others) if number in self.names},
                event_words(e, self.names),
            )
            for e in newest_first
        ]


def _usual_unit(hypothesis: Hypothesis) -> str:
    """Unit of a space of which no batch has been received: px in 2-D."""
    return "px" if len(hypothesis.centroid) == 2 else "m"


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
