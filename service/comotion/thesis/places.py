"""Where among the pairs a trajectory is: places close to those of the same source.

What is observed at an instant then lies in few blocks of places, and most tiles have nothing to do.
"""

import numpy as np

from ..arrays import Slots
from .samples import TILE

_NOBODY = -1


class Places:
    """Places of slots, handed out by blocks of TILE that each belong to one source.

    Attributes
    ----------
    of
        intp [slots]: place of a slot, -1 for none.
    blocks
        Number of blocks there are.
    """

    def __init__(self) -> None:
        self.of: Slots = np.zeros(0, np.intp)
        self.blocks = 0
        self._free: dict[int, list[int]] = {}
        self._owner: list[int] = []
        self._taken: list[int] = []

    def fit(self, slots: int) -> None:
        """Know of slots below a number."""
        self.of = np.pad(self.of, (0, slots - len(self.of)), constant_values=-1)

    def take(self, slots: Slots, sources: Slots) -> None:
        """Give places to those slots that have none."""
        without = self.of[slots] < 0
        for slot, source in zip(slots[without].tolist(), sources[without].tolist(), strict=True):
            free = self._free.setdefault(source, [])
            if not free:
                self._open(source, free)
            self.of[slot] = place = free.pop()
            self._taken[place // TILE] += 1

    def release(self, slots: Slots) -> None:
        """Take the places of slots back."""
        for slot in slots[self.of[slots] >= 0].tolist():
            block = int(self.of[slot]) // TILE
            owner = self._owner[block]
            self._free[owner].append(int(self.of[slot]))
            self.of[slot] = -1
            self._taken[block] -= 1
            if not self._taken[block]:
                # The source may never come back: let any have the block.
                self._free[owner] = [p for p in self._free[owner] if p // TILE != block]
                self._owner[block] = _NOBODY

    def _open(self, source: int, free: list[int]) -> None:
        """A block for a source: one that nobody has, or a new one."""
        if _NOBODY in self._owner:
            block = self._owner.index(_NOBODY)
        else:
            block = self.blocks
            self.blocks += 1
            self._owner.append(_NOBODY)
            self._taken.append(0)
        self._owner[block] = source
        free.extend(range(block * TILE + TILE - 1, block * TILE - 1, -1))
