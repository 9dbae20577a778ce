"""The times at which anything was observed."""

from bisect import bisect_left, bisect_right, insort

import numpy as np

from ..arrays import Stamps


class Instants:
    """Distinct times, in order; most come in order."""

    def __init__(self) -> None:
        self._stamps: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """Note a time."""
        if not self._stamps or self._stamps[-1] < stamp_ns:
            self._stamps.append(stamp_ns)
        elif self._stamps[bisect_left(self._stamps, stamp_ns)] != stamp_ns:
            insort(self._stamps, stamp_ns)

    def learn(self, stamps: Stamps) -> None:
        """Note many times."""
        self._stamps = sorted({*self._stamps, *stamps.tolist()})

    def drop(self, before_ns: int) -> None:
        """Forget the times before one."""
        del self._stamps[: bisect_left(self._stamps, before_ns)]

    def between(self, after_ns: int, until_ns: int) -> Stamps:
        """Times in (after, until], int64 [k]."""
        first, last = bisect_right(self._stamps, after_ns), bisect_right(self._stamps, until_ns)
        return np.array(self._stamps[first:last], np.int64)
