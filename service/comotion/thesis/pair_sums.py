"""Affinities of all pairs by (3.2) to (3.5) of the thesis, computed incrementally.

At an instant at which trajectory i was observed, i and j have one distance sample if j has a state there: it
is observed too, or inside a segment (between two observations) that is short enough to interpolate (3.5).
The new samples of an instant follow from the observations in the window and from those already summed;
samples of evicted observations are subtracted again. The samples are queued until affinities are wanted: then
one pass adds them to the sums of (3.3) of all pairs.
"""

import math
from bisect import bisect_right
from typing import Any

import numpy as np

from ..arrays import Bools, Floats, Floats32, Slots, Stamps, untouched_zeros
from ..trajectories.window import Window
from .kernels import BOTH, CHANGING, HELD, OBSERVED, PLANES, SAMPLE_PLANES, STRIP, WEIGHT, X, update_pairs

# The thesis chooses λ and γ such that the weight is 0.9 at v_move and the affinity 0.5 at sigma_switch.
_WEIGHT_SHORT_OF_ONE = 0.1
AFFINITY_AT_SWITCH = 0.5
# ε of (3.2) in units of v_move²; the thesis gives no number. At rest a weight then is 0.0023.
_EPSILON = 1e-3
# Times before and after all others.
_NEVER, _LATEST = np.iinfo(np.int64).min, np.iinfo(np.int64).max
_MIN_OBSERVATIONS = 2
# Most instants that are queued for a pass: bounds the memory of their samples.
_MAX_INSTANTS = 64
# Subtracting a squared distance from a sum again leaves an error of 1e-16 of it. For positions this many
# sigma_switch apart, that is 1e-4 of the variance at which affinities are 0.5.
_FAR = 1e6
_NONE = np.zeros((0, 0), np.float32)


