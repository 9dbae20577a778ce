"""One coordinate space: its trajectories, which of them are current, and the method over them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comotion_schemas import Event, Hypothesis

from .arrays import Bools, Floats, Labels, Slots
from .config import FusionConfig, to_ns
from .event_time.stats import Stats
from .event_time.timeline import Instant
from .hypotheses.description import describe
from .hypotheses.identity import IdAllocator, LabelMemory
from .partition import Method, MethodFactory, Rows, SpaceSpec
from .trajectories.window import Window

_MIN_OBSERVATIONS = 2
# A part of the ids that may differ from those sent before without all being looked for.
_FEW = 16
# m or px. Farther out, single precision resolves no motion, and squares of squares leave their range.
MAX_COORDINATE = 1e9

Ids = NDArray[np.uint64]


@dataclass(frozen=True)
class SpaceUpdate:
    """What one update says of a space.

    `labels` int64 [n] hypothesis id or negative, `confidence` float64 [n] in 0..1, in the order of
    `space.current`; `events` are those of this update only.
    """

    space: "Space"
    labels: Labels
    confidence: Floats
    hypotheses: list[Hypothesis]
    events: list[Event]


class Space:
    """Trajectories of one space and the method that groups them.

    States in different spaces are not comparable, so spaces share nothing but the id allocator.
    """

    def __init__(
        self, config: FusionConfig, spec: SpaceSpec, make: MethodFactory, ids: IdAllocator, stats: Stats
    ) -> None:
        self.spec = spec
        self._config = config
        self._stats = stats
        self.window = Window(spec.dim, to_ns(config.window), to_ns(config.track_timeout))
        self.method: Method = make(config, spec)
        self.memory = LabelMemory(ids)
        # (source index, id) of every slot in use, and back.
        self._slot_of: dict[tuple[int, int], int] = {}
        self.ids: Ids = np.zeros(0, np.uint64)
        # Ids that a source last sent, and their slots.
        self._last_sent: dict[int, tuple[Ids, Slots]] = {}
        self.current: Slots = np.zeros(0, np.intp)
        self._opened = 0

    def store(self, instant: Instant, source: int, room: int) -> None:
        """Put one instant of one source into the window and tell the method.

        Parameters
        ----------
        instant
            Released rows, in event-time order.
        source
            Index of the (source, session) the ids belong to.
        room
            How many new trajectories may be opened; the rows of others are refused.
        """
        batch, rows = instant.batch, instant.rows
        slots = self._find_or_open(_those(batch.ids, rows), source, room)
        known = slots >= 0
        if not known.any():
            return
        ended = known & self.window.ended[slots]
        if ended.any():
            # An id that its source has declared lost for good must not come back.
            self._stats.reject("duplicate-id")
        keep = known & ~ended
        if not keep.all():
            slots, rows = slots[keep], rows[keep]
        self._insert(instant, slots, rows)

    def _insert(self, instant: Instant, slots: Slots, rows: NDArray[np.intp]) -> None:
        batch = instant.batch
        if not len(slots):
            return
        sigma = np.full(len(rows), np.nan)
        if batch.sigma is not None:
            sigma[:] = _those(batch.sigma, rows) if isinstance(batch.sigma, np.ndarray) else batch.sigma
            # Noise beyond what coordinates can express says no more than at these ends, and squares badly.
            np.clip(sigma, 1 / MAX_COORDINATE, MAX_COORDINATE, out=sigma)
        turns = None if batch.quaternions is None else _those(batch.quaternions, rows).astype(np.float64)
        positions = _those(batch.positions, rows).astype(np.float64)
        stored = self.window.insert(slots, instant.stamp_ns, positions, sigma, turns)
        self._stats.observations += int(stored.sum())
        self._stats.duplicates += not stored.all()
        if stored.any():
            self.method.observed(self.window, Rows(instant.stamp_ns, slots[stored], instant.in_order))

    def _find_or_open(self, ids: Ids, source: int, room: int) -> Slots:
        slots = self._find(ids, source)
        fresh = np.flatnonzero(slots < 0)
        if len(fresh) > room:
            self._stats.reject("limit")
            fresh = fresh[:room]
        if len(fresh):
            slots[fresh] = self._open(ids[fresh], source)
        self._last_sent[source] = ids.copy(), slots
        return slots

    def _find(self, ids: Ids, source: int) -> Slots:
        """Slots of ids, -1 where there is none; most are those that the source sent last."""
        slots = self._found_again(ids, source)
        for k in np.flatnonzero(slots < 0).tolist():
            slots[k] = self._slot_of.get((source, int(ids[k])), -1)
        return slots

    def _found_again(self, ids: Ids, source: int) -> Slots:
        """Slots of the ids that the source sent last, -1 for the others."""
        sent, slots = self._last_sent.get(source, (ids[:0], np.zeros(0, np.intp)))
        if not len(sent) or not self.window.capacity:
            return np.full(len(ids), -1)
        # Most sources send the same again, but for a few that are replaced in their place.
        if len(sent) != len(ids) or np.count_nonzero(sent != ids) > len(ids) // _FEW:
            order = np.argsort(sent, kind="stable")
            at = order[np.minimum(np.searchsorted(sent, ids, sorter=order), len(sent) - 1)]
            slots = slots[at]
        # A slot may have been given to another since.
        window = self.window
        same = window.used[slots] & (window.source[slots] == source) & (self.ids[slots] == ids)
        return np.where(same & (slots >= 0), slots, -1)

    def _open(self, ids: Ids, source: int) -> Slots:
        slots = self.window.open(len(ids), source)
        if len(self.ids) < self.window.capacity:
            self.ids = np.concatenate([self.ids, np.zeros(self.window.capacity - len(self.ids), np.uint64)])
        self.ids[slots] = ids
        self._slot_of.update(((source, i), int(s)) for i, s in zip(ids.tolist(), slots, strict=True))
        self._stats.tracks += len(ids)
        self._opened += len(ids)
        return slots

    def end(self, ids: Ids, source: int) -> None:
        """Mark trajectories as lost for good."""
        slots = [self._slot_of[source, i] for i in ids.tolist() if (source, i) in self._slot_of]
        self.window.ended[slots] = True

    def end_source(self, source: int) -> None:
        """Mark every trajectory of a session that is over."""
        self.window.ended |= self.window.used & (self.window.source == source)
        self._last_sent.pop(source, None)

    def occupied(self) -> int:
        """Trajectories that count against the limit: those current at the last update or opened since.

        A source that churns keeps a tail of outdated trajectories in the window; they count by the
        quarter, which bounds memory without starving the living.
        """
        used = int(self.window.used.sum())
        return max(len(self.current) + self._opened, used // 4)

    def update(self, stamp_ns: int, timeout_ns: Callable[[int], int]) -> SpaceUpdate:
        """Let the window follow the watermark and partition what is current.

        `timeout_ns` gives the time without observation after which a trajectory of a source index
        is outdated.
        """
        window = self.window
        slots, counts = window.evictable(stamp_ns - window.span_ns)
        if len(slots):
            self.method.evicting(window, slots, counts)
            window.evict(slots, counts)
        fresh = self._fresh(stamp_ns, timeout_ns)
        self._forget(fresh)
        self.current = window.slots()
        self.current = self.current[fresh[self.current] & ~window.ended[self.current]]
        self._opened = 0
        partition = self.method.partition(window, self.current, stamp_ns, self.memory.previous(window))
        labels = self.memory.name(window, partition, self.current, self.method.matching)
        events = self.memory.note(window, stamp_ns)
        hypotheses = describe(self.spec.name, partition, self.memory.ids, labels, self.memory.references)
        return SpaceUpdate(self, labels, partition.confidence, hypotheses, events)

    def _fresh(self, stamp_ns: int, timeout_ns: Callable[[int], int]) -> Bools:
        limits = np.zeros(self.window.capacity, np.int64)
        for source in self.sources_in_use():
            limits[self.window.source == source] = timeout_ns(source)
        # Where the window is shorter than the timeout, what has left it has no state to report.
        held = self.window.stop > self.window.start
        # Compare stamps, not differences: the smallest int64 stands for "never observed".
        return self.window.used & held & (self.window.last_ns >= stamp_ns - limits)

    def _forget(self, fresh: Bools) -> None:
        """Let go of trajectories that are outdated and too short to say anything."""
        window = self.window
        gone = np.flatnonzero(window.used & ~fresh & (window.stop - window.start < _MIN_OBSERVATIONS))
        if not len(gone):
            return
        gone = gone[np.argsort(window.key[gone])]
        self.method.forgetting(window, gone)
        self.memory.forget(window, gone)
        for slot in gone.tolist():
            del self._slot_of[int(self.window.source[slot]), int(self.ids[slot])]
        self.window.close(gone)

    def sources_in_use(self) -> set[int]:
        """Indices of the sessions that have a trajectory here."""
        return set(np.flatnonzero(np.bincount(self.window.source[self.window.used])).tolist())

    def state(self) -> dict[str, Any]:
        """The window, the method and the labels, as plain values and arrays."""
        slots = self.window.slots()
        return {
            "name": self.spec.name,
            "unit": self.spec.unit,
            "dim": self.spec.dim,
            "ids": self.ids[slots],
            "window": self.window.state(),
            "method": self.method.state(),
            "memory": self.memory.state(self.window),
        }

    def load(self, state: dict[str, Any], *, keep_method: bool) -> None:
        """Take up :meth:`state`; without `keep_method` the trajectories alone."""
        slots = self.window.load(state["window"])
        self.ids = np.zeros(self.window.capacity, np.uint64)
        self.ids[slots] = state["ids"]
        sources = self.window.source[slots].tolist()
        self._slot_of = {
            (s, i): int(slot) for s, i, slot in zip(sources, state["ids"].tolist(), slots, strict=True)
        }
        self.method.load(state["method"] if keep_method else {}, self.window)
        self.memory.load(state["memory"] if keep_method else {}, self.window)


def _those(column: NDArray[Any], rows: NDArray[np.intp]) -> NDArray[Any]:
    """Some rows of a column, ascending; mostly they are all of them."""
    return column if len(rows) == len(column) else column[rows]
