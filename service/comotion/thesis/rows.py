"""Which row of the sums of all pairs each trajectory has."""

import numpy as np

from ..arrays import Slots

_NOBODY = -1


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
    """

    def __init__(self, strip: int) -> None:
        self._strip = strip
        self.of: Slots = np.zeros(0, np.intp)
        # By strip: its source; by strip and row inside: whether it is taken.
        self._source: Slots = np.zeros(0, np.intp)
        self._taken = np.zeros((0, strip), np.bool_)

    @property
    def strips(self) -> int:
        """How many strips there are."""
        return len(self._source)

    def fit(self, capacity: int) -> None:
        """Hold so many slots."""
        self.of = np.pad(self.of, (0, capacity - len(self.of)), constant_values=_NOBODY)

    def take(self, slots: Slots, sources: Slots) -> None:
        """Give rows to slots that have none, intp [n], each of a source, intp [n]."""
        for source in np.unique(sources).tolist():
            wanting = slots[sources == source]
            self._open(source, len(wanting))
            rows = np.flatnonzero(~self._taken & (self._source == source)[:, None])[: len(wanting)]
            self.of[wanting] = rows
            self._taken.flat[rows] = True

    def _open(self, source: int, count: int) -> None:
        """See to it that so many rows are free in the strips of a source."""
        missing = count - int((~self._taken[self._source == source]).sum())
        strips = -(-max(missing, 0) // self._strip)
        unused = np.flatnonzero(self._source == _NOBODY)
        more = max(strips - len(unused), 0)
        self._source = np.pad(self._source, (0, more), constant_values=_NOBODY)
        self._taken = np.pad(self._taken, ((0, more), (0, 0)))
        self._source[np.flatnonzero(self._source == _NOBODY)[:strips]] = source

    def give_back(self, slots: Slots) -> None:
        """Free the rows of slots that have one."""
        self._taken.flat[self.of[slots]] = False
        self.of[slots] = _NOBODY
        self._source[~self._taken.any(1)] = _NOBODY
