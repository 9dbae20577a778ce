"""The observations of every trajectory of one space that lie inside the window.

A trajectory lives in a slot. Its observations are contiguous and ordered by time, so that
a trajectory is read as plain array views. Slots are reused after a trajectory is forgotten; `key`,
its birth number, never is.
"""

from bisect import bisect_left
from copy import copy
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ..arrays import Bools, Floats, Ids, Labels, Slots, Stamps, ranks, untouched_zeros
from . import kernels
from .kernels import Columns, States, insert

_COLUMNS = Columns._fields[:5]
_KEPT = ("ended", "source", "key", "last_ns", "covariance", "_complete", "id", "label", "established")
_PER_SLOT = ("start", "stop", "used", "live", "label_ns", "far_ns", *_KEPT)
# Of a slot without a trajectory that has been observed; else 0.
_FRESH = {
    "last_ns": np.iinfo(np.int64).min,
    "covariance": np.nan,
    "_complete": True,
    "label": -1,
    "established": -1,
}
_FIRST_SLOTS = 64
# Doubled as need be. Rows whose length is a power of two would all want the same lines of the cache.
_FIRST_ROWS = 60
# Memory is given back when less than this share of it is still in use: of the rows of a slot, or of more
# slots than this number.
_MANY_SLOTS, _STILL_USED = 256, 0.25
_NO_TURN = np.full((1, 4), np.nan)


