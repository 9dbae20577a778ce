"""Weighted sums over the distance samples of every pair of trajectories, and their variance (3.3)."""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .window import Bools, Floats, Slots

_MIN_SAMPLES = 2
# Below this share of what the sums have held, too few digits of a variance are left.
_SOUND = 1e-9
_SUMS = ("weight", "first", "second", "shift", "peak")


@lru_cache(maxsize=4)
def each_pair(n: int) -> tuple[Slots, Slots]:
    """Indices i < j of all pairs of n, in the order of SciPy's pdist."""
    i, j = np.triu_indices(n, 1)
    return i, j


class PairSums:
    """What is kept of the samples of a pair: their number, and sums of w, w·d' and w·d'².

    Attributes
    ----------
    samples
        int32 [capacity, capacity], common samples of a pair; this and all that follow at
        [smaller slot, larger slot].
    weight, first, second
        float64: sums of w, w·d' and w·d'² over the samples, with d' = d − `shift`.
    shift
        float64: about the distance when the pair began. About zero, E[d²] − E[d]² would cancel.
    peak
        float64: the largest that `second` has been, the measure of the rounding it carries.
    """

    def __init__(self) -> None:
        self.samples: NDArray[np.int32] = np.zeros((0, 0), np.int32)
        self.weight: Floats = np.zeros((0, 0))
        self.first: Floats = np.zeros((0, 0))
        self.second: Floats = np.zeros((0, 0))
        self.shift: Floats = np.zeros((0, 0))
        self.peak: Floats = np.zeros((0, 0))

    def fit(self, capacity: int) -> None:
        """Make room for slots below `capacity`."""
        extra = capacity - len(self.samples)
        if extra:
            self.samples = np.pad(self.samples, (0, extra))
            for name in _SUMS:
                setattr(self, name, np.pad(getattr(self, name), (0, extra)))

    def at(self, these: Slots, those: Slots) -> Slots:
        """Where pairs of slots are in the flattened matrices, which are faster to index than by two."""
        return np.minimum(these, those) * len(self.samples) + np.maximum(these, those)

    def add(self, pairs: Slots, distance: Floats, weight: Floats, sign: int) -> None:
        """Add (`sign` 1) or take out (-1) one sample of each of some pairs, all of one shape."""
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

    def add_runs(
        self, pairs: Slots, runs: Slots, distance: Floats, weight: Floats, valid: Bools, sign: int
    ) -> None:
        """Add or take out any number of samples of each of some pairs.

        Parameters
        ----------
        pairs
            intp [n, k], distinct where they have a sample.
        runs
            intp [k], ascending from 0: the samples of column c are `runs[c]` up to the next run.
        distance, weight, valid
            [n, m]; samples that are not valid do not exist.
        """
        weight = np.where(valid, weight, 0.0)
        samples = np.add.reduceat(valid, runs, axis=1, dtype=np.int32)
        some = samples > 0
        total = np.add.reduceat(weight, runs, axis=1)
        fresh = some & (self.samples.reshape(-1)[pairs] == 0)
        if fresh.any():
            mean = np.add.reduceat(weight * distance, runs, axis=1)[fresh] / total[fresh]
            self._begin(pairs[fresh], mean)
        lengths = np.diff(runs, append=distance.shape[1])
        distance = distance - np.repeat(self.shift.reshape(-1)[pairs], lengths, axis=1)
        first = np.add.reduceat(weight * distance, runs, axis=1)
        second = np.add.reduceat(weight * distance**2, runs, axis=1)
        pairs = pairs[some]
        self.samples.reshape(-1)[pairs] += sign * samples[some]
        self.weight.reshape(-1)[pairs] += sign * total[some]
        self.first.reshape(-1)[pairs] += sign * first[some]
        self.second.reshape(-1)[pairs] += sign * second[some]

    def _begin(self, pairs: Slots, distance: Floats) -> None:
        """The first sample of pairs, or the first after all have gone."""
        self.shift.reshape(-1)[pairs] = distance
        for sums in (self.weight, self.first, self.second, self.peak):
            sums.reshape(-1)[pairs] = 0.0

    def forget(self, slots: Slots) -> None:
        """Drop all samples of trajectories."""
        self.samples[slots] = 0
        self.samples[:, slots] = 0

    def note_peak(self) -> None:
        """To be called before anything is taken out."""
        np.maximum(self.peak, self.second, out=self.peak)

    def read(self, slots: Slots) -> tuple[Floats, Bools, Bools]:
        """Variances [n, n], which of them exist, and which of those have drowned in rounding.

        One wild observation that comes and leaves would otherwise spoil its pairs for good.
        """
        pairs = self.at(slots[:, None], slots)
        comparable = self.samples.reshape(-1)[pairs] >= _MIN_SAMPLES
        weight = np.where(comparable, self.weight.reshape(-1)[pairs], 1.0)
        first, second = self.first.reshape(-1)[pairs], self.second.reshape(-1)[pairs]
        squares = second - first**2 / weight
        most = np.maximum(self.peak.reshape(-1)[pairs], second)
        variance = np.where(comparable, np.maximum(squares, 0.0) / weight, 0.0)
        return variance, comparable, comparable & (squares < _SOUND * most)
