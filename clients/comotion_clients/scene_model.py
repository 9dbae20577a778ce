"""Scene model: messages of one scene -> snapshot of its sources, service, hypotheses and events. Pure.

The caller passes the time: `now` and `arrived` are seconds of one monotonic clock, `wall_ns` is the wall
clock in nanoseconds.
"""

import math
from collections import deque
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from comotion_schemas import UNDETERMINED, Event, Hypothesis, HypothesisUpdate, ObservationBatch, Status
from comotion_schemas.colours import Palette
from comotion_schemas.hypotheses import OF_BODIES, EventKind
from comotion_schemas.keys import TOKEN_NAME_CHARACTERS, token_name
from comotion_schemas.naming import Names, named
from comotion_schemas.sequence import SequenceCounter
from comotion_schemas.text import shown

from .feature_names import HypothesisNames
from .joint_rows import joint_row
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

RATE_SPAN_S = 3.0
"""A rate is the mean over this time."""
RATE_MIN_SPAN_S = 0.5
"""Without arrivals over this time the rate is unknown: the first messages may come in a burst."""
STALL_S = 1.0
"""A stream is stalled after this time or :data:`STALL_PERIODS` periods, whichever is longer."""
STALL_PERIODS = 3
LOSS_SHOWN_S = 10.0
"""How long a loss is highlighted."""
GONE_SHOWN_S = 60.0
"""How long a source that has left remains in the list."""
EVENTS_KEPT = 100
_MOST_SOURCES = 4096
# Bounds on what texts of one component may take of a screen.
_MOST_CHARACTERS, _MOST_TEXT = 80, 500


@dataclass
class Stream:
    """Arrivals of one publisher: rate, age and number of lost messages."""

    lost: int = 0
    lost_at: float = -np.inf
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
class _Source:
    stream: Stream = field(default_factory=Stream)
    space: str = ""
    lag: float = float("nan")
    gone_at: float | None = None

    def age(self, now: float, reported: float) -> float:
        """Seconds since the last batch; `reported` by the service if none was received here."""
        return self.stream.age(now) if self.stream.arrivals else reported