class Window:
    """Store of trajectories of a `dim`, over `span_ns`, interpolated across gaps of `gap_ns` at most."""

    def __init__(self, dim: int, span_ns: int, gap_ns: int) -> None:
        self.dim, self.span_ns, self.gap_ns = dim, span_ns, gap_ns
        self.capacity = 0
        self._rows = _FIRST_ROWS
        self._free: list[int] = []
        # Most slots in use at once since the columns were made: that many have memory behind them.
        self._written = 0
        self._next_key = 0
        # Times at which anything in the window was observed, ns, ascending and distinct.
        self.instants: list[int] = []
        self.times: Stamps = np.zeros((0, _FIRST_ROWS), np.int64)
        self.positions: Floats = np.zeros((0, _FIRST_ROWS, dim))
        self.speed: Floats = np.zeros((0, _FIRST_ROWS))
        self.sigma: Floats = np.zeros((0, _FIRST_ROWS))
        self.quaternions: Floats | None = None
        self.start: Slots = np.zeros(0, np.intp)
        self.stop: Slots = np.zeros(0, np.intp)
        self.used: Bools = np.zeros(0, np.bool_)
        # Whether the trajectory in a slot is current, as set by the caller; new ones are.
        self.live: Bools = np.zeros(0, np.bool_)
        self.ended: Bools = np.zeros(0, np.bool_)
        self.source: Slots = np.zeros(0, np.intp)
        self.key: Stamps = np.zeros(0, np.int64)
        self.last_ns: Stamps = np.zeros(0, np.int64)
        # xx, xy, xz, yy, yz, zz of the newest observation, published by its source; NaN: not published.
        self.covariance: Floats = np.zeros((0, 6))
        # Whether the first observation in the window is the first ever: its speed is the second's.
        self._complete: Bools = np.zeros(0, np.bool_)
        # The source's own.
        self.id: Ids = np.zeros(0, np.uint64)
        # Set by comotion.hypotheses: the hypothesis of each trajectory, since when, and the one in which it
        # became an established member; negative for none.
        self.label: Labels = np.zeros(0, np.int64)
        self.label_ns: Stamps = np.zeros(0, np.int64)
        self.established: Labels = np.zeros(0, np.int64)
        # Length of a long step, set by the caller, and when each trajectory made its last one.
        self.far, self.far_ns = np.inf, np.zeros(0, np.int64)

    @property
    def columns(self) -> Columns:
        """For compiled loops."""
        turns = np.zeros((0, 0, 0)) if self.quaternions is None else self.quaternions
        return Columns(self.times, self.positions, self.speed, self.sigma, turns, self.start, self.stop)

    def held(self, column: NDArray[Any], slot: int) -> NDArray[Any]:
        """The observations in a slot, a view of a column such as `times`, [M, ...]."""
        return column[slot, self.start[slot] : self.stop[slot]]

    def newest(self, slots: Slots) -> Floats:
        """The newest position in each slot, which holds one, float64 [n, dim]."""
        return self.positions[slots, self.stop[slots] - 1]

    def states_at(self, slots: Slots, stamps: Stamps, gap_ns: int | None = None) -> States:
        """States at ascending instants, as :func:`.kernels.states_at`; by default across :attr:`gap_ns`."""
        return kernels.states_at(self.columns, self.gap_ns if gap_ns is None else gap_ns, slots, stamps)

    def recent_steps(self, slots: Slots, span_ns: int) -> tuple[Floats, Stamps]:
        """How far each trajectory has moved lately, and in which time, as :func:`.kernels.recent_steps`."""
        return kernels.recent_steps(self.columns, slots, span_ns)

    def slots(self) -> Slots:
        """Slots in use, oldest trajectory first, intp [n]."""
        used = self.used.nonzero()[0]
        return used[self.key[used].argsort(kind="stable")]

    def of(self, slots: Slots) -> Self:
        """The same columns with some slots, as if no others were in use; for reading."""
        part = copy(self)
        part.used = np.zeros_like(self.used)
        part.used[slots] = True
        return part

    def counts(self, slots: Slots) -> Slots:
        """How many observations each slot holds."""
        return self.stop[slots] - self.start[slots]

    def open(self, count: int, source: int) -> Slots:
        """Slots for `count` new trajectories of a source."""
        while len(self._free) < count:
            self._grow_slots()
        slots = np.array([self._free.pop() for _ in range(count)], np.intp)
        self.used[slots] = self.live[slots] = True
        self._written = max(self._written, self.capacity - len(self._free))
        self.source[slots] = source
        self.key[slots] = np.arange(self._next_key, self._next_key + count)
        self._next_key += count
        return slots

    def close(self, slots: Slots) -> None:
        """Free slots whose trajectories are forgotten."""
        for name in _PER_SLOT:
            getattr(self, name)[slots] = _FRESH.get(name, 0)
        self._free.extend(sorted((int(s) for s in slots), reverse=True))
        self._give_back()

    def _give_back(self) -> None:
        """Renew the columns when most of the memory behind them is unused."""
        used, rows = np.flatnonzero(self.used), _FIRST_ROWS
        longest = int(self.counts(used).max(initial=0))
        while longest > _STILL_USED * rows:
            rows *= 2
        few = self._written > _MANY_SLOTS and len(used) < _STILL_USED * self._written
        if few or rows < _STILL_USED * self._rows:
            self._compact(used)
            self._renew_columns(self.capacity, min(rows, self._rows))
            self._written = len(used)

    def insert(
        self, slots: Slots, stamps: Stamps | int, positions: Floats, sigma: Floats, quaternions: Floats | None
    ) -> Bools:
        """Store observations, each in its place in time.

        A slot may occur again, with a later time; stamps are ascending times of acquisition int64 [n], or one
        of all. Positions [n, dim] and sigma [n] (NaN: unknown) are in the unit of the space. Returns bool
        [n], False where the slot already has an observation at this time: it is left alone.
        """
        self._reserve(slots, 1 if isinstance(stamps, int) else int(np.bincount(slots).max(initial=1)))
        for stamp in [stamps] if isinstance(stamps, int) else np.unique(stamps).tolist():
            at = bisect_left(self.instants, stamp)
            if self.instants[at : at + 1] != [stamp]:
                self.instants.insert(at, stamp)
        if quaternions is not None and self.quaternions is None:
            self.quaternions = np.full((self.capacity, self._rows, 4), np.nan)
        if quaternions is None:
            quaternions = _NO_TURN.repeat(0 if self.quaternions is None else len(slots), 0)
        new, newest_ns = (positions, sigma, quaternions), (self.last_ns, self.far_ns)
        stamps = np.full(len(slots), stamps)
        return insert(slots, stamps, new, self.columns, newest_ns, self._complete, self.far)

    def evictable(self, oldest_ns: int) -> tuple[Slots, Slots]:
        """Slots with observations older than a time, and how many of them: (slots [n], counts [n])."""
        slots, counts = self.slots(), np.zeros(self.capacity, np.intp)
        old = slots
        while len(old):
            at = self.start[old] + counts[old]
            old = old[(at < self.stop[old]) & (self.times[old, at % self._rows] < oldest_ns)]
            counts[old] += 1
        affected = slots[counts[slots] > 0]
        return affected, counts[affected]

    def evict(self, slots: Slots, counts: Slots) -> None:
        """Drop the oldest observations of slots."""
        self.start[slots] += counts
        self._complete[slots] = False
        held = np.flatnonzero(self.used & (self.stop > self.start))
        oldest = self.times[held, self.start[held]].min(initial=np.iinfo(np.int64).max)
        del self.instants[: bisect_left(self.instants, int(oldest))]

    def _reserve(self, slots: Slots, more: int) -> None:
        """Make sure that every slot can take some more observations."""
        slots = np.unique(slots) if more > 1 else slots
        while len(full := slots[self.stop[slots] + more > self._rows]):
            if int(self.counts(full).max()) + more - 1 <= 3 * self._rows // 4:
                self._compact(full)
                return
            self._renew_columns(self.capacity, 2 * self._rows)

    def _compact(self, slots: Slots) -> None:
        """Move the observations of slots to the beginning of their rows."""
        spans = self._spans(slots)
        for name in _COLUMNS:
            if (column := getattr(self, name)) is not None:
                for slot, start, stop in spans:
                    column[slot, : stop - start] = column[slot, start:stop]
        self.stop[slots] -= self.start[slots]
        self.start[slots] = 0

    def _spans(self, slots: Slots) -> list[tuple[int, int, int]]:
        """Slots, each with the begin and end of its observations: slices are copied faster than by masks."""
        return list(zip(slots.tolist(), self.start[slots].tolist(), self.stop[slots].tolist(), strict=True))

    def _grow_slots(self) -> None:
        extra = max(_FIRST_SLOTS, self.capacity)
        self._renew_columns(self.capacity + extra, self._rows)
        for name in _PER_SLOT:
            column = getattr(self, name)
            fresh = np.full((extra, *column.shape[1:]), _FRESH.get(name, 0), column.dtype)
            setattr(self, name, np.concatenate([column, fresh]))
        self._free.extend(range(self.capacity + extra - 1, self.capacity - 1, -1))
        self.capacity += extra

    def _renew_columns(self, slots: int, rows: int) -> None:
        """Copy the slots in use into new columns of a size; memory that is never written costs nothing."""
        spans = self._spans(np.flatnonzero(self.used))
        for name in _COLUMNS:
            if (column := getattr(self, name)) is not None:
                grown = untouched_zeros((slots, rows, *column.shape[2:]), column.dtype)
                for slot, start, stop in spans:
                    grown[slot, start:stop] = column[slot, start:stop]
                setattr(self, name, grown)
        self._rows = rows

    def state(self) -> dict[str, Any]:
        """Everything the window holds, as plain arrays of their own."""
        slots = self.slots()
        counts = self.counts(slots)
        state: dict[str, Any] = {"next_key": self._next_key, "counts": counts}
        state |= {name: getattr(self, name)[slots] for name in _KEPT}
        spans = self._spans(slots)
        for name in _COLUMNS:
            if (column := getattr(self, name)) is not None:
                parts = [column[slot, start:stop] for slot, start, stop in spans]
                state[name] = np.concatenate([column[:0, 0], *parts])
        return state

    def load(self, state: dict[str, Any]) -> Slots:
        """Fill an empty window from :meth:`state`; returns the slots in the order of the state."""
        counts = state["counts"]
        slots = self.open(len(counts), 0)
        while counts.size and self._rows < counts.max():
            self._renew_columns(self.capacity, 2 * self._rows)
        if "quaternions" in state:
            self.quaternions = np.full((self.capacity, self._rows, 4), np.nan)
        places = np.repeat(slots, counts), ranks(np.repeat(slots, counts), np.arange(counts.sum()))
        self.start[slots], self.stop[slots] = 0, counts
        for name in state.keys() - {"next_key", "counts"}:
            getattr(self, name)[places if name in _COLUMNS else slots] = state[name]
        self._next_key = state["next_key"]
        self.instants = np.unique(state["times"]).tolist()
        return slots
