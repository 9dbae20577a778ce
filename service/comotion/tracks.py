"""The trajectories of one space: opens, fills, ends and forgets them as the batches of its sources say.

A trajectory is what a session observes of one feature: it is known by (session number, id).
"""

from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np

from .arrays import Ids, Slots, distinct, find
from .event_time.entries import Instants
from .event_time.stats import Stats
from .partition import Method
from .trajectories.jumps import jumps
from .trajectories.window import Window

# Most lost ids that are remembered of a session, the newest: those of some generations.
MAX_ENDED = 10_000
# Motion shows between two observations: an outdated trajectory with fewer in the window is forgotten.
_MIN_OBSERVATIONS = 2
# m or px. Farther out, single precision resolves no motion, and squares of squares leave their range.
MAX_COORDINATE = 1e9


class Tracks:
    """Trajectories of one space, in its window.

    The method gets to know what is about to leave the window. `timeout_ns` gives the time without observation
    after which a trajectory of a session number is outdated. `current` intp [n] are the slots of the
    trajectories of the last update, by age.
    """

    def __init__(
        self, window: Window, method: Method, stats: Stats, timeout_ns: Callable[[int], int]
    ) -> None:
        self._window, self._method, self._stats, self._timeout_ns = window, method, stats, timeout_ns
        self.current: Slots = np.zeros(0, np.intp)
        # Of each session that has sent anything: its ids, ascending, and slots and -1; None: to be sorted.
        self._sorted: dict[int, tuple[Ids, Slots] | None] = {}
        # Ids that each session has declared lost, oldest first.
        self._ended: dict[int, dict[int, None]] = {}
        # Up to when trajectories were searched for jumps.
        self._searched_ns = 0

    def find(self, ids: Ids, session: int) -> Slots:
        """Slots of the ids of a session, intp [n]; -1 where there is none."""
        entry = self._sorted.get(session)
        if entry is None:
            own_slots = np.flatnonzero(self._window.used & (self._window.source == session))
            own_slots = own_slots[np.argsort(self._window.id[own_slots])]
            entry = self._sorted[session] = self._window.id[own_slots], np.append(own_slots, -1)
        sorted_ids, slots = entry
        return slots[find(ids, sorted_ids)]

    def knows(self, session: int) -> bool:
        """Whether a session has sent anything."""
        return session in self._sorted

    def store(self, instants: Instants, allowance: Callable[[int], int]) -> tuple[int, int]:
        """Store rows of a batch in event-time order.

        `allowance` says how many of so many new trajectories may be opened: the rows of others are refused.
        Returns how many rows have new ids, and how many have ended ones.
        """
        slots, fresh, ended = self._find_or_open(instants, allowance)
        # An id that its source has declared lost for good must not come back.
        lost = self._window.ended[slots] & (slots >= 0)
        accepted = (slots >= 0) & ~lost
        count = int(np.count_nonzero(accepted))
        self._stats.refused_rows += len(slots) - count
        if count:
            self._insert(instants.of(accepted), slots[accepted])
        return fresh, ended + int(np.count_nonzero(lost))

    def _find_or_open(self, instants: Instants, allowance: Callable[[int], int]) -> tuple[Slots, int, int]:
        """Slots of the rows, -1 for those refused; how many are new, and how many have ended before."""
        ids, session = instants.ids, instants.session
        slots = self.find(ids, session)
        # Trajectories that are observed again count before new ones do.
        known = slots >= 0
        self._window.live[slots[known]] = True
        if known.all():
            return slots, 0, 0
        fresh = np.flatnonzero(~known)
        _, first, first_of_row = np.unique(ids[fresh], return_index=True, return_inverse=True)
        # By first appearance: the oldest trajectory has the lowest number.
        new = fresh[np.sort(first)]
        lost = self._ended.get(session, {})
        opened = new[[feature not in lost for feature in ids[new].tolist()]]
        ended = len(new) - len(opened)
        opened = opened[: allowance(len(opened)) if len(opened) else 0]
        slots[opened] = self._open(ids[opened], session)
        slots[fresh] = slots[fresh[first]][first_of_row]
        return slots, len(opened), ended

    def _insert(self, instants: Instants, slots: Slots) -> None:
        """Put rows of a batch into the window, each with its slot."""
        batch, rows, window = instants.batch, instants.rows, self._window
        sigma = np.full(len(rows), np.nan)
        if batch.sigma is not None:
            sigma[:] = batch.sigma[rows] if isinstance(batch.sigma, np.ndarray) else batch.sigma
            # Coordinates resolve no noise beyond these limits, and its square would overflow.
            np.clip(sigma, 1 / MAX_COORDINATE, MAX_COORDINATE, out=sigma)
        quaternions = None if batch.quaternions is None else batch.quaternions[rows].astype(np.float64)
        stamps = instants.stamp_ns if batch.stamps_ns is None else instants.stamps
        stored = window.insert(slots, stamps, instants.positions, sigma, quaternions)
        if batch.covariance is not None:
            # In 2-D without z.
            entries = [0, 1, 2, 3, 4, 5] if batch.dim == 3 else [0, 1, 3]
            declared = np.zeros((len(slots), 6))
            declared[:, entries] = batch.covariance[rows]
            # As a whole, so that it stays one; a variance is the largest of its entries.
            largest = np.maximum(declared.max(axis=1, keepdims=True), MAX_COORDINATE**2)
            window.covariance[slots] = declared * (MAX_COORDINATE**2 / largest)
        observed = int(np.count_nonzero(stored))
        self._stats.observations += observed
        self._stats.duplicate_rows += len(stored) - observed

    def _open(self, ids: Ids, session: int) -> Slots:
        """Open a trajectory for each of the ids, which have none; returns their slots, intp [n]."""
        slots = self._window.open(len(ids), session)
        self._window.id[slots] = ids
        self._sorted[session] = None
        self._stats.tracks += len(ids)
        return slots

    def _close(self, slots: Slots) -> None:
        """Forget trajectories, by age."""
        self._method.forgetting(self._window, slots)
        for session in self._sorted.keys() & set(self._window.source[slots].tolist()):
            self._sorted[session] = None
        self._window.close(slots)

    def end(self, ids: Ids, session: int) -> None:
        """Mark trajectories as ended for good, also those that have not been seen yet."""
        ids = ids[-MAX_ENDED:]
        slots = self.find(ids, session)
        self._window.ended[slots[slots >= 0]] = True
        ended = self._ended.setdefault(session, {})
        ended |= dict.fromkeys(ids.tolist())
        for feature in list(islice(ended, max(len(ended) - MAX_ENDED, 0))):
            del ended[feature]

    def end_session(self, session: int) -> None:
        """Mark all trajectories of a session as ended for good."""
        self._window.ended |= self._window.used & (self._window.source == session)
        self._sorted.pop(session, None)
        self._ended.pop(session, None)

    def occupied(self) -> int:
        """Trajectories that count against the limit: those current at the last update or observed since.

        A source whose features change quickly keeps many outdated trajectories in the window. They count
        by the quarter: memory is bounded, and there is allowance for new ones.
        """
        window = self._window
        return max(int(np.count_nonzero(window.live)), int(np.count_nonzero(window.used)) // 4)

    def held(self) -> dict[int, int]:
        """Trajectories that count against the share of each session number."""
        numbers, rows = distinct(self._window.source[self._window.live])
        return dict(zip(numbers.tolist(), np.bincount(rows).tolist(), strict=True))

    def sessions(self) -> set[int]:
        """Numbers of the sessions that have a trajectory here."""
        return set(np.bincount(self._window.source[self._window.used]).nonzero()[0].tolist())

    def displace(self, session: int, count: int) -> int:
        """Forget the youngest trajectories of a session number, `count` at most; returns how many."""
        window = self._window
        slots = np.flatnonzero(window.live & (window.source == session))
        displaced = slots[np.argsort(window.key[slots])][len(slots) - min(count, len(slots)) :]
        if len(displaced):
            self._evict(displaced, window.counts(displaced))
            self._close(displaced)
            self.current = self.current[window.used[self.current]]
        return len(displaced)

    def follow(self, stamp_ns: int) -> Slots:
        """Move the window to the watermark; returns :attr:`current`."""
        window = self._window
        slots, counts = window.evictable(stamp_ns - window.span_ns)
        if len(slots):
            self._evict(slots, counts)
        if not self._method.by_thesis:
            self._cut(stamp_ns)
        limits = np.zeros(window.capacity, np.int64)
        for session in self.sessions():
            limits[window.source == session] = self._timeout_ns(session)
        # Where the window is shorter than the timeout, trajectories that have left it have no current state.
        held = window.stop > window.start
        # Compare stamps, not differences: the smallest int64 stands for "never observed".
        fresh = window.used & held & (window.last_ns >= stamp_ns - limits)
        # Those that are outdated and too short to show motion.
        forgotten = window.used & ~fresh & (window.stop - window.start < _MIN_OBSERVATIONS)
        if self._method.by_thesis:
            # No evidence there, where memory grows with the square of their number.
            forgotten |= window.ended
        slots = window.slots()
        if forgotten.any():
            self._close(slots[forgotten[slots]])
            slots = slots[~forgotten[slots]]
        self.current = slots[fresh[slots] & ~window.ended[slots]]
        window.live[:] = False
        window.live[self.current] = True
        return self.current

    def _evict(self, slots: Slots, counts: Slots) -> None:
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
            reopened = self._open(track_id, source)
            window.insert(np.repeat(reopened, len(stamps)), stamps, positions, sigma, turns)
            window.covariance[reopened] = covariance

    def state(self) -> dict[str, Any]:
        """The window, and the ids that each session has declared lost, as plain values and arrays."""
        ended = [[session, np.array(list(ids), np.uint64)] for session, ids in self._ended.items()]
        return {"window": self._window.state(), "ended": ended}

    def load(self, state: dict[str, Any]) -> None:
        """Take up :meth:`state`."""
        slots = self._window.load(state["window"])
        self._ended = {int(session): dict.fromkeys(lost.tolist()) for session, lost in state["ended"]}
        self._sorted = dict.fromkeys(np.unique(self._window.source[slots]).tolist())
