"""Which distance samples of pairs come and go as the window changes: (3.2) and the set (3.5).

At an instant at which trajectory i was observed, i and j have one distance sample if j was observed
too, or if the instant lies inside a segment of j (between two observations of it) that is short
enough to interpolate. So a new observation brings samples of two kinds: of itself against the states
of others at its instant, and of the segment that it ends against the observations of others inside.
Eviction takes away the same two kinds.
"""

import math

import numpy as np
from scipy.spatial.distance import cdist, pdist

from .engine import Rows
from .states import Insertions, States, instants, locate, observations_between, states_at
from .sums import PairSums, each_pair
from .window import Bools, Floats, Slots, Stamps, Window

_MIN_OBSERVATIONS = 2
# ε of (3.2), in units of v_move².
_REST = 1e-3
_EARLIEST = np.iinfo(np.int64).min
# Samples computed at once: bounds the memory that a slow source of many features takes.
_MOST_AT_ONCE = 1_000_000


def velocity_weight(speed: Floats, v_move: float | None) -> Floats:
    """Weight of (3.2), w = 1 − exp(−λ(v² + ε)) with λ = −ln(1 − 0.9)/v_move²; 1 where `v_move` is None."""
    if v_move is None:
        return np.ones_like(speed)
    return -np.expm1(math.log(0.1) * ((speed / v_move) ** 2 + _REST))


