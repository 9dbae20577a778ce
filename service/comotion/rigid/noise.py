"""In trajectories, out the noise variance of each (step 4): published, else from its own observations."""

import numpy as np

from ..arrays import Floats, Ints, Slots, Stamps
from .kernels.differences import last_differences
from .kernels.records import DifferenceMemory
from .kernels.resampling import mean_square
from .tracks import Tracks

# Median of a chi-squared variable with dim degrees of freedom.
_CHI2_MEDIAN = {2: 1.386, 3: 2.366}
# The weight of a trajectory's own estimate no longer grows beyond so many differences; chosen on the scenes
# of docs/research/accuracy.md.
_MOST_DIFFERENCES = 60
NOISE_OBSERVATIONS = 4 * _MOST_DIFFERENCES
"""The noise of a trajectory is estimated on so many of its newest observations."""
# Share of the scene's extent: less noise than this is below the precision of float32, in which positions
# are sent.
_LEAST_NOISE = 1e-6
# Share of the scene's extent that is taken for the noise before there is any estimate; chosen on the scenes
# of docs/research/accuracy.md.
_FIRST_GUESS = 1e-3


class Differences:
    """Median squared third difference of every trajectory; computes each difference once.

    The memory has one entry for each slot of the window. Turn, shift and delay of a source change no
    difference.
    """

    def __init__(self) -> None:
        self._memory = DifferenceMemory(
            key=np.zeros(0, np.int64),
            newest=np.zeros(0, np.int64),
            written=np.zeros(0, np.intp),
            squares=np.zeros((0, NOISE_OBSERVATIONS)),
            median=np.zeros(0),
            used=np.zeros(0, np.intp),
            read=np.zeros(0, np.intp),
        )

    def rewritten(self, slots: Slots) -> None:
        """Forget the differences of these slots, intp [n]: observations came between others."""
        key = self._memory.key
        key[slots[slots < len(key)]] = -1

    def read(self, tracks: Tracks, gap_ns: Stamps) -> tuple[Floats, Ints]:
        """Median squared third difference and the count of differences, float64 [N] and intp [N].

        Takes the newest :data:`NOISE_OBSERVATIONS` observations, and no difference across a gap longer than
        `gap_ns` int64 [N].
        """
        self._grow(int(tracks.slot.max(initial=-1)) + 1)
        last_differences(tracks.observations, gap_ns, tracks.slot, tracks.key, self._memory)
        return self._memory.median[tracks.slot], self._memory.used[tracks.slot]

    def _grow(self, capacity: int) -> None:
        known = len(self._memory.key)
        if capacity > known:
            extra = max(capacity - known, known)
            grown = [np.concatenate([c, np.zeros((extra, *c.shape[1:]), c.dtype)]) for c in self._memory]
            self._memory = DifferenceMemory(*grown)
            self._memory.key[known:] = -1


def noise_variance(
    tracks: Tracks, squared: Floats, count: Ints, own: Ints, pool: float, *, on_arm: bool
) -> Floats:
    """Noise variance of a coordinate for trajectories `own`, float64 [n].

    It is the median squared third divided difference of a trajectory's own observations (never of
    interpolated positions), over the median of chi-squared. With few observations it is drawn towards the
    median of its source. A published sigma replaces it; but at the end of an arm a published sigma is only
    a lower bound, as the orientation is noisy too.

    Parameters
    ----------
    squared, count
        float64 [n] and intp [n], median squared third difference, and the count of differences.
    own
        intp [n], indices of trajectories.
    pool
        Differences that the median of the source is worth.
    on_arm
        Whether the differences are those of the ends of arms (see :mod:`comotion.rigid.resampling`).
    """
    estimate = squared / _CHI2_MEDIAN[tracks.dim]
    source = tracks.source[own]
    extent = tracks.extent
    known = count > 0
    scene = float(np.median(estimate[known])) if known.any() else (_FIRST_GUESS * extent) ** 2
    variance = np.zeros(len(own))
    for one in np.unique(source).tolist():
        mine = source == one
        pooled = float(np.median(estimate[mine & known])) if (mine & known).any() else scene
        n = np.minimum(count[mine], _MOST_DIFFERENCES)
        variance[mine] = (pool * pooled + n * estimate[mine]) / (pool + n)
    published = mean_square(tracks.sigma, tracks.start[own], tracks.stop[own])
    if on_arm:
        published = np.maximum(published, variance)
    variance = np.where(np.isfinite(published), published, variance)
    return np.maximum(variance, (_LEAST_NOISE * extent) ** 2)
