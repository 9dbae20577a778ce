"""Distance samples of every pair of trajectories and their weighted variance, (3.2), (3.3), (3.5).

At an instant at which trajectory i was observed, i and j have one distance sample if j was observed
too or can be interpolated there. The sums over a pair's samples are kept up to date: what a change of
the window adds or takes away is computed, never the whole again.
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

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
        int32 [capacity, capacity], by slot, like all that follow: common samples of a pair.
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
        self._restore_digits(window, slots)
        block = np.ix_(slots, slots)
        comparable = self.samples[block] >= _MIN_SAMPLES
        weight = np.where(comparable, self.weight[block], 1.0)
        variance = (self.second[block] - self.first[block] ** 2 / weight) / weight
        return np.where(comparable, np.maximum(variance, 0.0), 0.0), comparable

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
        for these, those in ((seen, seen), (seen, around), (filled, witnesses)):
            if len(these) and len(those):
                # One exponential per state: w is monotonic in v, so the faster of two has the larger.
                w = np.maximum.outer(weight[these], weight[those])
                d = cdist(states.position[these], states.position[those])
                self._add(slots[these], slots[those], d, w, sign)
                if those is not seen:
                    self._add(slots[those], slots[these], d.T, w.T, sign)

    def _add(self, these: Slots, those: Slots, distance: Floats, weight: Floats, sign: int) -> None:
        block = np.ix_(these, those)
        samples = self.samples[block]
        fresh = samples == 0
        if fresh.any():
            self.shift[block] = np.where(fresh, distance, self.shift[block])
            for sums in (self.weight, self.first, self.second, self.peak):
                sums[block] = np.where(fresh, 0.0, sums[block])
        distance = distance - self.shift[block]
        weight = sign * weight
        self.samples[block] = samples + sign
        self.weight[block] += weight
        self.first[block] += weight * distance
        self.second[block] += weight * distance**2

    def _restore_digits(self, window: Window, slots: Slots) -> None:
        """Rebuild pairs whose variance has drowned in the rounding of larger terms that came or left.

        One wild observation is enough for that, and would spoil its pairs for good.
        """
        block = np.ix_(slots, slots)
        weight = np.where(self.samples[block] >= _MIN_SAMPLES, self.weight[block], np.inf)
        second = self.second[block]
        drowned = second - self.first[block] ** 2 / weight < _SOUND * np.maximum(self.peak[block], second)
        drowned &= np.isfinite(weight)
        found: list[int] = []
        while drowned.any():
            worst = int(drowned.sum(axis=0).argmax())
            drowned[worst] = drowned[:, worst] = False
            found.append(int(slots[worst]))
        self.rebuild(window, np.array(found, np.intp))
