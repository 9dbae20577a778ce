"""The method of spaces in pixels: trajectories in, a partition by image motion out."""

from bisect import bisect_left, insort
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats, Floats32, Ints, Labels, Slots
from ..config import FusionConfig, PixelsConfig
from ..matching import continued, largest_first
from ..partition import NO_HYPOTHESIS, Partition, Previous, Rows, SpaceSpec
from ..trajectories.window import Window
from .describe import describe
from .grouping import group
from .key_frames import KeyFrames, key_frames, spread
from .reassignment import assign_newborns

# Affinity of a pair that has not been compared (ARCHITECTURE.md: too little time in common).
_UNKNOWN_AFFINITY = 0.5
_NOBODY: Slots = np.zeros(0, np.intp)
_NONE: Floats32 = np.zeros((0, 0), np.float32)


class PixelMethod:
    """The method of one space in pixels.

    Parameters
    ----------
    config
        Its group `pixels` matters here.
    spec
        The space.
    """

    matching = staticmethod(largest_first)

    def __init__(self, config: FusionConfig, spec: SpaceSpec) -> None:  # noqa: ARG002
        self._p = config.pixels
        self._stamps: list[int] = []
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
        """Slots are about to be freed: nothing is kept of them."""

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories.

        Compares the ended ones of the window as well: they connect those that came after them.
        """
        del self._stamps[: bisect_left(self._stamps, stamp_ns - window.span_ns)]
        grown, frames = self._grown(window, current)
        before = previous.labels[grown]
        found = group(frames, self._p, before=before) if len(grown) > 1 else None
        confidence, residual = np.zeros(window.capacity), np.full(window.capacity, np.nan)
        if found is not None:
            labels = found.labels
            confidence[grown], residual[grown] = found.confidence, found.similarity.residual
        else:
            # Nothing to compare: they stay what they were.
            known = np.unique(before[before >= 0])
            labels = np.where(before >= 0, np.searchsorted(known, before), NO_HYPOTHESIS)
        groups = np.full(window.capacity, NO_HYPOTHESIS)
        groups[grown] = labels
        count = int(labels.max(initial=-1)) + 1
        self._adopt(window, current, grown, previous, groups, confidence, count)
        self._compared = (current, grown, found.similarity.value) if found else (current, _NOBODY, _NONE)
        slots = np.union1d(current, grown)
        return Partition(
            slots=slots,
            groups=groups[slots],
            deciding=np.isin(slots, grown),
            confidence=confidence[current],
            position=window.positions[current, window.stop[current] - 1],
            described=describe(window, current, groups[current], residual[current], count),
        )

    def _grown(self, window: Window, current: Slots) -> tuple[Slots, KeyFrames]:
        """Trajectories that can be compared, by key, on the key frames of the window."""
        stamps = np.array(self._stamps, np.int64)
        stamps = stamps[spread(len(stamps), self._p.key_frames)]
        slots = window.slots()
        frames = key_frames(window, slots, stamps)
        ready = choose(frames.visible.sum(axis=0), ~np.isin(slots, current), self._p)
        return slots[ready], frames.of(ready)

    def _adopt(
        self,
        window: Window,
        current: Slots,
        grown: Slots,
        previous: Previous,
        groups: Ints,
        confidence: Floats,
        count: int,
    ) -> None:
        """Groups for the current trajectories that could not be compared."""
        young = current[~np.isin(current, grown)]
        labelled = grown[groups[grown] != NO_HYPOTHESIS]
        if not len(young):
            return
        names = _provisional(previous.labels[grown], groups[grown], count)
        known = labelled, names[groups[labelled]], previous.labels[young]
        labels, share = assign_newborns(window, young, *known, self._p.motion_weight)
        group_of = {int(name): k for k, name in enumerate(names)}
        groups[young] = [group_of.get(label, NO_HYPOTHESIS) for label in labels.tolist()]
        confidence[young] = share / 2

    def affinity(self) -> NDArray[np.float32]:
        """Similarity [n, n] of the last update's trajectories; 0.5 where not compared."""
        current, grown, value = self._compared
        affinity = np.full((len(current), len(current)), _UNKNOWN_AFFINITY, np.float32)
        _, rows, index = np.intersect1d(current, grown, assume_unique=True, return_indices=True)
        # Rounding and the floors of its factors can lift a similarity above 1.
        affinity[np.ix_(rows, rows)] = np.minimum(value[np.ix_(index, index)], np.float32(1))
        np.fill_diagonal(affinity, 1.0)
        return affinity

    def state(self) -> dict[str, Any]:
        """Nothing: previous labels are the warm start."""
        return {}

    def load(self, state: dict[str, Any], window: Window) -> None:
        """Read the instants from the window."""
        del state
        series = [window.series(slot).times for slot in window.slots().tolist()]
        self._stamps = np.unique(np.concatenate([np.zeros(0, np.int64), *series])).tolist()


def _provisional(before: Labels, groups: Ints, count: int) -> Labels:
    """Name of each group for votes, int64 [count]: the hypothesis it continues, or one above all others."""
    names = np.arange(count) + int(before.max(initial=0)) + 1
    for k, hypothesis in continued(before, groups, count, largest_first).items():
        names[k] = hypothesis
    return names


def choose(seen: Slots, dead: NDArray[np.bool_], parameters: PixelsConfig) -> Slots:
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
