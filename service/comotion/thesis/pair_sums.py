"""Affinities of all pairs by :mod:`~comotion.thesis.equations`, computed incrementally.

At an instant at which trajectory i was observed, i and j have one distance sample if j has a state there: it
is observed too, or inside a segment (between two observations) that is short enough to interpolate (3.5).
What an instant brings follows from what the window holds and from how much of it has been taken in already;
what eviction takes away is subtracted again. The samples wait until affinities are wanted: then one pass
takes them into the sums of (3.3) of all pairs.
"""

import math
from bisect import bisect_right
from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Floats32, Slots, Stamps, untouched_zeros
from ..trajectories.window import Window
from .equations import AFFINITY_AT_SWITCH, INCOMPARABLE, weight
from .kernels import PLANES, SAMPLE_PLANES, STRIP, WEIGHT, fill_samples, update_blocks
from .rows import Rows

# Times before and after all others.
_NEVER, _LATEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max
_MIN_OBSERVATIONS = 2
# Instants that wait for a pass at most: bounds the memory that their samples take.
_MAX_INSTANTS = 64
# What a squared distance leaves in a sum when it is subtracted again is 1e-16 of it. For places so many times
# sigma_switch apart that is 1e-4 of a variance at which affinities are 0.5.
_FAR = 1e6
_NOWHERE, _NO_AFFINITIES = np.zeros(0, np.intp), np.zeros((0, 0), np.float32)


