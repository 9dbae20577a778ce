"""The method of spaces in pixels as an engine: state between updates, identities, descriptions."""

from bisect import bisect_left, insort
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Slots
from ..config import FusionConfig
from ..hypotheses.labels import LabelMemory
from ..hypotheses.propagation import propagate
from ..partition import NO_HYPOTHESIS, IdAllocator, Partition, Rows, SpaceSpec
from ..trajectories.window import Window
from .describe import describe
from .grouping import group
from .keyframes import Floats32, KeyFrames, key_frames, spread
from .parameters import PixelParameters
from .young import adopt

# Affinity of a pair that has not been compared (ARCHITECTURE.md: too little time in common).
_UNKNOWN_AFFINITY = 0.5
_NOBODY: Slots = np.zeros(0, np.intp)
_NONE: Floats32 = np.zeros((0, 0), np.float32)


class PixelEngine:
    """Engine of one space in pixels.

    Parameters
    ----------
    config
        Only the window matters here, and that is the space's affair.
    spec
        The space.
    ids
        Where new hypotheses get their ids.
    parameters
        Of the method.
    """

    def __init__(
        self,
        config: FusionConfig,  # noqa: ARG002 - every engine is built from the same three
        spec: SpaceSpec,
        ids: IdAllocator,
        parameters: PixelParameters | None = None,
    ) -> None:
        self._spec = spec
        self._ids = ids
        self._p = parameters or PixelParameters()
        self._stamps: list[int] = []
        self._memory = LabelMemory()
        # Of the last update: who was current, who was compared, and their similarity.
        self._compared: tuple[Slots, Slots, Floats32] = (_NOBODY, _NOBODY, _NONE)

    def observed(self, window: Window, rows: Rows) -> None:  # noqa: ARG002
        """One instant of one source has been stored."""
        at = bisect_left(self._stamps, rows.stamp_ns)
        if at == len(self._stamps) or self._stamps[at] != rows.stamp_ns:
            insort(self._stamps, rows.stamp_ns)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """The oldest observations of some slots are about to go: nothing is kept of them."""

    def forgetting(self, window: Window, slots: Slots) -> None:
        """Slots are about to be freed."""
        self._memory.forget(window, slots)

    def update(self, window: Window, current: Slots, stamp_ns: int) -> Partition:
        """Partition the current trajectories.

        The dead of the window are compared as well: they connect those that came after them.
        """
        self._memory.fit(window)
        label = self._memory.label
        del self._stamps[: bisect_left(self._stamps, stamp_ns - window.span_ns)]
        held = label[current]
        grown, frames = self._grown(window, current)
        found = group(frames, self._p, before=label[grown]) if len(grown) > 1 else None
        confidence, residual = np.zeros(window.capacity), np.full(window.capacity, np.nan)
        if found is not None:
            label[grown] = propagate(label[grown], found.labels, self._ids.next)
            confidence[grown], residual[grown] = found.confidence, found.similarity.residual
        self._adopt(window, current, grown, held, confidence)
        labels = label[current]
        self._memory.lead(window, np.union1d(current, grown), held, labels)
        self._compared = (current, grown, found.similarity.value) if found else (current, _NOBODY, _NONE)
        events = self._memory.note(window, stamp_ns)
        births = self._memory.born_ns
        described = describe(window, current, labels, residual[current], self._spec.name, births)
        return Partition(labels, confidence[current], described, events)

    def _grown(self, window: Window, current: Slots) -> tuple[Slots, KeyFrames]:
        """Trajectories that can be compared, by key, on the key frames of the window."""
        stamps = np.array(self._stamps, np.int64)
        stamps = stamps[spread(len(stamps), self._p.key_frames)]
        slots = window.slots()
        frames = key_frames(window, slots, stamps)
        ready = choose(frames.visible.sum(axis=0), ~np.isin(slots, current), self._p)
        return slots[ready], frames.of(ready)

    def _adopt(self, window: Window, current: Slots, grown: Slots, held: Slots, confidence: Floats) -> None:
        """Labels for the current trajectories that could not be compared."""
        young, label = ~np.isin(current, grown), self._memory.label
        if not young.any():
            return
        labelled = grown[label[grown] != NO_HYPOTHESIS]
        known = labelled, label[labelled], held[young]
        labels, share = adopt(window, current[young], *known, self._p.motion_weight)
        label[current[young]] = labels
        confidence[current[young]] = share / 2

    def affinity(self) -> NDArray[np.float32]:
        """Similarity [n, n] of the last update's trajectories; 0.5 where not compared."""
        current, grown, value = self._compared
        affinity = np.full((len(current), len(current)), _UNKNOWN_AFFINITY, np.float32)
        _, rows, index = np.intersect1d(current, grown, assume_unique=True, return_indices=True)
        # Rounding and the floors of its factors can lift a similarity above 1.
        affinity[np.ix_(rows, rows)] = np.minimum(value[np.ix_(index, index)], np.float32(1))
        np.fill_diagonal(affinity, 1.0)
        return affinity

    def state(self, window: Window) -> dict[str, Any]:
        """Labels of all trajectories, since when there are the hypotheses, and so the warm start."""
        return self._memory.state(window)

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Take up :meth:`state`; the instants come from the window."""
        series = [window.series(slot).times for slot in window.slots().tolist()]
        self._stamps = np.unique(np.concatenate([np.zeros(0, np.int64), *series])).tolist()
        self._memory.load(state, window)


def choose(seen: Slots, dead: NDArray[np.bool_], parameters: PixelParameters) -> Slots:
    """Indices of the trajectories that are compared, ascending.

    The living go first, then who was seen longest. How many dead ones there may be follows from the
    number of the living, so that the time of an update does too.

    Parameters
    ----------
    seen
        intp [N]; on how many key frames.
    dead
        bool [N]; not among the current ones.
    """
    p = parameters
    ready = np.flatnonzero(seen >= p.least_seen)
    living = len(ready) - int(dead[ready].sum())
    most = min(p.most_tracks, max(p.few_tracks, round((1 + p.dead_share) * living)))
    rank = np.lexsort((-seen[ready], dead[ready]))
    return np.sort(ready[rank[:most]])
