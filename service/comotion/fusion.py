"""The face of the core: batches in, hypothesis updates out. No clock, no I/O, deterministic.

    batch -> timeline (event-time merge, watermark) -> window -> method -> hypotheses -> HypothesisUpdate

The caller owns the period and the clock: it hands in batches as they come, and asks for an update
with the time it holds to be now.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import UNDETERMINED, Event, HypothesisUpdate, Keys, ObservationBatch, SourceRef

from . import snapshot
from .config import FusionConfig, to_ns
from .event_time.health import SourceHealth, source_health
from .event_time.stats import Stats
from .event_time.timeline import Instant, Timeline
from .hypotheses.identity import IdAllocator
from .linking.linker import Linker, SpaceView
from .methods import make_method
from .partition import SpaceSpec
from .rigid.method import RigidMethod
from .space import MAX_COORDINATE, Space, SpaceUpdate

EVENT_MEMORY_NS = 2_000_000_000
MAX_SPACES = 256

TrackKey = tuple[str, str, int]


@dataclass(frozen=True)
class AffinitySnapshot:
    """Affinities of one space at the last update.

    `tracks` names the rows as (source, session, id); `matrix` is float32 [N, N] in 0..1.
    """

    tracks: list[TrackKey]
    matrix: NDArray[np.float32]


class Fusion:
    """Fuses observation batches of any number of sources into hypotheses of rigid bodies.

    Parameters
    ----------
    config
        Parameters; the defaults when None.
    scene
        Name of the scene, ``[a-z0-9_-]{1,64}``.
    session
        16 hex digits that name this run of the service.

    Raises
    ------
    ValueError
        If the scene is no valid name.
    """

    def __init__(
        self, config: FusionConfig | None = None, scene: str = "default", session: str = "0" * 16
    ) -> None:
        self.config = FusionConfig() if config is None else config
        self.scene = Keys(scene).scene
        self.session = session
        self.stats = Stats()
        self.spaces: dict[str, Space] = {}
        self.timeline = Timeline(self.config, self.stats)
        self.ids = IdAllocator()
        self.linker = Linker(self.config.linking.cameras)
        self.events: deque[Event] = deque()
        # (source, session) -> the index by which the windows know it.
        self.sessions: dict[tuple[str, str], int] = {}
        self.next_session = 0
        self._seq = 0

    def ingest(self, batch: ObservationBatch) -> None:
        """Take in a batch, in any order across sources. Raises nothing; counts what it drops."""
        self.stats.batches += 1
        if not self.timeline.is_new(batch):
            return
        space = self.spaces.get(batch.space)
        if space is not None and not space.spec.suits(batch):
            self.stats.reject("space-mismatch")
        elif np.abs(batch.positions).max(initial=0.0) > MAX_COORDINATE:
            self.stats.reject("range")
        else:
            self.timeline.add(batch)

    def advance(self, now_ns: int) -> None:
        """Fuse what the watermark has passed; calling it between updates spreads their work."""
        for instant in self.timeline.advance(now_ns):
            self._fuse(instant)

    def update(self, now_ns: int) -> HypothesisUpdate:
        """Fuse what the watermark has passed and partition every current trajectory.

        Parameters
        ----------
        now_ns
            The caller's clock, nanoseconds since the Unix epoch.
        """
        self.advance(now_ns)
        watermark = self.timeline.watermark_ns
        # Nothing has set a watermark yet: report its lower bound, so that stamps stay monotonic.
        stamp = now_ns - to_ns(self.config.max_lag) if watermark is None else watermark
        updates = [space.update(stamp, self._track_timeout_ns) for _, space in sorted(self.spaces.items())]
        self._remember(stamp, [event for update in updates for event in update.events])
        self._drop_idle_sessions()
        self.stats.updates += 1
        return self.linker.linked(self._assemble(now_ns, stamp, updates), [_view(one) for one in updates])

    def affinity(self, space: str) -> AffinitySnapshot:
        """Affinities of a space as of the last update.

        Raises
        ------
        KeyError
            If no source has published in that space.
        """
        found = self.spaces[space]
        names = {index: key for key, index in self.sessions.items()}
        owners = found.window.source[found.current].tolist()
        ids = found.ids[found.current].tolist()
        tracks = [(*names[owner], track) for owner, track in zip(owners, ids, strict=True)]
        return AffinitySnapshot(tracks, found.method.affinity())

    def sources(self, now_ns: int) -> list[SourceHealth]:
        """Health of every source: its session, age and whether it holds the watermark."""
        return source_health(self.timeline, now_ns)

    def snapshot(self, *, clean: bool = False) -> bytes:
        """Everything that must survive a restart: identities, windows and the watermark.

        `clean` says that no update follows: ids may then continue without a gap.
        """
        return snapshot.dump(self, clean=clean)

    @classmethod
    def restore(cls, config: FusionConfig, data: bytes, *, session: str | None = None) -> Self:
        """Continue from :meth:`snapshot`, under a new `session` if given.

        Raises
        ------
        ValueError
            If `data` is no snapshot of this version.
        """
        return snapshot.load(cls, config, data, session)

    def _space_of(self, instant: Instant) -> Space | None:
        """Space of an instant; the first batch that is fused defines it, none that was refused."""
        batch = instant.batch
        space = self.spaces.get(batch.space)
        if space is None and len(self.spaces) < MAX_SPACES:
            return self.open_space(SpaceSpec(batch.space, batch.unit, batch.dim))
        if space is not None and space.spec.suits(batch):
            return space
        if instant.last:
            self.stats.reject("limit" if space is None else "space-mismatch")
        return None

    def open_space(self, spec: SpaceSpec) -> Space:
        """Start a coordinate space."""
        space = Space(self.config, spec, make_method, self.ids, self.stats)
        self.spaces[spec.name] = space
        return space

    def _fuse(self, instant: Instant) -> None:
        batch = instant.batch
        space = self._space_of(instant)
        if space is None:
            return
        key = (batch.source, batch.session)
        if key not in self.sessions:
            self._enter_session(batch)
        index = self.sessions[key]
        room = self.config.max_tracks - sum(space.occupied() for space in self.spaces.values())
        space.store(instant, index, max(room, 0))
        if instant.last and batch.ended is not None:
            space.end(batch.ended, index)

    def _enter_session(self, batch: ObservationBatch) -> None:
        """A new session ends the trajectories of the one before."""
        for (source, _), index in self.sessions.items():
            if source == batch.source:
                for space in self.spaces.values():
                    space.end_source(index)
        self.sessions[batch.source, batch.session] = self.next_session
        self.next_session += 1

    def _track_timeout_ns(self, session: int) -> int:
        source = next(name for (name, _), index in self.sessions.items() if index == session)
        return self.timeline.track_timeout_ns(source)

    def _drop_idle_sessions(self) -> None:
        used = set().union(*(space.sources_in_use() for space in self.spaces.values()))
        current = {(name, clock.session) for name, clock in self.timeline.sources.items()}
        self.sessions = {k: i for k, i in self.sessions.items() if i in used or k in current}

    def _remember(self, stamp_ns: int, events: Sequence[Event]) -> None:
        self.events.extend(events)
        while self.events and self.events[0].stamp_ns < stamp_ns - EVENT_MEMORY_NS:
            self.events.popleft()

    def _assemble(self, now_ns: int, stamp_ns: int, updates: list[SpaceUpdate]) -> HypothesisUpdate:
        spaces = [one.space for one in updates]
        owners = np.concatenate([s.window.source[s.current] for s in spaces] or [np.zeros(0, np.intp)])
        used, track_source = np.unique(owners, return_inverse=True)
        names = {index: key for key, index in self.sessions.items()}
        labels = np.concatenate([one.labels for one in updates] or [np.zeros(0, np.int64)])
        ids = [s.ids[s.current] for s in spaces]
        confidence = np.concatenate([one.confidence for one in updates] or [np.zeros(0)])
        self._seq += 1
        return HypothesisUpdate(
            scene=self.scene,
            session=self.session,
            seq=self._seq - 1,
            stamp_ns=stamp_ns,
            published_ns=now_ns,
            period_ns=to_ns(self.config.period),
            sources=[SourceRef(name=names[i][0], session=names[i][1]) for i in used.tolist()],
            track_source=track_source.astype(np.uint16),
            track_id=np.concatenate(ids or [np.zeros(0, np.uint64)]),
            track_hypothesis=np.where(labels < 0, UNDETERMINED, labels).astype(np.uint32),
            track_confidence=np.clip(confidence, 0.0, 1.0).astype(np.float32),
            track_position=np.concatenate([_newest(s) for s in spaces] or [np.zeros((0, 3))]).astype(
                np.float32
            ),
            hypotheses=[h for one in updates for h in one.hypotheses],
            events=list(self.events),
        )


def _newest(space: Space) -> NDArray[np.float64]:
    """Newest fused state of the current trajectories [n, 3]; the third column is NaN in 2-D."""
    window, slots = space.window, space.current
    positions = np.full((len(slots), 3), np.nan)
    if len(slots):
        positions[:, : window.dim] = window.positions[slots, window.stop[slots] - 1]
    return positions


def _view(update: SpaceUpdate) -> SpaceView:
    """What the linker sees of a space."""
    space = update.space
    poses = None
    if isinstance(space.method, RigidMethod):
        poses = partial(space.method.poses, space.memory.ids)
    return SpaceView(space.spec, space.window, space.current, update.labels, update.hypotheses, poses)