class PairSums:
    """Keeps the sums of all pairs of trajectories in step with the window.

    A trajectory has samples from its second observation on: with a single observation it has at most one
    sample with any other trajectory, too few to compare, and no speed. Trajectories that their source has
    ended have no samples. `v_move` and `sigma_switch` are those of the configuration; without the first one
    weights are equal.
    """

    def __init__(self, v_move: float | None, sigma_switch: float) -> None:
        self._v_move = v_move
        self._sigma_switch = sigma_switch
        # Those of the kernels: their rows are the slots of the window, up to the last one in use.
        self.sums: Floats = untouched_zeros((0, STRIP, PLANES, STRIP), np.float64)
        # By slot: number of observations that are summed or queued, and the time of the newest of them.
        self._summed: Slots = np.zeros(0, np.intp)
        self._summed_ns: Stamps = np.zeros(0, np.int64)
        # Samples at queued instants; 1 for those to add, -1 for those to subtract; and the number of
        # instants.
        self._samples: Floats = np.zeros((0, _MAX_INSTANTS, SAMPLE_PLANES, STRIP))
        self._signs: Floats = np.zeros(_MAX_INSTANTS)
        self._waiting = 0
        self._affinity: Floats32 = _NONE

    def evicting(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Take out all samples that need one of the oldest `counts[k]` observations of `slots[k]`.

        Those are its own samples, and those of others after it up to its next observation: the common
        interval begins there now.
        """
        self._take_in(window)
        summed = self._summed[slots] > 0
        slots, counts = slots[summed], counts[summed]
        shortened = (window.counts(slots) - counts >= _MIN_OBSERVATIONS) & ~self._far(window, slots, counts)
        if shortened.any():
            self._shorten(window, slots[shortened], counts[shortened])
        self.forget(slots[~shortened])
        self._summed[slots[shortened]] -= counts[shortened]

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories; those that the window still holds come in again."""
        slots = slots[slots < len(self._summed)]
        slots = slots[self._summed[slots] > 0]
        self._summed[slots] = 0
        for strip, inside in zip(*(part.tolist() for part in np.divmod(slots, STRIP)), strict=True):
            self._samples[strip, :, :, inside] = 0.0
            self.sums[_blocks(strip) : _blocks(strip + 1), inside] = 0.0
            below = np.arange(strip, len(self._samples))
            self.sums[_blocks(below) + strip, :, :, inside] = 0.0

    def affinity(self, window: Window) -> Floats32:
        """Affinity (3.4) of each pair of trajectories, float32 [n, n] by slot; the next call overwrites it.

        It is 0.5 for pairs with fewer than two common samples.
        """
        self._take_in(window)
        if len(self._affinity) != len(self._summed):
            self._affinity = untouched_zeros((len(self._summed), len(self._summed)), np.float32)
        self._pass(self._affinity)
        np.fill_diagonal(self._affinity, 1.0)
        return self._affinity

    def _take_in(self, window: Window) -> None:
        """Queue the samples of observations that are new since the last call."""
        self._begin(window)
        slots = self._sampled(window)
        first, newest = window.start[slots] + self._summed[slots], window.times[slots, window.stop[slots] - 1]
        is_fresh = first < window.stop[slots]
        if not is_fresh.any():
            return
        # The segment that ends with the first new observation is new as well.
        fresh, begin = slots[is_fresh], window.times[slots[is_fresh], first[is_fresh]]
        summed_ns = self._summed_ns[fresh]
        follows = (self._summed[fresh] > 0) & (begin - summed_ns <= window.gap_ns)
        after, until = np.full((2, len(self._summed)), _LATEST)
        after[fresh] = np.where(follows, summed_ns, begin - 1)
        self._enqueue(window, after, until, 1.0)
        self._summed_ns[slots], self._summed[slots] = newest, window.counts(slots)

    def _sampled(self, window: Window) -> Slots:
        """Which slots have samples, ascending."""
        lasting = window.stop - window.start >= _MIN_OBSERVATIONS
        return np.flatnonzero(window.used & ~window.ended & lasting)

    def _begin(self, window: Window) -> None:
        """Leave out trajectories whose sums do not hold any more, and allocate those of new ones."""
        slots = np.flatnonzero(self._summed > 0)
        newest = window.times[slots, window.start[slots] + self._summed[slots] - 1]
        # Observations older than those already summed change summed segments.
        self.forget(slots[window.ended[slots] | (newest != self._summed_ns[slots])])
        used = np.flatnonzero(window.used)
        strips = -(-int(used.max(initial=-1) + 1) // STRIP)
        extra = strips * STRIP - len(self._summed)
        if extra <= 0:
            return
        self._pass()
        self._summed, self._summed_ns = np.pad(self._summed, (0, extra)), np.pad(self._summed_ns, (0, extra))
        self._samples = np.zeros((strips, *self._samples.shape[1:]))
        if _blocks(strips) > len(self.sums):
            # Twice as many at once: growing copies everything.
            grown = untouched_zeros((2 * _blocks(strips), *self.sums.shape[1:]), np.float64)
            grown[: len(self.sums)] = self.sums
            self.sums = grown

    def _far(self, window: Window, slots: Slots, counts: Slots) -> Bools:
        """Which slots were so far away at an evicted observation that subtracting it leaves an error."""
        first, newest = window.start[slots], window.positions[slots, window.stop[slots] - 1]
        columns = (first + np.minimum(k, counts - 1) for k in range(counts.max(initial=0)))
        away = [np.abs(window.positions[slots, column] - newest).max(axis=1) for column in columns]
        return np.asarray(np.max(away, axis=0, initial=0.0) > _FAR * self._sigma_switch)

    def _shorten(self, window: Window, slots: Slots, counts: Slots) -> None:
        """Queue the removal of the samples of the oldest observations of each slot."""
        first = window.start[slots]
        begin, gone = window.times[slots, first + counts], window.times[slots, first + counts - 1]
        after, until = np.full((2, len(self._summed)), _NEVER)
        until[slots] = np.where(begin - gone <= window.gap_ns, begin - 1, gone)
        self._enqueue(window, after, until, -1.0)

    def _enqueue(self, window: Window, after: Stamps, until: Stamps, sign: float) -> None:
        """Queue samples for the next pass; a full buffer starts one.

        Of each row, int64 [rows] each, the states later than `after` and no later than `until` come or go.
        """
        first, last = (bisect_right(window.instants, int(time)) for time in (after.min(), until.max()))
        for begin in range(first, last, _MAX_INSTANTS):
            stamps = np.array(window.instants[begin : min(last, begin + _MAX_INSTANTS)])
            if self._waiting + len(stamps) > _MAX_INSTANTS:
                self._pass()
            changing = (after < stamps[:, None]) & (stamps[:, None] <= until)
            wait = slice(self._waiting, self._waiting + len(stamps))
            self._fill(window, stamps, changing, self._samples[:, wait])
            self._signs[wait], self._waiting = sign, wait.stop

    def _fill(self, window: Window, stamps: Stamps, changing: Bools, samples: Floats) -> None:
        """Write the samples of all rows at instants [T] to [strips, T, SAMPLE_PLANES, STRIP]."""
        slots = self._sampled(window)
        states = window.states_at(slots, stamps)
        rows = np.zeros((SAMPLE_PLANES, *changing.shape))
        rows[X : X + window.dim, :, slots] = states.position.transpose(2, 0, 1)
        rows[WEIGHT][:, slots] = weight(states.speed, self._v_move)
        rows[OBSERVED][:, slots], rows[HELD][:, slots] = states.observed, states.held
        rows[CHANGING] = changing * rows[HELD]
        rows[BOTH] = rows[OBSERVED] * rows[CHANGING]
        samples[:] = rows.reshape(SAMPLE_PLANES, len(stamps), -1, STRIP).transpose(2, 1, 0, 3)

    def _pass(self, affinity: Floats32 = _NONE) -> None:
        """Add the queued samples to the sums; write affinities where they are wanted."""
        rate = math.log(AFFINITY_AT_SWITCH) / self._sigma_switch**2
        present = np.asarray(self._samples[:, : self._waiting].any(axis=3), np.bool_)
        update_pairs(self.sums, self._samples, self._signs[: self._waiting], present, rate, affinity)
        self._waiting = 0


def weight(speed: Floats, v_move: float | None) -> Floats:
    """(3.2): w = 1 − exp(−λ(v² + ε)) with λ = −ln(1 − 0.9)/v_move².

    As w grows with v, the weight of a pair is the larger of the weights of its two trajectories. (After (3.5)
    the thesis prints the observed trajectory's alone; the maximum of (3.2) is kept.)
    """
    if v_move is None:
        return np.ones_like(speed)
    rate = -math.log(_WEIGHT_SHORT_OF_ONE) / v_move**2
    return -np.expm1(-rate * (speed**2 + _EPSILON * v_move**2))


def _blocks(strips: Any) -> Any:
    """Number of blocks of a number of strips."""
    return strips * (strips + 1) // 2