class SceneModel:
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
        self.scene = scene
        self._kinds = frozenset(get_args(EventKind)) if all_events else OF_BODIES
        self.names = HypothesisNames(names)
        self.palette = Palette()
        self._sources: dict[str, _Source] = {}
        self._units: dict[str, str] = {}
        self._updates = Stream()
        self._sequences = SequenceCounter()
        self._update: HypothesisUpdate | None = None
        self._service: Status | None = None
        self._services: set[str] = set()
        self._service_gone = False
        self._events: dict[tuple[int, str, int], Event] = {}

    @property
    def seen(self) -> bool:
        """Whether any message of the scene was received."""
        return bool(self._sources) or self._update is not None or self._service is not None

    @property
    def update(self) -> HypothesisUpdate | None:
        """The newest update."""
        return self._update

    def on_batch(self, batch: ObservationBatch, arrived: float, wall_ns: int) -> None:
        """Add a batch of a source."""
        source = self._source(batch.source)
        lost = self._sequences.sight(f"obs/{batch.source}", batch.session, batch.seq).lost
        source.stream.arrive(lost, arrived)
        source.space, source.gone_at = shown(batch.space, _MOST_CHARACTERS), None
        source.lag = (wall_ns - batch.stamp_ns) / 1e9
        self._units[batch.space] = batch.unit

    def on_update(self, update: HypothesisUpdate, arrived: float) -> list[Event]:
        """Add an update; returns the events that no earlier update had."""
        lost = self._sequences.sight("hypotheses", update.session, update.seq).lost
        self._updates.arrive(lost, arrived)
        self._update, self._service_gone = update, False
        self.names.on_update(update)
        self.palette.see(update.hypotheses)
        told = [e for e in update.events if e.kind in self._kinds]
        new = [e for e in told if (e.stamp_ns, e.kind, e.hypothesis) not in self._events]
        self._events.update({(e.stamp_ns, e.kind, e.hypothesis): e for e in new})
        for key in list(self._events)[:-EVENTS_KEPT]:
            del self._events[key]
        return new

    def on_status(self, status: Status) -> None:
        """Add a Status; the one of the service that speaks also names sources that sent nothing yet.

        Where services have tokens, who has none is no service.
        """
        self.names.on_status(status)
        short = status.component[:TOKEN_NAME_CHARACTERS]
        holds = any(token in (status.component, short) for token in map(token_name, self._services))
        if status.role == "service" and status.replica != "standby" and (holds or not self._services):
            self._service = status
            for name in status.ages:
                self._source(name)

    def on_presence(self, role: str, name: str, *, alive: bool, now: float) -> None:
        """Process that a component entered or left the scene."""
        if role == "service":
            (self._services.add if alive else self._services.discard)(name)
            self._service_gone = not self._services
        elif role == "source":
            if alive:
                self._source(name).gone_at = None
            elif name in self._sources:
                self._sources[name].gone_at = now

    def _source(self, name: str) -> _Source:
        """What is known of a source; one too many is not remembered."""
        if len(self._sources) >= _MOST_SOURCES and name not in self._sources:
            return _Source()
        return self._sources.setdefault(name, _Source())

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
        status, update = self._service, self._update
        return ServiceRow(
            state=self._service_state(now),
            rate=self._updates.rate(now),
            age=self._updates.age(now),
            lag=float("nan") if update is None else (update.published_ns - update.stamp_ns) / 1e9,
            lost=self._updates.lost,
            losing=self._updates.losing(now),
            seq=-1 if update is None else update.seq,
            message="" if status is None else shown(status.message, _MOST_TEXT),
            counters={} if status is None else dict(status.counters),
            rejected={} if status is None else {str(k): v for k, v in status.rejected.items()},
            problems=[]
            if status is None
            else [ProblemRow(one.kind, one.source, shown(one.text, _MOST_TEXT)) for one in status.problems],
        )

    def _service_state(self, now: float) -> ServiceState:
        if self._service_gone or (self._update is None and self._service is None):
            return "absent"
        if self._update is None or self._updates.stalled(now):
            return "silent"
        return "ok" if self._service is None else self._service.state

    def _source_rows(self, now: float) -> list[SourceRow]:
        tracks = self._tracks_per_source()
        reported = {} if self._service is None else self._service.ages
        clocks = {} if self._service is None else self._service.clock_offsets
        rows = []
        for name, source in sorted(self._sources.items()):
            age = source.age(now, reported.get(name, float("inf")))
            if source.gone_at is not None and now - source.gone_at > GONE_SHOWN_S:
                del self._sources[name]
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
                    space=shown(h.space, _MOST_CHARACTERS),
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
        newest_first = sorted(self._events.values(), key=lambda e: e.stamp_ns, reverse=True)
        return [
            EventRow(
                e.stamp_ns,
                (update.stamp_ns - e.stamp_ns) / 1e9,
                e.kind,
                e.hypothesis,
                list(e.others),
                {one: self.names[one] for one in (e.hypothesis, *e.others) if one in self.names},
            )
            for e in newest_first
        ]


def _usual_unit(hypothesis: Hypothesis) -> str:
    """Unit of a space of which no batch has been received: px in 2-D."""
    return "px" if len(hypothesis.centroid) == 2 else "m"


def _rotation_vector(rotation: list[float] | float) -> list[float]:
    """Rotation vector [3] in rad of a quaternion (x, y, z, w); an angle is [1]."""
    if not isinstance(rotation, list):
        return [rotation]
    axis, w = np.array(rotation[:3]), rotation[3]
    sine = float(np.linalg.norm(axis))
    # Of the two turns that a quaternion stands for, the one of at most half a circle.
    angle = 2 * math.atan2(sine, abs(w)) * (1 if w >= 0 else -1)
    return [0.0] * 3 if sine == 0 else (axis * (angle / sine)).tolist()


def _source_state(source: _Source, age: float, now: float) -> SourceState:
    if source.gone_at is not None:
        return "gone"
    if not source.stream.arrivals:
        return "stalled" if math.isfinite(age) else "silent"
    return "stalled" if source.stream.stalled(now) else "ok"
