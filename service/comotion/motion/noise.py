"""Noise of each trajectory, from its source where published, else from the trajectory itself."""

import numpy as np

from ..window import Floats, Stamps
from .sampling import difference_noise
from .tracks import Ints, Tracks

# Median of a chi-squared variable with dim degrees of freedom.
_CHI2_MEDIAN = {2: 1.386, 3: 2.366}
# Beyond this many samples a trajectory's own estimate is as good as its pool ever was.
_ENOUGH = 60
_READ = 4 * _ENOUGH
# Noise below this share of the scene is below float32, in which positions travel.
_FLOOR = 1e-6
# Noise as a share of the scene before anything is known.
_FIRST_GUESS = 1e-3


def noise_variance(
    tracks: Tracks, positions: Floats, own: Ints, gap_ns: Stamps, pool: float, *, on_arm: bool
) -> Floats:
    """Noise variance of a coordinate for trajectories `own`, float64 [n].

    The median squared third divided difference of a trajectory's own samples (never interpolated
    ones), over the median of chi-squared, is its variance; with few samples it is drawn to the
    median of its source, worth `pool` samples. A published sigma stands in for both;
    at the end of an orientation's arm it is a lower bound, as turning is noisy too.
    """
    squared, count = difference_noise(
        tracks.times, positions, tracks.start[own], tracks.stop[own], gap_ns, _READ
    )
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
    published = _published(tracks)[own]
    if on_arm:
        published = np.maximum(published, variance)
    variance = np.where(np.isfinite(published), published, variance)
    return np.maximum(variance, (_FLOOR * extent) ** 2)


def _published(tracks: Tracks) -> Floats:
    """Mean square of the published sigmas of each trajectory, NaN where one is missing, [N]."""
    sums = np.add.reduceat(tracks.sigma**2, tracks.start)
    return np.asarray(sums / np.diff(tracks.offsets), np.float64)
