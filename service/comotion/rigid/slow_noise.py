"""Estimates slow noise, which differences of successive observations do not show (step 4).

Drift, slip of features, and noise that is correlated over time cancel in those differences. They show in the
distances of features that lie side by side: most such pairs are on one body.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from ..arrays import Bools, Floats, Ints, last_true, quantiles, thinned
from ..geometry.frames import ENOUGH, FEW, FEWEST

# The quantile of the pairs that is read: up to this share of the nearest pairs must be on one body.
_QUANTILE = 0.4
# s; lags at which the change of distances is read.
_LAGS = 2.0 ** np.arange(7) / 15
# s; correlation times that are tried: octaves up to half of the usual window, and two beyond it.
_TIMES = np.array([2, 4, 8, 16, 32, 64, 256, 1024]) / 15
# Least white noise, in tolerances: interpolation and rounding leave at least this.
_LEAST_WHITE = 0.05


@dataclass(frozen=True)
class SlowNoise:
    """Noise of a source in units of its tolerance: white, and a first-order autoregression.

    `slow` is the variance of the latter; `time` its correlation time in frames. Where that is far longer than
    the window, it is a random walk.
    """

    white: float = 1.0
    slow: float = 0.0
    time: float = 1.0

    @property
    def persistence(self) -> float:
        """Correlation of neighbouring frames."""
        return float(np.exp(-1 / self.time)) if self.slow > 0 else 0.0

    def factor(self, frames: int) -> float:
        """Variance about the mean over a number of frames."""
        return self.white + self.slow * float(1 - np.exp(-frames / 3 / self.time))


def slow_noise(y: Floats, w: Floats, tolerance: Floats, rows: Ints, frame_rate: float) -> SlowNoise:
    """Slow noise of one source, from the variograms of the distances of its nearest pairs.

    The variogram at lag k, half the mean squared difference of a distance, is that of the white noise plus
    slow (1 - exp(-k / time)) of the slow one. The tolerance stands where it covers all of it.

    Parameters
    ----------
    y, w, tolerance
        float64 [P, F, 3], [P, F] (0: unobserved) and [P], variance of a coordinate.
    rows
        intp [n], current rows of the source.
    frame_rate
        Hz.
    """
    if len(rows) <= FEW:
        return SlowNoise()
    # A row and its nearest ones: beyond three, more and more pairs span two bodies.
    drawn, positions = thinned(rows, ENOUGH), y[rows, last_true(w[rows] > 0)]
    nearest = cKDTree(positions).query(positions[np.searchsorted(rows, drawn)], FEW + 1)[1][:, 1:]
    first, second = np.repeat(drawn, FEW), rows[nearest].ravel()
    both, between = (w[first] > 0) & (w[second] > 0), y[first] - y[second]
    apart = np.sqrt(np.einsum("nfi,nfi->nf", between, between))
    lags, usual = _variogram(both, apart, tolerance[first] + tolerance[second], frame_rate)
    # Pairs at rest may be without any noise.
    if len(lags) < FEW or usual.min() <= 0:
        return SlowNoise()
    best, least, times, wanted = SlowNoise(), np.inf, _TIMES * frame_rate, np.ones(len(lags))
    parts = np.stack(np.broadcast_arrays(1.0, 1 - np.exp(-lags / times[:, None])), 2) / usual[:, None]
    for time, of_time in zip(times.tolist(), parts, strict=True):
        (a, b), error = nnls(of_time, wanted)
        if error < least:
            best, least = SlowNoise(max(float(a), _LEAST_WHITE), float(b), time), error
    return best if best.factor(w.shape[1]) > 1 else SlowNoise()


def _variogram(both: Bools, apart: Floats, tolerance: Floats, frame_rate: float) -> tuple[Floats, Floats]:
    """Lags in frames at which enough pairs of rows are seen, and the usual variogram there, in tolerances.

    Of n pairs: bool [n, F], whether both are seen; float64 [n, F], their distance; and its tolerance, [n].
    """
    lags, usual = [], []
    for lag in np.unique(np.maximum(np.round(_LAGS * frame_rate), 1).astype(np.intp)).tolist():
        seen = both[:, lag:] & both[:, :-lag]
        count = seen.sum(1)
        enough = count >= FEWEST
        if enough.sum() >= FEWEST:
            squares = np.square((apart[:, lag:] - apart[:, :-lag]) * seen).sum(1)
            variogram = 0.5 * squares[enough] / count[enough]
            usual += quantiles(variogram / tolerance[enough], (_QUANTILE,))
            lags.append(float(lag))
    return np.array(lags), np.array(usual)
