"""Affinities of all pairs by :mod:`~comotion.thesis.equations`, computed incrementally.

Nothing is computed when an observation comes in: the samples (3.5) that it brings follow from what the window
holds and from how much of it has been taken in already. They are taken into the sums of (3.3) all at once,
with those that eviction takes away, when affinities are wanted: one pass over the sums of all pairs.
"""

from typing import Any

import numpy as np

from ..arrays import Floats32, Slots, Stamps, aligned_zeros
from ..partition import Rows
from ..trajectories.window import Window
from .block_sums import BlockSums
from .kernels import LATEST, NEVER, STRIP, find_unsummed
from .samples import MOST_INSTANTS, ObservationTimes, Participants, SampleBuffer

NO_ROW = -1
_NO_OWNER = -1
_MIN_OBSERVATIONS = 2
# Rounding adds up over hours: at every so many updates one block is computed again, each in its turn. With
# the default period that is one block a second.
_UPDATES_PER_REFRESH = 10


class RowIndex:
    """Rows of slots, handed out by strips that each belong to one source.

    What is observed at an instant then lies in few strips, and most blocks have nothing to do.

    Attributes
    ----------
    of
        intp [slots]: row of a slot, :data:`NO_ROW` for none.
    strips
        Number of strips.
    """

    def __init__(self) -> None:
        self.of: Slots = np.zeros(0, np.intp)
        self.strips = 0
        self._free: dict[int, list[int]] = {}
        self._owner: list[int] = []
        self._occupied: list[int] = []

    def fit(self, slots: int) -> None:
        """Hold slots below a number."""
        self.of = np.pad(self.of, (0, slots - len(self.of)), constant_values=NO_ROW)

    def assign(self, slots: Slots, sources: Slots) -> None:
        """Give rows to those of n slots that have none; `sources` intp [n] are their sources."""
        without = self.of[slots] == NO_ROW
        for slot, source in zip(slots[without].tolist(), sources[without].tolist(), strict=True):
            free = self._free.setdefault(source, [])
            if not free:
                self._open_strip(source, free)
            self.of[slot] = row = free.pop()
            self._occupied[row // STRIP] += 1

    def release(self, slots: Slots) -> None:
        """Take the rows of slots back."""
        for slot in slots[self.of[slots] != NO_ROW].tolist():
            strip = int(self.of[slot]) // STRIP
            owner = self._owner[strip]
            self._free[owner].append(int(self.of[slot]))
            self.of[slot] = NO_ROW
            self._occupied[strip] -= 1
            if not self._occupied[strip]:
                # The source may never come back: any source may have an empty strip.
                self._free[owner] = [row for row in self._free[owner] if row // STRIP != strip]
                self._owner[strip] = _NO_OWNER

    def _open_strip(self, source: int, free: list[int]) -> None:
        if _NO_OWNER in self._owner:
            strip = self._owner.index(_NO_OWNER)
        else:
            strip = self.strips
            self.strips += 1
            self._owner.append(_NO_OWNER)
            self._occupied.append(0)
        self._owner[strip] = source
        free.extend(range(strip * STRIP + STRIP - 1, strip * STRIP - 1, -1))


class PairSums:
    """Keeps the sums of all pairs of trajectories in step with the window.

    A trajectory takes part from its second observation on: with one it has at most one sample with any
    other, which cannot be compared, and its speed is not known yet. One that its source has given up takes
    part no more.

    Parameters
    ----------
    v_move
        Speed of λ in (3.2), in the space's unit per second; None: equal weights.
    dtype
        Precision of the sums: float32, or float64.

    Attributes
    ----------
    sums, rows
        The sums by rows, and the row of each slot.
    """

    def __init__(self, v_move: float | None, dtype: type[np.floating[Any]] = np.float32) -> None:
        self._v_move = v_move
        self.sums = BlockSums(dtype)
        self.rows = RowIndex()
        # Newest observation of each slot whose samples have been taken in.
        self._known: Stamps = np.zeros(0, np.int64)
        self._pending = SampleBuffer(0, self.sums.dtype)
        self._times = ObservationTimes()
        self._updates = 0
        self._room: Floats32 = np.zeros(0, np.float32)

    def observed(self, window: Window, rows: Rows) -> None:
        """Take note of observations that have just been stored."""
        self._fit(window)
        slots, stamp = rows.slots, rows.stamp_ns
        self._times.add(stamp)
        # A late observation changes the segment that it divides, so all of its trajectory comes in again.
        late = slots[self._known[slots] >= stamp]
        self._restart(late)

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out all samples that need one of the oldest `counts[k]` observations of `slots[k]`.

        Those are its own samples, and those of others after it up to its next observation: the common
        interval begins there now.
        """
        self._take_in(window)
        part = self._known[slots] != NEVER
        slots, counts = slots[part], counts[part]
        stay = window.counts(slots) - counts >= _MIN_OBSERVATIONS
        if stay.any():
            self._shorten(window, slots[stay], counts[stay])
        self._restart(slots[~stay])

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories, and their rows."""
        slots = slots[slots < len(self._known)]
        self._restart(slots)
        self.rows.release(slots)

    def rebuild(self, window: Window, slots: Slots) -> None:
        """Compute all samples of trajectories anew from the window."""
        self._fit(window)
        self._times.add_all(window, slots)
        self._restart(slots)

    def affinity(self, window: Window, slots: Slots, sigma_switch: float) -> Floats32:
        """Affinity (3.4) of each pair of trajectories.

        Parameters
        ----------
        window
            Store of the trajectories.
        slots
            intp [n].
        sigma_switch
            Standard deviation at which the affinity is 0.5, in the unit of the distances.

        Returns
        -------
        NDArray[float32]
            [n, n], symmetric; 0.5 for pairs with fewer than two common samples. Overwritten by the next call.
        """
        self._take_in(window)
        self._assign_rows(window, slots)
        n = len(slots)
        if len(self._room) < n * n:
            self._room = aligned_zeros((n * n + n * n // 4,), np.float32)
        affinity = self._room[: n * n].reshape(n, n)
        place = np.full(self.sums.strips * STRIP, -1)
        place[self.rows.of[slots]] = np.arange(n)
        wanted = sigma_switch, place, affinity
        imprecise = self.sums.add_and_compare(self._pending, *wanted)
        self._pending.count = 0
        self._updates += 1
        if self._updates % _UPDATES_PER_REFRESH == 0 and self.sums.blocks:
            next_block = self._updates // _UPDATES_PER_REFRESH % self.sums.blocks
            imprecise = np.union1d(imprecise, [next_block])
        if len(imprecise):
            self._recompute(window, imprecise)
            self.sums.compare(imprecise, *wanted)
        np.exp(affinity, out=affinity)
        np.fill_diagonal(affinity, 1.0)
        return affinity

    def _fit(self, window: Window) -> None:
        extra = window.capacity - len(self._known)
        if extra:
            self._known = np.pad(self._known, (0, extra), constant_values=NEVER)
            self.rows.fit(window.capacity)

    def _restart(self, slots: Slots) -> None:
        """Drop the samples of trajectories; those that the window still holds come in again."""
        self._known[slots] = NEVER
        rows = self.rows.of[slots]
        rows = rows[rows != NO_ROW]
        self.sums.forget(rows)
        self._pending.drop(rows)

    def _taking_part(self, window: Window) -> Slots:
        lasting = window.used & ~window.ended
        return np.flatnonzero(lasting & (window.stop - window.start >= _MIN_OBSERVATIONS))

    def _take_in(self, window: Window) -> None:
        """Note the samples that observations have brought since the last time."""
        self._fit(window)
        self.forget(np.flatnonzero(window.ended & (self.rows.of != NO_ROW)))
        slots = self._taking_part(window)
        newest = window.times[slots, window.stop[slots] - 1]
        fresh = newest > self._known[slots]
        if not fresh.any():
            return
        self._assign_rows(window, slots[fresh])
        who = Participants.of(slots, self.rows.of[slots])
        who.after[fresh] = self._unsummed_after(window, slots[fresh])
        first, last = int(who.after[fresh].min()), int(newest[fresh].max())
        self._enqueue(window, who, self._times.between(first, last), 1)
        self._known[slots] = np.maximum(self._known[slots], newest)

    def _assign_rows(self, window: Window, slots: Slots) -> None:
        self.rows.assign(slots, window.source[slots])
        self.sums.fit(self.rows.strips)
        self._pending.fit(self.rows.strips)

    def _unsummed_after(self, window: Window, slots: Slots) -> Stamps:
        after = np.empty(len(slots), np.int64)
        find_unsummed(window.times, window.start, window.stop, slots, self._known, window.gap_ns, after)
        return after

    def _shorten(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Note the samples that go with the oldest observations of each slot."""
        part = self._taking_part(window)
        who = Participants.of(part, self.rows.of[part])
        first = window.start[slots]
        begin, gone = window.times[slots, first + counts], window.times[slots, first + counts - 1]
        until = np.where(begin - gone <= window.gap_ns, begin - 1, gone)
        who.until[:] = NEVER
        index = np.searchsorted(part, slots)
        who.after[index], who.until[index] = NEVER, until
        oldest = int(window.times[slots, first].min())
        self._times.drop(oldest)
        stamps = self._times.between(oldest - 1, int(until.max()))
        self._enqueue(window, who, stamps, -1)

    def _enqueue(self, window: Window, who: Participants, stamps: Stamps, sign: int) -> None:
        """Have samples wait for the next pass over the sums; a full buffer goes there at once."""
        while len(stamps):
            if not self._pending.free:
                self.sums.add(self._pending)
                self._pending.count = 0
            part, stamps = stamps[: self._pending.free], stamps[self._pending.free :]
            self._pending.add(window, who, part, sign=sign, v_move=self._v_move)

    def _recompute(self, window: Window, blocks: Slots) -> None:
        """Sum blocks up again from the window, of which everything has been taken in."""
        part = self._taking_part(window)
        rows = self.rows.of[part]
        for block in blocks.tolist():
            strip, other = self.sums.empty(block)
            here = (rows // STRIP == strip) | (rows // STRIP == other)
            second = STRIP if other != strip else 0
            inside = rows[here] % STRIP + np.where(rows[here] // STRIP == strip, 0, second)
            who = Participants.of(part[here], inside)
            who.after[:] = NEVER
            stamps = self._times.between(NEVER, LATEST)
            samples = SampleBuffer(2 if other != strip else 1, self.sums.dtype)
            # The newest first, for their distance becomes the shift.
            for k in reversed(range(0, len(stamps), MOST_INSTANTS)):
                samples.count = 0
                samples.add(window, who, stamps[k : k + MOST_INSTANTS], sign=1, v_move=self._v_move)
                self.sums.add_to(block, samples)
