"""All spaces of a scene, each updated alone. One that fails is built anew.

A fault in a space costs what it has derived, at worst its trajectories; never the service, nor another space.
Bounds are kept here: of spaces, and of trajectories, of which each source has its share.

Unit and dim of a space are those of the configuration, else of the source that was the first to observe
something in it, as long as any source that agrees observes it. A source that contradicts is refused, and so
is one that is not among the sources that the configuration names.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from comotion_schemas import ObservationBatch, RejectionReason
from comotion_schemas.messages import ProblemKind

from .config import FusionConfig, SpaceConfig, to_ns
from .event_time.budget import Budget, Turns
from .event_time.entries import Instants
from .event_time.timeline import Timeline
from .event_time.troubles import CLOCKS
from .hypotheses.identity import IdAllocator
from .partition import SpaceSpec
from .shedding import FULL, Effort
from .space import REFUSED, Space
from .space_update import SpaceUpdate

# Share of a period for updating spaces, and for that with reading and publishing. The first is less than what
# makes updates slow: a source that spends all of it must not make all others leave out work.
_GROUPING, _WHOLE = 0.6, 0.85
_UNDECLARED = SpaceConfig()
# Spaces at a time, and the share of them that one source may open.
_MAX_SPACES, _OF_ONE_SOURCE = 256, 0.25
# ns without data after which a space may have another unit or dimension.
_RELEASE_NS = 5_000_000_000
# Rows of an instant that are looked at, for each trajectory that there may be.
_ROWS_FOR_A_TRACK = 2


@dataclass
class Spaces:
    """The spaces of a scene by name; `turns` lets them be updated."""

    config: FusionConfig
    ids: IdAllocator
    timeline: Timeline
    _spaces: dict[str, Space] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.turns = Turns(Budget(_GROUPING, to_ns(self.config.period), whole=_WHOLE))

    def __iter__(self) -> Iterator[Space]:
        return iter(self._spaces.values())

    def __getitem__(self, name: str) -> Space:
        return self._spaces[name]

    def refusal(self, batch: ObservationBatch) -> RejectionReason | None:
        """Why a batch does not fit in its space; None if it does, or the space can be released for it."""
        name, space = batch.space, self._spaces.get(batch.space)
        declared = self.config.spaces.get(name, _UNDECLARED)
        unit, dim = declared.unit, declared.dim
        # A space whose sources are gone may take another unit and dimension.
        if space is not None and not self._is_released(space):
            unit, dim = unit or space.spec.unit, dim or space.spec.dim
        if declared.sources is not None and batch.source not in declared.sources:
            text = f"that it observes in {name}, where the configuration names other sources"
        elif unit in (None, batch.unit) and dim in (None, batch.dim):
            return None
        else:
            configured = declared.unit is not None or declared.dim is not None
            first = "" if space is None else space.owner
            owner = "the configuration" if configured else first or "the first source"
            said = f"{unit or batch.unit} and {dim or batch.dim}"
            text = f"that {name} has unit {batch.unit} and dim {batch.dim}, where {owner} says {said}"
        self.timeline.troubles.note("contradicts-space", batch.source, text)
        return "space-mismatch"

    def store(self, instant: Instants) -> RejectionReason | None:
        """Put instants into their space; returns why they are refused, if so. Raises nothing."""
        name = instant.batch.space
        with self.timeline.faults.guard("storing a batch", instant.batch):
            if not len(instant.rows):
                self._end(instant)
                return None
            refused = self._space_for(instant.batch)
            if refused is not None:
                return refused
            space, may_open = self._spaces[name], partial(self._allowance, instant.session)
            fits = space.store(self._without_taken(self._cut(instant), space), may_open)
            self._end(instant)
            return None if fits else "range"
        self._rebuild(name, keep=True)
        return "defect"

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session number as ended for good."""
        for space in self:
            space.tracks.end_session(session)

    def update(self, stamp_ns: int, effort: Effort = FULL) -> list[SpaceUpdate]:
        """Update every space, in turn as far as the budget of its sources goes. Raises nothing.

        Spaces whose sources have spent their share are listed as they were. A space that fails is built
        anew, at best with its trajectories. The arguments are those of :meth:`.space.Space.update`.
        """
        updates: dict[str, SpaceUpdate | None] = {}

        def update(name: str) -> None:
            for keep in (True, False, False):
                with self.timeline.faults.guard(f"updating a space ({name!r})"):
                    updates[name] = self._spaces[name].update(stamp_ns, effort)
                    return
                self._rebuild(name, keep=keep)

        # Where a clock is known to be wrong, no motion is compared.
        mistimed = self._doubted(*CLOCKS)
        for space in self:
            space.drift.mistimed = mistimed
        shares = {name: self._shares(space) for name, space in self._spaces.items()}
        for name in self.turns.take(self.timeline.at_ns, shares, update):
            with self.timeline.faults.guard(f"repeating a space ({name!r})"):
                last = self._spaces[name].last
                updates[name] = None if last is None else last.repeated()
        for source in self.turns.costly:
            self.timeline.troubles.note("over-budget", source)
        for space in self:
            for source in space.frame.contradicting:
                text = f"that {space.spec.name} is carried, which others do not say"
                self.timeline.troubles.note("contradicts-space", source, text)
            for number in space.drift.drifting:
                if number in self.timeline.sessions:
                    self.timeline.troubles.note("drifts", self.timeline.sessions[number][0])
        doubted = self._doubted("ids-reused", "ids-short-lived")
        listed = [part for _, part in sorted(updates.items()) if part is not None]
        return [part.doubted(doubted) for part in listed] if doubted else listed

    def _doubted(self, *kinds: ProblemKind) -> list[int]:
        """Numbers of the sessions of sources with a trouble of some kinds."""
        sources = self.timeline.troubles.sources(*kinds)
        return [number for number, (source, _) in self.timeline.sessions.items() if source in sources]

    def _shares(self, space: Space) -> dict[str, float]:
        """Share of each source in what a space costs: that of its trajectories."""
        sessions, held = self.timeline.sessions, space.tracks.held().items()
        counts = {sessions[number][0]: count for number, count in held if number in sessions}
        total = sum(counts.values())
        return {source: n / total for source, n in counts.items()} if total else {space.owner: 1.0}

    def sessions(self) -> set[int]:
        """Numbers of the sessions that have a trajectory anywhere."""
        return {number for space in self for number in space.tracks.sessions()}

    def tidy(self, in_use: set[int]) -> None:
        """Forget empty spaces in which nothing was published for long, and sessions without tracks."""
        expiry_ns = to_ns(max(self.config.limits.expiry, self.config.hypotheses.memory))
        for name, space in list(self._spaces.items()):
            if not space.tracks.sessions() and self._idle_ns(space) > expiry_ns:
                del self._spaces[name]
        for space in self:
            space.checks.keep(in_use)

    def open(self, spec: SpaceSpec) -> Space:
        """Open a space, in the place of one of its name."""
        space = Space(self.config, spec, self.ids, self.timeline)
        space.fed_ns = self.timeline.at_ns
        # In the order in which they were opened.
        self._spaces.pop(spec.name, None)
        self._spaces[spec.name] = space
        return space

    def _rebuild(self, name: str, *, keep: bool) -> None:
        """Build a space anew, with its trajectories and labels where they can be kept."""
        if (old := self._spaces.get(name)) is None:
            return
        fresh = self.open(old.spec)
        fresh.fed_ns, fresh.owner = old.fed_ns, old.owner
        if not keep:
            return
        with self.timeline.faults.guard(f"keeping the trajectories of a space ({name!r})"):
            fresh.load(old.state() | {"method": {}}, keep_method=True)
            return
        self.open(old.spec)

    def _space_for(self, batch: ObservationBatch) -> RejectionReason | None:
        """Make sure that there is a space for rows of a batch."""
        if (refusal := self.refusal(batch)) is not None:
            return refusal
        space, spec = self._spaces.get(batch.space), SpaceSpec(batch.space, batch.unit, batch.dim)
        if space is None or space.spec != spec:
            if space is None and not self._admit_space(batch.source):
                return "limit"
            space = self.open(spec)
            space.owner = batch.source
        space.fed_ns = self.timeline.at_ns
        return None

    def _is_released(self, space: Space) -> bool:
        return self._idle_ns(space) > _RELEASE_NS

    def _idle_ns(self, space: Space) -> int:
        """Time since something came in; a space of a snapshot counts as published in just now."""
        space.fed_ns = space.fed_ns or self.timeline.at_ns
        return self.timeline.at_ns - space.fed_ns

    def _admit_space(self, source: str) -> bool:
        """Whether a source may open one more; of too many, the one without data for longest goes."""
        candidates = [space for space in self if space.owner == source]
        if len(candidates) < _OF_ONE_SOURCE * _MAX_SPACES:
            candidates = list(self)
            if len(candidates) < _MAX_SPACES:
                return True
        oldest = min(candidates, key=lambda space: space.fed_ns)
        if not self._is_released(oldest):
            return False
        del self._spaces[oldest.spec.name]
        return True

    def _cut(self, instant: Instants) -> Instants:
        """The first rows, where there are many more than trajectories for each of its stamps."""
        most = _ROWS_FOR_A_TRACK * self.config.max_tracks
        if len(instant.rows) <= most:
            return instant
        most *= 1 + int(np.count_nonzero(np.diff(instant.stamps)))
        if len(instant.rows) > most:
            self._refuse(len(instant.rows) - most, instant)
        return replace(instant, stamps=instant.stamps[:most], rows=instant.rows[:most])

    def _refuse(self, count: int, instant: Instants) -> None:
        self.timeline.stats.refused_rows += count
        self.timeline.troubles.note("limit", instant.batch.source, REFUSED)

    def _end(self, instant: Instants) -> None:
        """End the trajectories of the ids that a batch declares lost, in all spaces of its session."""
        if instant.last and instant.batch.ended is not None:
            for space in self:
                if space.tracks.knows(instant.session):
                    space.tracks.end(instant.batch.ended, instant.session)

    def _without_taken(self, instant: Instants, home: Space) -> Instants:
        """The rows but those with an id that their session uses in another space."""
        others = [space for space in self if space is not home and space.tracks.knows(instant.session)]
        if not others:
            return instant
        ids = instant.ids
        # An id that has a trajectory here has none elsewhere.
        taken = home.tracks.find(ids, instant.session) < 0
        taken &= np.any([space.tracks.find(ids, instant.session) >= 0 for space in others], axis=0)
        if taken.any():
            self._refuse(int(np.count_nonzero(taken)), instant)
        return instant.of(~taken)

    def _allowance(self, session: int, wanted: int) -> int:
        """How many new trajectories a session may open; sessions above their share lose some."""
        most, spaces = self.config.max_tracks, [space.tracks for space in self]
        free = max(most - sum(tracks.occupied() for tracks in spaces), 0)
        if wanted <= free:
            return wanted
        held: Counter[int] = Counter()
        for tracks in spaces:
            held.update(tracks.held())
        share = most // len(held.keys() | {session})
        due = min(wanted, share - held[session])
        while free < due:
            greediest = max(held, key=lambda number: held[number], default=session)
            excess = held[greediest] - share
            if greediest == session or excess <= 0:
                break
            freed, most_freed = 0, min(due - free, excess)
            for tracks in spaces:
                freed += tracks.displace(greediest, most_freed - freed)
            if not freed:
                break
            held[greediest] -= freed
            free += freed
        return min(wanted, free)