class PairSums:
    """Keeps the sums of all pairs of trajectories in step with the window.

    A trajectory takes part from its second observation on: with one it has at most one sample with any
    other, which cannot be compared, and its speed is not known yet. One that its source has given up takes
    part no more.

    Parameters
    ----------
    v_move
        Speed of λ in (3.2), in the space's unit per second; None: equal weights.
    sigma_switch
        Standard deviation at which the affinity is 0.5, in the unit of the distances.

    Attributes
    ----------
    rows
        The row in `sums` of each slot that takes part.
    sums
        float64 [blocks or more, PLANES, STRIP, STRIP], those of :func:`.kernels.update_blocks`.
    """

    def __init__(self, v_move: float | None, sigma_switch: float) -> None:
        self._v_move = v_move
        self._sigma_switch = sigma_switch
        self.rows = Rows(STRIP)
        self.sums: Floats = untouched_zeros((0, PLANES, STRIP, STRIP), np.float64)
        # Newest observation of each slot whose samples have been taken in.
        self._known: Stamps = np.zeros(0, np.int64)
        # How many observations of each slot have been taken in.
        self._held: Slots = np.zeros(0, np.intp)
        # Samples at the instants that wait, of which there are so many, and whether they come or go.
        self._samples: Floats = np.zeros((0, _MAX_INSTANTS, SAMPLE_PLANES, STRIP))
        self._signs: Floats = np.zeros(_MAX_INSTANTS)
        self._waiting = 0
        self._room: Floats32 = np.zeros(0, np.float32)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out all samples that need one of the oldest `counts[k]` observations of `slots[k]`.

        Those are its own samples, and those of others after it up to its next observation: the common
        interval begins there now.
        """
        self._take_in(window)
        part = self.rows.of[slots] >= 0
        slots, counts = slots[part], counts[part]
        stay = (window.counts(slots) - counts >= _MIN_OBSERVATIONS) & ~self._far(window, slots, counts)
        if stay.any():
            self._shorten(window, slots[stay], counts[stay])
        self.forget(slots[~stay])
        self._held[slots[stay]] -= counts[stay]

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories; those that the window still holds come in again."""
        slots = slots[slots < len(self._known)]
        slots = slots[self.rows.of[slots] >= 0]
        self._known[slots], self._held[slots] = _NEVER, 0
        for row in self.rows.of[slots].tolist():
            strip, inside = divmod(row, STRIP)
            self._samples[strip, :, :, inside] = 0.0
            first = _blocks(strip)
            self.sums[first : first + strip + 1, :, inside, :] = 0.0
            below = np.arange(strip, len(self._samples))
            self.sums[_blocks(below) + strip, :, :, inside] = 0.0
        self.rows.give_back(slots)

    def order(self, window: Window, slots: Slots) -> Slots:
        """In which order :meth:`affinity` takes least time: which slot comes first and so on, intp [n]."""
        self._take_in(window)
        return np.argsort(self.rows.of[slots], kind="stable")

    def affinity(self, window: Window, slots: Slots) -> Floats32:
        """Affinity (3.4) of each pair of trajectories.

        Parameters
        ----------
        window
            Store of the trajectories.
        slots
            intp [n].

        Returns
        -------
        NDArray[float32]
            [n, n], symmetric; 0.5 for pairs with fewer than two common samples. Overwritten by the next call.
        """
        self._take_in(window)
        n = len(slots)
        if len(self._room) < n * n:
            self._room = untouched_zeros((n * n + n * n // 4,), np.float32)
        affinity = self._room[: n * n].reshape(n, n)
        rows = self.rows.of[slots]
        part = rows >= 0
        place = np.full(len(self._samples) * STRIP, -1)
        place[rows[part]] = np.flatnonzero(part)
        self._pass(place, affinity)
        np.exp(affinity, out=affinity)
        affinity[~part], affinity[:, ~part] = INCOMPARABLE, INCOMPARABLE
        np.fill_diagonal(affinity, 1.0)
        return affinity

    def _fit(self, window: Window) -> None:
        """Hold all slots."""
        extra = window.capacity - len(self._known)
        if extra:
            self._known = np.pad(self._known, (0, extra), constant_values=_NEVER)
            self._held = np.pad(self._held, (0, extra))
            self.rows.fit(window.capacity)

    def _begin(self, window: Window, slots: Slots) -> None:
        """Give rows, and room for the sums, to trajectories that take part from now on."""
        self.rows.take(slots, window.source[slots])
        if self.rows.strips == len(self._samples):
            return
        if self._waiting:
            self._pass()
        self._samples = np.zeros((self.rows.strips, *self._samples.shape[1:]))
        if _blocks(self.rows.strips) > len(self.sums):
            # Twice as many at once: growing copies everything.
            grown = untouched_zeros((2 * _blocks(self.rows.strips), *self.sums.shape[1:]), np.float64)
            grown[: len(self.sums)] = self.sums
            self.sums = grown

    def _taking_part(self, window: Window) -> Slots:
        lasting = window.used & ~window.ended
        return np.flatnonzero(lasting & (window.stop - window.start >= _MIN_OBSERVATIONS))

    def _take_in(self, window: Window) -> None:
        """Note the samples that observations have brought since the last time."""
        self._fit(window)
        self.forget(np.flatnonzero(window.ended))
        slots = self._taking_part(window)
        first = window.start[slots] + self._held[slots]
        # A late observation changes the segment that it divides, so all of its trajectory comes in again.
        late = (self._held[slots] > 0) & (window.times[slots, first - 1] != self._known[slots])
        self.forget(slots[late])
        first[late] = window.start[slots[late]]
        fresh = first < window.stop[slots]
        if not fresh.any():
            return
        self._begin(window, slots[self.rows.of[slots] < 0])
        newest = window.times[slots, window.stop[slots] - 1]
        since = self._summed_until(window, slots[fresh], first[fresh])
        after, until = np.full((2, len(slots)), _LATEST)
        after[fresh] = since
        self._enqueue(window, slots, (after, until), (int(since.min()), int(newest[fresh].max())), 1.0)
        self._known[slots], self._held[slots] = newest, window.counts(slots)

    def _summed_until(self, window: Window, slots: Slots, first: Slots) -> Stamps:
        """States later than this are not in the sums yet, ns [n]; `first` is the first new observation."""
        known, next_ns = self._known[slots], window.times[slots, first]
        # The segment that ends with the first new observation is new as well.
        follows = known != _NEVER
        follows[follows] = next_ns[follows] - known[follows] <= window.gap_ns
        return np.where(follows, known, next_ns - 1)

    def _far(self, window: Window, slots: Slots, counts: Slots) -> Bools:
        """Which slots were so far away, at an observation that goes, that subtracting it leaves a trace."""
        first, now = window.start[slots], window.positions[slots, window.stop[slots] - 1]
        gone = (first + np.minimum(k, counts - 1) for k in range(counts.max(initial=0)))
        away = [np.abs(window.positions[slots, at] - now).max(axis=1) for at in gone]
        return np.asarray(np.max(away, axis=0, initial=0.0) > _FAR * self._sigma_switch)

    def _shorten(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Note the samples that go with the oldest observations of each slot."""
        part, first = self._taking_part(window), window.start[slots]
        begin, gone = window.times[slots, first + counts], window.times[slots, first + counts - 1]
        after, until = np.full((2, len(part)), _NEVER)
        until[np.searchsorted(part, slots)] = np.where(begin - gone <= window.gap_ns, begin - 1, gone)
        oldest = int(window.times[slots, first].min())
        self._enqueue(window, part, (after, until), (oldest - 1, int(until.max())), -1.0)

    def _enqueue(
        self, window: Window, slots: Slots, of: tuple[Stamps, Stamps], span: tuple[int, int], sign: float
    ) -> None:
        """Have the samples in a span (after, until] wait for the next pass; a full buffer makes one."""
        columns = window.times, window.positions, window.speed, window.start, window.stop, window.gap_ns
        first, last = (bisect_right(window.instants, time) for time in span)
        while first < last:
            if self._waiting == _MAX_INSTANTS:
                self._pass()
            stamps = np.array(window.instants[first : min(last, first + _MAX_INSTANTS - self._waiting)])
            wait = slice(self._waiting, self._waiting + len(stamps))
            samples = self._samples[:, wait]
            samples[:] = 0.0
            fill_samples(*columns, slots, self.rows.of[slots], stamps, *of, samples)
            samples[:, :, WEIGHT] = weight(samples[:, :, WEIGHT], self._v_move)
            self._signs[wait] = sign
            self._waiting += len(stamps)
            first += len(stamps)

    def _pass(self, place: Slots = _NOWHERE, out: Floats32 = _NO_AFFINITIES) -> None:
        """Take what waits into the sums; write the logarithms of affinities where they are wanted."""
        rate = math.log(AFFINITY_AT_SWITCH) / self._sigma_switch**2
        present = np.asarray(self._samples[:, : self._waiting].any(axis=3), np.bool_)
        signs = self._signs[: self._waiting]
        update_blocks(self.sums, self._samples, signs, present, rate, place, out)
        self._waiting = 0


def _blocks(strips: Any) -> Any:
    """Blocks of so many strips."""
    return strips * (strips + 1) // 2