class Pairs:
    """Keeps the sums of all pairs of trajectories in step with the window.

    A trajectory takes part from its second observation on: with one it has at most one sample with
    any other, which cannot be compared, and its speed is not known yet.

    Parameters
    ----------
    v_move
        Speed of λ in (3.2), in the space's unit per second; None: equal weights.
    """

    def __init__(self, v_move: float | None) -> None:
        self._v_move = v_move
        self.sums = PairSums()

    def observed(self, window: Window, rows: Rows) -> None:
        """Take in observations that have just been stored."""
        self.sums.fit(window.capacity)
        slots, stamp = rows.slots, rows.stamp_ns
        index = locate(window, slots, stamp)
        newest = index == window.stop[slots] - 1
        # One next to the first changes what the first's speed is.
        early = ~newest & (index < window.start[slots] + 2)
        middle = ~newest & ~early
        late = Insertions.at(window, slots[middle], index[middle]) if middle.any() else None
        self._extend(window, slots[newest & (window.counts(slots) >= _MIN_OBSERVATIONS)], stamp, late)
        if late is not None:
            self._sweep(window, late.slots, late.t_left, late.t_right, sign=-1, late=late)
            self._sweep(window, late.slots, late.t_left, late.t_right)
        self.rebuild(window, slots[early])

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out all samples that need one of the oldest `counts[k]` observations of `slots[k]`.

        Those are its own samples, and those of others after it up to its next observation: the
        common interval begins there now.
        """
        self.sums.fit(window.capacity)
        self.sums.note_peak()
        stay = window.counts(slots) - counts >= _MIN_OBSERVATIONS
        if stay.any():
            self._shorten(window, slots[stay], counts[stay])
        self.sums.forget(slots[~stay])

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories."""
        self.sums.forget(slots)

    def rebuild(self, window: Window, slots: Slots) -> None:
        """Compute all samples of trajectories anew from the window."""
        self.sums.fit(window.capacity)
        self.sums.forget(slots)
        slots = slots[window.counts(slots) >= _MIN_OBSERVATIONS]
        first, last = window.times[slots, window.start[slots]], window.times[slots, window.stop[slots] - 1]
        self._sweep(window, slots, first - 1, last)

    def variance(self, window: Window, slots: Slots) -> tuple[Floats, Bools]:
        """Weighted variance of the distance (3.3) of each pair of `slots`.

        Returns
        -------
        variance
            float64 [n, n], the space's unit squared; 0 where not comparable.
        comparable
            bool [n, n]; whether a pair has the two samples that a variance takes.
        """
        self.sums.fit(window.capacity)
        variance, comparable, drowned = self.sums.read(slots)
        if drowned.any():
            self.rebuild(window, slots[_cover(drowned)])
            variance, comparable, _ = self.sums.read(slots)
        return variance, comparable

    def _extend(self, window: Window, slots: Slots, stamp_ns: int, late: Insertions | None) -> None:
        """Add what the newest observation of each slot brings; its second brings the first one in."""
        if not len(slots):
            return
        left = window.stop[slots] - 2
        self._add_segments(window, slots, left, 1)
        self._add_points(window, slots, stamp_ns, 1, late=late)
        begun = window.times[slots, left]
        young = left == window.start[slots]
        for first in np.unique(begun[young]).tolist():
            # What lies inside a segment that is new as well has come with that segment.
            inside = slots[begun < first]
            self._add_points(window, slots[young & (begun == first)], first, 1, late=late, without=inside)

    def _shorten(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out what the oldest observations of each slot have brought."""
        first = window.start[slots]
        left = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
        self._add_segments(window, np.repeat(slots, counts), left, -1)
        begin = window.times[slots, first + counts]
        for stamp in instants(window, slots, _EARLIEST, int(begin.max()) - 1).tolist():
            inside = slots[stamp < begin]
            here = inside[window.times[inside, locate(window, inside, stamp)] == stamp]
            self._add_points(window, here, stamp, -1, without=inside)

    def _add_points(
        self,
        window: Window,
        slots: Slots,
        stamp_ns: int,
        sign: int,
        *,
        late: Insertions | None = None,
        without: Slots | None = None,
    ) -> None:
        """Samples of observations made at one instant against the states of others there.

        Not against the interpolated states of `without`; with `late`, against the states before its
        observations came.
        """
        if not len(slots):
            return
        others = _taking_part(window)
        states = states_at(window, others, stamp_ns)
        if late is not None:
            late.undo(states, np.searchsorted(others, late.slots), stamp_ns, window.gap_ns)
        if without is not None:
            rows = np.searchsorted(others, without)
            states.held[rows] &= states.observed[rows]
        changing = np.zeros(len(others), np.bool_)
        changing[np.searchsorted(others, slots)] = True
        self._add_instant(others, states, changing, sign)

    def _add_segments(self, window: Window, slots: Slots, left: Slots, sign: int) -> None:
        """Samples of observations of others inside the segments that begin at `left` of each slot."""
        begin, end = window.times[slots, left], window.times[slots, left + 1]
        short = end - begin <= window.gap_ns
        others = _taking_part(window)
        for start in np.unique(begin[short]).tolist():
            chosen = np.flatnonzero(short & (begin == start))
            those, index = observations_between(window, others, start, int(end[chosen].max()))
            if not len(those):
                continue
            step = max(1, _MOST_AT_ONCE // len(those))
            for k in range(0, len(chosen), step):
                part = chosen[k : k + step]
                self._add_inside(window, slots[part], left[part], those, index, sign)

    def _add_inside(
        self, window: Window, slots: Slots, left: Slots, those: Slots, index: Slots, sign: int
    ) -> None:
        """Samples between segments (n) and observations (m, by slot), where one is inside the other."""
        begin, end = window.times[slots, left, None], window.times[slots, left + 1, None]
        stamps = window.times[those, index]
        inside = (begin < stamps) & (stamps < end)
        fraction = (stamps - begin) / (end - begin)
        start, goal = window.positions[slots, left], window.positions[slots, left + 1]
        there = window.positions[those, index]
        square = np.zeros(inside.shape)
        for c in range(window.dim):
            square += (start[:, c, None] + fraction * (goal - start)[:, c, None] - there[:, c]) ** 2
        # The speed at an interpolated instant is that of the segment.
        mine = velocity_weight(window.speed[slots, left + 1], self._v_move)
        theirs = velocity_weight(window.speed[those, index], self._v_move)
        unique, runs = np.unique(those, return_index=True)
        pairs = self.sums.at(slots[:, None], unique)
        self.sums.add_runs(pairs, runs, np.sqrt(square), np.maximum.outer(mine, theirs), inside, sign)

    def _sweep(
        self,
        window: Window,
        slots: Slots,
        after: Stamps,
        until: Stamps,
        *,
        sign: int = 1,
        late: Insertions | None = None,
    ) -> None:
        """Add or take out the samples of slots at all instants in (after, until] of each.

        With `late`, the states are those before its observations came.
        """
        if not len(slots):
            return
        others = _taking_part(window)
        rows = np.searchsorted(others, slots)
        for stamp in instants(window, others, int(after.min()), int(until.max())).tolist():
            states = states_at(window, others, stamp)
            if late is not None:
                late.undo(states, np.searchsorted(others, late.slots), stamp, window.gap_ns)
            changing = np.zeros(len(others), np.bool_)
            changing[rows[(after < stamp) & (stamp <= until)]] = True
            self._add_instant(others, states, changing, sign)

    def _add_instant(self, slots: Slots, states: States, changing: Bools, sign: int) -> None:
        """One sample for each pair of held states of which one is observed and one is changing."""
        weight = velocity_weight(states.speed, self._v_move)
        seen = np.flatnonzero(changing & states.observed)
        filled = np.flatnonzero(changing & states.held & ~states.observed)
        rest = states.held & ~changing
        around = np.concatenate([filled, np.flatnonzero(rest)])
        witnesses = np.flatnonzero(rest & states.observed)
        # One exponential per state: w is monotonic in v, so the faster of two has the larger.
        if len(seen) > 1:
            i, j = each_pair(len(seen))
            w = np.maximum(weight[seen[i]], weight[seen[j]])
            pairs = self.sums.at(slots[seen[i]], slots[seen[j]])
            self.sums.add(pairs, pdist(states.position[seen]), w, sign)
        for these, those in ((seen, around), (filled, witnesses)):
            if len(these) and len(those):
                w = np.maximum.outer(weight[these], weight[those])
                d = cdist(states.position[these], states.position[those])
                self.sums.add(self.sums.at(slots[these, None], slots[those]), d, w, sign)


def _taking_part(window: Window) -> Slots:
    return np.flatnonzero(window.used & (window.stop - window.start >= _MIN_OBSERVATIONS))


def _cover(pairs: Bools) -> list[int]:
    """Few rows of a symmetric bool [n, n] that have a part in every pair marked."""
    left, found = pairs.copy(), []
    while left.any():
        worst = int(left.sum(axis=0).argmax())
        left[worst] = left[:, worst] = False
        found.append(worst)
    return found
