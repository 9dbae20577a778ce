"""Interface of the core: fuses observation batches into updates. No clock, no I/O, deterministic.

    batch -> event time -> space: trajectories -> method -> hypotheses -> joints
          -> assembly -> links -> update

The caller owns the period and the clock: it passes batches as they come, and requests an update
with the time that it takes for now.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import HypothesisUpdate, Keys, ObservationBatch, RejectionReason

from .assembly import Assembly, at_rest, moved
from .config import FusionConfig, to_ns
from .event_time.budget import CostClock
from .event_time.stats import Stats
from .event_time.timeline import Timeline
from .following import PublishedIds
from .hypotheses.identity import ID_GAP, IdAllocator
from .joints.joints import Joints
from .partition import SpaceSpec
from .saving import load, pieces, plain, refill
from .shedding import FULL, Effort
from .spaces import Spaces
from .tracks import MAX_COORDINATE

# Stamps beyond are no times since 1970; their differences could leave the range of int64.
_MAX_STAMP_NS = 2**62


@dataclass(frozen=True)
class AffinitySnapshot:
    """Affinities of one space at the last update.

    `tracks` names the rows as (source, session, id); `matrix` is float32 [N, N] in 0..1.
    """

    tracks: list[tuple[str, str, int]]
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
    config
        As above.
    stats
        The counters of Status.
    timeline
        Event time: the watermark, the sources, the accounts of their sessions, what sources do wrong, and
        errors of the fusion itself.

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
        self._scene, self._session = Keys(scene).scene, session
        self.stats = Stats()
        self.timeline = Timeline(self.config, self.stats)
        self._ids = IdAllocator(first_id)
        self._spaces = Spaces(self.config, self._ids, self.timeline)
        self._assembly = Assembly(self.config, self.timeline.faults)
        self._published = PublishedIds()
        self._latest: HypothesisUpdate | None = None
        self._seq = 0

    @property
    def spaces(self) -> dict[str, int]:
        """Names of the spaces that have been observed, sorted, and how many rows :meth:`affinity` has."""
        return dict(sorted((space.spec.name, space.size) for space in self._spaces))

    @property
    def next_id(self) -> int:
        """The least id that no hypothesis has had."""
        published = self._published.ids
        return max(self._ids.following, 0 if published is None else published.following)

    def ingest(self, batch: ObservationBatch) -> None:
        """Take in a batch, in any order across sources. Raises nothing; counts what it drops."""
        refusal: RejectionReason | None = "defect"
        with self.timeline.faults.guard("checking a batch", batch):
            refusal = self._spaces.refusal(batch)
            stamps, refused = batch.stamps_ns, refusal is not None
            oldest = batch.stamp_ns if stamps is None or not len(stamps) else int(stamps.min())
            in_time = oldest >= 0 and batch.stamp_ns <= _MAX_STAMP_NS
            if not refused and not (in_time and np.abs(batch.positions).max(initial=0.0) <= MAX_COORDINATE):
                refusal = "range"
        self.timeline.receive(batch, refusal)

    def advance(self, now_ns: int, at_ns: int | None = None) -> None:
        """Fuse what the watermark has passed; calling it between updates spreads their work.

        The times are those of :meth:`update`.
        """
        self.timeline.advance(now_ns, at_ns, self._spaces.store, self._spaces.end_session)

    def update(self, now_ns: int, at_ns: int | None = None, *, level: int = 0) -> HypothesisUpdate:
        """Fuse what the watermark has passed and group every current trajectory. Raises nothing.

        Parameters
        ----------
        now_ns
            The caller's clock, nanoseconds since the Unix epoch, with which stamps are compared.
        at_ns
            A clock that is never set, in ns, for the time between arrivals; None: `now_ns`.
        level
            Of the work that is left out, as :mod:`comotion.shedding` says; 0: none.
        """
        self.advance(now_ns, at_ns)
        timeline, effort = self.timeline, Effort.at(level)
        watermark, shift_ns = timeline.watermark_ns, timeline.clock.shift_ns
        # Nothing has set a watermark yet: report its lower bound, so that stamps stay monotonic.
        stamp = now_ns - to_ns(self.config.max_lag) if watermark is None else watermark
        updates = self._spaces.update(stamp, effort)
        in_use = self._spaces.sessions()
        timeline.forget_idle(in_use)
        self._spaces.tidy(in_use | set(timeline.sessions))
        live = bool(timeline.sources.sending(timeline.at_ns))
        header = {
            "scene": self._scene,
            "session": self._session,
            "seq": self._seq,
            "stamp_ns": stamp,
            "published_ns": now_ns,
            "period_ns": to_ns(self.config.period),
            "live": live,
        }
        self._seq += 1
        self.stats.updates += 1
        self.stats.shed += effort != FULL
        update = self._assembly.message(header, updates, timeline.sessions, effort, self._spaces.open)
        if not live and any(source.heard_ns is not None for source in timeline.sources.values()):
            update = at_rest(update)
        self._latest = moved(update, shift_ns) if shift_ns else update
        return self._published.apply(self._latest)

    def measure(self, clock: CostClock, grouping: CostClock | None = None) -> None:
        """Limit what each source may cost, as the budgets of `limits` say; without, nothing is limited.

        Parameters
        ----------
        clock
            Time that this thread has spent, in ns from any start.
        grouping
            The same for what updates of spaces cost, where that counts otherwise; None: `clock`.
        """
        self.timeline.budget.clock, self._spaces.turns.budget.clock = clock, grouping or clock

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
            self._published.follow(self._latest, published)

    def affinity(self, space: str) -> AffinitySnapshot:
        """Affinities of a space as of the last update.

        Raises
        ------
        KeyError
            If no source has published in that space.
        """
        sessions, ids, matrix = self._spaces[space].affinity()
        owners = [self.timeline.sessions[number] for number in sessions.tolist()]
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
        own = None if hypothesis is None else self._published.own(hypothesis)
        if own is None and hypothesis is not None:
            return []
        return sorted(self._published.name(number) for space in self._spaces for number in space.forget(own))

    def snapshot(self, *, clean: bool = False) -> bytes:
        """Everything that must survive a restart: identities, windows, sequence numbers and the watermark.

        Batches that wait for the watermark are not kept. `clean` says that no update follows: ids may
        then continue without a gap.
        """
        return b"".join(self.capture(clean=clean)())

    def capture(self, *, clean: bool = False) -> Callable[[], list[Any]]:
        """Copy the state of :meth:`snapshot`; what is returned serialises it, later or in another thread.

        It gives the snapshot as a list of buffers.
        """
        state = {
            "method": self.config.method,
            "scene": self._scene,
            "session": self._session,
            "next_id": self._ids.following + (0 if clean else ID_GAP),
            "timeline": self.timeline.state(),
            "assembly": plain(self._assembly),
            "published": plain(self._published),
            "spaces": [space.state() for space in self._spaces],
        }
        return partial(pieces, state)

    @classmethod
    def restore(cls, config: FusionConfig, data: bytes, *, session: str | None = None) -> Self:
        """Continue from :meth:`snapshot`, under a new `session` if given.

        Raises
        ------
        ValueError
            If `data` is no snapshot of this version, or damaged.
        """
        return load(data, partial(cls._build, config, session))

    @classmethod
    def _build(cls, config: FusionConfig, session: str | None, state: dict[str, Any]) -> Self:
        fusion = cls(config, scene=state["scene"], session=session or state["session"])
        fusion._ids.following = int(state["next_id"])
        fusion.timeline.load(state["timeline"])
        refill(fusion._assembly, state["assembly"])
        # The trajectories serve every method; what a method has derived from them is its own.
        same_method = state["method"] == config.method
        if not same_method:
            fusion._assembly.joints = Joints(config.joints)
        refill(fusion._published, state["published"])
        if fusion._published.ids is not None:
            fusion._published.ids.following += ID_GAP
        for part in state["spaces"]:
            space = fusion._spaces.open(SpaceSpec(part["name"], part["unit"], int(part["dim"])))
            space.load(part, keep_method=same_method)
        return fusion
