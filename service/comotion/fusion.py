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

from comotion_schemas import Event, HypothesisUpdate, Joint, Keys, ObservationBatch, RejectionReason

from . import snapshot
from .assembly import Header, assemble, at_rest, moved
from .config import FusionConfig, to_ns
from .event_time.faults import Fault, Faults
from .event_time.instants import Instant
from .event_time.sources import SourceHealth
from .event_time.stats import Ledger, Stats
from .event_time.steps import ClockTrouble
from .event_time.timeline import Timeline
from .following import PublishedIds
from .hypotheses.events import EVENT_MEMORY_NS
from .hypotheses.identity import ID_GAP, IdAllocator
from .joints.room import Joints
from .linking.linker import Linker
from .methods import make_method
from .partition import Method, SpaceSpec
from .shedding import FULL, Effort
from .source_checks import TroubleKind
from .space import MAX_COORDINATE, SpaceUpdate
from .spaces import Spaces

# Stamps beyond are no times since 1970; their differences could leave the range of int64.
_MAX_STAMP_NS = 2**62

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
        self._faults = Faults(self.stats)
        self._timeline = Timeline(self.config, self.stats, self._faults)
        self._ids = IdAllocator(first_id)
        self._spaces = Spaces(self.config, self._ids, self.stats, self._faults, self.make_method)
        self._linker = Linker(self.config.linking)
        self._joints = Joints(self.config)
        self._events: deque[Event] = deque()
        self._published: PublishedIds | None = None
        self._effort = FULL
        self._latest: HypothesisUpdate | None = None
        self._seq = 0

    @property
    def watermark_ns(self) -> int | None:
        """Event time up to which everything is fused, ns since the Unix epoch; None before any."""
        watermark = self._timeline.watermark_ns
        return None if watermark is None else watermark + self._timeline.steps.shift_ns

    @property
    def spaces(self) -> list[str]:
        """Names of the spaces that have been observed, sorted."""
        return self._spaces.names()

    def ingest(self, batch: ObservationBatch) -> None:
        """Take in a batch, in any order across sources. Raises nothing; counts what it drops."""
        try:
            refusal = self._refusal(batch)
        except Exception as error:  # a defect costs the batch, not the service
            self._faults.note("checking a batch", error, batch)
            refusal = "defect"
        self._timeline.receive(batch, refusal)

    def advance(self, now_ns: int, at_ns: int | None = None) -> None:
        """Fuse what the watermark has passed; calling it between updates spreads their work.

        Parameters
        ----------
        now_ns, at_ns
            As for :meth:`update`.
        """
        self._spaces.at_ns = now_ns if at_ns is None else at_ns
        for event in self._timeline.advance(now_ns, at_ns):
            if isinstance(event, Instant):
                self._timeline.done(event, self._spaces.store(event))
            else:
                self._spaces.end_session(event.session)

    def update(self, now_ns: int, at_ns: int | None = None) -> HypothesisUpdate:
        """Fuse what the watermark has passed and group every current trajectory. Raises nothing.

        Parameters
        ----------
        now_ns
            The caller's clock, nanoseconds since the Unix epoch, with which stamps are compared.
        at_ns
            A clock that is never set, in ns, for the time between arrivals; None: `now_ns`.
        """
        self.advance(now_ns, at_ns)
        timeline, at_ns = self._timeline, now_ns if at_ns is None else at_ns
        watermark, shift_ns = timeline.watermark_ns, timeline.steps.shift_ns
        # Nothing has set a watermark yet: report its lower bound, so that stamps stay monotonic.
        stamp = now_ns - to_ns(self.config.max_lag) if watermark is None else watermark
        updates = self._spaces.update(stamp, timeline.track_timeout_ns, self._effort)
        joints, changes = self._jointed(stamp, updates)
        self._remember(stamp, [*(event for one in updates for event in one.events), *changes])
        in_use = self._spaces.sessions_in_use()
        timeline.forget_idle(in_use)
        self._spaces.tidy(in_use | set(timeline.sessions))
        period_ns, live = to_ns(self.config.period), bool(timeline.sources.sending(at_ns))
        header = Header(self.scene, self.session, self._seq, stamp, now_ns, period_ns, live)
        self._seq += 1
        self.stats.updates += 1
        self.stats.shed += self._effort != FULL
        update = self._linked(self._assembled(header, updates, joints), updates)
        if not live and timeline.sources.has_heard():
            update = at_rest(update)
        self._latest = moved(update, shift_ns) if shift_ns else update
        return self._latest if self._published is None else self._published.apply(self._latest)

    def _jointed(self, stamp_ns: int, updates: list[SpaceUpdate]) -> tuple[list[Joint], list[Event]]:
        try:
            found = self._joints.update(stamp_ns, [one.view for one in updates], judging=self._effort.joints)
            self._joints.keep(h.id for one in updates for h in one.hypotheses)
        except Exception as error:  # a defect costs the joints, not the service
            self._faults.note("finding joints", error)
            self._joints = Joints(self.config)
            return [], []
        return found

    def _assembled(self, header: Header, updates: list[SpaceUpdate], joints: list[Joint]) -> HypothesisUpdate:
        """One message of all spaces that fit into one; a space that does not is built anew."""
        sessions = self._timeline.sessions
        try:
            return assemble(header, updates, sessions, self._events, joints)
        except Exception as error:  # a defect costs a space, not the service
            self._faults.note("putting an update together", error)
        self._events.clear()
        kept: list[SpaceUpdate] = []
        update = assemble(header, kept, sessions, self._events, [])
        for one in updates:
            try:
                update = assemble(header, [*kept, one], sessions, self._events, [])
                kept.append(one)
            except Exception as error:
                self._faults.note(f"listing space {one.view.spec.name!r}", error)
                self._spaces.open(one.view.spec)
        updates[:] = kept
        return update

    def _linked(self, update: HypothesisUpdate, updates: Sequence[SpaceUpdate]) -> HypothesisUpdate:
        try:
            views = [one.view for one in updates]
            return self._linker.linked(update, views, deciding=self._effort.links)
        except Exception as error:  # a defect costs the links, not the service
            self._faults.note("linking spaces", error)
            self._linker = Linker(self.config.linking)
            return update

    def shed(self, level: int) -> None:
        """Leave out work from the next update on, as :mod:`comotion.shedding` says; 0: nothing."""
        self._effort = Effort.at(level)

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
        gone = (one for space in self._spaces for one in space.forget(hypothesis))
        return sorted(gone if self._published is None else map(self._published.name, gone))

    def follow_recordings(self) -> None:
        """Take the time of the sources for granted: a recording may be played again with its own stamps."""
        self._timeline.steps.follow_all = True

    @property
    def ledger(self) -> Ledger:
        """What became of the batches of each source and session."""
        return self._timeline.ledger

    def tracks_in(self, space: str) -> int:
        """Rows of :meth:`affinity` of a space."""
        return self._spaces[space].size

    def faults(self) -> list[Fault]:
        """Errors of the fusion itself since the last call, with their traces."""
        return self._faults.take()

    @property
    def shift_ns(self) -> int:
        """By how much stamps are ahead of the time scale of `now_ns`; 0 unless sources were followed."""
        return self._timeline.steps.shift_ns

    def clock_set(self, by_ns: int) -> None:
        """Take note of by how much the clock of this machine, not `now_ns`, was set since the start."""
        self._timeline.steps.clock_set_ns = by_ns

    def wrong_clocks(self) -> dict[str, ClockTrouble]:
        """Sources whose clock is wrong, as of the last :meth:`advance`."""
        return self._timeline.steps.troubles(self._timeline.at_ns)

    def rivalled(self) -> list[str]:
        """Sources of which a second process sends too, as of the last :meth:`advance`."""
        return self._timeline.sources.rivalled(self._timeline.at_ns)

    def wrong_data(self) -> dict[str, dict[TroubleKind, float]]:
        """Sources whose ids or unit cannot be right, as :meth:`SourceChecks.troubles` says."""
        found = self._spaces.checks.troubles(self._timeline.at_ns)
        sessions = self._timeline.sessions
        return {sessions[number][0]: kinds for number, kinds in found.items() if number in sessions}

    @property
    def newest_ns(self) -> int | None:
        """Largest stamp that was accepted, on the time scale of `now_ns`; None before any."""
        return max((source.newest_ns for source in self._timeline.sources.values()), default=None)

    def sources(self, now_ns: int, at_ns: int | None = None) -> list[SourceHealth]:
        """Health of every source: its session, age, and whether it sends."""
        return self._timeline.sources.health(now_ns, now_ns if at_ns is None else at_ns)

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
            "spaces": [space.state() for space in self._spaces],
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
            space = fusion._spaces.open(SpaceSpec(part["name"], part["unit"], int(part["dim"])))
            # The trajectories serve every method; what a method has derived from them is its own.
            space.load(part, keep_method=state["method"] == config.method)
        return fusion

    def make_method(self, spec: SpaceSpec) -> Method:
        """Build the method for a space; a subclass may choose another one."""
        return make_method(self.config, spec)

    def _refusal(self, batch: ObservationBatch) -> RejectionReason | None:
        """Why a batch cannot be fused, whatever its time; None if it can."""
        refused = self._spaces.refusal(batch)
        if refused is not None:
            return refused
        stamps = batch.stamps_ns
        oldest = batch.stamp_ns if stamps is None or not len(stamps) else int(stamps.min())
        if oldest < 0 or batch.stamp_ns > _MAX_STAMP_NS:
            return "range"
        if np.abs(batch.positions).max(initial=0.0) > MAX_COORDINATE:
            return "range"
        return None

    def _remember(self, stamp_ns: int, events: Sequence[Event]) -> None:
        """Keep the events that updates still list."""
        self._events.extend(events)
        while self._events and self._events[0].stamp_ns < stamp_ns - EVENT_MEMORY_NS:
            self._events.popleft()
