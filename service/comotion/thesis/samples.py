"""Samples the distances of pairs: which trajectories have a state when, and which pairs it concerns.

At an instant at which trajectory i was observed, i and j have one distance sample if j has a state there: it
is observed too, or inside a segment (between two observations) that is short enough to interpolate (3.5).
When states come or go, only pairs change in which one of the two is changing.
"""

from bisect import bisect_left, bisect_right, insort
from typing import Any, NamedTuple, Self

import numpy as np

from ..arrays import Slots, Stamps, aligned_zeros
from ..trajectories.window import Window
from .equations import weight_exponent
from .kernels import ABSENT, LATEST, SIGN, STATUSES, STRIP, Array, fill_samples

MOST_INSTANTS = 64
"""Instants whose samples are worked out at once: bounds the memory that this takes."""


class ObservationTimes:
    """Distinct times at which anything was observed, ascending; most come in order."""

    def __init__(self) -> None:
        self._stamps: list[int] = []

    def add(self, stamp_ns: int) -> None:
        """Add a time."""
        if not self._stamps or self._stamps[-1] < stamp_ns:
            self._stamps.append(stamp_ns)
        elif self._stamps[bisect_left(self._stamps, stamp_ns)] != stamp_ns:
            insort(self._stamps, stamp_ns)

    def add_all(self, window: Window, slots: Slots) -> None:
        """Add the times of all observations of slots."""
        index = np.arange(window.times.shape[1])
        held = (index >= window.start[slots, None]) & (index < window.stop[slots, None])
        self._stamps = sorted({*self._stamps, *window.times[slots][held].tolist()})

    def drop(self, before_ns: int) -> None:
        """Drop the times before one."""
        del self._stamps[: bisect_left(self._stamps, before_ns)]

    def between(self, after_ns: int, until_ns: int) -> Stamps:
        """Times in (after, until], int64 [k]."""
        first, last = bisect_right(self._stamps, after_ns), bisect_right(self._stamps, until_ns)
        return np.array(self._stamps[first:last], np.int64)


class Participants(NamedTuple):
    """Trajectories that have samples, and which of their states come or go.

    Attributes
    ----------
    slots, rows
        intp [n]: slots of the window and rows of the pair sums.
    after, until
        int64 [n] ns: the states in (after, until] are changing.
    """

    slots: Slots
    rows: Slots
    after: Stamps
    until: Stamps

    @classmethod
    def of(cls, slots: Slots, rows: Slots) -> Self:
        """Trajectories of which nothing is changing yet."""
        return cls(slots, rows, *np.full((2, len(slots)), LATEST))


class SampleBuffer:
    """Samples of T instants among the rows of some strips, with space for a few more instants.

    The status of a row at an instant is ABSENT without a state there, or else the sum of OBSERVED and
    CHANGING. Two rows are partners in a sample if one of them is observed and one of them is changing.

    Parameters
    ----------
    strips
        Number of strips, each of STRIP rows.
    dtype
        Of `values`.
    capacity
        Most instants.

    Attributes
    ----------
    count
        T.
    values
        [strips, capacity, 8, STRIP], a strip and instant in one piece: x, y and z (zero beyond the space's
        dimension), the weight, and for each status of a partner 1, -1 where the sample is taken out, or 0
        where there is none. The first four planes mean nothing where a row is ABSENT.
    status
        int8 [strips, capacity, STRIP].
    any_partner
        bool [strips, capacity, 4]: whether any row of a strip is a partner for rows of a status.
    """

    def __init__(self, strips: int, dtype: np.dtype[Any], capacity: int = MOST_INSTANTS) -> None:
        self.count = 0
        self.values: Array = aligned_zeros((strips, capacity, SIGN + STATUSES, STRIP), dtype)
        self.status: Array = np.full((strips, capacity, STRIP), ABSENT, np.int8)
        self.any_partner: Array = np.zeros((strips, capacity, STATUSES), np.bool_)

    @property
    def strips(self) -> int:
        """Number of strips."""
        return len(self.status)

    @property
    def free(self) -> int:
        """How many more instants fit."""
        return int(self.status.shape[1]) - self.count

    def fit(self, strips: int) -> None:
        """Hold so many strips; the rows of new ones are absent."""
        if strips <= self.strips:
            return
        wider, t, old = SampleBuffer(strips, self.values.dtype), self.count, self.strips
        wider.values[:old, :t], wider.any_partner[:old, :t] = self.values[:, :t], self.any_partner[:, :t]
        wider.status[:old, :t] = self.status[:, :t]
        self.values, self.status, self.any_partner = wider.values, wider.status, wider.any_partner

    def drop(self, rows: Slots) -> None:
        """Take the samples of some rows out."""
        strip, inside = rows // STRIP, rows % STRIP
        self.status[strip, :, inside] = ABSENT
        self.values[strip, :, SIGN:, inside] = 0

    def add(
        self, window: Window, who: Participants, stamps: Stamps, *, sign: int, v_move: float | None
    ) -> None:
        """Append the samples that come (`sign` 1) or go (-1) at some more instants.

        Parameters
        ----------
        window
            Store of the trajectories.
        who
            The trajectories that have samples.
        stamps
            int64 [T] ns, ascending; T of `free` or less.
        sign
            1 or -1.
        v_move
            Speed of λ in (3.2), or None.
        """
        if not len(stamps):
            return
        part = slice(self.count, self.count + len(stamps))
        out = self.values[:, part], self.status[:, part], self.any_partner[:, part]
        columns = window.times, window.positions, window.speed, window.start, window.stop
        fill_samples(*columns, *who, stamps, window.gap_ns, sign, *weight_exponent(v_move), *out)
        self.count += len(stamps)
