"""Assigns each trajectory a row of the sums of all pairs."""

import numpy as np

from ..arrays import Slots

_NONE = -1


class Rows:
    """Rows in strips, each of which holds trajectories of one source.

    Such trajectories are observed at the same instants: at most instants a pair of strips then has either
    samples of all its pairs or of none.

    Parameters
    ----------
    strip
        Rows of a strip.

    Attributes
    ----------
    of
        intp [slots], the row of each slot, -1 for none.
    slots
        intp [rows], the slot of each row, -1 for none.
    """

    def __init__(self, strip: int) -> None:
        self._strip = strip
        self.of: Slots = np.zeros(0, np.intp)
        self.slots: Slots = np.zeros(0, np.intp)
        # Of each strip, -1 for none.
        self._source: Slots = np.zeros(0, np.intp)

    def fit(self, capacity: int) -> None:
        """Grow to a number of slots."""
        self.of = np.pad(self.of, (0, capacity - len(self.of)), constant_values=_NONE)

    def take(self, slots: Slots, sources: Slots) -> None:
        """Give rows to slots that have none, intp [n], each of a source, intp [n]."""
        for source in np.unique(sources).tolist():
            rowless = slots[sources == source]
            while len(free := self._free(source)) < len(rowless):
                self._open(source)
            self.of[rowless], self.slots[free[: len(rowless)]] = free[: len(rowless)], rowless

    def _free(self, source: int) -> Slots:
        return np.flatnonzero((self.slots == _NONE) & (np.repeat(self._source, self._strip) == source))

    def _open(self, source: int) -> None:
        """Assign an unused strip, or a new one, to a source."""
        if not (self._source == _NONE).any():
            self._source = np.append(self._source, _NONE)
            self.slots = np.pad(self.slots, (0, self._strip), constant_values=_NONE)
        self._source[np.flatnonzero(self._source == _NONE)[0]] = source

    def give_back(self, slots: Slots) -> None:
        """Free the rows of slots that have one."""
        self.slots[self.of[slots]] = _NONE
        self.of[slots] = _NONE
        self._source[(self.slots == _NONE).reshape(-1, self._strip).all(1)] = _NONE
