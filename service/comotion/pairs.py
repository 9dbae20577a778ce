"""Distance samples of every pair of trajectories and their weighted variance, (3.2), (3.3), (3.5).

At an instant at which trajectory i was observed, i and j have one distance sample if j was observed
too or can be interpolated there. The sums over a pair's samples are kept up to date: what a change of
the window adds or takes away is computed, never the whole again.
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist

from .engine import Rows
from .states import Insertions, States, instants, locate, states_at
from .window import Bools, Floats, Slots, Stamps, Window

_MIN_OBSERVATIONS = 2
_MIN_SAMPLES = 2
# ε of (3.2), in units of v_move².
_REST = 1e-3
# Below this share of what the sums have held, too few digits of a variance are left.
_SOUND = 1e-9
_SUMS = ("weight", "first", "second", "shift", "peak")
_EARLIEST = np.iinfo(np.int64).min


def velocity_weight(speed: Floats, v_move: float | None) -> Floats:
    """Weight of (3.2), w = 1 − exp(−λ(v² + ε)) with λ = −ln(1 − 0.9)/v_move²; 1 where `v_move` is None."""
    if v_move is None:
        return np.ones_like(speed)
    return -np.expm1(math.log(0.1) * ((speed / v_move) ** 2 + _REST))


@lru_cache(maxsize=4)
def _each_pair(n: int) -> tuple[Slots, Slots]:
    """Indices i < j of all pairs of n, in the order of pdist."""
    i, j = np.triu_indices(n, 1)
    return i, j


def _cover(pairs: Bools) -> list[int]:
    """Few rows of a symmetric bool [n, n] that have a part in every pair marked."""
    left, found = pairs.copy(), []
    while left.any():
        worst = int(left.sum(axis=0).argmax())
        left[worst] = left[:, worst] = False
        found.append(worst)
    return found


class PairSums:
    """Weighted sums of the distances of all pairs of trajectories over their common samples.

    A trajectory takes part from its second observation on: with one it has at most one sample with
    any other, which cannot be compared, and its speed is not known yet.

    Parameters
    ----------
    v_move
        Speed of λ in (3.2), in the space's unit per second; None: equal weights.

    Attributes
    ----------
    samples
        int32 [capacity, capacity], common samples of a pair; this and all that follow at
        [smaller slot, larger slot].
    weight, first, second
        float64: sums of w, w·d' and w·d'² over the samples, with d' = d − `shift`.
    shift
        float64: the distance at the pair's first sample. About zero, E[d²] − E[d]² would cancel.
    peak
        float64: the largest that `second` has been, the measure of the rounding it carries.
    """

    def __init__(self, v_move: float | None) -> None:
        self._v_move = v_move
        self.samples: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        self.weight: Floats = np.zeros((0, 0))
        self.first: Floats = np.zeros((0, 0))
        self.second: Floats = np.zeros((0, 0))
        self.shift: Floats = np.zeros((0, 0))
        self.peak: Floats = np.zeros((0, 0))

    def observed(self, window: Window, rows: Rows) -> None:
        """Take in observations that have just been stored."""
        self._fit(window.capacity)
        slots, stamp = rows.slots, rows.stamp_ns
        index = locate(window, slots, stamp)
        newest = index == window.stop[slots] - 1
        # The second observation brings the first one in, and a late one next to the first changes
        # what its speed is.
        young = (window.counts(slots) <= _MIN_OBSERVATIONS) | (~newest & (index < window.start[slots] + 2))
        middle = ~newest & ~young
        late = Insertions.at(window, slots[middle], index[middle]) if middle.any() else None
        self._extend(window, slots[newest & ~young], stamp, late)
        if late is not None:
            self._sweep(window, late.slots, late.t_left, late.t_right, sign=-1, late=late)
            self._sweep(window, late.slots, late.t_left, late.t_right)
        self.rebuild(window, slots[young])

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out all samples that need one of the oldest `counts[k]` observations of `slots[k]`.

        Those are its own samples, and those of others after it up to its next observation: the
        common interval begins there now.
        """
        self._fit(window.capacity)
        np.maximum(self.peak, self.second, out=self.peak)
        stay = window.counts(slots) - counts >= _MIN_OBSERVATIONS
        kept, first = slots[stay], (window.start[slots] + counts)[stay]
        t_left, t_right = window.times[kept, first - 1], window.times[kept, first]
        until = np.where(t_right - t_left <= window.gap_ns, t_right - 1, t_left)
        self._sweep(window, kept, np.full(len(kept), _EARLIEST), until, sign=-1)
        self.forget(slots[~stay])

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories."""
        self.samples[slots] = 0
        self.samples[:, slots] = 0

    def rebuild(self, window: Window, slots: Slots) -> None:
        """Compute all samples of trajectories anew from the window."""
        self._fit(window.capacity)
        self.forget(slots)
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
        self._fit(window.capacity)
        variance, comparable, drowned = self._read(slots)
        if drowned.any():
            self.rebuild(window, slots[_cover(drowned)])
            variance, comparable, _ = self._read(slots)
        return variance, comparable

    def _read(self, slots: Slots) -> tuple[Floats, Bools, Bools]:
        """Variances, which are comparable, and which have drowned in rounding.

        One wild observation that comes and leaves would otherwise spoil its pairs for good.
        """
        pairs = self._at(slots[:, None], slots)
        comparable = self.samples.reshape(-1)[pairs] >= _MIN_SAMPLES
        weight = np.where(comparable, self.weight.reshape(-1)[pairs], 1.0)
        first, second = self.first.reshape(-1)[pairs], self.second.reshape(-1)[pairs]
        squares = second - first**2 / weight
        most = np.maximum(self.peak.reshape(-1)[pairs], second)
        variance = np.where(comparable, np.maximum(squares, 0.0) / weight, 0.0)
        return variance, comparable, comparable & (squares < _SOUND * most)

    def _fit(self, capacity: int) -> None:
        extra = capacity - len(self.samples)
        if extra:
            self.samples = np.pad(self.samples, (0, extra))
            for name in _SUMS:
                setattr(self, name, np.pad(getattr(self, name), (0, extra)))

    def _extend(self, window: Window, slots: Slots, stamp_ns: int, late: Insertions | None) -> None:
        """Add what the newest observation of each slot has made possible: it, and its last segment."""
        before = window.times[slots, window.stop[slots] - 2]
        after = np.where(stamp_ns - before <= window.gap_ns, before, stamp_ns - 1)
        self._sweep(window, slots, after, np.full(len(slots), stamp_ns), late=late)

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
        """Add or take out the samples of slots at instants in (after, until] of each.

        With `late`, the states are those before its observations came.
        """
        if not len(slots):
            return
        others = np.flatnonzero(window.used & (window.stop - window.start >= _MIN_OBSERVATIONS))
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
            i, j = _each_pair(len(seen))
            w = np.maximum(weight[seen[i]], weight[seen[j]])
            self._add(self._at(slots[seen[i]], slots[seen[j]]), pdist(states.position[seen]), w, sign)
        for these, those in ((seen, around), (filled, witnesses)):
            if len(these) and len(those):
                w = np.maximum.outer(weight[these], weight[those])
                d = cdist(states.position[these], states.position[those])
                self._add(self._at(slots[these, None], slots[those]), d, w, sign)

    def _add(self, pairs: Slots, distance: Floats, weight: Floats, sign: int) -> None:
        samples = self.samples.reshape(-1)[pairs]
        fresh = samples == 0
        if fresh.any():
            self._begin(pairs[fresh], distance[fresh])
        distance = distance - self.shift.reshape(-1)[pairs]
        weight = sign * weight
        self.samples.reshape(-1)[pairs] = samples + sign
        self.weight.reshape(-1)[pairs] += weight
        weight = weight * distance
        self.first.reshape(-1)[pairs] += weight
        self.second.reshape(-1)[pairs] += weight * distance

    def _begin(self, pairs: Slots, distance: Floats) -> None:
        """The first sample of pairs, or the first after all have gone."""
        self.shift.reshape(-1)[pairs] = distance
        for sums in (self.weight, self.first, self.second, self.peak):
            sums.reshape(-1)[pairs] = 0.0

    def _at(self, these: Slots, those: Slots) -> Slots:
        """Where pairs of slots are in the flattened matrices, which are faster to index than by two."""
        return np.minimum(these, those) * len(self.samples) + np.maximum(these, those)
