"""Released instants of all spaces in; updates of each space out. One that fails is built anew.

A fault in a space costs what it has derived, at worst its trajectories; never the service, nor another space.
Bounds are kept here: of spaces, and of trajectories, of which each source has its share.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from comotion_schemas import ObservationBatch, RejectionReason

from .arrays import Bools
from .config import FusionConfig, to_ns
from .event_time.faults import Faults
from .event_time.instants import Instant
from .event_time.stats import Stats
from .hypotheses.identity import IdAllocator
from .partition import Method, SpaceSpec
from .shedding import FULL, Effort
from .source_checks import MOST_ROWS, SourceChecks
from .space import Space, SpaceUpdate

MakeMethod = Callable[[SpaceSpec], Method]


@dataclass
class Spaces:
    """The spaces of a scene by name.

    Attributes
    ----------
    config, ids, stats, faults, make_method
        Of the fusion.
    at_ns
        The clock of arrivals; the caller keeps it up to date.
    checks
        What is wrong with the ids and units of sources.
    """

    config: FusionConfig
    ids: IdAllocator
    stats: Stats
    faults: Faults
    make_method: MakeMethod
    at_ns: int = 0
    checks: SourceChecks = field(default_factory=SourceChecks)
    _spaces: dict[str, Space] = field(default_factory=dict)
    _fed_ns: dict[str, int] = field(default_factory=dict)
    # Spaces of each session number that has published in any.
    _homes: dict[int, set[str]] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Space]:
        return iter(self._spaces.values())

    def __getitem__(self, name: str) -> Space:
        return self._spaces[name]

    def names(self) -> list[str]:
        """Names, sorted."""
        return sorted(self._spaces)

    def refusal(self, batch: ObservationBatch) -> RejectionReason | None:
        """Why a batch does not fit in its space; None if it does, or the space can be released for it."""
        space = self._spaces.get(batch.space)
        if space is None or space.spec.suits(batch) or self._is_released(batch.space):
            return None
        return "space-mismatch"

    def store(self, instant: Instant) -> RejectionReason | None:
        """Put an instant into its space; returns why it is refused, if so. Raises nothing."""
        name = instant.batch.space
        try:
            refused = self._space_for(instant.batch)
            if refused is not None:
                return refused
            if not self._store(self._spaces[name], instant):
                return "range"
        except Exception as error:  # a defect costs a batch and a space, not the service
            self.faults.note("storing a batch", error, instant.batch)
            self._rebuild(name, keep=True)
            return "defect"
        return None

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session number as ended for good."""
        for space in self:
            space.end_session(session)
        self._homes.pop(session, None)

    def update(
        self, stamp_ns: int, timeout_ns: Callable[[int], int], effort: Effort = FULL
    ) -> list[SpaceUpdate]:
        """Update every space; one that fails is built anew, at best with its trajectories. Raises nothing."""
        updates = []
        for turn, name in enumerate(self.names(), self.stats.updates):
            for keep in (True, False, False):
                try:
                    found = self._spaces[name].update(stamp_ns, timeout_ns, effort, turn)
                    updates.append(self._doubted(found))
                    break
                except Exception as error:
                    self.faults.note(f"updating space {name!r}", error)
                    self._rebuild(name, keep=keep)
        return updates

    def _doubted(self, update: SpaceUpdate) -> SpaceUpdate:
        """The same with half the confidence at most in what sources say whose ids change hands."""
        numbers = self.checks.doubted(self.at_ns)
        if not numbers:
            return update
        most = np.where(np.isin(update.sessions, numbers), 0.5, 1.0)
        return replace(update, confidence=np.minimum(update.confidence, most))

    def sessions_in_use(self) -> set[int]:
        """Numbers of the sessions that have a trajectory anywhere."""
        found: set[int] = set().union(*(space.sessions_in_use() for space in self))
        return found

    def tidy(self, in_use: set[int]) -> None:
        """Forget spaces that are empty and that nobody has long published in, and sessions without tracks."""
        expiry_ns = to_ns(max(self.config.limits.expiry, self.config.hypotheses.memory))
        for name, space in list(self._spaces.items()):
            if not space.sessions_in_use() and self.at_ns - self._fed_ns.get(name, 0) > expiry_ns:
                self.drop(name)
        self._homes = {number: homes for number, homes in self._homes.items() if number in in_use}
        self.checks.keep(in_use)

    def drop(self, name: str) -> None:
        """Forget a space."""
        self._spaces.pop(name, None)
        self._fed_ns.pop(name, None)
        for homes in self._homes.values():
            homes.discard(name)

    def open(self, spec: SpaceSpec) -> Space:
        """Open a space, in the place of one of its name."""
        self.drop(spec.name)
        space = Space(self.config, spec, self.make_method(spec), self.ids, self.stats)
        self._spaces[spec.name], self._fed_ns[spec.name] = space, self.at_ns
        return space

    def _rebuild(self, name: str, *, keep: bool) -> None:
        """Build a space anew, with its trajectories and labels where they can be kept."""
        old = self._spaces.get(name)
        if old is None:
            return
        fed_ns = self._fed_ns.get(name, 0)
        homes = {number for number, names in self._homes.items() if name in names}
        fresh = self.open(old.spec)
        self._fed_ns[name] = fed_ns
        if not keep:
            return
        try:
            fresh.load(old.state() | {"method": {}}, keep_method=True)
            for number in homes:
                self._homes[number].add(name)
        except Exception as error:
            self.faults.note(f"keeping the trajectories of space {name!r}", error)
            self.open(old.spec)

    def _space_for(self, batch: ObservationBatch) -> RejectionReason | None:
        """Make sure that there is a space for a batch; the first batch that is fused defines it."""
        space = self._spaces.get(batch.space)
        if space is not None and not space.spec.suits(batch):
            if not self._is_released(batch.space):
                return "space-mismatch"
            space = None
        if space is None:
            if batch.space not in self._spaces and not self._make_room():
                return "limit"
            self.open(SpaceSpec(batch.space, batch.unit, batch.dim))
        self._fed_ns[batch.space] = self.at_ns
        return None

    def _is_released(self, name: str) -> bool:
        return self.at_ns - self._fed_ns.get(name, 0) > to_ns(self.config.limits.release)

    def _make_room(self) -> bool:
        """Whether one more space may be opened; the one that nobody publishes for longest makes room."""
        if len(self._spaces) < self.config.limits.spaces:
            return True
        name = min(self._spaces, key=lambda one: self._fed_ns.get(one, 0))
        if not self._is_released(name):
            return False
        self.drop(name)
        return True

    def _store(self, space: Space, instant: Instant) -> bool:
        """Returns False if all its rows are too far out."""
        number, name = instant.session, space.spec.name
        homes = self._homes.setdefault(number, set())
        elsewhere = self._elsewhere(instant, homes - {name}) if len(instant.rows) else None
        homes.add(name)
        stored = space.store(instant, lambda wanted: self._room(number, wanted), elsewhere)
        if instant.last and instant.batch.ended is not None:
            for home in homes:
                self._spaces[home].end(instant.batch.ended, number)
        where = number, name
        self.checks.note(where, stored, self.at_ns)
        some = instant.rows[:MOST_ROWS]
        ids, positions = instant.batch.ids[some], instant.batch.positions[some].astype(np.float64)
        share = stored.fresh / max(len(instant.rows), 1)
        self.checks.look(where, ids, positions, share, (instant.stamp_ns, self.at_ns))
        return stored.fits

    def _elsewhere(self, instant: Instant, homes: set[str]) -> Bools | None:
        """Which rows have an id that their session uses in another space, bool [n]; None for none."""
        if not homes:
            return None
        ids = instant.batch.ids[instant.rows]
        found = np.zeros(len(ids), np.bool_)
        for home in homes:
            found |= self._spaces[home].holds(ids, instant.session)
        return found if found.any() else None

    def _room(self, session: int, wanted: int) -> int:
        """How many new trajectories a session may open; who holds more than its share makes room."""
        free = max(self.config.max_tracks - sum(space.occupied() for space in self), 0)
        if wanted <= free:
            return wanted
        held: dict[int, int] = {}
        for space in self:
            for number, count in space.held().items():
                held[number] = held.get(number, 0) + count
        share = self.config.max_tracks // len(held.keys() | {session})
        due = min(wanted, share - held.get(session, 0))
        while free < due:
            greediest = max(held, key=lambda number: held[number], default=session)
            excess = held.get(greediest, 0) - share
            if greediest == session or excess <= 0:
                break
            freed = self._displace(greediest, min(due - free, excess))
            if not freed:
                break
            held[greediest] -= freed
            free += freed
        return min(wanted, free)

    def _displace(self, session: int, count: int) -> int:
        """Drop the youngest trajectories of a session; returns how many."""
        freed = 0
        for space in self:
            freed += space.displace(session, count - freed)
        return freed
