"""One space: stores its released instants, and groups its trajectories at each update."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import Bools, Floats, Ints, Slots, Stamps, distinct
from .config import FusionConfig, to_ns
from .event_time.entries import Instants
from .event_time.stats import Stats
from .event_time.troubles import Troubles
from .extent_check import ExtentCheck
from .hypotheses.drift import DriftCheck
from .hypotheses.explained import explained
from .hypotheses.identity import IdAllocator
from .hypotheses.registry import Registry
from .last_grouping import LastGrouping, representatives
from .linking.linker import SpaceView
from .moving_frame import Carrying
from .partition import Method, Partition, SpaceSpec
from .saving import plain
from .shedding import FULL, Effort
from .source_checks import SourceChecks
from .space_update import SpaceUpdate
from .trajectories.jumps import jumps
from .trajectories.track_index import TrackIndex
from .trajectories.window import Ids, Window

# Motion shows between two observations: an outdated trajectory with fewer in the window is forgotten.
_MIN_OBSERVATIONS = 2
REFUSED = "rows are refused: more trajectories than `max_tracks`, or an id in two spaces"
"""Text where rows are beyond a bound."""
# m or px. Farther out, single precision resolves no motion, and squares of squares leave their range.
MAX_COORDINATE = 1e9


class Space:
    """Trajectories of one space and the method that groups them.

    States in different spaces are not comparable, so spaces share nothing but the id allocator.

    Attributes
    ----------
    index
        Session and id of the trajectories.
    carrying
        Whether the frame moves, and where it is.
    owner
        The source that was the first to observe something here; empty where that is not known.
    fed_ns
        When something came in last, on the clock of arrivals.
    """

    def __init__(
        self,
        config: FusionConfig,
        spec: SpaceSpec,
        method: Method,
        ids: IdAllocator,
        stats: Stats,
        troubles: Troubles,
    ) -> None:
        self.spec = spec
        self._stats, self._troubles = stats, troubles
        self._window = Window(spec.dim, to_ns(config.window), to_ns(config.track_timeout))
        self.index = TrackIndex(self._window)
        self._method = method
        self._hypotheses = Registry(spec.name, ids, config.hypotheses, established=method.established)
        self._current: Slots = np.zeros(0, np.intp)
        self._last: LastGrouping | None = None
        # Keys of the trajectories of the last update, and that update.
        self._listed: tuple[Stamps, SpaceUpdate] | None = None
        self.owner, self.fed_ns = "", 0
        self.extent, self.checks = ExtentCheck(spec.unit, config.limits.extent), SourceChecks(troubles)
        self.drift = DriftCheck()
        self._groupings = 0
        # Up to when trajectories were searched for jumps.
        self._searched_ns = 0
        declared = config.spaces.get(spec.name)
        self.carrying = Carrying(spec.dim, spec.unit == "m", None if declared is None else declared.moving)

    def store(self, instants: Instants, allowance: Callable[[int], int], taken: Bools | None = None) -> bool:
        """Put released rows into the window, in event-time order; False if all are too far out.

        `allowance` says how many of so many new trajectories may be opened: the rows of others are refused.
        So are those that are `taken`, bool [n], whose id stands for a feature elsewhere.
        """
        session, source, refused = instants.session, instants.batch.source, self._stats.refused_rows
        fits, fresh, ended = self._store(instants, allowance, taken)
        factor, doubt = self.extent.refused.get(session), self.extent.doubts.get(session)
        if factor or doubt:
            self._troubles.note("scale", source, factor or doubt)
        if not factor and self._stats.refused_rows - refused > ended:
            self._troubles.note("limit", source, REFUSED)
        self.checks.look(instants, fresh, ended)
        return fits

    def _store(
        self, instants: Instants, allowance: Callable[[int], int], taken: Bools | None
    ) -> tuple[bool, int, int]:
        """Whether rows fit into the scene, rows with new ids, and with ended ones."""
        batch, session = instants.batch, instants.session
        rows, stamps = instants.rows, instants.stamps[: len(instants.rows)]
        if taken is not None:
            rows, stamps = rows[~taken], stamps[~taken]
        places: NDArray[Any] = batch.positions[rows]
        in_scene = self.extent.fits(session, places) if len(rows) else None
        if in_scene is not None:
            if not in_scene.any():
                return False, 0, 0
            rows, stamps = rows[in_scene], stamps[in_scene]
        slots, fresh, ended = self._find_or_open(batch.ids[rows], session, allowance)
        has_slot = slots >= 0
        # An id that its source has declared lost for good must not come back.
        accepted = has_slot.copy()
        accepted[has_slot] = ~self._window.ended[slots[has_slot]]
        ended += int(np.count_nonzero(has_slot & ~accepted))
        self._stats.refused_rows += len(instants.rows) - int(np.count_nonzero(accepted))
        if accepted.any():
            self._insert(instants, slots[accepted], rows[accepted], stamps[accepted])
        return True, fresh, ended

    def _insert(self, instants: Instants, slots: Slots, rows: Ints, stamps: Stamps) -> None:
        """Put rows of a batch into the window, each with its slot and stamp."""
        batch = instants.batch
        self.carrying.declared[instants.session] = batch.source, bool(batch.moving)
        sigma = np.full(len(rows), np.nan)
        if batch.sigma is not None:
            sigma[:] = batch.sigma[rows] if isinstance(batch.sigma, np.ndarray) else batch.sigma
            # Coordinates resolve no noise beyond these limits, and its square would overflow.
            np.clip(sigma, 1 / MAX_COORDINATE, MAX_COORDINATE, out=sigma)
        quaternions = None if batch.quaternions is None else batch.quaternions[rows].astype(np.float64)
        at_once = instants.stamp_ns if batch.stamps_ns is None else stamps
        positions = batch.positions[rows].astype(np.float64)
        stored = self._window.insert(slots, at_once, positions, sigma, quaternions)
        if batch.covariance is not None:
            # In 2-D without z.
            entries = [0, 1, 2, 3, 4, 5] if batch.dim == 3 else [0, 1, 3]
            declared = np.zeros((len(slots), 6))
            declared[:, entries] = batch.covariance[rows]
            self._window.covariance[slots] = np.clip(declared, -(MAX_COORDINATE**2), MAX_COORDINATE**2)
        self._stats.observations += int(stored.sum())
        self._stats.duplicate_rows += int(len(stored) - stored.sum())

    def _find_or_open(
        self, ids: Ids, session: int, allowance: Callable[[int], int]
    ) -> tuple[Slots, int, int]:
        """Slots of ids, -1 for those refused; how many are new, and how many have ended before."""
        slots = self.index.find(ids, session)
        # Trajectories that are observed again count before new ones do.
        self._window.live[slots[slots >= 0]] = True
        fresh, ended = np.flatnonzero(slots < 0), 0
        if len(fresh):
            _, first, first_of_row = np.unique(ids[fresh], return_index=True, return_inverse=True)
            # By first appearance: the oldest trajectory has the lowest number.
            new = fresh[np.sort(first)]
            has_ended = self.index.has_ended(ids[new], session)
            opened, ended = new[~has_ended], int(has_ended.sum())
            opened = opened[: allowance(len(opened)) if len(opened) else 0]
            slots[opened] = self.index.open(ids[opened], session)
            slots[fresh] = slots[fresh[first]][first_of_row]
            self._stats.tracks += len(opened)
            fresh = opened
        return slots, len(fresh), ended

    def occupied(self) -> int:
        """Trajectories that count against the limit: those current at the last update or observed since.

        A source whose features change quickly keeps many outdated trajectories in the window. They count
        by the quarter: memory is bounded, and there is allowance for new ones.
        """
        window = self._window
        return max(int(np.count_nonzero(window.live)), int(np.count_nonzero(window.used)) // 4)

    @property
    def size(self) -> int:
        """Trajectories of the last grouping."""
        return 0 if self._last is None else len(self._last.current)

    def held(self) -> dict[int, int]:
        """Trajectories that count against the share of each session number."""
        numbers, rows = distinct(self._window.source[self._window.live])
        return dict(zip(numbers.tolist(), np.bincount(rows).tolist(), strict=True))

    def displace(self, session: int, count: int) -> int:
        """Forget the youngest trajectories of a session number, `count` at most; returns how many."""
        window = self._window
        slots = np.flatnonzero(window.live & (window.source == session))
        displaced = slots[np.argsort(window.key[slots])][len(slots) - min(count, len(slots)) :]
        if not len(displaced):
            return 0
        self._method.evicting(window, displaced, window.counts(displaced))
        window.evict(displaced, window.counts(displaced))
        self._close(displaced)
        self._current = self._current[window.used[self._current]]
        return len(displaced)

    def update(self, stamp_ns: int, timeout_ns: Callable[[int], int], effort: Effort = FULL) -> SpaceUpdate:
        """Move the window to the watermark and group what is current, as far as `effort` says.

        `timeout_ns` gives the time without observation after which a trajectory of a session number is
        outdated.
        """
        window = self._window
        self._evict(stamp_ns)
        if self._method.cutting:
            self._cut(stamp_ns)
        fresh = self._fresh(stamp_ns, timeout_ns)
        self._forget(fresh)
        slots = window.slots()
        current = self._current = slots[fresh[slots] & ~window.ended[slots]]
        window.live[:] = False
        window.live[current] = True
        present = distinct(window.source[current])[0].tolist()
        self.carrying.follow(present, self.sessions_in_use())
        self.extent.look(window, current)
        partition = self._partition(stamp_ns, effort)
        labels, hypotheses, events = self._hypotheses.update(
            window, partition, current, stamp_ns, self._method.matching, boxes=effort.boxes
        )
        # Links and joints follow from motion in the frame; what is published is relative to the world.
        present = [h for h in hypotheses if not h.absent]
        frame = None
        if self.carrying.frame is not None:
            hypotheses, frame = self.carrying.frame.relative(stamp_ns, hypotheses, labels, partition.position)
        owners, newest, registry = window.source[current], _newest(window, current), self._hypotheses
        seen = (window.last_ns[current] - window.times[current, window.start[current]]) / 1e9
        motions = partial(self._method.motions, registry.ids, registry.references)
        self._listed = (
            window.key[current],
            SpaceUpdate(
                sessions=owners,
                ids=window.id[current],
                positions=newest,
                labels=labels,
                confidence=partition.confidence * explained(labels, present, newest, owners, seen),
                hypotheses=hypotheses,
                events=events,
                view=SpaceView(self.spec, window, current, labels, present, motions),
                frame=frame,
            ),
        )
        return self._listed[1]

    def repeated(self) -> SpaceUpdate | None:
        """The last update again, without events, and without trajectories that are gone; None before any."""
        if self._listed is None:
            return None
        keys, last = self._listed
        slots, window = last.view.current, self._window
        same = window.used[slots] & (window.key[slots] == keys) & ~window.ended[slots]
        return last.without_some(same)

    def _partition(self, stamp_ns: int, effort: Effort) -> Partition:
        """Group the current trajectories, or some of them; the others keep their groups."""
        window, current = self._window, self._current
        previous = self._hypotheses.previous(window)
        self._method.searching = self._groupings % effort.search_every == 0
        self._groupings += 1
        self.drift.look(window, current, previous.labels, stamp_ns, self._method.delays_ns)
        steady = window.used & ~np.isin(window.source, self.drift.drifting)
        grouped = representatives(window, current[steady[current]], previous.labels, effort.share)
        view = window
        if len(grouped) < len(current):
            sampled = len(grouped) < np.count_nonzero(steady[current])
            view = window.of(grouped if sampled else np.flatnonzero(steady))
        partition = self._method.partition(view, grouped, stamp_ns, previous)
        self._last = LastGrouping.of(window, partition, grouped)
        if len(grouped) == len(current):
            return partition
        return self._last.extended(window, current, previous.labels)

    def _evict(self, stamp_ns: int) -> None:
        slots, counts = self._window.evictable(stamp_ns - self._window.span_ns)
        if len(slots):
            self._method.evicting(self._window, slots, counts)
            self._window.evict(slots, counts)

    def _cut(self, stamp_ns: int) -> None:
        """Begin trajectories anew where they jump: before the jump they followed another feature."""
        window = self._window
        live = np.flatnonzero(window.used & window.live & ~window.ended)
        slots, first = jumps(window, live, self._searched_ns)
        self._searched_ns = stamp_ns
        for slot, begin in zip(slots, first, strict=True):
            rest = slice(begin, window.stop[slot])
            stamps, positions = window.times[slot, rest].copy(), window.positions[slot, rest].copy()
            sigma, covariance = window.sigma[slot, rest].copy(), window.covariance[slot].copy()
            turns = None if window.quaternions is None else window.quaternions[slot, rest].copy()
            track_id, source = window.id[[slot]], int(window.source[slot])
            self._close(np.array([slot]))
            reopened = self.index.open(track_id, source)
            window.insert(np.repeat(reopened, len(stamps)), stamps, positions, sigma, turns)
            window.covariance[reopened] = covariance
        self._stats.tracks += len(slots)

    def _fresh(self, stamp_ns: int, timeout_ns: Callable[[int], int]) -> Bools:
        limits = np.zeros(self._window.capacity, np.int64)
        for session in self.sessions_in_use():
            limits[self._window.source == session] = timeout_ns(session)
        # Where the window is shorter than the timeout, trajectories that have left it have no current state.
        held = self._window.stop > self._window.start
        # Compare stamps, not differences: the smallest int64 stands for "never observed".
        return self._window.used & held & (self._window.last_ns >= stamp_ns - limits)

    def _forget(self, fresh: Bools) -> None:
        """Forget trajectories that are outdated and too short to show motion."""
        window = self._window
        forgotten = np.flatnonzero(window.used & ~fresh & (window.stop - window.start < _MIN_OBSERVATIONS))
        if not len(forgotten):
            return
        self._close(forgotten[np.argsort(window.key[forgotten])])

    def _close(self, slots: Slots) -> None:
        """Forget trajectories, by age."""
        window = self._window
        self._method.forgetting(window, slots)
        self.index.close(slots)

    def forget(self, hypothesis: int | None) -> list[int]:
        """Forget a hypothesis, or all; returns those forgotten."""
        return self._hypotheses.forget(self._window, hypothesis)

    def affinity(self) -> tuple[Slots, Ids, NDArray[np.float32]]:
        """Session numbers intp [n], ids uint64 [n] and affinities float32 [n, n] of the last grouping."""
        last = self._last
        if last is None:
            return np.zeros(0, np.intp), np.zeros(0, np.uint64), np.zeros((0, 0), np.float32)
        return last.sessions, last.ids, self._method.affinity()

    def sessions_in_use(self) -> set[int]:
        """Numbers of the sessions that have a trajectory here."""
        return set(np.flatnonzero(np.bincount(self._window.source[self._window.used])).tolist())

    def state(self) -> dict[str, Any]:
        """The window, the method and the labels, as plain values and arrays."""
        return {
            "name": self.spec.name,
            "unit": self.spec.unit,
            "dim": self.spec.dim,
            "window": self._window.state(),
            "method": self._method.state(),
            "hypotheses": self._hypotheses.state(),
            "frame": plain(self.carrying.frame),
            "ended": [[number, ids] for number, ids in self.index.ended()],
        }

    def load(self, state: dict[str, Any], *, keep_method: bool) -> None:
        """Take up :meth:`state`; without `keep_method` the trajectories alone."""
        slots = self._window.load(state["window"])
        self.index.load(slots, state["ended"])
        self._method.load(state["method"] if keep_method else {}, self._window)
        self._hypotheses.load(state["hypotheses"] if keep_method else {}, self._window)
        if state["frame"] is not None:
            self.carrying.load(state["frame"] if keep_method else None)


def _newest(window: Window, slots: Slots) -> Floats:
    """Newest positions [n, 3]; the third column is NaN in 2-D."""
    positions = np.full((len(slots), 3), np.nan)
    if len(slots):
        positions[:, : window.dim] = window.positions[slots, window.stop[slots] - 1]
    return positions
