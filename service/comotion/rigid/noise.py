"""Noise of each trajectory, from its source where published, else from the trajectory itself."""

import numpy as np

from ..arrays import Floats, Ints, Slots, Stamps
from .sampling import last_differences, mean_square
from .tracks import Tracks

# Median of a chi-squared variable with dim degrees of freedom.
_CHI2_MEDIAN = {2: 1.386, 3: 2.366}
# Beyond this many samples a trajectory's own estimate is as good as its pool ever was.
_ENOUGH = 60
READ = 4 * _ENOUGH
"""Newest samples of a trajectory that its noise is read off."""
# Noise below this share of the scene is below float32, in which positions travel.
_FLOOR = 1e-6
# Noise as a share of the scene before anything is known.
_FIRST_GUESS = 1e-3


class Differences:
    """Median squared third difference of every trajectory; each difference is computed once.

    Slots are those of the window. Neither turning nor shifting nor delaying a source changes them.
    """

    def __init__(self) -> None:
        self._key: Stamps = np.zeros(0, np.int64)
        self._newest: Stamps = np.zeros(0, np.int64)
        self._written: Slots = np.zeros(0, np.intp)
        self._squares: Floats = np.zeros((0, READ))
        self._median: Floats = np.zeros(0)
        self._count: Slots = np.zeros(0, np.intp)
        self._asked: Slots = np.zeros(0, np.intp)

    def rewritten(self, slots: Slots) -> None:
        """Observations have come between others: what is known of these slots is void."""
        self._key[slots[slots < len(self._key)]] = -1

    def read(self, tracks: Tracks, gap_ns: Stamps) -> tuple[Floats, Ints]:
        """Median over the newest :data:`READ` samples and the count of differences, [N] each."""
        self._grow(int(tracks.slot.max(initial=-1)) + 1)
        last_differences(
            tracks.times,
            tracks.positions,
            tracks.start,
            tracks.stop,
            gap_ns,
            tracks.slot,
            tracks.key,
            self._key,
            self._newest,
            self._written,
            self._squares,
            self._median,
            self._count,
            self._asked,
        )
        return self._median[tracks.slot], self._count[tracks.slot]

    def _grow(self, capacity: int) -> None:
        extra = capacity - len(self._key)
        if extra <= 0:
            return
        extra = max(extra, len(self._key))
        self._key = np.concatenate([self._key, np.full(extra, -1)])
        for name in ("_newest", "_written", "_squares", "_median", "_count", "_asked"):
            column = getattr(self, name)
            setattr(self, name, np.concatenate([column, np.zeros((extra, *column.shape[1:]), column.dtype)]))


def noise_variance(
    tracks: Tracks, squared: Floats, count: Ints, own: Ints, pool: float, *, on_arm: bool
) -> Floats:
    """Noise variance of a coordinate for trajectories `own`, float64 [n].

    The median squared third divided difference of a trajectory's own samples (never interpolated
    ones), over the median of chi-squared, is its variance; with few samples it is drawn to the
    median of its source, worth `pool` samples. A published sigma stands in for both;
    at the end of an orientation's arm it is a lower bound, as turning is noisy too.

    Parameters
    ----------
    squared, count
        float64 [n] and intp [n]: that median, and over how many.
    """
    estimate = squared / _CHI2_MEDIAN[tracks.dim]
    source = tracks.source[own]
    extent = tracks.extent()
    known = count > 0
    scene = float(np.median(estimate[known])) if known.any() else (_FIRST_GUESS * extent) ** 2
    variance = np.zeros(len(own))
    for one in np.unique(source).tolist():
        mine = source == one
        pooled = float(np.median(estimate[mine & known])) if (mine & known).any() else scene
        n = np.minimum(count[mine], _ENOUGH)
        variance[mine] = (pool * pooled + n * estimate[mine]) / (pool + n)
    published = mean_square(tracks.sigma, tracks.start[own], tracks.stop[own])
    if on_arm:
        published = np.maximum(published, variance)
    variance = np.where(np.isfinite(published), published, variance)
    return np.maximum(variance, (_FLOOR * extent) ** 2)
