"""The face of the core: observation batches in, hypothesis updates out. No clock, no I/O, deterministic.

    batch -> event time -> space: trajectories -> method -> hypotheses -> joints
          -> assembly -> links -> update

The caller owns the period and the clock: it passes batches as they come, and requests an update
with the time that it takes for now.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event, HypothesisUpdate, Keys, ObservationBatch, RejectionReason

from . import snapshot
from .assembly import Header, assemble
from .config import FusionConfig, to_ns
from .event_time.instants import Instant, SessionEnded
from .event_time.sources import SourceHealth
from .event_time.stats import Stats
from .event_time.timeline import Timeline
from .following import PublishedIds
from .hypotheses.events import EVENT_MEMORY_NS
from .hypotheses.identity import ID_GAP, IdAllocator
from .joints.room import Joints
from .linking.linker import Linker
from .methods import make_method
from .partition import Method, SpaceSpec
from .space import MAX_COORDINATE, Space

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
    first_id
        Id of the first hypothesis.

    Attributes
    ----------
    config, scene, session
        As above.
    stats
        The counters of Status.

    Raises
    ------
    ValueError
        If the scene is no valid name.
    """

    def __init__(
        self,
        config: FusionConfig | None = None,
        scene: str = "default",
        session: str = "0" * 16,
        *,
        first_id: int = 1,
    ) -> None:
        self.config = FusionConfig() if config is None else config
        self.scene = Keys(scene).scene
        self.session = session
        self.stats = Stats()
        self._timeline = Timeline(self.config, self.stats)
        self._spaces: dict[str, Space] = {}
        self._ids = IdAllocator(first_id)
        self._linker = Linker(self.config.linking)
        self._joints = Joints(self.config)
        self._events: deque[Event] = deque()
        self._published: PublishedIds | None = None
        self._latest: HypothesisUpdate | None = None
        self._seq = 0

    @property
    def watermark_ns(self) -> int | None:
        """Event time up to which everything is fused, ns since the Unix epoch; None before any."""
        return self._timeline.watermark_ns

    @property
    def spaces(self) -> list[str]:
        """Names of the spaces that have been observed, sorted."""
        return sorted(self._spaces)

    def ingest(self, batch: ObservationBatch) -> None:
        """Take in a batch, in any order across sources. Raises nothing; counts what it drops."""
        self._timeline.receive(batch, self._refusal(batch))

    def advance(self, now_ns: int) -> None:
        """Fuse what the watermark has passed; calling it between updates spreads their work."""
        for event in self._timeline.advance(now_ns):
            if isinstance(event, Instant):
                self._fuse(event)
            else:
                self._end_session(event)

    def update(self, now_ns: int) -> HypothesisUpdate:
        """Fuse what the watermark has passed and group every current trajectory.

        Parameters
        ----------
        now_ns
            The caller's clock, nanoseconds since the Unix epoch.
        """
        self.advance(now_ns)
        watermark = self._timeline.watermark_ns
        # Nothing has set a watermark yet: report its lower bound, so that stamps stay monotonic.
        stamp = now_ns - to_ns(self.config.max_lag) if watermark is None else watermark
        timeout_ns = self._timeline.track_timeout_ns
        updates = [space.update(stamp, timeout_ns) for _, space in sorted(self._spaces.items())]
        joints, changes = self._joints.update(stamp, [one.view for one in updates])
        self._joints.keep(h.id for one in updates for h in one.hypotheses)
        self._remember(stamp, [*(event for one in updates for event in one.events), *changes])
        in_use = set().union(*(space.sessions_in_use() for space in self._spaces.values()))
        self._timeline.forget_idle(in_use)
        period_ns, live = to_ns(self.config.period), self._timeline.live(now_ns)
        header = Header(self.scene, self.session, self._seq, stamp, now_ns, period_ns, live)
        self._seq += 1
        self.stats.updates += 1
        update = assemble(header, updates, self._timeline.sessions, self._events, joints)
        self._latest = self._linker.linked(update, [one.view for one in updates])
        return self._latest if self._published is None else self._published.apply(self._latest)

    def follow(self, published: HypothesisUpdate) -> None:
        """Take over the ids and births of what another service of the scene publishes.

        A standby does so with each update of the active service: when it takes over, its own updates go on
        under the same ids.

        Parameters
        ----------
        published
            An update of the active service, with about the watermark of the last own update.
        """
        if self._latest is not None:
            self._published = self._published or PublishedIds()
            self._published.follow(self._latest, published)

    def affinity(self, space: str) -> AffinitySnapshot:
        """Affinities of a space as of the last update.

        Raises
        ------
        KeyError
            If no source has published in that space.
        """
        sessions, ids, matrix = self._spaces[space].affinity()
        owners = [self._timeline.sessions[number] for number in sessions.tolist()]
        tracks = [(*owner, track) for owner, track in zip(owners, ids.tolist(), strict=True)]
        return AffinitySnapshot(tracks, matrix)

    def forget(self, hypothesis: int | None = None) -> list[int]:
        """Forget a hypothesis, or all when None: what it was, where it was, and its id.

        Its features are grouped as new ones at the next update, which lists it as ended.

        Returns
        -------
        list[int]
            The ids of the forgotten hypotheses, ascending.
        """
        if hypothesis is not None and self._published is not None:
            hypothesis = self._published.own(hypothesis)
            if hypothesis is None:
                return []
        gone = (one for space in self._spaces.values() for one in space.forget(hypothesis))
        return sorted(gone if self._published is None else map(self._published.name, gone))

    def start_over(self) -> None:
        """Forget all that has been observed; counters and ids go on. Stamps may then start anywhere."""
        self._timeline = Timeline(self.config, self.stats)
        self._spaces.clear()
        self._linker = Linker(self.config.linking)
        self._events.clear()

    def sources(self, now_ns: int) -> list[SourceHealth]:
        """Health of every source: its session, age and whether the watermark waits for it."""
        return self._timeline.health(now_ns)

    def snapshot(self, *, clean: bool = False) -> bytes:
        """Everything that must survive a restart: identities, windows, sequence numbers and the watermark.

        Batches that wait for the watermark are not kept. `clean` says that no update follows: ids may
        then continue without a gap.
        """
        return b"".join(self.capture(clean=clean)())

    def capture(self, *, clean: bool = False) -> Callable[[], list[Any]]:
        """Copy the state of :meth:`snapshot`, to be serialised later or by another thread.

        Returns
        -------
        Callable
            Gives the snapshot as a list of buffers; it shares nothing with the fusion.
        """
        state = self._state(clean)
        following = state["next_id"]
        if self._published is not None:
            following = max(following, self._published.following + ID_GAP)
        return partial(snapshot.pieces, state, following)

    def _state(self, clean: bool) -> dict[str, Any]:
        """Plain values, and arrays that nothing else changes."""
        return {
            "method": self.config.method,
            "scene": self.scene,
            "session": self.session,
            "next_id": self._ids.following + (0 if clean else ID_GAP),
            "timeline": self._timeline.state(),
            "events": [
                {"stamp_ns": e.stamp_ns, "kind": e.kind, "hypothesis": e.hypothesis, "others": e.others}
                for e in self._events
            ],
            "links": self._linker.state(),
            "joints": self._joints.state(),
            "published": None if self._published is None else self._published.state(),
            "spaces": [space.state() for space in self._spaces.values()],
        }

    @classmethod
    def restore(cls, config: FusionConfig, data: bytes, *, session: str | None = None) -> Self:
        """Continue from :meth:`snapshot`, under a new `session` if given.

        Raises
        ------
        ValueError
            If `data` is no snapshot of this version, or damaged.
        """
        return snapshot.load(data, partial(cls._build, config, session))

    @classmethod
    def _build(cls, config: FusionConfig, session: str | None, state: dict[str, Any]) -> Self:
        fusion = cls(config, scene=state["scene"], session=session or state["session"])
        fusion._ids.following = int(state["next_id"])
        fusion._timeline.load(state["timeline"])
        fusion._events.extend(Event(**event) for event in state["events"])
        fusion._linker.load(state["links"])
        if state.get("published") is not None:
            fusion._published = PublishedIds.load(state["published"])
        if state["method"] == config.method:
            fusion._joints.load(state.get("joints", []))
        for part in state["spaces"]:
            space = fusion._open_space(SpaceSpec(part["name"], part["unit"], int(part["dim"])))
            # The trajectories serve every method; what a method has derived from them is its own.
            space.load(part, keep_method=state["method"] == config.method)
        return fusion

    def make_method(self, spec: SpaceSpec) -> Method:
        """Build the method for a space; a subclass may choose another one."""
        return make_method(self.config, spec)

    def _refusal(self, batch: ObservationBatch) -> RejectionReason | None:
        """Why a batch cannot be fused, whatever its time; None if it can."""
        space = self._spaces.get(batch.space)
        if space is not None and not space.spec.suits(batch):
            return "space-mismatch"
        if np.abs(batch.positions).max(initial=0.0) > MAX_COORDINATE:
            return "range"
        return None

    def _fuse(self, instant: Instant) -> None:
        space = self._space_of(instant)
        if space is None:
            return
        room = self.config.max_tracks - sum(space.occupied() for space in self._spaces.values())
        space.store(instant, max(room, 0))
        if instant.last and instant.batch.ended is not None:
            space.end(instant.batch.ended, instant.session)

    def _end_session(self, event: SessionEnded) -> None:
        for space in self._spaces.values():
            space.end_session(event.session)

    def _space_of(self, instant: Instant) -> Space | None:
        """Space of an instant; the first batch that is fused defines it, none that was refused."""
        batch = instant.batch
        space = self._spaces.get(batch.space)
        if space is None and len(self._spaces) < MAX_SPACES:
            return self._open_space(SpaceSpec(batch.space, batch.unit, batch.dim))
        if space is not None and space.spec.suits(batch):
            return space
        if instant.last:
            self.stats.reject("limit" if space is None else "space-mismatch")
        return None

    def _open_space(self, spec: SpaceSpec) -> Space:
        space = Space(self.config, spec, self.make_method(spec), self._ids, self.stats)
        self._spaces[spec.name] = space
        return space

    def _remember(self, stamp_ns: int, events: Sequence[Event]) -> None:
        """Keep the events that updates still list."""
        self._events.extend(events)
        while self._events and self._events[0].stamp_ns < stamp_ns - EVENT_MEMORY_NS:
            self._events.popleft()
