"""The default method in spaces of unit px: groups image trajectories by body.

Before a camera that rests, or a background that moves smoothly, the belief of each trajectory is carried from
update to update (:mod:`.resting`). Before any other:

1. Choose key frames and the trajectories that are compared on them (:mod:`.key_frames`).
2. Group them, in the steps 2 to 6 of :mod:`.grouping`.
7. Put those that are too short to be compared into the groups of their neighbours (:mod:`.newborns`).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..arrays import Floats32, Slots
from ..partition import NO_HYPOTHESIS, Method, Partition, Previous
from ..trajectories.window import Window
from .belief import BACKGROUND, Belief
from .describe import alone_at_rest, describe, of_moving_camera
from .grouping import group
from .key_frames import compared_trajectories
from .newborns import assign_newborns
from .resting import RestingCamera

# Affinity of a pair that has not been compared: nothing is known for or against it.
_UNKNOWN_AFFINITY = 0.5


class PixelMethod(Method):
    """The method of one space in pixels."""

    def __init__(self) -> None:
        self._camera = RestingCamera()
        no_slots: Slots = np.zeros(0, np.intp)
        # Of the last update: current slots, compared slots, and the similarity of these.
        self._last: tuple[Slots, Slots, Floats32] = (no_slots, no_slots, np.zeros((0, 0), np.float32))

    def partition(self, window: Window, current: Slots, stamp_ns: int, previous: Previous) -> Partition:
        """Group the current trajectories, and the ended ones that were compared with them."""
        belief = self._camera.advance(window, stamp_ns, previous.labels) if window.instants else None
        if belief is not None:
            return self._believed(belief, window, current)
        compared, frames = compared_trajectories(window, current)  # 1
        groups = np.full(window.capacity, NO_HYPOTHESIS)
        confidence, variance = np.zeros(window.capacity), np.full(window.capacity, np.nan)
        similarity = np.ones((len(compared), len(compared)), np.float32)
        if len(compared) > 1:
            labels, confidence[compared], similarity = group(frames, previous.labels[compared])  # 2 to 6
            groups[compared] = np.where(alone_at_rest(frames, labels), NO_HYPOTHESIS, labels)
            variance[compared] = frames.variance
        self._last = current, compared, similarity
        count = int(groups.max(initial=-1)) + 1
        newborn = current[~np.isin(current, compared)]
        if len(newborn):
            labelled = current[groups[current] != NO_HYPOTHESIS]
            groups[newborn], share = assign_newborns(window, newborn, labelled, groups[labelled])
            confidence[newborn] = share / 2
        slots = np.union1d(current, compared)
        described = describe(window, current, groups[current], variance[current], count)
        return Partition(
            slots=slots,
            groups=groups[slots],
            deciding=np.isin(slots, compared),
            confidence=confidence[current],
            position=window.newest(current),
            described=of_moving_camera(described),
        )

    def _believed(self, belief: Belief, window: Window, current: Slots) -> Partition:
        """The groups before a background that is followed."""
        slots = window.slots()
        groups, shown = belief.shown(slots), belief.shown(current)
        labels = shown[shown >= 0]
        self._last = current, current[shown >= 0], (labels[:, None] == labels).astype(np.float32)
        described = describe(window, current, shown, belief.variance[current], len(belief.bodies))
        described[BACKGROUND] = replace(described[BACKGROUND], static=not self._camera.carried)
        return Partition(
            slots=slots,
            groups=groups,
            deciding=groups >= 0,
            confidence=np.where(shown >= 0, belief.confidence(current), 0.0),
            position=window.newest(current),
            described=of_moving_camera(described) if self._camera.carried else described,
        )

    def affinity(self) -> NDArray[np.float32]:
        """Similarity [n, n] of the last update's trajectories; 0.5 where not compared."""
        current, compared, value = self._last
        affinity = np.full((len(current), len(current)), _UNKNOWN_AFFINITY, np.float32)
        _, rows, index = np.intersect1d(current, compared, assume_unique=True, return_indices=True)
        # Rounding and the floors of its factors can lift a similarity above 1.
        affinity[np.ix_(rows, rows)] = np.minimum(value[np.ix_(index, index)], np.float32(1))
        np.fill_diagonal(affinity, 1.0)
        return affinity
