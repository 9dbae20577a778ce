"""Released instants of one space in; at each update, the hypotheses of its current trajectories out."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event, Hypothesis, Pose

from .arrays import Bools, Floats, Labels, Slots
from .config import FusionConfig, to_ns
from .event_time.instants import Instant
from .event_time.stats import Stats
from .extent_check import ExtentCheck
from .hypotheses.explained import explained
from .hypotheses.identity import IdAllocator
from .hypotheses.registry import Registry
from .last_grouping import LastGrouping
from .linking.linker import SpaceView
from .moving_frame import MovingFrame
from .partition import BodyMotion, Method, Partition, Rows, SpaceSpec
from .rigid.method import RigidMethod
from .rigid.poses import Poses
from .shedding import FULL, Effort
from .source_checks import Stored
from .trajectories.track_index import Ids, TrackIndex
from .trajectories.window import Window

# Motion shows between two observations: an outdated trajectory with fewer in the window is forgotten.
_MIN_OBSERVATIONS = 2
# m or px. Farther out, single precision resolves no motion, and squares of squares leave their range.
MAX_COORDINATE = 1e9


@dataclass(frozen=True)
class SpaceUpdate:
    """Current trajectories of one space and their hypotheses, as of one update.

    Attributes
    ----------
    sessions, ids
        intp [n], number of the session, and uint64 [n], id of the feature: who each trajectory is.
    positions
        float64 [n, 3]: newest fused positions, in the space's unit; the third column is NaN in 2-D.
    labels
        int64 [n], hypothesis id, negative for none.
    confidence
        float64 [n] in 0..1.
    hypotheses
        The hypotheses with current members, and the absent ones.
    events
        Those of this update only.
    view
        What the linker needs to see.
    frame
        Where the frame of the space is in the world; None where it does not move.
    """

    sessions: Slots
    ids: Ids
    positions: Floats
    labels: Labels
    confidence: Floats
    hypotheses: list[Hypothesis]
    events: list[Event]
    view: SpaceView
    frame: Pose | None = None


class Space:
    """Trajectories of one space and the method that groups them.

    States in different spaces are not comparable, so spaces share nothing but the id allocator.

    Parameters
    ----------
    config
        Parameters of the fusion.
    spec
        Name, unit and dimension.
    method
        Method for this space.
    ids
        Where new hypotheses get their ids.
    stats
        Counters of the fusion.
    """

    def __init__(
        self, config: FusionConfig, spec: SpaceSpec, method: Method, ids: IdAllocator, stats: Stats
    ) -> None:
        self.spec = spec
        self._stats = stats
        self._window = Window(spec.dim, to_ns(config.window), to_ns(config.track_timeout))
        self._index = TrackIndex(self._window)
        self._method = method
        self._hypotheses = Registry(spec.name, ids, config.hypotheses, established=method.established)
        self._current: Slots = np.zeros(0, np.intp)
        self._opened: list[Slots] = []
        self._frame: MovingFrame | None = None
        self._last: LastGrouping | None = None
        self.extent = ExtentCheck(spec.unit, config.limits.extent)
        self._groupings = 0
        known = config.spaces.get(spec.name)
        if known is not None and known.moving:
            self._carry()

    def _carry(self) -> None:
        """Take the frame for one that moves."""
        self._frame = self._frame or MovingFrame(self.spec.dim, metric=self.spec.unit == "m")

    def store(self, instant: Instant, room: Callable[[int], int], taken: Bools | None = None) -> Stored:
        """Put one instant into the window, and the method's sums where it keeps any.

        Parameters
        ----------
        instant
            Released rows, in event-time order.
        room
            Tells how many of so many new trajectories may be opened; the rows of others are refused.
        taken
            bool [n], rows whose id stands for a feature elsewhere: they are refused.

        Returns
        -------
        Stored
            What became of it.
        """
        rows = instant.rows if taken is None else instant.rows[~taken]
        near = self.extent.fits(instant.session, _take(instant.batch.positions, rows)) if len(rows) else None
        if near is not None and not near.any():
            return Stored(fits=False, factor=self.extent.refused[instant.session])
        rows = rows if near is None else rows[near]
        self._stats.refused_rows += len(instant.rows) - len(rows)
        slots, fresh, ended = self._find_or_open(_take(instant.batch.ids, rows), instant.session, room)
        known = slots >= 0
        # An id that its source has declared lost for good must not come back.
        keep = known.copy()
        keep[known] = ~self._window.ended[slots[known]]
        ended += int(np.count_nonzero(known & ~keep))
        self._stats.refused_rows += int(np.count_nonzero(known & ~keep))
        if not keep.all():
            slots, rows = slots[keep], rows[keep]
        if len(slots):
            self._insert(instant, slots, rows)
        return Stored(True, fresh, ended, self.extent.refused.get(instant.session, 0.0))

    def _insert(self, instant: Instant, slots: Slots, rows: NDArray[np.intp]) -> None:
        batch = instant.batch
        if batch.moving:
            self._carry()
        sigma = np.full(len(rows), np.nan)
        if batch.sigma is not None:
            sigma[:] = _take(batch.sigma, rows) if isinstance(batch.sigma, np.ndarray) else batch.sigma
            # Coordinates resolve no noise beyond these limits, and its square would overflow.
            np.clip(sigma, 1 / MAX_COORDINATE, MAX_COORDINATE, out=sigma)
        quaternions = None
        if batch.quaternions is not None:
            quaternions = _take(batch.quaternions, rows).astype(np.float64)
        positions = _take(batch.positions, rows).astype(np.float64)
        stored = self._window.insert(slots, instant.stamp_ns, positions, sigma, quaternions)
        self._stats.observations += int(stored.sum())
        self._stats.duplicate_rows += int(len(stored) - stored.sum())
        if stored.any():
            self._method.observed(self._window, Rows(instant.stamp_ns, slots[stored], instant.in_order))

    def _find_or_open(self, ids: Ids, session: int, room: Callable[[int], int]) -> tuple[Slots, int, int]:
        """Slots of ids, -1 for those refused; how many are new, and how many have ended before."""
        slots = self._index.find(ids, session)
        fresh, ended = np.flatnonzero(slots < 0), 0
        if len(fresh):
            gone = self._index.has_ended(ids[fresh], session)
            fresh, ended = fresh[~gone], int(gone.sum())
            allowed = room(len(fresh)) if len(fresh) else 0
            fresh = fresh[:allowed]
            self._stats.refused_rows += int(np.count_nonzero(slots < 0)) - len(fresh)
        if len(fresh):
            slots[fresh] = self._index.open(ids[fresh], session)
            self._stats.tracks += len(fresh)
            self._opened.append(slots[fresh])
        self._index.expect(ids, session, slots)
        return slots, len(fresh), ended

    def end(self, ids: Ids, session: int) -> None:
        """Mark trajectories of a session as ended for good."""
        self._index.end(ids, session)

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session as ended for good."""
        self._index.end_session(session)

    def occupied(self) -> int:
        """Trajectories that count against the limit: those current at the last update or opened since.

        A source whose features change quickly keeps many outdated trajectories in the window. They count
        by the quarter: memory is bounded, and there is room for new ones.
        """
        used = int(self._window.used.sum())
        return max(len(self._current) + sum(map(len, self._opened)), used // 4)

    @property
    def size(self) -> int:
        """Trajectories of the last grouping."""
        return 0 if self._last is None else len(self._last.current)

    def held(self) -> dict[int, int]:
        """Trajectories that count against the share of each session number."""
        slots = np.concatenate([self._current, *self._opened])
        numbers, counts = np.unique(self._window.source[slots], return_counts=True)
        return dict(zip(numbers.tolist(), counts.tolist(), strict=True))

    def holds(self, ids: Ids, session: int) -> Bools:
        """Which ids of a session have a trajectory here, bool [n]."""
        return np.asarray(self._index.find(ids, session) >= 0)

    def displace(self, session: int, count: int) -> int:
        """Forget the youngest trajectories of a session number, `count` at most; returns how many."""
        window = self._window
        slots = np.concatenate([self._current, *self._opened])
        slots = slots[window.source[slots] == session]
        gone = slots[np.argsort(window.key[slots])][len(slots) - min(count, len(slots)) :]
        if not len(gone):
            return 0
        self._method.evicting(window, gone, window.counts(gone))
        window.evict(gone, window.counts(gone))
        self._close(gone)
        self._current = self._current[window.used[self._current]]
        self._opened = [some[window.used[some]] for some in self._opened]
        return len(gone)

    def update(
        self, stamp_ns: int, timeout_ns: Callable[[int], int], effort: Effort = FULL, turn: int = 0
    ) -> SpaceUpdate:
        """Move the window to the watermark and group what is current.

        Parameters
        ----------
        stamp_ns
            The watermark.
        timeout_ns
            Gives the time without observation after which a trajectory of a session number is outdated.
        effort
            What to do and what to leave out.
        turn
            Number of the update: which of the spaces is grouped in it, where not all are.
        """
        window = self._window
        self._evict(stamp_ns)
        fresh = self._fresh(stamp_ns, timeout_ns)
        self._forget(fresh)
        slots = window.slots()
        current = self._current = slots[fresh[slots] & ~window.ended[slots]]
        self._opened = []
        self.extent.look(window, current)
        partition = self._partition(stamp_ns, effort, turn)
        labels, hypotheses, events = self._hypotheses.update(
            window, partition, current, stamp_ns, self._method.matching, boxes=effort.boxes
        )
        # Links and joints follow from motion in the frame; what is published is relative to the world.
        present = [one for one in hypotheses if not one.absent]
        frame = None
        if self._frame is not None:
            relative = self._frame.relative(stamp_ns, hypotheses, labels, partition.position)
            hypotheses, frame = relative.hypotheses, relative.frame
        owners, newest = window.source[current], _newest(window, current)
        return SpaceUpdate(
            sessions=owners,
            ids=self._index.ids[current],
            positions=newest,
            labels=labels,
            confidence=partition.confidence * explained(labels, present, newest, owners),
            hypotheses=hypotheses,
            events=events,
            view=SpaceView(self.spec, window, current, labels, present, self._poses(), self._motions()),
            frame=frame,
        )

    def _partition(self, stamp_ns: int, effort: Effort, turn: int) -> Partition:
        """Group the current trajectories, or carry the last groups on where it is not their turn."""
        window, current = self._window, self._current
        previous = self._hypotheses.previous(window)
        if self._last is not None and len(self._last.current) and turn % effort.group_every:
            return self._last.carried(window, current)
        if isinstance(self._method, RigidMethod):
            self._method.searching = self._groupings % effort.search_every == 0
        self._groupings += 1
        found = self._method.partition(window, current, stamp_ns, previous)
        self._last = LastGrouping.of(window, found, current, self._index.ids[current])
        return found

    def _evict(self, stamp_ns: int) -> None:
        slots, counts = self._window.evictable(stamp_ns - self._window.span_ns)
        if len(slots):
            self._method.evicting(self._window, slots, counts)
            self._window.evict(slots, counts)

    def _fresh(self, stamp_ns: int, timeout_ns: Callable[[int], int]) -> Bools:
        limits = np.zeros(self._window.capacity, np.int64)
        for session in self.sessions_in_use():
            limits[self._window.source == session] = timeout_ns(session)
        # Where the window is shorter than the timeout, what has left it has no state to report.
        held = self._window.stop > self._window.start
        # Compare stamps, not differences: the smallest int64 stands for "never observed".
        return self._window.used & held & (self._window.last_ns >= stamp_ns - limits)

    def _forget(self, fresh: Bools) -> None:
        """Forget trajectories that are outdated and too short to show motion."""
        window = self._window
        gone = np.flatnonzero(window.used & ~fresh & (window.stop - window.start < _MIN_OBSERVATIONS))
        if not len(gone):
            return
        self._close(gone[np.argsort(window.key[gone])])

    def _close(self, gone: Slots) -> None:
        """Forget trajectories, by age."""
        window = self._window
        self._method.forgetting(window, gone)
        self._hypotheses.labels.forget(window, gone)
        self._index.close(gone)

    def _poses(self) -> Callable[[], Poses | None] | None:
        """Where the poses of its hypotheses come from; None where the method has none."""
        if isinstance(self._method, RigidMethod):
            return partial(self._method.poses, self._hypotheses.labels.ids)
        return None

    def _motions(self) -> Callable[[Collection[int]], dict[int, BodyMotion]] | None:
        """Where the motions of its hypotheses come from; None where the method knows none."""
        if isinstance(self._method, RigidMethod):
            labels = self._hypotheses.labels
            return partial(self._method.motions, labels.ids, labels.references)
        return None

    def forget(self, hypothesis: int | None) -> list[int]:
        """Forget a hypothesis, or all; returns those forgotten."""
        return self._hypotheses.forget(hypothesis)

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
            "ids": self._index.ids[self._window.slots()],
            "window": self._window.state(),
            "method": self._method.state(),
            "hypotheses": self._hypotheses.state(self._window),
            "frame": None if self._frame is None else self._frame.state(),
            "ended": [[number, ids] for number, ids in self._index.ended()],
        }

    def load(self, state: dict[str, Any], *, keep_method: bool) -> None:
        """Take up :meth:`state`; without `keep_method` the trajectories alone."""
        slots = self._window.load(state["window"])
        self._index.load(state["ids"], slots, state["ended"])
        self._method.load(state["method"] if keep_method else {}, self._window)
        self._hypotheses.load(state["hypotheses"] if keep_method else {}, self._window)
        if state.get("frame") is not None:
            self._carry()
            if keep_method and self._frame is not None:
                self._frame.load(state["frame"])


def _take(column: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Some rows of a column, ascending; mostly they are all of them."""
    return column if len(rows) == len(column) else column[rows]


def _newest(window: Window, slots: Slots) -> Floats:
    """Newest positions [n, 3]; the third column is NaN in 2-D."""
    positions = np.full((len(slots), 3), np.nan)
    if len(slots):
        positions[:, : window.dim] = window.positions[slots, window.stop[slots] - 1]
    return positions
