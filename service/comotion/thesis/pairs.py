"""Which distance samples of pairs come and go as the window changes: (3.2) and the set (3.5).

Nothing is computed when an observation comes in: the samples that it brings follow from what the window
holds and from how much of it has been taken in already. They are taken in all at once, with those
that eviction takes away, when affinities are asked for: one pass over the sums of all pairs.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..aligned import aligned_zeros
from ..arrays import Floats, Slots, Stamps
from ..compiled import compiled
from ..partition import Rows
from ..trajectories.instants import Instants
from ..trajectories.interpolation import locate
from ..trajectories.kernels import newest_at
from ..trajectories.window import Window
from .affinity import Affinity, Matrix
from .places import Places
from .samples import EARLIEST, LATEST, MOST_INSTANTS, TILE, Changing, Insertions, Samples
from .sums import PairSums

_MIN_OBSERVATIONS = 2
_NEVER = EARLIEST
# Rounding adds up over hours: a tile is summed anew at every so many updates, one after the other.
_UPDATES_PER_RECOUNT = 10


class Pairs:
    """Keeps the sums of all pairs of trajectories in step with the window.

    A trajectory takes part from its second observation on: with one it has at most one sample with
    any other, which cannot be compared, and its speed is not known yet. One that its source has
    given up takes part no more.

    Parameters
    ----------
    v_move
        Speed of λ in (3.2), in the space's unit per second; None: equal weights.
    dtype
        Precision of the sums: float32, or float64.
    """

    def __init__(self, v_move: float | None, dtype: type[np.floating[Any]] = np.float32) -> None:
        self._v_move = v_move
        self._sums = PairSums(dtype)
        self._places = Places()
        # Newest observation of each slot whose samples have been taken in.
        self._known: Stamps = np.zeros(0, np.int64)
        self._waiting = Samples(0, self._sums.dtype)
        self._instants = Instants()
        self._reads = 0
        self._matrix: Matrix = np.zeros((0, 0), np.float32)

    def observed(self, window: Window, rows: Rows) -> None:
        """Take note of observations that have just been stored."""
        self._fit(window)
        slots, stamp = rows.slots, rows.stamp_ns
        self._instants.add(stamp)
        late = slots[window.last_ns[slots] > stamp]
        late = late[window.times[late, window.stop[late] - 1] > stamp]
        if not len(late):
            return
        index = locate(window, late, stamp)
        # One next to the first changes what the first's speed is.
        early = index < window.start[late] + 2
        self._restart(late[early])
        # Of later ones that have not been taken in yet, it is one more of those.
        between = ~early & (self._known[late] > stamp)
        if between.any():
            self._insert(window, Insertions.at(window, late[between], index[between]))

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out all samples that need one of the oldest `counts[k]` observations of `slots[k]`.

        Those are its own samples, and those of others after it up to its next observation: the
        common interval begins there now.
        """
        self._take_in(window)
        part = self._known[slots] != _NEVER
        slots, counts = slots[part], counts[part]
        stay = window.counts(slots) - counts >= _MIN_OBSERVATIONS
        if stay.any():
            self._shorten(window, slots[stay], counts[stay])
        self._restart(slots[~stay])

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories."""
        slots = slots[slots < len(self._known)]
        self._restart(slots)
        self._places.release(slots)

    def rebuild(self, window: Window, slots: Slots) -> None:
        """Compute all samples of trajectories anew from the window."""
        self._fit(window)
        self._instants.learn(_instants(window, slots))
        self._restart(slots)

    def affinity(self, window: Window, slots: Slots, sigma_switch: float) -> Affinity:
        """Affinity (3.4) of each pair of `slots`, exp(−γσ²) with γ = −ln 0.5 / sigma_switch².

        Parameters
        ----------
        window
            Where the trajectories are.
        slots
            intp [n].
        sigma_switch
            Standard deviation at which the affinity is 0.5, in the unit of the distances.

        Returns
        -------
        Affinity
            Of `slots`; 0.5 for pairs with fewer than two common samples. Overwritten by the next call.
        """
        self._take_in(window)
        self._give_places(window, slots)
        width = self._sums.blocks * TILE
        if len(self._matrix) < width:
            self._matrix = aligned_zeros((width, width), np.float32)
        rounded = self._sums.add_and_compare(self._waiting, sigma_switch, self._matrix)
        self._waiting.count = 0
        self._reads += 1
        if self._reads % _UPDATES_PER_RECOUNT == 0 and self._sums.tiles:
            rounded = np.union1d(rounded, [self._reads // _UPDATES_PER_RECOUNT % self._sums.tiles])
        if len(rounded):
            self._recount(window, rounded)
            self._sums.compare(rounded, sigma_switch, self._matrix)
        np.fill_diagonal(self._matrix, 1.0)
        return Affinity(self._matrix, self._places.of[slots])

    def variance(self, window: Window, slots: Slots) -> tuple[Floats, NDArray[np.int64]]:
        """Weighted variance of the distance (3.3) of each pair of `slots`.

        Returns
        -------
        variance
            float64 [n, n], the space's unit squared; 0 where there are fewer than two samples.
        samples
            int64 [n, n]: common samples of each pair.
        """
        self._take_in(window)
        self._recount(window, self._add())
        n, placed = len(slots), np.flatnonzero(self._places.of[slots] >= 0)
        variance, samples = np.zeros((n, n)), np.zeros((n, n), np.int64)
        places = self._places.of[slots[placed]]
        *found, rounded = self._sums.read(places)
        if len(rounded):
            self._recount(window, rounded)
            *found, _ = self._sums.read(places)
        variance[np.ix_(placed, placed)], samples[np.ix_(placed, placed)] = found
        return variance, samples

    def _fit(self, window: Window) -> None:
        extra = window.capacity - len(self._known)
        if extra:
            self._known = np.pad(self._known, (0, extra), constant_values=_NEVER)
            self._places.fit(window.capacity)

    def _restart(self, slots: Slots) -> None:
        """Drop the samples of trajectories; those that the window still holds come in again."""
        self._known[slots] = _NEVER
        places = self._places.of[slots]
        places = places[places >= 0]
        self._sums.forget(places)
        self._waiting.drop(places)

    def _taking_part(self, window: Window) -> Slots:
        lasting = window.used & ~window.ended
        return np.flatnonzero(lasting & (window.stop - window.start >= _MIN_OBSERVATIONS))

    def _take_in(self, window: Window) -> None:
        """Note the samples that observations have brought since the last time."""
        self._fit(window)
        self.forget(np.flatnonzero(window.ended & (self._places.of >= 0)))
        slots = self._taking_part(window)
        newest = window.times[slots, window.stop[slots] - 1]
        fresh = newest > self._known[slots]
        if not fresh.any():
            return
        self._give_places(window, slots[fresh])
        who = Changing.of(slots, self._places.of[slots])
        who.after[fresh] = self._begun(window, slots[fresh])
        first, last = int(who.after[fresh].min()), int(newest[fresh].max())
        self._wait(window, who, self._instants.between(first, last), 1)
        self._known[slots] = np.maximum(self._known[slots], newest)

    def _give_places(self, window: Window, slots: Slots) -> None:
        self._places.take(slots, window.source[slots])
        self._sums.fit(self._places.blocks)
        self._waiting.fit(self._places.blocks)

    def _begun(self, window: Window, slots: Slots) -> Stamps:
        """From when on (exclusive) the states of slots have not been taken in."""
        begun = np.empty(len(slots), np.int64)
        _begun(window.times, window.start, window.stop, slots, self._known, window.gap_ns, begun)
        return begun

    def _shorten(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Note the samples that go with the oldest observations of each slot."""
        part = self._taking_part(window)
        who = Changing.of(part, self._places.of[part])
        first = window.start[slots]
        begin, gone = window.times[slots, first + counts], window.times[slots, first + counts - 1]
        until = np.where(begin - gone <= window.gap_ns, begin - 1, gone)
        who.until[:] = EARLIEST
        rows = np.searchsorted(part, slots)
        who.after[rows], who.until[rows] = EARLIEST, until
        oldest = int(window.times[slots, first].min())
        self._instants.drop(oldest)
        stamps = self._instants.between(oldest - 1, int(until.max()))
        self._wait(window, who, stamps, -1)

    def _insert(self, window: Window, late: Insertions) -> None:
        """Note what changes with observations that came between two that have been taken in."""
        slots = self._taking_part(window)
        slots = slots[self._known[slots] != _NEVER]
        who = Changing.of(slots, self._places.of[slots])
        who.known[:] = self._known[slots]
        rows = np.searchsorted(slots, late.slots)
        who.after[rows], who.until[rows] = late.times[:, 0], late.times[:, 1]
        stamps = self._instants.between(int(late.times[:, 0].min()), int(late.times[:, 1].max()))
        self._wait(window, who, stamps, -1, late)
        self._wait(window, who, stamps, 1)

    def _wait(
        self, window: Window, who: Changing, stamps: Stamps, sign: int, late: Insertions | None = None
    ) -> None:
        """Have samples wait for the next pass over the sums; many go there at once."""
        while len(stamps):
            if not self._waiting.room:
                self._add()
            part, stamps = stamps[: self._waiting.room], stamps[self._waiting.room :]
            self._waiting.add(window, who, part, sign=sign, v_move=self._v_move, late=late)

    def _add(self) -> Slots:
        """Take the waiting samples into the sums; answers which tiles are mostly rounding now."""
        rounded = self._sums.add(self._waiting)
        self._waiting.count = 0
        return rounded

    def _recount(self, window: Window, tiles: Slots) -> None:
        """Sum tiles anew from the window, of which everything has been taken in."""
        everyone = self._taking_part(window)
        places = self._places.of[everyone]
        for tile in tiles.tolist():
            row, column = self._sums.recount(tile)
            here = (places // TILE == row) | (places // TILE == column)
            slots = everyone[here]
            offset = TILE if column != row else 0
            inside = places[here] % TILE + np.where(places[here] // TILE == row, 0, offset)
            who = Changing.of(slots, inside)
            who.after[:] = EARLIEST
            stamps = self._instants.between(EARLIEST, LATEST)
            samples = Samples(2 if column != row else 1, self._sums.dtype)
            # The newest first, for their distance becomes the shift.
            for k in reversed(range(0, len(stamps), MOST_INSTANTS)):
                samples.count = 0
                samples.add(window, who, stamps[k : k + MOST_INSTANTS], sign=1, v_move=self._v_move)
                self._sums.add_to(tile, samples)


@compiled()
def _begun(
    times: Stamps, start: Slots, stop: Slots, slots: Slots, known: Stamps, gap_ns: int, begun: Stamps
) -> None:
    for n in range(len(slots)):
        s, past = slots[n], known[slots[n]]
        first = newest_at(times[s], start[s], stop[s], past) + 1
        # The segment that ends with the first new observation is new as well.
        follows = first > start[s] and past != _NEVER and times[s, first] - past <= gap_ns
        begun[n] = past if follows else times[s, first] - 1


def _instants(window: Window, slots: Slots) -> Stamps:
    """Distinct times at which any of the slots was observed, ascending, int64 [k]."""
    index = np.arange(window.times.shape[1])
    held = (index >= window.start[slots, None]) & (index < window.stop[slots, None])
    return np.unique(window.times[slots][held])
