"""The last partition of a space in, the same one for the trajectories of now out."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from .arrays import Bools, Slots, Stamps
from .partition import NO_HYPOTHESIS, Partition
from .trajectories.window import Window

Ids = NDArray[np.uint64]


@dataclass(frozen=True)
class LastGrouping:
    """A partition, and whose it was.

    Attributes
    ----------
    partition
        As the method has found it.
    current
        intp [n], the slots that were current.
    keys, current_keys
        int64, of the trajectories that were in the slots of the partition, and in `current`.
    sessions, ids
        intp [n] and uint64 [n]: who the current ones were.
    """

    partition: Partition
    current: Slots
    keys: Stamps
    current_keys: Stamps
    sessions: Slots
    ids: Ids

    @classmethod
    def of(cls, window: Window, partition: Partition, current: Slots, ids: Ids) -> Self:
        """Take down a partition of the trajectories of now."""
        keys = window.key[partition.slots], window.key[current]
        return cls(partition, current, *keys, window.source[current], ids)

    def carried(self, window: Window, current: Slots) -> Partition:
        """The same groups; trajectories that are new since belong to none.

        Parameters
        ----------
        current
            intp [n], the slots that are current now.
        """
        last = self.partition
        kept = _same(window, last.slots, self.keys)
        groups, deciding = np.full(window.capacity, NO_HYPOTHESIS), np.zeros(window.capacity, np.bool_)
        groups[last.slots[kept]], deciding[last.slots[kept]] = last.groups[kept], last.deciding[kept]
        confidence, known = np.zeros(window.capacity), _same(window, self.current, self.current_keys)
        confidence[self.current[known]] = last.confidence[known]
        slots = np.union1d(current, last.slots[kept])
        return replace(
            last,
            slots=slots,
            groups=groups[slots],
            deciding=deciding[slots],
            confidence=confidence[current],
            position=window.positions[current, window.stop[current] - 1],
        )


def _same(window: Window, slots: Slots, keys: Stamps) -> Bools:
    """Which slots still hold the trajectories of the keys."""
    return np.asarray(window.used[slots] & (window.key[slots] == keys))
